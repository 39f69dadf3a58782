"""Choose horizon and order from the Gram alone, and say why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..kalman import STABLE_TO
from ..methods.subspace import Subspace
from .candidates import (
    Candidate,
    Mask,
    first_close,
    first_simulating,
    horizons,
    shortened,
    simulation_error_of,
)
from .held_out import GRID, held_out_errors, smallest_enough
from .options import HasHorizon, closed, leaves_horizon, rows_of, weighting_of
from .reasons import as_asked, horizon_reason, simulation_reason, skipped_orders
from .scan import OrderScan, choose_order, scan_orders, steady_modes

UNLIKE = 2.5  # times the error of all data: where unseen halves cannot do better, they differ
LONGEST_MEMORY = 20  # samples: a longer horizon leaves too few observations of a short record
NOTHING = 0.9  # of the outputs' deviation: a simulation that misses more explains too little
KEPT = 1.2  # of the simulation error: more with a few more columns is an accident

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen method options and order, with the reasons in words."""

    method: Any
    decomposition: Any
    order: int
    scan: OrderScan | None
    reasons: tuple[str, ...]
    held_out: NDArray[np.float64] | None = None  # (n, 2): order, relative error


def choose(
    stream: Stream,
    method: Any,
    order: int | str,
    feedthrough: Mask,
    progress: Progress,
    stability: str = "raise",
) -> Choice:
    """Return horizon and order: as asked for, or by criterion, unseen halves and steadiness.

    The horizons tried are 10, 20, 40 and 80 block rows. With inputs those (and the
    weightings, where that is open) count that simulate the data within 2 % of the best error
    at the order asked for or found; of these, and without inputs of all, the shortest whose
    prediction error is within 2 % of the best. Where the inputs seem to follow the outputs,
    transition and completion become those that feedback does not bias. Unstable orders are
    skipped; with "project" and without inputs not those whose poles grow by less than e over
    the longest piece, which is how undamped motion and its noise look.

    Raises
    ------
    DataError
        The record is too short for the shortest horizon.
    """
    leaves = leaves_horizon(method)
    if not leaves:
        decomposition = method.decompose(stream, feedthrough=feedthrough)
        candidates = [(decomposition.method, decomposition)]
        reasons = decomposition.reasons or as_asked(method)
    else:
        candidates, reasons = horizons(stream, method, order, feedthrough), ()
    if isinstance(order, str):
        chosen = _with_order(stream, candidates, feedthrough, reasons, progress, stability)
    else:
        chosen = _best_for_order(candidates, order, stream, reasons)
    if leaves:
        chosen = _afresh(stream, chosen, feedthrough)
    return _without_feedback(chosen)


def _with_order(
    stream: Stream,
    candidates: Sequence[Candidate],
    feedthrough: Mask,
    reasons: tuple[str, ...],
    progress: Progress,
    stability: str,
) -> Choice:
    """Return the order, and the candidate that goes with it.

    The criterion ranks the horizons of the first weighting and gives a largest order; with
    inputs, unseen halves say how much of it is worth having, and the simulation with that
    order which candidate gives it best.
    """
    tried, projects, near = [], stability == "project", _near_circle(stream)
    first = candidates[0][0]
    ranked = [each for each in candidates if weighting_of(each[0]) == weighting_of(first)]
    for k, (option, decomposition) in enumerate(ranked):
        progress("orders", k, len(ranked))
        scan = scan_orders(option, decomposition, near=near, projects=projects)
        tried.append((option, decomposition, scan))
    decides = candidates[0][1].criterion_decides
    chosen = _best_of(tried, stream.n_outputs, decides, reasons)
    found = chosen.scan
    if not stream.n_inputs or found is None or found.rank is not None or not found.stable.any():
        return chosen
    progress("held out", 0, 2)
    tentative = _by_held_out(stream, chosen, feedthrough)
    progress("held out", 1, 2)
    again = _simulating_best(stream, candidates, tentative)
    if again.method == chosen.method:
        return tentative
    # another candidate may need another order
    known = next((each[2] for each in tried if each[0] == again.method), None)
    scan = known or scan_orders(again.method, again.decomposition)
    if not scan.stable.any():
        return tentative
    order, why = choose_order(scan, forced=True)
    other = replace(again, scan=scan, order=order, reasons=(*again.reasons[:-1], why))
    return _by_held_out(stream, other, feedthrough)


def _simulating_best(stream: Stream, candidates: Sequence[Candidate], choice: Choice) -> Choice:
    """Return the choice with the candidate that simulates best with its order."""
    if len(candidates) < 2:
        return choice
    k = first_simulating(stream, candidates, choice.order)
    if k is None:
        return choice
    method, decomposition = candidates[k]
    reason = simulation_reason(method, candidates, choice.order)
    return replace(
        choice, method=method, decomposition=decomposition, reasons=(reason, *choice.reasons[-1:])
    )


