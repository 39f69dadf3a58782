"""Poles of free and forced motion together, by stochastic subspace identification."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..exosystem import signal_basis
from ..methods.ssi import SSI
from ..modes import Complexes
from ..record import Floats, Record

HORIZON_SHARE = 10  # of the record: the horizon, where it is not given
LARGEST_HORIZON = 1200  # rows of the future times sensors; the cost grows with its cube
SMALLEST_HORIZON = 10
LARGEST_ORDER = 80
NOISE_STEP = 1.25  # fall of the singular values behind the last one that is not noise
CLIFF = 1e3  # fall behind which there is nothing but rounding or very little noise
NAMED = 0.01  # relative distance within which a pole is that of a frequency given

Indices = NDArray[np.int64]


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


def free_poles(
    outputs: Floats, dt: float, block_rows: int, smallest_order: int, order: int | None = None
) -> FreePoles:
    """Return the poles of a record whose structure and input run freely.

    Data-driven SSI, a constant taken out of every Hankel row, the order from the last clear
    fall of the singular values unless it is given (Han, Bohn & Bauer 2021, step I; the gain
    and the positive-real step do not exist for poles on the unit circle, nor are needed).

    Raises
    ------
    DataError
        Too few samples, constant channels.
    """
    method = SSI(kind="data", block_rows=block_rows)
    found = method.decompose(Record(outputs, dt=dt))
    largest = found.largest_order
    if order is None:
        order = order_by_fall(found.singular_values, smallest_order, largest)
    order = min(order, largest)
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


@dataclass(frozen=True, eq=False)
class Division:
    """Which poles are the structure's, and which the input's.

    Attributes
    ----------
    structure : complex array (at most n_dof,)
        [rad/s], the fastest decay first.
    inputs : complex array
        Taken as undamped.
    input_hz : array
        Frequencies of the input, ascending: those given, and others that the poles show.
    missing_hz : array
        Frequencies given that no pole shows.
    """

    structure: Complexes
    inputs: Complexes
    input_hz: Floats
    missing_hz: Floats


def divide(poles: Complexes, n_dof: int, duration: float, known_hz: Sequence[float]) -> Division:
    """Divide poles into structure and input.

    Poles at frequencies given are the input's; of the others, the n_dof that decay fastest
    are the structure's and the rest the input's too. (The closed form that follows is
    consistent for any n_dof pairs, so it cannot tell a wrong choice: the checks must.)
    """
    left = list(range(len(poles)))
    named: list[int] = []
    missing: list[float] = []
    for hertz in known_hz:
        nearest = _named(poles, left, hertz, duration)
        if nearest is None:
            missing.append(hertz)
        else:
            left.remove(nearest)
            named.append(nearest)
    structure, others = left[:n_dof], left[n_dof:]
    inputs = np.asarray([*known_hz, *(poles[others].imag / (2 * np.pi))], dtype=np.float64)
    return Division(poles[structure], poles[[*named, *others]], np.sort(inputs), np.array(missing))


def _named(poles: Complexes, left: list[int], hertz: float, duration: float) -> int | None:
    """Return the pole of an undamped sine of this frequency, or None."""
    if not left:
        return None
    off = np.abs(poles[left].imag / (2 * np.pi * hertz) - 1) / NAMED
    cost = off + np.abs(poles[left].real) * duration
    best = int(np.argmin(np.where(off <= 1, cost, np.inf)))
    return left[best] if off[best] <= 1 else None


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Least squares of a record on its poles.

    Attributes
    ----------
    structure : complex array (n_channels, n_modes)
        c_i of Σ Re(c_i e^{λ_i t}).
    inputs : complex array (n_channels, n_frequencies)
    residuals : array (rows, n_channels)
    sizes : array (n_modes,)
        Root of the energy that each mode brings into these rows.
    noise : complex array (n_channels, n_frequencies)
        What `inputs` becomes of white noise as large as the residuals: a sample of its error.
    """

    structure: Complexes
    inputs: Complexes
    residuals: Floats
    sizes: Floats
    noise: Complexes


def amplitudes(
    outputs: Floats, dt: float, poles: Complexes, input_hz: Floats, rows: slice = slice(None)
) -> Amplitudes:
    """Fit amplitudes of all channels, and a constant, to some rows of a record.

    This is the smoother of the autonomous model, which has no process noise: it needs no
    initial state, and the stretch need not be the start.
    """
    t = dt * np.arange(len(outputs))[rows]
    decay = np.exp(np.outer(t, poles))
    free = np.stack([decay.real, -decay.imag], axis=2).reshape(len(t), -1)
    basis = np.hstack([free, signal_basis(input_hz, t, offset=True)])
    size = np.linalg.norm(basis, axis=0)
    size[size == 0] = 1
    p, n = outputs.shape[1], 2 * len(poles)
    probe = np.random.default_rng(0).standard_normal((len(t), p))
    both = np.hstack([outputs[rows], probe])
    both = np.linalg.lstsq(basis / size, both, rcond=None)[0] / size[:, None]
    solved = both[:, :p]
    residuals = outputs[rows] - basis @ solved
    deviation = np.sqrt((residuals**2).sum(axis=0) / max(1, len(t) - basis.shape[1]))
    modes = solved[:n].reshape(-1, 2, p)
    parts = [free[:, 2 * k : 2 * k + 2] @ modes[k] for k in range(len(poles))]
    return Amplitudes(
        (modes[:, 0] + 1j * modes[:, 1]).T,
        _phasors(solved[n + 1 :]),
        residuals,
        np.array([np.linalg.norm(part) for part in parts]),
        _phasors(both[n + 1 :, p:]) * deviation[:, None],
    )


def _phasors(coefficients: Floats) -> Complexes:
    """Return c of Re(c e^{jωt}) from those of cos ωt, sin ωt, … (2 n, n_channels)."""
    pairs = coefficients.reshape(-1, 2, coefficients.shape[1])
    return np.asarray((pairs[:, 0] - 1j * pairs[:, 1]).T)
