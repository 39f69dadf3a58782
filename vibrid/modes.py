"""Modes: poles, shapes and participation of any model, and how to compare them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from .errors import DataError, OptionError, check_positive
from .fit import Fit
from .record import Channel, Floats, make_channels
from .statespace import StateSpace

Complexes = NDArray[np.complex128]

PAIRING_LIMIT = 1e-12  # of products of unit left and right vectors: below it a pole is defective

# power of λ that turns a displacement shape into what the sensor measures
DERIVATIVES = {
    "displacement": 0,
    "velocity": 1,
    "acceleration": 2,
    "base_acceleration": 2,
    "force": 0,
    "other": 0,
}


@dataclass(frozen=True, eq=False)
class Modes:
    """Modes of a model, frequencies ascending.

    Attributes
    ----------
    poles : complex array (n_modes,)
        Continuous [rad/s], one of each conjugate pair (positive imaginary part).
    shapes : complex array (n_outputs, n_modes)
        Displacement shapes: rows divided by λ or λ² for velocity or acceleration and
        multiplied by the channel's sign; the largest component is 1. Of channels of quantity
        "other", plain sensor amplitudes.
    participation : complex array (n_modes, n_inputs)
        Row of V⁻¹ B in continuous time that belongs to the shape so scaled; inputs held
        (zoh) for forces, band-limited for base acceleration.
    real_poles : complex array
        Poles that do not oscillate [rad/s], and those on the negative real axis of the
        discrete plane, which sit at the Nyquist frequency (imaginary part π/dt).
    output_channels : tuple of Channel
    frequencies_std, damping_std : array (n_modes,)
        Standard deviations; NaN where not estimated.
    """

    poles: Complexes
    shapes: Complexes
    participation: Complexes
    real_poles: Complexes
    output_channels: tuple[Channel, ...]
    frequencies_std: Floats
    damping_std: Floats

    def __repr__(self) -> str:
        pairs = zip(self.frequencies_hz, self.damping_ratios, strict=True)
        listed = ", ".join(f"{f:.4g} Hz {100 * zeta:.3g} %" for f, zeta in pairs)
        return f"<Modes: {listed or 'none'}>"

    @property
    def n_modes(self) -> int:
        return len(self.poles)

    @property
    def frequencies_hz(self) -> Floats:
        """Natural frequencies |λ| / 2π, ascending [Hz]."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping_ratios(self) -> Floats:
        """−Re λ / |λ|; negative for an unstable mode."""
        return np.asarray(-self.poles.real / np.abs(self.poles))

    @property
    def phase_collinearity(self) -> Floats:
        """MPC of each shape: 1 for a real (in-phase) shape, see `mpc`."""
        return mpc(self.shapes)

    def select(self, indices: Sequence[int] | NDArray[np.int64]) -> Modes:
        """Return some of the modes, in the order given."""
        chosen = np.asarray(indices, dtype=np.int64)
        return Modes(
            self.poles[chosen],
            self.shapes[:, chosen],
            self.participation[chosen],
            self.real_poles,
            self.output_channels,
            self.frequencies_std[chosen],
            self.damping_std[chosen],
        )


def modes_of(model: Fit | StateSpace) -> Modes:
    """Return the modes of an identified or any other model; nothing is left out.

    Parameters
    ----------
    model : Fit or StateSpace
        Discrete or continuous. Of a StateSpace, the outputs count as quantity "other".

    Returns
    -------
    Modes
        Invariant to the state basis.

    Raises
    ------
    DataError
        A discrete pole at zero: it has no continuous counterpart.

    Examples
    --------
    >>> oscillator = StateSpace([[0, 1], [-100, -0.2]], [[0], [1]], [[1, 0]], [[0]], None)
    >>> modes_of(oscillator).damping_ratios.round(6).tolist()
    [0.01]
    """
    if isinstance(model, Fit):
        system, outputs, inputs = model.model, model.output_channels, model.input_channels
    else:
        system = model
        outputs = make_channels(None, system.n_outputs, "y")
        inputs = make_channels(None, system.n_inputs, "u")
    values, left, vectors = sla.eig(system.A, left=True, right=True)
    continuous = _continuous(values, system.dt)
    oscillates = (values.imag > 0) & (continuous.imag > 0)
    chosen = np.flatnonzero(oscillates)
    chosen = chosen[np.argsort(np.abs(continuous[chosen]), kind="stable")]
    real = np.sort_complex(continuous[values.imag == 0])
    poles = continuous[chosen]
    shapes = _displacement_shapes(system.C @ vectors[:, chosen], poles, outputs)
    size = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(len(chosen))]
    size = np.where(size == 0, 1, size)
    rows = _modal_inputs(left[:, chosen].conj().T, vectors[:, chosen], system.B)
    rows = rows * _input_factors(system.dt, values[chosen], inputs) * size[:, None]
    unknown = np.full(len(chosen), np.nan)
    return Modes(poles, shapes / size, rows, real, tuple(outputs), unknown, unknown)


def _modal_inputs(left: Complexes, right: Complexes, B: Floats) -> Complexes:
    """Return the rows of V⁻¹ B that belong to some eigenvectors.

    From left vectors, because all of V may be singular where other poles coincide
    (rigid-body motion). Those of coinciding poles among these are paired by their own small
    matrix; where they have no full set of vectors the rows do not exist and are NaN.
    """
    pairing, driven = left @ right, left @ B
    if len(pairing) == 0 or np.linalg.svd(pairing, compute_uv=False)[-1] > PAIRING_LIMIT:
        return np.asarray(np.linalg.solve(pairing, driven))
    own = np.diag(pairing)
    lost = np.abs(own) < np.sqrt(PAIRING_LIMIT)
    rows = np.where(lost[:, None], np.nan, driven / np.where(lost, 1, own)[:, None])
    return np.asarray(rows)


