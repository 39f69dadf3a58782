"""Poles of free and forced motion together, by stochastic subspace identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...methods.preparation import check_order
from ...methods.ssi import SSI
from ...modes import Complexes
from ...record import Floats, Record

HORIZON_SHARE = 10  # of the record: the horizon, where it is not given
LARGEST_HORIZON = 1200  # rows of the future times sensors; the cost grows with its cube
SMALLEST_HORIZON = 10
LARGEST_ORDER = 80
NOISE_STEP = 1.25  # fall of the singular values behind the last one that is not noise
CLIFF = 1e3  # fall behind which there is nothing but rounding or very little noise


@dataclass(frozen=True, eq=False)
class FreePoles:
    """Poles of the autonomous model of structure and input together.

    Attributes
    ----------
    poles : complex array (n_pairs,)
        Continuous [rad/s], Im λ > 0, the fastest decay first; real poles are left out.
    order : int
        Of the model, with its real poles.
    singular_values : array
    block_rows : int
    """

    poles: Complexes
    order: int
    singular_values: Floats
    block_rows: int


def usual_horizon(n_samples: int, n_channels: int) -> int:
    """Return a tenth of the record [samples], within what is affordable."""
    longest = max(SMALLEST_HORIZON, LARGEST_HORIZON // n_channels)
    return int(np.clip(n_samples // HORIZON_SHARE, SMALLEST_HORIZON, longest))


def largest_order(block_rows: int, n_channels: int) -> int:
    """Return the largest order that shift invariance of so many block rows can tell."""
    return (block_rows - 1) * n_channels


def free_poles(
    outputs: Floats, dt: float, block_rows: int, smallest_order: int, order: int | None = None
) -> FreePoles:
    """Return the poles of a record whose structure and input run freely.

    Data-driven SSI, a constant taken out of every Hankel row, the order from the last clear
    fall of the singular values unless it is given (Han, Bohn & Bauer 2021, step I; the gain
    and the positive-real step do not exist for poles on the unit circle, nor are needed).

    Raises
    ------
    OptionError
        An order that the horizon cannot tell.
    DataError
        Too few samples, constant channels.
    """
    method = SSI(kind="data", block_rows=block_rows)
    found = method.decompose(Record(outputs, dt=dt))
    largest = found.largest_order
    if order is None:
        order = order_by_fall(found.singular_values, smallest_order, largest)
    check_order(order, largest_order(block_rows, outputs.shape[1]), f"{block_rows} block rows")
    order = min(order, largest)  # of noise-free data no more than their rank
    A = found.realize(order, method.transition).A
    return FreePoles(oscillating(A, dt), order, found.singular_values, block_rows)


def oscillating(A: Floats, dt: float) -> Complexes:
    """Return the continuous poles of a discrete A with Im λ > 0, the fastest decay first."""
    values = np.linalg.eigvals(A).astype(np.complex128)
    poles = np.log(values[values.imag > 0]) / dt
    return np.asarray(poles[np.argsort(poles.real, kind="stable")])


def order_by_fall(values: Floats, smallest: int, largest: int) -> int:
    """Return the even order behind which the singular values fall: by most, or last clearly."""
    orders = np.arange(smallest, min(largest, LARGEST_ORDER, len(values) - 1) + 1, 2)
    if not len(orders):
        return largest
    falls = values[orders - 1] / np.maximum(values[orders], 1e-300)
    if falls.max() > CLIFF:
        return int(orders[np.argmax(falls)])
    clear = orders[falls > NOISE_STEP]
    return int(clear[-1]) if len(clear) else smallest
