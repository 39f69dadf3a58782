"""Physical coordinates: from poles and sensor columns to 𝒦, 𝒟 and forces, in closed form.

A free response of the sensors Σ Re(c_i e^{λ_i t}) has displacement shapes φ_i = c_i / λ_i^d, d
the derivative that each sensor measures, and [𝒦 𝒟] = −Φ Λ² [Φ; Φ Λ]⁻¹ (formulas equivalent to
step III of Han, Bohn & Bauer 2021, eq. 43-65, without its Kronecker systems). The input model
does not enter; only poles and shapes do, whatever their scale.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError
from ..exosystem import signal_basis
from ..mechanics import MOTIONS, Sensor, mechanical_state_space
from ..modes import Complexes
from ..physical.scaling import normalized_of
from ..record import Floats
from ..statespace import StateSpace

Powers = NDArray[np.int64]
DEPENDENT = 1e-9  # relative: inputs closer to each other cannot be told apart


def displacement_shapes(poles: Complexes, columns: Complexes, powers: Powers) -> Complexes:
    """Return the shapes (n_dof, n_modes) of sensor columns, one row a DOF."""
    return np.asarray(columns / poles[None, :] ** powers[:, None])


def normalized_matrices(
    poles: Complexes, columns: Complexes, powers: Powers
) -> tuple[Floats, Floats]:
    """Return 𝒦 and 𝒟 (n_dof, n_dof) from one pole of each of n_dof pairs.

    Parameters
    ----------
    poles : complex array (n_dof,)
        [rad/s], Im λ > 0.
    columns : complex array (n_dof, n_dof)
        What the sensors show of each mode, at any scale.
    powers : int array (n_dof,)
        0, 1, 2 for displacement, velocity, acceleration.

    Examples
    --------
    >>> stiffness, damping = normalized_matrices(np.array([-1 + 7j]), np.array([[3j]]), [2])
    >>> stiffness.round(9), damping.round(9)
    (array([[50.]]), array([[2.]]))
    """
    shapes = displacement_shapes(poles, columns, np.asarray(powers))
    both = np.hstack([shapes, shapes.conj()])
    damping, stiffness = normalized_of(both, np.concatenate([poles, poles.conj()]))
    return stiffness, damping


def normalized_system(stiffness: ArrayLike, damping: ArrayLike, powers: Powers) -> StateSpace:
    """Return the continuous system from M⁻¹f at every DOF to the sensors."""
    K = np.asarray(stiffness, dtype=np.float64)
    sensors: list[Sensor] = [(MOTIONS[power], dof) for dof, power in enumerate(powers)]
    return mechanical_state_space(np.eye(len(K)), damping, K, sensors=sensors, forces=range(len(K)))


def dynamic_stiffness(P: Floats, rates: Floats) -> Complexes:
    """Return s² I + s 𝒟 + 𝒦 (n_rates, n, n) of P = [𝒦 𝒟] at s = iω, ω the rates [rad/s]."""
    n, s = len(P), 1j * rates[:, None, None]
    return np.asarray(s**2 * np.eye(n) + s * P[:, n:] + P[:, :n])


def periodic_force(
    stiffness: Floats,
    damping: Floats,
    powers: Powers,
    frequencies_hz: ArrayLike,
    columns: Complexes,
    *,
    dt: float,
    hold: str,
) -> Complexes:
    """Return the phasors of M⁻¹f (n_dof, n_frequencies) behind steady sensor phasors.

    c_k = G(jω_k) p_k solved for p_k: continuous for a band-limited force, which a sine is, and
    of the discrete model for a force held between samples (with the continuous formula that
    would be 65 % wrong at 50 samples a second, 16 % at 200).

    Parameters
    ----------
    columns : complex array (n_dof, n_frequencies)
        What the sensors show is Σ_k Re(c_k e^{jω_k t}).
    hold : "band_limited", "zoh" or "foh"
    """
    system = normalized_system(stiffness, damping, powers)
    if hold != "band_limited":
        system = system.to_discrete(dt, hold)
    if not columns.shape[1]:
        return np.asarray(columns)
    G = system.frequency_response(frequencies_hz)
    return np.asarray(np.linalg.solve(G, columns.T[:, :, None])[:, :, 0].T)


def force_history(phasors: Complexes, frequencies_hz: Floats, n_samples: int, dt: float) -> Floats:
    """Return Σ_k Re(p_k e^{jω_k t}) at the samples (n_samples, n_dof); it cannot drift."""
    basis = signal_basis(frequencies_hz, dt * np.arange(n_samples))
    weights = np.stack([phasors.real, -phasors.imag], axis=2).reshape(len(phasors), -1)
    return np.asarray(basis @ weights.T, dtype=np.float64)


def input_matrix(force: Floats, inputs: Floats) -> Floats:
    """Return ℬ (n_dof, n_inputs) with M⁻¹f = ℬ u, constants of both left out.

    Raises
    ------
    OptionError
        Inputs that are constant or multiples of each other.
    """
    u, f = inputs - inputs.mean(axis=0), force - force.mean(axis=0)
    size = np.linalg.norm(u, axis=0)
    check_independent(u)
    solved = np.linalg.lstsq(u / size, f, rcond=None)[0]
    return np.asarray((solved / size[:, None]).T)


def check_independent(inputs: Floats) -> None:
    """Refuse inputs (columns) of which one is zero or follows from the others."""
    size = np.linalg.norm(inputs, axis=0)
    values = np.linalg.svd(inputs / np.where(size > 0, size, 1), compute_uv=False)
    rank = int((values > DEPENDENT * values.max(initial=0)).sum())
    if rank < inputs.shape[1]:
        raise OptionError(
            f"The {inputs.shape[1]} inputs are not independent (rank {rank}); ℬ cannot be told. "
            "Leave inputs out with select(inputs=[…])."
        )
