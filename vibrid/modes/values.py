"""Modes: poles, shapes and participation of any model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..errors import DataError
from ..fit import Fit
from ..record import Channel, Floats, make_channels
from ..statespace import StateSpace
from .shapes import mpc

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
    basis = eigenvectors_of(system)
    poles = basis.poles
    shapes = _displacement_shapes(system.C @ basis.right, poles, outputs)
    size = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(len(poles))]
    size = np.where(size == 0, 1, size)
    rows = basis.modal_rows(system.B)
    rows = rows * _input_factors(system.dt, basis.values, inputs) * size[:, None]
    deviations = (_deviations(model, each, len(poles)) for each in ("frequencies", "damping"))
    return Modes(poles, shapes / size, rows, basis.real_poles, tuple(outputs), *deviations)


def _deviations(model: Fit | StateSpace, name: str, count: int) -> Floats:
    """Return the standard deviations that a fit knows, in the order of its modes; else NaN."""
    known = model.diagnostics.figures.get(f"{name}_std") if isinstance(model, Fit) else None
    return np.full(count, np.nan) if known is None or len(known) != count else np.asarray(known)


@dataclass(frozen=True, eq=False)
class Eigenvectors:
    """Eigenvectors of the modes of a model, in the order of `modes_of`.

    Attributes
    ----------
    values : complex array (n_modes,)
        Eigenvalues of A: of a discrete model, in the discrete plane.
    poles : complex array (n_modes,)
        The same in continuous time [rad/s].
    right : complex array (n, n_modes)
        Columns ψ with A ψ = λ ψ.
    left : complex array (n_modes, n)
        Rows with l A = λ l, of any size.
    real_poles : complex array
        The poles that do not oscillate [rad/s].
    """

    values: Complexes
    poles: Complexes
    right: Complexes
    left: Complexes
    real_poles: Complexes

    def modal_rows(self, matrix: Floats) -> Complexes:
        """Return the rows of Ψ⁻¹ · matrix (n, k) that belong to the modes, (n_modes, k).

        From left vectors, because all of Ψ may be singular where other poles coincide
        (rigid-body motion). Those of coinciding poles among the modes are paired by their own
        small matrix; where they have no full set of vectors the rows do not exist and are NaN.
        """
        return _paired_rows(self.left @ self.right, self.left @ matrix)


def eigenvectors_of(system: StateSpace) -> Eigenvectors:
    """Return the eigenvectors of a model's modes, frequencies ascending."""
    values, left, right = sla.eig(system.A, left=True, right=True)
    continuous = _continuous(values, system.dt)
    oscillates = (values.imag > 0) & (continuous.imag > 0)
    chosen = np.flatnonzero(oscillates)
    chosen = chosen[np.argsort(np.abs(continuous[chosen]), kind="stable")]
    return Eigenvectors(
        values[chosen],
        continuous[chosen],
        right[:, chosen],
        left[:, chosen].conj().T,
        np.sort_complex(continuous[values.imag == 0]),
    )


def _paired_rows(pairing: Complexes, driven: Complexes) -> Complexes:
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
