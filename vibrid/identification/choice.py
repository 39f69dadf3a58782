"""Choose horizon and order from the Gram alone, and say why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..errors import DataError, UnstableModelError
from ..gram import reduce
from ..methods.preparation import check_length
from .held_out import GRID, held_out_errors, smallest_enough
from .scan import OrderScan, choose_order, scan_orders

HORIZONS = (10, 20, 40, 80)
LARGEST_HANKEL = 2600  # rows: beyond it a factorization takes seconds
CLOSE = 0.02  # of the criterion a sample and output: a longer horizon must gain more

Progress = Callable[[str, int, int], None]
Mask = bool | Sequence[bool] | None


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
    stream: Stream, method: Any, order: int | str, feedthrough: Mask, progress: Progress
) -> Choice:
    """Return horizon and order: as asked for, or by criterion, unseen halves and steadiness.

    Raises
    ------
    DataError
        The record is too short for the shortest horizon.
    UnstableModelError
        An automatic order, and every order tried is unstable.
    """
    given = method.block_rows is not None
    if given:
        candidates = [(method, method.decompose(stream, feedthrough=feedthrough))]
    else:
        candidates = _horizons(stream, method, order, feedthrough)
    reasons = (f"block_rows={method.block_rows} as asked for",) if given else ()
    if isinstance(order, str):
        tried = []
        for k, (option, decomposition) in enumerate(candidates):
            progress("orders", k, len(candidates))
            tried.append((option, decomposition, scan_orders(option, decomposition)))
        chosen = _best_of(stream, tried, reasons)
        if stream.n_inputs and chosen.scan is not None and chosen.scan.rank is None:
            progress("held out", 0, 1)
            chosen = _by_held_out(stream, chosen, feedthrough)
    else:
        chosen = _best_for_order(candidates, order, stream, reasons)
    return chosen if given else _afresh(stream, chosen, feedthrough)


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
    if possible and choice.decomposition.criterion(choice.order)[1]:
        # a few more columns may tip a pole over the circle: what was found stable is kept
        stable = fresh.criterion(choice.order)[1]
        return replace(choice, decomposition=fresh) if stable else choice
    return replace(choice, decomposition=fresh)


def _horizons(
    stream: Stream, method: Any, order: int | str, feedthrough: Mask
) -> list[tuple[Any, Any]]:
    """Return the method with every horizon that the record allows; one Gram serves all.

    Nearly noise-free data need no longer horizon than the first that shows their rank.
    """
    channels = stream.n_inputs + stream.n_outputs
    shortest = HORIZONS[0]
    if not isinstance(order, str):
        shortest = max(shortest, -(-order // stream.n_outputs) + 1)
    allowed = [
        rows
        for rows in sorted({shortest, *HORIZONS})
        if rows >= shortest
        and _rows(method, rows) * channels <= LARGEST_HANKEL
        and _fits(stream, _rows(method, rows))
    ]
    allowed = allowed or [_longest(stream, method, shortest)]
    gram = reduce(stream, _rows(method, allowed[-1]))
    found: list[tuple[Any, Any]] = []
    for rows in allowed:
        option = replace(method, block_rows=rows)
        found.append((option, option.decompose(stream, feedthrough=feedthrough, gram=gram)))
        if found[-1][1].rank_limited:
            break
    return found


def _rows(method: Any, block_rows: int) -> int:
    return block_rows + (method.past_rows or block_rows)


def _fits(stream: Stream, n_rows: int) -> bool:
    try:
        check_length(stream, n_rows)
    except DataError:
        return False
    return True


def _longest(stream: Stream, method: Any, wanted: int) -> int:
    """Return the longest horizon up to `wanted` that the record allows."""
    for rows in range(wanted, 1, -1):
        if _fits(stream, _rows(method, rows)):
            return rows
    check_length(stream, _rows(method, 2))
    return 2


def _best_of(
    stream: Stream, tried: Sequence[tuple[Any, Any, OrderScan]], reasons: tuple[str, ...]
) -> Choice:
    usable = [each for each in tried if each[2].stable.any() or each[2].rank is not None]
    if not usable:
        raise UnstableModelError(
            f"Every order from {tried[0][2].orders[0]} to {tried[-1][2].orders[-1]} gives an "
            "unstable model. Detrend the record or use a band without drift, name another "
            'block_rows, or ask for an order with stability="project" (--stability project).'
        )
    values = [
        min(scan.criterion[scan.stable], default=np.inf) / decomposition.n_columns
        for _, decomposition, scan in usable
    ]
    # a horizon that shows the rank shows all there is; shorter ones may hide modes
    exact = usable[-1][2].rank is not None
    method, decomposition, scan = usable[-1 if exact else _first_close(values, stream)]
    order, why = choose_order(scan, forced=stream.n_inputs > 0)
    skipped = int((~scan.stable).sum())
    if skipped:
        why += f"; {skipped} of {len(scan.orders)} orders were unstable and skipped"
    reasons = reasons or (_horizon_reason(method, [each[:2] for each in tried], ""),)
    return Choice(method, decomposition, order, scan, (*reasons, why))


def _best_for_order(
    candidates: Sequence[tuple[Any, Any]], order: int, stream: Stream, reasons: tuple[str, ...]
) -> Choice:
    """Return the shortest horizon that predicts (nearly) best at the order asked for."""
    values = []
    for _, decomposition in candidates:
        possible = 1 <= order <= decomposition.largest_order and len(candidates) > 1
        value, stable = decomposition.criterion(order) if possible else (np.inf, False)
        values.append(value / decomposition.n_columns if stable else np.inf)
    method, decomposition = candidates[_first_close(values, stream)]
    reasons = reasons or (_horizon_reason(method, candidates, f" at order {order}"),)
    return Choice(method, decomposition, order, None, (*reasons, f"order={order} as asked for"))


def _first_close(values: Sequence[float], stream: Stream) -> int:
    limit = min(values) + CLOSE * stream.n_outputs
    return next(k for k, value in enumerate(values) if value <= limit)


def _horizon_reason(method: Any, tried: Sequence[tuple[Any, Any]], where: str) -> str:
    rows = f"block_rows={method.block_rows}"
    if method == tried[-1][0] and tried[-1][1].rank_limited:
        return f"{rows} shows the rank of these nearly noise-free data"
    if len(tried) == 1:
        return f"{rows} is the longest that this record and its channels allow"
    others = ", ".join(str(option.block_rows) for option, _ in tried)
    return (
        f"{rows} is the shortest of {others} whose prediction error{where} is within "
        f"{100 * CLOSE:g} % of the best"
    )


def _by_held_out(stream: Stream, choice: Choice, feedthrough: Mask) -> Choice:
    """Return the smallest order that simulates unseen halves nearly as well as the best.

    Nonlinearity and coloured noise let the criterion ask for ever more states; data that a
    model has not seen do not.
    """
    assert choice.scan is not None
    stable = choice.scan.orders[choice.scan.stable]
    orders = [int(k) for k in stable if k <= choice.order and (k in GRID or k == choice.order)]
    errors = held_out_errors(stream, choice.method, feedthrough, orders)
    # at 100 % error the halves say nothing: one of them may hold no force at all
    if choice.order not in errors or min(errors.values()) >= 1:
        return choice
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
