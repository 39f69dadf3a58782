"""Commands, exit statuses and errors of `vibrid`."""

from __future__ import annotations

import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Annotated

from cyclopts import App, CycloptsError, Parameter
from rich.text import Text

from ..errors import DataError, OptionError, VibridError
from ..files import load
from ..files.fits import is_fit
from ..files.survey import survey
from ..fit import Fit
from ..physical import fit_rayleigh
from ..record import FrequencyResponses, Record
from ..reporting import (
    Outcome,
    ResponsesOutcome,
    describe_fit,
    describe_record,
    describe_responses,
    fit_as_json,
    outcome_as_json,
    responses_as_json,
    responses_outcome_as_json,
    summary,
    summary_of_responses,
    survey_as_json,
)
from ..reporting.blind import blind_as_json, describe_blind
from ..reporting.physical import describe_physical, physical_as_json
from . import demo as demos
from .console import (
    DEBUG,
    DONE,
    FAILED,
    INTERRUPTED,
    WRONG_USE,
    bug,
    errors,
    fail,
    give_up_output,
    output,
    pipe_closed,
    settle_streams,
    show,
    show_json,
    wrong_use,
)
from .making import Blind, Physical
from .options import RESULTS, Identifying, MethodOptions, Reading, Results
from .work import identify_file, progress_on

REPEATABLE = ("--quantity", "--dof", "--unit")

AS_READ, AUTOMATIC, NO_OPTIONS, PRINTED = Reading(), Identifying(), MethodOptions(), Results()
AS_FOUND, UNKNOWN_FORCE = Physical(), Blind()

Json = Annotated[
    bool, Parameter(help="Print one JSON object instead of text. Default: text.", group=RESULTS)
]

app = App(
    name="vibrid",
    help=(
        "From vibration records to state-space models and modes.\n\n"
        "Begin with: vibrid demo; with a file of your own: vibrid info FILE. "
        "The options of a command: vibrid COMMAND --help"
    ),
    version=lambda: metadata.version("vibrid"),
    help_format="plaintext",
    default_parameter=Parameter(negative=(), show_default=False),
    suppress_keyboard_interrupt=False,
)


@app.command
def identify(
    file: Path,
    /,
    *,
    reading: Reading = AS_READ,
    identifying: Identifying = AUTOMATIC,
    options: MethodOptions = NO_OPTIONS,
    results: Results = PRINTED,
) -> int:
    """Identify a model and its modes from the record in a file.

    For example: vibrid identify run.csv --inputs hammer --band 0 50 --save run.vibrid.h5

    Parameters
    ----------
    file
        CSV, text, NPY, NPZ, MAT, HDF5, UFF 58, WAV or TDMS.
    """
    with progress_on(errors()) as progress:
        outcome = identify_file(file, reading, identifying, options, results.save, progress)
    if isinstance(outcome, ResponsesOutcome):
        if results.json:
            show_json(responses_outcome_as_json(outcome))
        else:
            show(summary_of_responses(outcome))
    elif results.json:
        show_json(outcome_as_json(outcome))
    else:
        show(summary(outcome))
    return DONE


@app.command
def info(file: Path, /, *, reading: Reading = AS_READ, json: Json = False) -> int:
    """Say what a file holds: channels, length, rate, gaps, drift, spectrum.

    Parameters
    ----------
    file
        CSV, text, NPY, NPZ, MAT, HDF5, UFF 58, WAV or TDMS; or a model written by --save.
    """
    if is_fit(file):
        return _info_of_fit(file, reading, json)
    content = reading.read(file)
    if isinstance(content, FrequencyResponses):
        if json:
            show_json(responses_as_json(content, file.name))
        else:
            show(describe_responses(content, file.name))
        return DONE
    looked = survey(content)
    if json:
        show_json(survey_as_json(looked, content))
    else:
        show(describe_record(looked, content))
    return DONE


def _info_of_fit(file: Path, reading: Reading, as_json: bool) -> int:
    if reading != AS_READ:
        raise OptionError(f"{file} holds a saved model; the options for records do not apply.")
    fit = load(file)
    if as_json:
        show_json(fit_as_json(fit, file.name))
    else:
        show(describe_fit(fit, file.name))
    return DONE


@app.command
def physical(
    file: Path,
    /,
    *,
    reading: Reading = AS_READ,
    identifying: Identifying = AUTOMATIC,
    options: MethodOptions = NO_OPTIONS,
    making: Physical = AS_FOUND,
    results: Results = PRINTED,
) -> int:
    """Make mass, damping and stiffness matrices from a record or a saved model, with a verdict.

    For example: vibrid physical run.csv --inputs hammer --channels channels.csv --order 4

    Parameters
    ----------
    file
        A record (CSV, text, NPY, NPZ, MAT, HDF5, UFF 58, WAV, TDMS), or a model by --save.
    """
    fit, filtered = _fit_of(file, reading, identifying, options, results)
    model = making.of(fit, filtered)
    oscillating = int((model.poles.imag > 0).sum())
    law = fit_rayleigh(model) if oscillating > 1 else None
    if results.json:
        show_json(physical_as_json(model, law))
    else:
        show(describe_physical(model, law))
    return DONE


