"""The work behind `vibrid identify`: read, filter, identify, score, save."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from ..errors import DataError, OptionError, PathError, check_writable
from ..files import save
from ..files.survey import survey
from ..fit import Fit
from ..identification import Assessment, assess, assess_unseen, identify
from ..record import FrequencyResponses, Record
from ..reporting import Outcome, ResponsesOutcome
from .options import Identifying, MethodOptions, Reading, given_options, loaded, method_of

Progress = Callable[[str, int, int], None]

STEPS = {
    "read": "Reading the file",
    "survey": "Looking through the record",
    "filter": "Filtering to the band",
    "reduce": "Reducing the data",
    "orders": "Trying orders",
    "complete": "Completing the model",
    "eliminate": "Removing modes one by one",
    "refine": "Refining",
    "oscillations": "Finding modes and forces",
    "rows": "Looking for degrees of freedom without force",
    "subspace": "Separating modes and forces",
    "pieces": "Leaving out pieces",
    "score": "Scoring the model",
}


def identify_file(
    file: Path,
    reading: Reading,
    identifying: Identifying,
    options: MethodOptions,
    target: Path | None,
    progress: Progress,
) -> Outcome | ResponsesOutcome:
    """Return all that there is to say about a file, the model saved if `target` is given."""
    identifying.check()
    given = given_options(options)
    if identifying.method is not None:
        method_of(identifying.method, given)
    if target is not None:
        check_writable(target)
        _check_kept(target, (file, reading.channels))
    progress("read", 0, 1)
    content = reading.read(file)
    if isinstance(content, FrequencyResponses):
        return _identify_responses(content, file.name, identifying, given, target, progress)
    return identify_record(content, identifying, given, target, progress)


def _check_kept(target: Path, read: tuple[Path | None, ...]) -> None:
    """Refuse to write the model over a file that is read."""
    for path in read:
        if path is not None and path.exists() and target.exists() and path.samefile(target):
            raise PathError(f"--save would overwrite {path}, which is read; name another file.")


def _identify_responses(
    responses: FrequencyResponses,
    name: str,
    identifying: Identifying,
    given: dict[str, Any],
    target: Path | None,
    progress: Progress,
) -> ResponsesOutcome:
    """Identify from frequency responses, and save the model."""
    if identifying.band is not None:
        raise OptionError(f"--band filters time records; {name} holds frequency responses.")
    chosen = identifying.method or "era"
    fit = identify(
        responses,
        method_of(chosen, given),
        identifying.chosen_order(),
        feedthrough=identifying.feedthrough,
        stability=identifying.stability,
        refine=identifying.refine,
        progress=progress,
    )
    reason = "as asked for" if identifying.method else "because these are frequency responses"
    saved = None if target is None else save(fit, target)
    return ResponsesOutcome(responses, name, reason, fit, saved)


def identify_record(
    source: Record,
    identifying: Identifying,
    given: dict[str, Any],
    target: Path | None,
    progress: Progress,
    *,
    band_reason: str = "as asked for",
    score_unseen: Callable[[Record, Fit], Assessment | None] = assess_unseen,
    unseen_part: str = "the last quarter, by a model of the first three quarters",
) -> Outcome:
    """Identify a record as the options say, score it, and save the model."""
    name = identifying.method or ("n4sid" if source.n_inputs else "ssi")
    method = method_of(name, given)
    progress("survey", 0, 1)
    surveyed = survey(source)
    record = source
    if identifying.band is not None:
        progress("filter", 0, 1)
        record = loaded(source, "--band").to_band(*identifying.band)
    fit = identify(
        record,
        method,
        identifying.chosen_order(),
        offset=identifying.offset,
        feedthrough=identifying.feedthrough,
        stability=identifying.stability,
        refine=identifying.refine,
        progress=progress,
    )
    progress("score", 0, 1)
    return Outcome(
        source=source,
        record=record,
        survey=surveyed,
        band=identifying.band,
        band_reason=band_reason,
        method_reason=_method_reason(identifying, source),
        fit=fit,
        seen=_scored(fit, record),
        unseen=score_unseen(record, fit),
        unseen_part=unseen_part,
        saved=None if target is None else save(fit, target),
    )


def _method_reason(identifying: Identifying, record: Record) -> str:
    if identifying.method is not None:
        return "as asked for"
    return "because there are inputs" if record.n_inputs else "because there are no inputs"


def _scored(fit: Fit, record: Record) -> Assessment | None:
    try:
        return assess(fit, record)
    except DataError:  # too short to find an initial state and score the rest
        return None


@contextmanager
def progress_on(console: Console) -> Iterator[Progress]:
    """Show what is being done on a terminal; nothing elsewhere."""
    if not console.is_terminal:
        yield lambda what, done, total: None
        return
    with console.status("") as status:

        def report(what: str, done: int, total: int) -> None:
            count = f" ({done + 1} of {total})" if total > 1 else ""
            status.update(f"{STEPS.get(what, what)}{count} …")

        yield report
