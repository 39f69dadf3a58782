"""Commands, exit statuses and errors of `vibrid`."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter, UnknownOptionError, UnusedCliTokensError
from rich.console import Console, RenderableType
from rich.text import Text

from ..errors import DataError, OptionError, VibridError
from ..files import load
from ..files.fits import is_fit
from ..files.survey import survey
from ..fit import Fit
from ..physical import fit_rayleigh
from ..record import FrequencyResponses
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
from ..reporting.physical import describe_physical, physical_as_json
from . import demo as demos
from .options import RESULTS, Identifying, MethodOptions, Physical, Reading, Results
from .work import identify_file, progress_on

DONE, FAILED, WRONG_USE, INTERRUPTED = 0, 1, 2, 130
DEBUG = "VIBRID_DEBUG"
REPEATABLE = ("--quantity", "--dof", "--unit")

AS_READ, AUTOMATIC, NO_OPTIONS, PRINTED = Reading(), Identifying(), MethodOptions(), Results()
AS_FOUND = Physical()

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
    with progress_on(_errors()) as progress:
        outcome = identify_file(file, reading, identifying, options, results.save, progress)
    if isinstance(outcome, ResponsesOutcome):
        if results.json:
            _print_json(responses_outcome_as_json(outcome))
        else:
            _print(summary_of_responses(outcome))
    elif results.json:
        _print_json(outcome_as_json(outcome))
    else:
        _print(summary(outcome))
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
            _print_json(responses_as_json(content, file.name))
        else:
            _print(describe_responses(content, file.name))
        return DONE
    looked = survey(content)
    if json:
        _print_json(survey_as_json(looked, content))
    else:
        _print(describe_record(looked, content))
    return DONE


def _info_of_fit(file: Path, reading: Reading, as_json: bool) -> int:
    if reading != AS_READ:
        raise OptionError(f"{file} holds a saved model; the options for records do not apply.")
    fit = load(file)
    if as_json:
        _print_json(fit_as_json(fit, file.name))
    else:
        _print(describe_fit(fit, file.name))
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
        _print_json(physical_as_json(model, law))
    else:
        _print(describe_physical(model, law))
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
    with progress_on(_errors()) as progress:
        outcome = identify_file(file, reading, identifying, options, results.save, progress)
    filtered = isinstance(outcome, Outcome) and outcome.band is not None
    return outcome.fit, filtered


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
    _settle_streams()
    with warnings.catch_warnings():
        if not os.environ.get(DEBUG):  # what a user should know is a finding or an error
            warnings.simplefilter("ignore")
        return _run(list(sys.argv[1:] if arguments is None else arguments))


def _run(arguments: list[str]) -> int:
    try:
        status = app(
            spread(arguments),
            console=_output(),
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
        sys.stdout.flush()
        return status if isinstance(status, int) else DONE
    except CycloptsError as error:
        return _fail(_wrong_use(error), WRONG_USE)
    except OptionError as error:
        return _fail(str(error), WRONG_USE)
    except VibridError as error:
        return _fail(str(error), FAILED)
    except KeyboardInterrupt:
        return _fail("Interrupted.", INTERRUPTED)
    except BrokenPipeError:
        return _pipe_closed()
    except MemoryError:
        return _fail("Not enough memory; choose fewer channels or a narrower --band.", FAILED)
    except OSError as error:
        _give_up_output()  # it may be what failed, and would fail again at exit
        where = f"{error.filename}: " if error.filename else "Reading or writing failed: "
        return _fail(f"{where}{error.strerror or error}.", FAILED)
    except Exception as error:
        return _bug(error)


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
            _print(Text(f"{k}. {introduction}\n", style="bold"))
        with progress_on(_errors()) as progress:
            outcome = run(folder, progress)
        found &= outcome.is_reference_found
        if as_json:
            said.append(outcome_as_json(outcome))
        else:
            _print(summary(outcome))
            _print(Text(""))
    if as_json:
        _print_json({"demo": said})
    if not found:
        raise DataError("The demo missed known frequencies; this is a defect, please report it.")
    return DONE


def _output() -> Console:
    return Console(markup=False, highlight=False, emoji=False)


def _errors() -> Console:
    return Console(stderr=True)


def _print(what: RenderableType) -> None:
    console = _output()
    if console.is_terminal:
        console.print(what)
        return
    with console.capture() as captured:
        console.print(what)
    # columns are padded; in a file or pipe nobody wants blanks at the ends of lines
    print("\n".join(line.rstrip() for line in captured.get().splitlines()))


def _print_json(facts: dict[str, Any]) -> None:
    print(json.dumps(facts, ensure_ascii=False, allow_nan=False, indent=2))


def _fail(message: str, status: int) -> int:
    print(f"vibrid: {message}" if status != INTERRUPTED else message, file=sys.stderr)
    return status


def _wrong_use(error: CycloptsError) -> str:
    if isinstance(error, UnknownOptionError) and error.token.value == "-":
        return "Standard input is not read; write it to a file and give its path."
    if isinstance(error, UnusedCliTokensError):
        rest = " ".join(error.unused_tokens or ())
        return f"Nothing takes the argument {rest!r}; give one FILE, and options by name."
    words = re.sub(r'^Command "[^"]*" parameter ', "", " ".join(str(error).split()))
    words = words.replace("positional arguments. Only got", "values; got")
    return f"{words} See {' '.join(['vibrid', *(error.command_chain or ())])} --help."


def _bug(error: Exception) -> int:
    if os.environ.get(DEBUG):
        traceback.print_exc()
    words = " ".join(str(error).split())
    return _fail(
        f"internal error, please report it: {type(error).__name__}: {words} "
        f"({DEBUG}=1 shows where).",
        FAILED,
    )


def _pipe_closed() -> int:
    """End quietly when the reader, such as head, has gone."""
    _give_up_output()
    return FAILED


def _give_up_output() -> None:
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _settle_streams() -> None:
    """Print to nowhere where a stream is closed, and never fail at a letter it cannot encode."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
