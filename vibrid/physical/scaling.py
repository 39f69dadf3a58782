"""Scaling of shapes by co-located pairs, and matrices from scaled shapes."""

from __future__ import annotations

import numpy as np

from ..errors import DataError
from ..modes import Complexes
from ..record import Floats
from .layout import Layout
from .modal import ModalData

NODE = 1e-6  # of a shape's largest component: a smaller one is a node
STEPS = 20  # of Gauss-Newton, which starts close: a few are used


def scaled_shapes(data: ModalData, layout: Layout) -> Complexes:
    """Return W (n_dof, n_poles), scaled so that Ψᵀ U Ψ = I (plain transposes).

    Symbols: v_s, g_a entries of the displacement shape at sensor s and of the row of
    Ψ̂⁻¹ B_c at actuator a; w_s = t v_s and w_a = g_a / t.

    Notes
    -----
    One co-located pair gives t² = g_a / v_s (Pappalardo et al. 2022, eq. 119-122, with the
    sensor's row and the actuator's column at one DOF; De Angelis et al. 2002). Several
    pairs, or several sensors at a DOF: all of w by least squares on the displacement
    residues v_s g_a = w_s w_a of all sensors and actuators, pole by pole. The sign of t
    does not matter: M, K and R are quadratic in w.

    Raises
    ------
    DataError
        A mode has a node at every co-located DOF, so that its scale cannot be told.
    """
    _check_nodes(data, layout)
    W = np.empty((layout.n_dof, len(data.poles)), dtype=np.complex128)
    for k in [*data.pairs, *data.reals]:
        start = _from_pairs(data.shapes[:, k], data.forces[k], layout)
        W[:, k] = _least_squares(start, data.shapes[:, k], data.forces[k], layout)
    W[:, data.pairs + 1] = W[:, data.pairs].conj()
    return W


def drive_point_motion(data: ModalData, layout: Layout) -> Floats:
    """Return how much each pole moves at the co-located DOFs, relative to its largest motion."""
    seen = np.isin(layout.sensor_dofs, layout.pairs)
    size = np.abs(data.shapes)
    return np.asarray(size[seen].max(axis=0) / size.max(axis=0))


def _check_nodes(data: ModalData, layout: Layout) -> None:
    motion = drive_point_motion(data, layout)
    if motion.min() < NODE:
        hertz = abs(data.poles[int(np.argmin(motion))]) / (2 * np.pi)
        names = ", ".join(layout.dofs[k] for k in layout.pairs)
        raise DataError(
            f"The mode at {hertz:.4g} Hz has a node at {names}: its motion there is "
            f"{motion.min():.1e} of its largest, and no other DOF has a sensor and a force. "
            "Add a co-located pair elsewhere."
        )


def _from_pairs(v: Complexes, g: Complexes, layout: Layout) -> Complexes:
    mean_v = dof_means(v[:, None], layout.sensor_dofs, layout.n_dof)[:, 0]
    mean_g = dof_means(g[:, None], layout.force_dofs, layout.n_dof)[:, 0]
    pairs = layout.pairs
    square = np.vdot(mean_v[pairs], mean_g[pairs]) / np.vdot(mean_v[pairs], mean_v[pairs])
    t = np.sqrt(complex(square))
    seen = ~np.isnan(mean_v.real)
    return np.asarray(np.where(seen, t * mean_v, mean_g / t))


def _least_squares(w: Complexes, v: Complexes, g: Complexes, layout: Layout) -> Complexes:
    """Return w with w_s w_a closest to the residues v_s g_a (complex Gauss-Newton)."""
    s = np.repeat(layout.sensor_dofs, len(g))
    a = np.tile(layout.force_dofs, len(v))
    residue = np.outer(v, g).ravel()
    if len(residue) == len(w):
        return w  # one pair and nothing twice: solved exactly
    rows = np.arange(len(residue))
    for _ in range(STEPS):
        slope = np.zeros((len(residue), len(w)), dtype=np.complex128)
        np.add.at(slope, (rows, s), w[a])
        np.add.at(slope, (rows, a), w[s])
        step = np.linalg.lstsq(slope, residue - w[s] * w[a], rcond=None)[0]
        w = w + step
        if np.linalg.norm(step) < 1e-14 * np.linalg.norm(w):
            break
    return w


def dof_means(rows: Complexes, places: np.ndarray, n_dof: int) -> Complexes:
    """Return the mean of the rows at each DOF (n_dof, k), NaN where there is none."""
    total = np.zeros((n_dof, rows.shape[1]), dtype=np.complex128)
    np.add.at(total, places, rows)
    count = np.bincount(places, minlength=n_dof)
    total[count == 0] = np.nan
    return np.asarray(total / np.maximum(count, 1)[:, None])


def matrices_of(W: Complexes, poles: Complexes) -> tuple[Floats, Floats, Floats]:
    """Return M, R, K (n_dof, n_dof) of scaled shapes.

    M = (W Λ Wᵀ)⁻¹, K = −(W Λ⁻¹ Wᵀ)⁻¹, R = −M W Λ² Wᵀ M (Pappalardo et al. 2022, eq. 123).
    Of fewer pairs than DOFs pseudoinverses, the matrices of the subspace of the shapes.
    """
    M = _inverse(((W * poles) @ W.T).real, W.shape[1] // 2)
    K = -_inverse(((W / poles) @ W.T).real, W.shape[1] // 2)
    R = -M @ ((W * poles**2) @ W.T).real @ M
    return M, R, K


def _inverse(matrix: Floats, rank: int) -> Floats:
    if rank >= len(matrix):
        return np.asarray(np.linalg.inv(matrix))
    left, values, right = np.linalg.svd(matrix)
    return np.asarray((right[:rank].T / values[:rank]) @ left[:, :rank].T)


def flexibility_of(W: Complexes, poles: Complexes) -> Floats:
    """Return −W Λ⁻¹ Wᵀ, the flexibility at the instrumented DOFs of all modes in W."""
    return np.asarray(-((W / poles) @ W.T).real)


def normalized_of(shapes: Complexes, poles: Complexes) -> tuple[Floats, Floats]:
    """Return M⁻¹R and M⁻¹K from displacement shapes of any scale, as many pairs as DOFs.

    [M⁻¹K M⁻¹R] = −Φ Λ² [Φ; Φ Λ]⁻¹ (Han, Bohn & Bauer 2021; De Angelis et al. 2002), with
    both poles of each pair. Of fewer pairs than DOFs the solution of minimum norm.
    """
    n = len(shapes)
    both = np.vstack([shapes, shapes * poles])
    right = -shapes * poles**2
    size = np.linalg.norm(both, axis=0)  # the columns' scale is free: equal ones
    if both.shape[1] == 2 * n:
        solved = np.linalg.solve((both / size).T, (right / size).T).T
    else:
        solved = np.linalg.lstsq((both / size).T, (right / size).T, rcond=None)[0].T
    return solved[:, n:].real, solved[:, :n].real


def per_mass(M: Floats, R: Floats, K: Floats) -> tuple[Floats, Floats]:
    """Return M⁻¹R and M⁻¹K."""
    return np.asarray(np.linalg.solve(M, R)), np.asarray(np.linalg.solve(M, K))
