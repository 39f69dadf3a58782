"""How well each order simulates the half of the data that it was not identified on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chunks import Segment, Stream
from ..errors import DataError
from ..fit import Fit
from ..scores import fit_percent, folds, start_samples
from .completion import Completion
from .options import by_transition
from .stability import is_stable

LONGEST_HALF = 20_000  # samples of a half: more only cost time
GRID = (1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 20, 24, 28, 32, 36, 40, 48, 54, 60)
ENOUGH = 1.05  # of the smallest error: what a smaller order may cost


def held_out_errors(
    stream: Stream,
    method: Any,
    feedthrough: bool | Sequence[bool] | None,
    orders: Sequence[int],
) -> dict[int, float]:
    """Return the relative simulation error of each order on unseen halves; {} if too short.

    Each half of every segment is simulated by a model of the other half; the initial state
    is MAP and its samples are not scored. Unstable orders are left out.

    Returns
    -------
    dict order → error
        Mean over outputs and halves of ‖y − ŷ‖ / ‖y − ȳ‖.
    """
    halves = halves_of(stream)
    skipped = start_samples(max(orders, default=0))
    if not all(scored_segments(half, skipped) for half in halves):
        return {}
    try:
        known = [method.decompose(half, feedthrough=feedthrough) for half in halves]
    except DataError:
        return {}
    errors: dict[int, list[float]] = {order: [] for order in orders}
    for decomposition, seen, unseen in zip(known, halves, halves[::-1], strict=True):
        for order in orders:
            if order > decomposition.largest_order:
                continue
            fit = simulated(method, decomposition, order, seen)
            if fit is not None:
                errors[order].append(unseen_error(fit, unseen, skipped))
    means = {order: float(np.mean(each)) for order, each in errors.items() if len(each) == 2}
    return {order: mean for order, mean in means.items() if np.isfinite(mean)}


def simulated(method: Any, decomposition: Any, order: int, stream: Stream) -> Fit | None:
    """Return the stable model of this order that simulates the stream best, or None.

    Without its Kalman gain, which a simulation does not need: half of the work.
    """
    fits = [option.realize(decomposition, order) for option in by_transition(method)]
    tried = [_bare(fit, stream) for fit in fits if is_stable(fit)]
    best = min(tried, key=lambda each: each.simulation_error, default=None)
    return None if best is None else best.complete("simulation")


def _bare(fit: Fit, stream: Stream) -> Completion:
    """Return the completion of the fit without its gain."""
    gain = np.zeros_like(fit.kalman_gain)
    return Completion(replace(fit, kalman_gain=gain), stream, compare=False)


def simulation_error(fit: Fit) -> float:
    """Return the relative rms error of a completed fit's simulation; infinite without one."""
    error = fit.diagnostics.figures.get("simulation_error", np.inf)
    return float(error) if np.isfinite(error) else np.inf


def smallest_enough(errors: dict[int, float]) -> int:
    """Return the smallest order whose error is within 5 % of the smallest error."""
    limit = ENOUGH * min(errors.values())
    return min(order for order, error in errors.items() if error <= limit)


def halves_of(stream: Stream) -> tuple[Stream, Stream]:
    """Return the stream of first halves and that of second halves, next to each other."""
    first, second = [], []
    for segment in stream.segments:
        if segment.length < 2:
            continue
        (_, middle), _ = folds(segment.length, 2)
        length = min(middle, LONGEST_HALF)
        cut = segment.start + middle
        first.append(Segment(segment.record, cut - length, cut))
        second.append(Segment(segment.record, cut, min(segment.stop, cut + length)))
    return (
        replace(stream, segments=tuple(first)),
        replace(stream, segments=tuple(second)),
    )


def scored_segments(unseen: Stream, skipped: int) -> list[Segment]:
    """Return the segments long enough to be scored: the same ones for every order."""
    return [segment for segment in unseen.segments if segment.length > 2 * skipped]


def unseen_error(fit: Fit, unseen: Stream, skipped: int, *, predicts: bool = False) -> float:
    """Return the relative error of simulation, or of prediction, on data a fit has not seen.

    The samples that initial states may take, the first `skipped` of a segment, do not count.
    Infinite for an unstable model.
    """
    if not is_stable(fit):
        return np.inf
    run = fit.predict if predicts else fit.simulate_record
    measured, modelled = [], []
    offsets = _offsets_of(fit, unseen)
    for segment in scored_segments(unseen, skipped):
        piece = unseen.records[segment.record].slice(segment.start, segment.stop)
        offset = offsets[segment.record]
        measured.append(np.asarray(piece.outputs[skipped:]) - offset)
        modelled.append(run(piece, output_offset=offset)[skipped:] - offset)
    each = fit_percent(np.vstack(measured), np.vstack(modelled))
    moving = np.isfinite(each)  # an output that rests in this half says nothing
    return float(1 - each[moving].mean() / 100) if moving.any() else np.inf


def _offsets_of(fit: Fit, stream: Stream) -> NDArray[np.float64]:
    """Return the offsets of each record; the fit's own where it is not of these records."""
    known = fit.diagnostics.figures.get("record_offsets")
    if known is None or len(known) != len(stream.records):
        return np.tile(fit.output_offset, (len(stream.records), 1))
    return np.asarray(known)
