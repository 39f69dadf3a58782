"""Try every order on one decomposition: criterion, modes, and which modes are steady."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..fit import Decomposition, Method
from ..kalman import STABLE_TO
from ..modes import Modes, match_modes, modes_of
from ..record import Floats
from .stability import projected

LARGEST_ORDER = 60
EVERY_ORDER_TO = 12  # odd orders matter for small systems; beyond, only pairs
STEADY_SHARE = 0.8  # of the larger orders that a mode must appear in to count as steady
STEADY_FREQUENCY = 0.02
STEADY_MAC = 0.9
LARGEST_DAMPING = 0.2  # of a mode that can be steady
UNDAMPED = -1e-6  # damping ratio that rounding may leave of an undamped mode
JUDGED_BY = 0.5  # of the orders must lie above the one whose modes they judge
NEAR_END = 0.9  # of the largest order: a minimum there is no minimum
ENOUGH_GAIN = 0.98  # of the criterion's fall, where it has no minimum


@dataclass(frozen=True, eq=False)
class OrderScan:
    """What every order tried gave.

    Attributes
    ----------
    orders : array of int
    criterion : array
        Bayesian information criterion; NaN where unstable.
    modes : tuple of Modes
    rank : int or None
        The order beyond which the (nearly noise-free) data hold nothing but rounding.
    n_near : int
        How many of the unstable orders are so by poles next to the unit circle.
    """

    orders: NDArray[np.int64]
    criterion: Floats
    modes: tuple[Modes, ...]
    rank: int | None
    n_near: int = 0

    @property
    def stable(self) -> NDArray[np.bool_]:
        return np.isfinite(self.criterion)

    def persistence(self, modes: Modes, smallest_order: int = 1) -> Floats:
        """Return in which share of the orders from the smallest on each mode appears."""
        chosen = np.flatnonzero(self.orders >= smallest_order)
        seen = np.zeros(modes.n_modes)
        for k in chosen:
            seen[_steady_pairs(modes, self.modes[k])[:, 0]] += 1
        return seen / max(1, len(chosen))


def scan_orders(
    method: Method,
    decomposition: Decomposition,
    *,
    near: float = STABLE_TO,
    projects: bool = False,
) -> OrderScan:
    """Return criterion and modes of every order worth trying.

    Orders with poles outside the unit circle, but not beyond the radius `near`, are counted;
    if `projects`, these poles are reflected and the orders are stable ones.
    """
    largest = min(decomposition.largest_order, LARGEST_ORDER)
    small = range(1, min(EVERY_ORDER_TO, largest) + 1)
    orders = sorted({*small, *range(EVERY_ORDER_TO + 2, largest + 1, 2), largest})
    criterion, modes, n_near = [], [], 0
    for order in orders:
        value, stable = decomposition.criterion(order)
        fit = method.realize(decomposition, order)
        if not stable and np.isfinite(value) and fit.model.spectral_radius <= near:
            n_near += not projects
            if projects:
                fit, stable = projected(fit), True
        criterion.append(value if stable else np.nan)
        modes.append(modes_of(fit))
    limited = decomposition.rank_limited and decomposition.largest_order <= LARGEST_ORDER
    return OrderScan(
        np.array(orders),
        np.array(criterion),
        tuple(modes),
        largest if limited else None,
        n_near,
    )


def steady_modes(scan: OrderScan, largest: int | None = None) -> tuple[int, Modes] | None:
    """Return the smallest stable order up to `largest` that holds most steady modes, and these.

    A mode of an order is steady when at least 80 % of the orders from it on have it too:
    frequency within 2 %, MAC at least 0.9. None where there is no such mode.
    """
    best: tuple[int, Modes] | None = None
    judged = len(scan.orders) - int(np.ceil(JUDGED_BY * len(scan.orders)))
    for k in range(max(1, judged)):
        modes, order = scan.modes[k], int(scan.orders[k])
        if largest is not None and order > largest:
            break
        seen, damping = scan.persistence(modes, order), modes.damping_ratios
        kept = np.flatnonzero(
            (seen >= STEADY_SHARE) & (damping > UNDAMPED) & (damping < LARGEST_DAMPING)
        )
        if scan.stable[k] and len(kept) > (best[1].n_modes if best else 0):
            best = order, modes.select(kept)
    return best


def choose_order(scan: OrderScan, *, forced: bool) -> tuple[int, str]:
    """Return an order and why.

    The rank where the data are nearly noise-free. Else with inputs the minimum of the
    information criterion; without, the smallest order that holds every steady mode, because
    coloured excitation makes the criterion fall for ever.
    """
    first, last = scan.orders[0], scan.orders[-1]
    if scan.rank is not None:
        return scan.rank, f"order={scan.rank} is the rank of these nearly noise-free data"
    found = None if forced else steady_modes(scan)
    if found is not None:
        order, steady = found
        return order, (
            f"order={order} is the smallest stable one with all {steady.n_modes} modes that at "
            f"least {100 * STEADY_SHARE:g} % of the orders from it to {last} have"
        )
    values = np.where(scan.stable, scan.criterion, np.inf)
    best = int(np.argmin(values))
    if scan.orders[best] < NEAR_END * last or len(scan.orders) < EVERY_ORDER_TO:
        return int(scan.orders[best]), (
            f"order={scan.orders[best]} has the lowest information criterion of {first} to {last}"
        )
    worst = values[scan.stable].max()
    enough = worst - ENOUGH_GAIN * (worst - values[best])
    knee = int(scan.orders[np.flatnonzero(values <= enough)[0]])
    return knee, (
        f"order={knee} reaches {100 * ENOUGH_GAIN:g} % of the information criterion's fall, "
        f"which goes on to the largest order tried, {last}: noise or excitation is coloured"
    )


def _steady_pairs(first: Modes, second: Modes) -> NDArray[np.int64]:
    return match_modes(first, second, frequency_limit=STEADY_FREQUENCY, mac_limit=STEADY_MAC)