def _continuous(values: Complexes, dt: float | None) -> Complexes:
    if dt is None:
        return np.asarray(values)
    if (values == 0).any():
        raise DataError(
            "The model has a discrete pole at zero, a pure delay without a frequency. Use a "
            "lower order."
        )
    return np.asarray(np.log(values.astype(complex)) / dt)


def _displacement_shapes(
    measured: Complexes, poles: Complexes, channels: Sequence[Channel]
) -> Complexes:
    power = np.array([DERIVATIVES[channel.quantity] for channel in channels])
    sign = np.array([channel.sign for channel in channels])
    return np.asarray(sign[:, None] * measured / poles[None, :] ** power[:, None])


def _input_factors(dt: float | None, values: Complexes, channels: Sequence[Channel]) -> Complexes:
    """Return what turns rows of V⁻¹ B into continuous time and the inputs' own directions.

    For held inputs λ / (μ − 1) (the exact inverse of the hold), for band-limited ones 1 / (μ dt).
    """
    sign = np.array([channel.sign for channel in channels])
    if dt is None:
        return np.asarray(np.ones((len(values), 1)) * sign, dtype=np.complex128)
    held = np.log(values) / dt / (values - 1)
    limited = 1 / (values * dt)
    base = np.array([channel.quantity == "base_acceleration" for channel in channels], dtype=bool)
    return np.asarray(np.where(base[None, :], limited[:, None], held[:, None]) * sign)


def mac(first: NDArray[Any], second: NDArray[Any]) -> Floats:
    """Return the modal assurance criterion between the columns of two sets of shapes.

    |φᴴψ|² / (φᴴφ · ψᴴψ) (Allemang & Brown 1982), between 0 and 1.

    Parameters
    ----------
    first, second : array (n_outputs, k), (n_outputs, l)

    Returns
    -------
    array (k, l)

    Examples
    --------
    >>> mac(np.array([[1.0], [2.0]]), np.array([[2.0, -2.0], [4.0, 1.0]])).round(12).tolist()
    [[1.0, 0.0]]
    """
    if first.shape[0] != second.shape[0]:
        raise OptionError(
            f"Shapes have {first.shape[0]} and {second.shape[0]} components; must agree."
        )
    cross = np.abs(first.conj().T @ second) ** 2
    size = np.sum(np.abs(first) ** 2, axis=0)[:, None] * np.sum(np.abs(second) ** 2, axis=0)
    return np.asarray(np.divide(cross, size, out=np.zeros_like(cross), where=size > 0))


def mpc(shapes: NDArray[Any]) -> Floats:
    """Return the modal phase collinearity of each column: 1 where all move in phase.

    ((Sxx − Syy)² + 4 Sxy²) / (Sxx + Syy)² of the real and imaginary parts about zero
    (Pappa, Elliott & Schenk 1993; no mean is removed, which suits shapes of one sign too).

    Parameters
    ----------
    shapes : complex array (n_outputs, n_modes)

    Returns
    -------
    array (n_modes,)
    """
    x, y = np.real(shapes), np.imag(shapes)
    xx, yy, xy = (x * x).sum(axis=0), (y * y).sum(axis=0), (x * y).sum(axis=0)
    total = xx + yy
    spread = (xx - yy) ** 2 + 4 * xy**2
    return np.asarray(np.divide(spread, total**2, out=np.ones_like(total), where=total > 0))


def match_modes(
    first: Modes,
    second: Modes,
    *,
    frequency_limit: float = 0.02,
    damping_limit: float | None = None,
    mac_limit: float = 0.8,
) -> NDArray[np.int64]:
    """Pair modes of two models, each at most once: as many as the limits allow, then the closest.

    Parameters
    ----------
    first, second : Modes
        Of the same outputs.
    frequency_limit : float
        Largest relative difference of frequency.
    damping_limit : float, optional
        Largest relative difference of the damping ratio; unlimited by default.
    mac_limit : float
        Smallest MAC.

    Returns
    -------
    array (n_pairs, 2)
        Indices into `first` and `second`, ordered by the first.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and used only here

    if first.n_modes == 0 or second.n_modes == 0:
        return np.zeros((0, 2), dtype=np.int64)
    check_positive("frequency_limit", frequency_limit)
    f, g = first.frequencies_hz[:, None], second.frequencies_hz[None, :]
    apart = np.abs(f - g) / np.maximum(f, g)
    alike = mac(first.shapes, second.shapes)
    allowed = (apart <= frequency_limit) & (alike >= mac_limit)
    if damping_limit is not None:
        z, y = first.damping_ratios[:, None], second.damping_ratios[None, :]
        allowed &= np.abs(z - y) <= damping_limit * np.maximum(np.abs(z), np.abs(y))
    far = 10.0  # dearer than any allowed pair, so the number of pairs comes first
    cost = np.where(allowed, apart / frequency_limit + (1 - alike), far)
    rows, columns = linear_sum_assignment(cost)
    kept = allowed[rows, columns]
    return np.stack([rows[kept], columns[kept]], axis=1)
