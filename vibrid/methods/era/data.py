"""What data are taken for: responses, decays, correlations or a forced record."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...chunks import Stream, open_stream
from ...errors import DataError, OptionError
from ...fit import Finding
from ...gram import BlockGram, reduce
from ...record import FrequencyResponses, ImpulseResponses, Record
from ..finite_response import fir, truncation
from .correlations import from_correlations
from .decays import DECAYED, energy_ratio, from_decays
from .evidence import Evidence
from .responses import Mask, from_frequency_responses, from_impulse_responses

Data = ImpulseResponses | FrequencyResponses | Record | Sequence[Record] | Stream
RESPONSES = ("auto", "decay", "correlations", "fir")
FIR_LAGS = 1000  # of a forced record, where sizes are left out
FIR_WEIGHTS = 1200  # weights of an output: the cost of the factorization grows with the cube
FIR_ROWS = 4000  # of the Gram, all channels: 128 MB
CUT_LIMIT = 0.05  # of the largest response, left at the last lags
SAMPLES_PER_WEIGHT = 4  # fewer leave nothing but noise


def decomposed(
    method: Any, data: Data, offset: str, feedthrough: Mask, gram: BlockGram | None
) -> Evidence:
    """Return the decomposition of whatever the data are."""
    if isinstance(data, ImpulseResponses | FrequencyResponses):
        _check_no_record_options(method, type(data).__name__)
    if isinstance(data, ImpulseResponses):
        return from_impulse_responses(method, data, feedthrough)
    if isinstance(data, FrequencyResponses):
        return from_frequency_responses(method, data, feedthrough)
    stream = data if isinstance(data, Stream) else open_stream(data, offset)
    kind = method.responses
    if stream.n_inputs:
        return _forced(method, stream, feedthrough, gram)
    if kind == "fir":
        raise OptionError(
            'responses="fir" needs inputs; the record has none. Name them (select(), or --inputs), '
            'or use responses="decay" or "correlations".'
        )
    if kind == "correlations":
        return from_correlations(method, stream, feedthrough, gram, "correlations as asked for")
    if kind == "decay":
        return from_decays(method, stream, feedthrough, gram, "a decay as asked for")
    if method.references is not None:
        reason = "correlations of ambient vibration, because references are named"
        return from_correlations(method, stream, feedthrough, gram, reason)
    return _judged(method, stream, feedthrough, gram)


def _check_no_record_options(method: Any, data: str) -> None:
    """Refuse options that say how to take a record."""
    for name, unset in (("responses", "auto"), ("references", None)):
        if getattr(method, name) != unset:
            raise OptionError(
                f"{name}={getattr(method, name)!r} says how to take a record; {data} are taken "
                f"as they are. Leave {name} out."
            )


def _judged(method: Any, stream: Stream, feedthrough: Mask, gram: BlockGram | None) -> Evidence:
    """Take outputs alone for a decay where they decay or have a rank, else for ambient."""
    ratio = energy_ratio(stream)
    words = f"the last quarter has {100 * ratio:.3g} % of the energy of the first"
    force = 'responses="{0}" takes it for {1}'
    if ratio < DECAYED:
        other = force.format("correlations", "ambient vibration")
        reason = f"a free decay, because {words} (limit {100 * DECAYED:g} %); {other}"
        return from_decays(method, stream, feedthrough, gram, reason)
    try:
        reason = f"a free motion, because the data have a rank; {words}"
        found = from_decays(method, stream, feedthrough, gram, reason)
    except DataError:
        found = None  # too short to tell: correlations say what they need
    if found is not None and found.rank_limited:
        return found
    other = force.format("decay", "a free decay")
    reason = (
        f"correlations of ambient vibration, because {words} (a decay has less than "
        f"{100 * DECAYED:g} %); {other}"
    )
    try:
        return from_correlations(method, stream, feedthrough, gram, reason)
    except DataError as error:
        raise DataError(
            f"{error} The record was taken for ambient vibration, because {words}; {other} "
            "(--responses decay)."
        ) from error


def _forced(method: Any, stream: Stream, feedthrough: Mask, gram: BlockGram | None) -> Evidence:
    """Estimate finite impulse responses of a record with inputs, and realize them."""
    if method.responses not in ("auto", "fir"):
        raise OptionError(
            f'responses="{method.responses}" takes outputs alone; the record has '
            f"{stream.n_inputs} inputs. Leave them out (select(inputs=[]), or --inputs '' with "
            '--outputs), or use responses="fir".'
        )
    if method.references is not None:
        raise OptionError(
            f"references={method.references} belong to correlations of outputs alone; the record "
            f"has {stream.n_inputs} inputs. Leave either out."
        )
    n_lags = _fir_lags(method, stream)
    try:
        responses = fir(stream, n_lags, feedthrough=feedthrough)
    except (DataError, OptionError) as error:
        if method.rows is None or method.columns is None:
            raise
        sizes = f"rows={method.rows} and columns={method.columns}"
        raise type(error)(f"{sizes} need responses of {n_lags} lags. {error}") from error
    cut = truncation(responses)
    return from_impulse_responses(
        method,
        responses,
        feedthrough,
        stream=stream,
        gram=reduce(stream, n_lags) if gram is None else gram.shorten(n_lags),
        reasons=(f"finite impulse responses of {n_lags} lags from inputs and outputs",),
        findings=_cut_findings(cut, n_lags),
        known={"responses": "fir", "fir_truncation": cut},
    )


def _cut_findings(cut: float, n_lags: int) -> tuple[Finding, ...]:
    if cut <= CUT_LIMIT:
        return ()
    return (
        Finding(
            "responses-cut-off",
            "warning",
            f"The finite impulse responses are cut off: after {n_lags} lags {100 * cut:.2g} % of "
            f"the largest is left (limit {100 * CUT_LIMIT:g} %), which disturbs all lags.",
            "Use more rows and columns, or OKID, which needs no response that has died.",
        ),
    )


def _fir_lags(method: Any, stream: Stream) -> int:
    """Return how many lags are estimated, D included."""
    if method.rows is not None and method.columns is not None:
        return int(method.highest_lag(method.rows, method.columns)) + 1
    m, longest = stream.n_inputs, max(segment.length for segment in stream.segments)
    most = min(
        FIR_LAGS,
        FIR_WEIGHTS // m,
        FIR_ROWS // (m + stream.n_outputs),
        longest // (SAMPLES_PER_WEIGHT * m + 1),
    )
    return max(most, 4)
