"""From mass, damping and stiffness to state-space models and undamped modes.

The structure is M q̈ + R q̇ + K q = S f − M ι a: forces f on chosen DOFs, base acceleration a
along the influence vector ι, q relative to the base. The states are [q; q̇].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from .errors import OptionError, check_choice, check_whole
from .record import Floats
from .statespace import StateSpace

Sensor = tuple[str, int] | tuple[str, int, int]
MOTIONS = ("displacement", "velocity", "acceleration")


def mechanical_state_space(
    mass: ArrayLike,
    damping: ArrayLike,
    stiffness: ArrayLike,
    *,
    sensors: Sequence[Sensor],
    forces: Sequence[int] = (),
    base: ArrayLike | bool | None = None,
    absolute: bool = True,
) -> StateSpace:
    """Return the continuous state-space model of a structure, states [q; q̇].

    Parameters
    ----------
    mass, damping, stiffness : arrays (n_dof, n_dof)
        M, R, K in consistent units.
    sensors : sequence of (quantity, dof) or (quantity, dof, sign)
        Quantity is displacement, velocity or acceleration; dof counts from 0; sign −1 for a
        sensor mounted against its DOF.
    forces : sequence of int
        DOFs with a force input, in the order of the inputs.
    base : array (n_dof,), True or None
        Influence vector ι of a base acceleration, the last input; True is all ones. The
        states are then relative to the base.
    absolute : bool
        Whether acceleration sensors include the base's (then D of the base is zero).
        Displacements and velocities are always relative.

    Raises
    ------
    OptionError
        Shapes, DOFs or quantities that do not fit; a singular mass matrix.

    Examples
    --------
    >>> model = mechanical_state_space(
    ...     [[2.0]], [[0.4]], [[8.0]], sensors=[("acceleration", 0)], forces=[0]
    ... )
    >>> model.C, model.D
    (array([[-4. , -0.2]]), array([[0.5]]))
    """
    M, R, K = check_matrices(mass, damping, stiffness)
    n = len(M)
    load = np.zeros((n, len(forces)))
    for column, dof in enumerate(forces):
        check_whole("the DOF of a force", dof, 0, n - 1)
        load[dof, column] = 1
    influence = _influence(base, n)
    per_mass = _solve_mass(M, np.hstack([-K, -R, load]))
    motion, push = per_mass[:, : 2 * n], np.hstack([per_mass[:, 2 * n :], -influence])
    A = np.vstack([np.eye(n, 2 * n, k=n), motion])
    B = np.vstack([np.zeros_like(push), push])
    seen = push.copy()
    if absolute:
        seen[:, len(forces) :] = 0  # −ι a of the relative motion and +ι a of the base
    C, D = _sensor_rows(sensors, motion, seen)
    return StateSpace(A, B, C, D, None)


def undamped_modes(mass: ArrayLike, stiffness: ArrayLike) -> tuple[Floats, Floats]:
    """Return natural frequencies (n_dof,) [Hz], ascending, and mass-normalized shapes.

    Column k of the shapes Φ (n_dof, n_dof) belongs to frequency k; Φᵀ M Φ = I.

    Raises
    ------
    OptionError
        M not positive definite, or K with a negative eigenvalue, which is no stable spring.

    Examples
    --------
    >>> frequencies_hz, shapes = undamped_modes([[4.0]], [[4.0 * (2 * np.pi) ** 2]])
    >>> frequencies_hz, abs(shapes)
    (array([1.]), array([[0.5]]))
    """
    M, K = check_matrices(mass, stiffness)
    try:
        squares, shapes = scipy.linalg.eigh(K, M)
    except np.linalg.LinAlgError:
        raise OptionError("The mass matrix must be positive definite; it is not.") from None
    if squares[0] < -1e-9 * np.abs(squares).max():
        raise OptionError(
            f"The stiffness matrix gives ω² = {squares[0]:.3g}; it must not be negative. "
            "Check the signs of the springs."
        )
    return np.sqrt(np.maximum(squares, 0)) / (2 * np.pi), np.asarray(shapes)


def rayleigh_damping(mass: ArrayLike, stiffness: ArrayLike, alpha: float, beta: float) -> Floats:
    """Return R = alpha M + beta K (n_dof, n_dof); alpha in 1/s, beta in s."""
    M, K = check_matrices(mass, stiffness)
    return np.asarray(alpha * M + beta * K)


def modal_damping(mass: ArrayLike, stiffness: ArrayLike, damping_ratios: ArrayLike) -> Floats:
    """Return the R (n_dof, n_dof) with these damping ratios, one for all modes or one a mode.

    R = M Φ diag(2 ζ ω) Φᵀ M with the mass-normalized Φ, modes by ascending frequency.

    Examples
    --------
    >>> modal_damping([[2.0]], [[8.0]], 0.1)
    array([[0.8]])
    """
    M, K = check_matrices(mass, stiffness)
    frequencies_hz, shapes = undamped_modes(M, K)
    ratios = np.asarray(damping_ratios, dtype=np.float64)
    if ratios.shape not in ((), (len(M),)):
        raise OptionError(
            f"damping_ratios must be one number or {len(M)}, one a mode; got shape {ratios.shape}."
        )
    weighted = M @ shapes
    return np.asarray((weighted * (2 * ratios * 2 * np.pi * frequencies_hz)) @ weighted.T)


def check_matrices(*matrices: ArrayLike) -> list[Floats]:
    """Return square matrices of one size as float64, or raise `OptionError`."""
    arrays = [np.array(matrix, dtype=np.float64) for matrix in matrices]
    size = arrays[0].shape
    for array in arrays:
        if array.ndim != 2 or array.shape != size or size[0] != size[1] or not size[0]:
            shapes = ", ".join(str(each.shape) for each in arrays)
            raise OptionError(f"M, R and K must be square and of one size; got {shapes}.")
        if not np.isfinite(array).all():
            raise OptionError("M, R and K must be finite; NaN or infinite values found.")
    return arrays


def _solve_mass(M: Floats, right: Floats) -> Floats:
    try:
        return np.asarray(np.linalg.solve(M, right))
    except np.linalg.LinAlgError:
        raise OptionError("The mass matrix is singular; every DOF needs a mass.") from None


def _influence(base: ArrayLike | bool | None, n: int) -> Floats:
    """Return ι as a column, or no column."""
    if base is None or base is False:
        return np.zeros((n, 0))
    vector = np.ones(n) if base is True else np.asarray(base, dtype=np.float64)
    if vector.shape != (n,):
        raise OptionError(f"base must be True or {n} numbers, one a DOF; got shape {vector.shape}.")
    return vector[:, None]


def _sensor_rows(sensors: Sequence[Sensor], motion: Floats, push: Floats) -> tuple[Floats, Floats]:
    """Return C and D; acceleration is `motion` @ states + `push` @ inputs."""
    if not sensors:
        raise OptionError("At least one sensor is needed; none was given.")
    n = len(motion)
    rows: dict[str, tuple[Any, Any]] = {
        "displacement": (np.eye(n, 2 * n), np.zeros_like(push)),
        "velocity": (np.eye(n, 2 * n, k=n), np.zeros_like(push)),
        "acceleration": (motion, push),
    }
    C, D = np.empty((len(sensors), 2 * n)), np.empty((len(sensors), push.shape[1]))
    for k, (quantity, dof, *signs) in enumerate(sensors):
        check_choice("the quantity of a sensor", quantity, MOTIONS)
        check_whole("the DOF of a sensor", dof, 0, n - 1)
        sign = signs[0] if signs else 1
        C[k], D[k] = sign * rows[quantity][0][dof], sign * rows[quantity][1][dof]
    return C, D