def _fit_of(
    file: Path,
    reading: Reading,
    identifying: Identifying,
    options: MethodOptions,
    results: Results,
) -> tuple[Fit, bool]:
    """Return the saved or identified model, and whether the record was filtered."""
    if is_fit(file):
        if (reading, identifying, options) != (AS_READ, AUTOMATIC, NO_OPTIONS):
            raise OptionError(f"{file} holds a saved model; it is not identified again.")
        return load(file), False
    with progress_on(errors()) as progress:
        outcome = identify_file(file, reading, identifying, options, results.save, progress)
    filtered = isinstance(outcome, Outcome) and outcome.band is not None
    return outcome.fit, filtered


@app.command
def blind(
    file: Path,
    /,
    *,
    dofs: Annotated[int, Parameter(help="Number of degrees of freedom: one sensor at each.")],
    reading: Reading = AS_READ,
    knowing: Blind = UNKNOWN_FORCE,
    results: Results = PRINTED,
) -> int:
    """Find M⁻¹K, M⁻¹D and unknown forces from sensors alone, with a verdict.

    Exits 1 where the data do not determine them: the rule that refuses is printed.
    For example: vibrid blind run.csv --outputs a1,a2,a3 --dofs 3 --excitation periodic

    Parameters
    ----------
    file
        A record (CSV, text, NPY, NPZ, MAT, HDF5, UFF 58, WAV, TDMS).
    """
    if results.save is not None:
        raise OptionError("--save is for models; keep a blind identification with --json.")
    content = reading.read(file)
    if not isinstance(content, Record):
        raise DataError(
            f"{file} holds frequency responses; blind identification takes time records."
        )
    with progress_on(errors()) as progress:
        fit = knowing.of(content, dofs, progress)
    if results.json:
        show_json(blind_as_json(fit))
    else:
        show(describe_blind(fit))
    return DONE if fit.accepted else FAILED


@app.command
def demo(
    file: Path | None = None,
    /,
    *,
    reading: Reading = AS_READ,
    identifying: Identifying = AUTOMATIC,
    options: MethodOptions = NO_OPTIONS,
    results: Results = PRINTED,
) -> int:
    """Identify two records, a real building and a simulated test; or a file of your own.

    The models are written to ./vibrid-demo, unless --save says otherwise.

    Parameters
    ----------
    file
        Your own record; the options are those of identify. Default: both demos.
    """
    if file is not None:
        target = results.save or demos.demo_folder() / f"{file.stem}.vibrid.h5"
        kept = replace(results, save=target)
        return identify(
            file, reading=reading, identifying=identifying, options=options, results=kept
        )
    if (reading, identifying, options, replace(results, json=False)) != (
        AS_READ,
        AUTOMATIC,
        NO_OPTIONS,
        PRINTED,
    ):
        raise OptionError("demo takes options only with a FILE (and --json always).")
    return _both_demos(results.json)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status: 0, 1 for data, 2 for wrong use, 130."""
    settle_streams()
    with warnings.catch_warnings():
        if not os.environ.get(DEBUG):  # what a user should know is a finding or an error
            warnings.simplefilter("ignore")
        return _run(list(sys.argv[1:] if arguments is None else arguments))


def _run(arguments: list[str]) -> int:
    try:
        status = app(
            spread(arguments),
            console=output(),
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
        sys.stdout.flush()
        return status if isinstance(status, int) else DONE
    except CycloptsError as error:
        return fail(wrong_use(error), WRONG_USE)
    except OptionError as error:
        return fail(str(error), WRONG_USE)
    except VibridError as error:
        return fail(str(error), FAILED)
    except KeyboardInterrupt:
        return fail("Interrupted.", INTERRUPTED)
    except BrokenPipeError:
        return pipe_closed()
    except MemoryError:
        return fail("Not enough memory; choose fewer channels or a narrower --band.", FAILED)
    except OSError as error:
        give_up_output()  # it may be what failed, and would fail again at exit
        where = f"{error.filename}: " if error.filename else "Reading or writing failed: "
        return fail(f"{where}{error.strerror or error}.", FAILED)
    except Exception as error:
        return bug(error)


def spread(tokens: list[str]) -> list[str]:
    """Repeat a flag before each of several NAME=VALUE, so that FILE may follow them.

    >>> spread(["--unit", "a=g", "b=g", "run.csv"])
    ['--unit', 'a=g', '--unit', 'b=g', 'run.csv']
    """
    done: list[str] = []
    flag = ""
    for k, token in enumerate(tokens):
        is_pair = re.match(r"[^-].*=", token) is not None and not Path(token).exists()
        if flag and is_pair and tokens[k - 1] != flag:
            done.append(flag)
        if token.startswith("-") or not is_pair:
            flag = token if token in REPEATABLE else ""
        done.append(token)
    return done


def _both_demos(as_json: bool) -> int:
    folder = demos.demo_folder()
    said, found = [], True
    runs: tuple[tuple[str, Callable[..., Outcome]], ...] = (
        (demos.BUILDING, demos.identify_building),
        (demos.SHAKER, demos.identify_shaker_test),
    )
    for k, (introduction, run) in enumerate(runs, start=1):
        if not as_json:
            show(Text(f"{k}. {introduction}\n", style="bold"))
        with progress_on(errors()) as progress:
            outcome = run(folder, progress)
        found &= outcome.is_reference_found
        if as_json:
            said.append(outcome_as_json(outcome))
        else:
            show(summary(outcome))
            show(Text(""))
    if as_json:
        show_json({"demo": said})
    if not found:
        raise DataError("The demo missed known frequencies; this is a defect, please report it.")
    return DONE
