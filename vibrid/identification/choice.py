"""Choose horizon and order from the Gram alone, and say why."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..errors import DataError, UnstableModelError
from ..fit import Decomposition, Method
from ..gram import BlockGram, reduce
from ..methods.preparation import check_length
from ..modes import Modes, match_modes, modes_of
from ..record import Floats
from .held_out import GRID, held_out_errors, smallest_enough

HORIZONS = (10, 20, 40, 80)
LARGEST_HANKEL = 2600  # rows: beyond it a factorization takes seconds
LARGEST_ORDER = 60
EVERY_ORDER_TO = 12  # odd orders matter for small systems; beyond, only pairs
CLOSE = 0.02  # of the criterion a sample and output: a longer horizon must gain more
STEADY_SHARE = 0.5  # of the orders that a mode must appear in to count as steady
STEADY_FREQUENCY = 0.02
STEADY_MAC = 0.9
LARGEST_DAMPING = 0.2  # of a mode that can be steady
NEAR_END = 0.9  # of the largest order: a minimum there is no minimum
ENOUGH_GAIN = 0.98  # of the criterion's fall, where it has no minimum

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class OrderScan:
    """What every order tried gave.

    Attributes
    ----------
    orders : array of int
    criterion : array
        Bayesian information criterion; NaN where unstable.
    modes : tuple of Modes
    """

    orders: np.ndarray[Any, np.dtype[np.int64]]
    criterion: Floats
    modes: tuple[Modes, ...]

    @property
    def stable(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        return np.isfinite(self.criterion)

    def persistence(self, modes: Modes, smallest_order: int = 1) -> Floats:
        """Return in which share of the orders from the smallest on each mode appears."""
        others = [
            other
            for order, other in zip(self.orders, self.modes, strict=True)
            if order >= smallest_order
        ]
        seen = np.zeros(modes.n_modes)
        for other in others:
            seen[_steady_pairs(modes, other)[:, 0]] += 1
        return seen / len(others)


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
    feedthrough: bool | Sequence[bool] | None,
    progress: Progress,
) -> Choice:
    """Return horizon and order: as asked for, or by criterion and steadiness.

    Raises
    ------
    DataError
        The record is too short for the shortest horizon.
    UnstableModelError
        An automatic order, and every order tried is unstable.
    """
    if method.block_rows is not None:
        decomposition = method.decompose(stream, feedthrough=feedthrough)
        reasons: tuple[str, ...] = (f"block_rows={method.block_rows} as asked for",)
        candidates = [(method, decomposition)]
    else:
        candidates = _horizons(stream, method, order, feedthrough)
        reasons = ()
    if isinstance(order, str):
        tried = []
        for k, (option, decomposition) in enumerate(candidates):
            progress("orders", k, len(candidates))
            tried.append((option, decomposition, scan_orders(option, decomposition)))
        chosen = _best_of(stream, tried, reasons)
        progress("held out", 0, 1)
        return _by_held_out(stream, chosen, feedthrough) if stream.n_inputs else chosen
    return _best_for_order(candidates, order, stream, reasons)


def scan_orders(method: Method, decomposition: Decomposition) -> OrderScan:
    """Return criterion and modes of every order worth trying."""
    largest = min(decomposition.largest_order, LARGEST_ORDER)
    small = range(1, min(EVERY_ORDER_TO, largest) + 1)
    orders = [*small, *range(EVERY_ORDER_TO + 2, largest + 1, 2)]
    criterion, modes = [], []
    for order in orders:
        value, stable = decomposition.criterion(order)
        criterion.append(value if stable else np.nan)
        modes.append(modes_of(method.realize(decomposition, order)))
    return OrderScan(np.array(orders), np.array(criterion), tuple(modes))


def steady_modes(scan: OrderScan) -> tuple[Modes, Floats]:
    """Return the modes that at least half of the even orders agree on, and their share.

    Taken from the order that holds most of them; a mode counts where frequency agrees
    within 2 % and MAC is at least 0.9.
    """
    best, share = scan.modes[0].select([]), np.zeros(0)
    for modes in scan.modes:
        seen = scan.persistence(modes)
        damping = modes.damping_ratios
        kept = np.flatnonzero((seen >= STEADY_SHARE) & (damping > 0) & (damping < LARGEST_DAMPING))
        if len(kept) > best.n_modes:
            best, share = modes.select(kept), seen[kept]
    return best, share


def _steady_pairs(first: Modes, second: Modes) -> np.ndarray[Any, np.dtype[np.int64]]:
    return match_modes(first, second, frequency_limit=STEADY_FREQUENCY, mac_limit=STEADY_MAC)


def _horizons(
    stream: Stream, method: Any, order: int | str, feedthrough: bool | Sequence[bool] | None
) -> list[tuple[Any, Any]]:
    """Return the method with every horizon that the record allows; one Gram serves all."""
    channels = stream.n_inputs + stream.n_outputs
    shortest = HORIZONS[0]
    if not isinstance(order, str):
        shortest = max(shortest, -(-order // stream.n_outputs) + 1)
    allowed = [
        rows
        for rows in sorted({shortest, *HORIZONS})
        if rows >= shortest and 2 * rows * channels <= LARGEST_HANKEL and _fits(stream, 2 * rows)
    ]
    if not allowed:
        allowed = [_longest(stream, shortest)]
    past = method.past_rows
    gram: BlockGram = reduce(stream, allowed[-1] + (past or allowed[-1]))
    return [
        (option, option.decompose(stream, feedthrough=feedthrough, gram=gram))
        for option in (replace(method, block_rows=rows) for rows in allowed)
    ]


def _fits(stream: Stream, n_rows: int) -> bool:
    try:
        check_length(stream, n_rows)
    except DataError:
        return False
    return True


def _longest(stream: Stream, wanted: int) -> int:
    """Return the longest horizon below `wanted` that the record allows."""
    for rows in range(wanted, 1, -1):
        if _fits(stream, 2 * rows):
            return rows
    check_length(stream, 2 * 2)
    return 2


def _best_of(
    stream: Stream, tried: Sequence[tuple[Any, Any, OrderScan]], reasons: tuple[str, ...]
) -> Choice:
    usable = [each for each in tried if each[2].stable.any()]
    if not usable:
        raise UnstableModelError(
            f"Every order from {tried[0][2].orders[0]} to {tried[-1][2].orders[-1]} gives an "
            "unstable model. Detrend the record or use a band without drift, name another "
            'block_rows, or ask for an order with stability="project".'
        )
    values = [
        np.nanmin(scan.criterion) / decomposition.n_columns for _, decomposition, scan in usable
    ]
    limit = min(values) + CLOSE * stream.n_outputs
    chosen = next(k for k, value in enumerate(values) if value <= limit)
    method, decomposition, scan = usable[chosen]
    if len(tried) > 1:
        others = ", ".join(str(option.block_rows) for option, _, _ in tried)
        reasons = (
            f"block_rows={method.block_rows} is the shortest of {others} whose prediction error "
            f"is within {100 * CLOSE:g} % of the best",
        )
    elif not reasons:
        reasons = (f"block_rows={method.block_rows} is the longest that the record allows",)
    order, why = choose_order(scan, forced=stream.n_inputs > 0)
    skipped = int((~scan.stable).sum())
    if skipped:
        why += f"; {skipped} of {len(scan.orders)} orders were unstable and skipped"
    return Choice(method, decomposition, order, scan, (*reasons, why))


def _by_held_out(
    stream: Stream, choice: Choice, feedthrough: bool | Sequence[bool] | None
) -> Choice:
    """Return the smallest order that simulates unseen halves nearly as well as the best.

    Nonlinearity and coloured noise let the criterion ask for ever more states; data that a
    model has not seen do not.
    """
    assert choice.scan is not None
    stable = choice.scan.orders[choice.scan.stable]
    orders = [int(k) for k in stable if k <= choice.order and (k in GRID or k == choice.order)]
    errors = held_out_errors(stream, choice.method, feedthrough, orders)
    if not errors:
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


def choose_order(scan: OrderScan, *, forced: bool) -> tuple[int, str]:
    """Return an order and why.

    With inputs, the minimum of the information criterion; without, the smallest order that
    holds every steady mode, because coloured excitation makes the criterion fall for ever.
    """
    if not forced:
        found = _smallest_with_steady(scan)
        if found is not None:
            return found
    values = np.where(scan.stable, scan.criterion, np.inf)
    best = int(np.argmin(values))
    if scan.orders[best] < NEAR_END * scan.orders[-1] or len(scan.orders) < EVERY_ORDER_TO:
        return int(scan.orders[best]), (
            f"order={scan.orders[best]} has the lowest information criterion of "
            f"{scan.orders[0]} to {scan.orders[-1]}"
        )
    worst = values[scan.stable].max()
    enough = worst - ENOUGH_GAIN * (worst - values[best])
    knee = int(np.flatnonzero(values <= enough)[0])
    return int(scan.orders[knee]), (
        f"order={scan.orders[knee]} reaches {100 * ENOUGH_GAIN:g} % of the information "
        f"criterion's fall, which goes on to the largest order tried, {scan.orders[-1]}: noise "
        "or excitation is coloured"
    )


def _smallest_with_steady(scan: OrderScan) -> tuple[int, str] | None:
    steady, _ = steady_modes(scan)
    if steady.n_modes == 0:
        return None
    held = np.array([len(_steady_pairs(steady, modes)) for modes in scan.modes])
    held[~scan.stable] = 0
    chosen = int(np.argmax(held))
    count = f"all {steady.n_modes}" if held[chosen] == steady.n_modes else f"{held[chosen]} of"
    return int(scan.orders[chosen]), (
        f"order={scan.orders[chosen]} is the smallest stable one with {count} modes that at "
        f"least {100 * STEADY_SHARE:g} % of the orders {scan.orders[0]} to {scan.orders[-1]} "
        "agree on"
    )


def _best_for_order(
    candidates: Sequence[tuple[Any, Any]], order: int, stream: Stream, reasons: tuple[str, ...]
) -> Choice:
    """Return the shortest horizon that predicts (nearly) best at the order asked for."""
    if len(candidates) == 1:
        method, decomposition = candidates[0]
        if not reasons:
            reasons = (f"block_rows={method.block_rows} is the longest that the record allows",)
        return Choice(method, decomposition, order, None, (*reasons, f"order={order} as asked for"))
    values = []
    for _, decomposition in candidates:
        if order > decomposition.largest_order or order < 1:
            values.append(np.inf)
            continue
        value, stable = decomposition.criterion(order)
        values.append(value / decomposition.n_columns if stable else np.inf)
    limit = min(values) + CLOSE * stream.n_outputs
    chosen = next(k for k, value in enumerate(values) if value <= limit)
    method, decomposition = candidates[chosen]
    others = ", ".join(str(option.block_rows) for option, _ in candidates)
    reason = (
        f"block_rows={method.block_rows} is the shortest of {others} whose prediction error at "
        f"order {order} is within {100 * CLOSE:g} % of the best"
    )
    return Choice(method, decomposition, order, None, (reason, f"order={order} as asked for"))
