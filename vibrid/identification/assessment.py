"""Score a fit on its own record, and on a part that a twin of it has not seen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..fit import Fit
from ..record import Floats, Record
from ..scores import InitialRule, fit_percent, start_samples, vaf_percent

RULES = {
    "map": "initial state by MAP from the first {count} samples, which are not scored",
    "least_squares": "initial state by least squares over all samples",
    "zero": "from rest",
}


@dataclass(frozen=True, eq=False)
class Assessment:
    """How well a model explains a stretch of data.

    Attributes
    ----------
    kind : "simulation" (from the inputs alone) or "prediction" (one step ahead)
    fit_percent, vaf_percent : array (n_outputs,) [%]
    rule : str
        How the initial state was found.
    start, stop : float
        The stretch that was scored [s].
    seen : bool
        Whether the model was identified on this stretch.
    """

    kind: Literal["simulation", "prediction"]
    fit_percent: Floats
    vaf_percent: Floats
    rule: str
    start: float
    stop: float
    seen: bool


def assess(fit: Fit, record: Record, initial: InitialRule = "map") -> Assessment:
    """Return the scores of a fit on the record it was identified on.

    Simulation from the inputs where there are any, else one-step prediction.

    Raises
    ------
    DataError
        The record is too short to find an initial state and score the rest.
    """
    count = start_samples(fit.order) if initial == "map" else 0
    scored = np.ones(record.n_samples, dtype=bool)
    for start, _ in record.segments():
        scored[start : start + count] = False
    rule = RULES[initial].format(count=count)
    return _scores(fit, record, _modelled(fit, record, initial), scored, rule, seen=True)


def assess_last(twin: Fit, record: Record, cut: int) -> Assessment:
    """Return the scores of a fit of samples [0, cut) on the rest of the record.

    The state at the cut is carried over: the model runs from the start of the record. A piece
    that begins after the cut gets a MAP initial state, whose samples are not scored.
    """
    known = {
        segment.start: state
        for segment, state in zip(twin.segments, twin.initial_states, strict=True)
    }
    unknown = np.full(twin.order, np.nan)
    starts = [start for start, _ in record.segments()]
    initial = np.array([known.get(start, unknown) for start in starts])
    scored = np.arange(record.n_samples) >= cut
    for start in starts:
        if start not in known:
            scored[start : start + start_samples(twin.order)] = False
    modelled = _modelled(twin, record, initial)
    rule = "state carried over"
    if any(start not in known for start in starts):
        rule += ", and by MAP after each gap (those samples are not scored)"
    return _scores(twin, record, modelled, scored, rule, seen=False)


def _modelled(fit: Fit, record: Record, initial: InitialRule | Floats) -> Floats:
    run = fit.simulate_record if record.n_inputs else fit.predict
    return run(record, initial)


def _scores(
    fit: Fit,
    record: Record,
    modelled: Floats,
    scored: NDArray[np.bool_],
    rule: str,
    *,
    seen: bool,
) -> Assessment:
    measured = np.asarray(record.outputs[:], dtype=np.float64)[scored]
    if len(measured) < 2:
        raise DataError(
            f"A record of {record.n_samples} samples is too short to score a model of order "
            f"{fit.order}: {len(measured)} samples are left, at least 2 are needed."
        )
    rows = np.flatnonzero(scored)
    return Assessment(
        "simulation" if record.n_inputs else "prediction",
        fit_percent(measured, modelled[scored]),
        vaf_percent(measured, modelled[scored]),
        rule,
        float(rows[0] * record.dt),
        float((rows[-1] + 1) * record.dt),
        seen,
    )