def _without_feedback(choice: Choice) -> Choice:
    """Return the choice with the estimators that survive feedback, where it is suspected.

    Neither projection along the future inputs nor simulation can be trusted there: what
    feedback makes of the noise looks like response.
    """
    known = choice.decomposition
    feedback = known.feedback if isinstance(known, Subspace) else None
    if feedback is None or not feedback.suspected:
        return choice
    method = closed(choice.method, transition="regression", completion="prediction")
    if method == choice.method:
        return choice
    changed = [
        f"{name}={value}"
        for name, value in vars(method).items()
        if value != vars(choice.method)[name]
    ]
    why = f"{' and '.join(changed)}, because the inputs seem to follow the outputs (feedback)"
    return replace(choice, method=method, reasons=(*choice.reasons, why))


def choose_for_responses(decomposition: Any, order: int | str, progress: Progress) -> Choice:
    """Return the order for measured responses: as asked for, or the smallest with all steady modes.

    Raises
    ------
    UnstableModelError
        An automatic order, and every order tried is unstable.
    """
    method = decomposition.method
    if not isinstance(order, str):
        why = f"order={order} as asked for"
        return Choice(method, decomposition, order, None, (*decomposition.reasons, why))
    progress("orders", 0, 1)
    scan = scan_orders(method, decomposition)
    forced = decomposition.criterion_decides
    return _best_of([(method, decomposition, scan)], 1, forced, decomposition.reasons)


def _afresh(stream: Stream, choice: Choice, feedthrough: Mask) -> Choice:
    """Return the choice decomposed from all columns that its own horizon allows.

    The Gram that served all horizons has the columns of the longest. So the result is that
    of asking for this horizon.
    """
    allowed = sum(
        max(0, segment.length - choice.decomposition.gram.n_rows + 1) for segment in stream.segments
    )
    if choice.decomposition.gram.n_columns == allowed:
        return choice
    fresh = choice.method.decompose(stream, feedthrough=feedthrough)
    possible = 1 <= choice.order <= min(fresh.largest_order, choice.decomposition.largest_order)
    known = choice.decomposition
    if possible and known.criterion(choice.order)[1]:
        # a few more columns may tip a pole over the circle: what was found good is kept
        good = fresh.criterion(choice.order)[1]
        if good and stream.n_inputs and not fresh.rank_limited:
            short = shortened(stream)
            before = simulation_error_of(short, choice.method, known, choice.order)
            good = simulation_error_of(short, choice.method, fresh, choice.order) <= KEPT * before
        return replace(choice, decomposition=fresh) if good else choice
    return replace(choice, decomposition=fresh)


def _best_of(
    tried: Sequence[tuple[Any, Any, OrderScan]],
    n_outputs: int,
    forced: bool,
    reasons: tuple[str, ...],
) -> Choice:
    usable = [each for each in tried if each[2].stable.any() or each[2].rank is not None]
    if not usable:
        return _unstable(tried, reasons)
    values = [
        min(scan.criterion[scan.stable], default=np.inf) / decomposition.n_columns
        for _, decomposition, scan in usable
    ]
    # a horizon that shows the rank shows all there is; shorter ones may hide modes
    exact = usable[-1][2].rank is not None
    method, decomposition, scan = usable[-1 if exact else first_close(values, n_outputs)]
    order, why = choose_order(scan, forced=forced)
    why += skipped_orders(scan)
    if rows_of(method) is not None:
        reasons = reasons or (horizon_reason(method, [each[:2] for each in tried], ""),)
    return Choice(method, decomposition, order, scan, (*reasons, why))


def _near_circle(stream: Stream) -> float:
    """Return the radius of poles that grow by e over the longest piece; 1 with inputs.

    With inputs it is simulation that ranks models, for which poles must not grow at all.
    """
    if stream.n_inputs:
        return STABLE_TO
    return float(np.exp(1 / max(segment.length for segment in stream.segments)))


def _unstable(tried: Sequence[tuple[Any, Any, OrderScan]], reasons: tuple[str, ...]) -> Choice:
    """Return the lowest criterion where no order is stable: the stability policy decides."""
    best = min(tried, key=lambda each: each[1].criterion(int(each[2].orders[0]))[0])
    method, decomposition, scan = best
    values = [decomposition.criterion(int(order))[0] for order in scan.orders]
    order = int(scan.orders[int(np.argmin(values))])
    why = (
        f"order={order} has the lowest information criterion of {scan.orders[0]} to "
        f"{scan.orders[-1]}, all of which are unstable"
    )
    return Choice(method, decomposition, order, scan, (*(reasons or as_asked(method)), why))


def _best_for_order(
    candidates: Sequence[Candidate], order: int, stream: Stream, reasons: tuple[str, ...]
) -> Choice:
    """Return the candidate that simulates, or without inputs predicts, best at this order.

    The shortest horizon among those that are nearly as good as the best.
    """
    why = f"order={order} as asked for"
    exact = candidates[-1][1].rank_limited
    if stream.n_inputs and len(candidates) > 1 and not exact:
        k = first_simulating(stream, candidates, order)
        if k is not None:
            method, decomposition = candidates[k]
            reason = simulation_reason(method, candidates, order)
            return Choice(method, decomposition, order, None, (reason, why))
    values = []
    for _, decomposition in candidates:
        possible = 1 <= order <= decomposition.largest_order and len(candidates) > 1
        value, stable = decomposition.criterion(order) if possible else (np.inf, False)
        values.append(value / decomposition.n_columns if stable else np.inf)
    method, decomposition = candidates[first_close(values, stream.n_outputs)]
    if rows_of(method) is not None:
        reasons = reasons or (horizon_reason(method, candidates, f" at order {order}"),)
    return Choice(method, decomposition, order, None, (*reasons, why))


def _by_held_out(stream: Stream, choice: Choice, feedthrough: Mask) -> Choice:
    """Return the smallest order that simulates unseen halves nearly as well as the best.

    Nonlinearity and coloured noise let the criterion ask for ever more states; data that a
    model has not seen do not. The order stays where no simulation explains anything: then it
    is other forces that move the structure.
    """
    assert choice.scan is not None
    stable = choice.scan.orders[choice.scan.stable]
    orders = [int(k) for k in stable if k <= choice.order and (k in GRID or k == choice.order)]
    errors = held_out_errors(stream, choice.method, feedthrough, orders)
    # at 100 % error, or far above what all data reach, the halves hold different motion: one
    # may hold no force at all, or a sweep's other frequencies
    seen = simulation_error_of(shortened(stream), choice.method, choice.decomposition, choice.order)
    best = min(errors.values(), default=np.inf)
    if NOTHING <= min(best, seen) < np.inf:
        why = f"{choice.reasons[-1]}; simulation, which misses {100 * seen:.3g} %, cannot judge"
        return replace(choice, reasons=(*choice.reasons[:-1], why))
    if choice.order not in errors or best >= min(1.0, UNLIKE * seen):
        return _by_seen(stream, choice, orders)
    order = smallest_enough(errors)
    why = choice.reasons[-1]
    if order == choice.order:
        why += ", and no smaller one simulates unseen halves within 5 % of the error"
    else:
        why = (
            f"order={order} is the smallest that simulates unseen halves within 5 % of the error "
            f"of the best ({100 * errors[order]:.3g} %); by itself, {why}"
        )
    curve = np.array(sorted(errors.items()))
    return replace(choice, order=order, reasons=(*choice.reasons[:-1], why), held_out=curve)


def _by_seen(stream: Stream, choice: Choice, orders: Sequence[int]) -> Choice:
    """Return the order with the best balance of simulation error and parameters.

    Where unseen halves say nothing: they are too short, or hold other frequencies. Errors of
    a simulation are not white, so samples within a horizon count as one observation: the
    criterion is (N p / h) ln error² + n (m + p) ln(N p / h) with the horizon h, at most 20.
    Where h is no more than how far responses reach, which is far longer than their memory, no
    order is taken that lacks modes which persist.
    """
    assert choice.scan is not None
    steady = steady_modes(choice.scan, choice.order)
    if steady is not None and not isinstance(choice.method, HasHorizon):
        orders = [order for order in orders if order >= steady[0]]
    m, p = stream.n_inputs, stream.n_outputs
    short = shortened(stream)
    rows = rows_of(choice.method)
    horizon = min(rows, LONGEST_MEMORY) if rows else choice.decomposition.gram.n_rows // 2
    observed = max(2.0, short.n_samples * p / horizon)
    values = {}
    for order in orders:
        error = simulation_error_of(short, choice.method, choice.decomposition, order)
        fit = observed * 2 * np.log(max(error, np.finfo(float).tiny))
        values[order] = fit + order * (m + p) * np.log(observed)
    order = min(values, key=lambda each: values[each], default=choice.order)
    if order == choice.order or not np.isfinite(values[order]):
        return choice
    why = (
        f"order={order} balances simulation error and parameters best (one observation per "
        f"{horizon} samples); by itself, {choice.reasons[-1]}"
    )
    return replace(choice, order=order, reasons=(*choice.reasons[:-1], why))
