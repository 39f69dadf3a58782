"""Scaling of shapes by co-located pairs, and matrices from scaled shapes."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ..errors import DataError
from ..modes import Complexes
from ..record import Floats
from .layout import Layout
from .modal import Indices, ModalData

NODE = 1e-6  # of a shape's largest component: a smaller one is a node
COINCIDE = 1e-6  # relative distance below which poles share their shapes
CLOSE = 1e-2  # and below which they are scaled together where the layout allows: noise mixes
# their shapes. Of a triangle of equal masses with two modes at one place, 5 % noise, M is
# .3 instead of 8 % off; of modes 1 % apart nothing is lost.
APART = 0.05  # least motion at the co-located DOFs that allows it
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

    Of r poles that coincide only the space of their shapes is known, not the shapes: the
    scale is then a matrix T with T Tᵀ = V⁺ Gᵀ at the co-located DOFs, r of which are needed.
    Where they are, poles within 1 % are taken so too.

    Raises
    ------
    DataError
        A mode has a node at every co-located DOF, or more modes coincide than there are
        co-located DOFs, so that their scale cannot be told.
    """
    _check_nodes(data, layout)
    W = np.empty((layout.n_dof, len(data.poles)), dtype=np.complex128)
    for group in _groups(data, layout):
        V, G = data.shapes[:, group], data.forces[group]
        if len(group) > 1:
            W[:, group] = _of_group(V, G, layout)
        else:
            start = _from_pairs(V[:, 0], G[0], layout)
            W[:, group[0]] = _least_squares(start, V[:, 0], G[0], layout)
    W[:, data.pairs + 1] = W[:, data.pairs].conj()
    return W


def _groups(data: ModalData, layout: Layout) -> list[Indices]:
    """Return which poles are scaled together, one of each pair, most of them alone."""
    groups: list[Indices] = []
    for k in [*data.pairs, *data.reals]:
        pole, alone = data.poles[k], np.array([k])
        apart = abs(pole / data.poles[groups[-1][-1]] - 1) if groups else np.inf
        both = np.append(groups[-1], k) if apart < CLOSE else alone
        if apart < COINCIDE or (
            apart < CLOSE and _least_motion(data.shapes[:, both], layout) > APART
        ):
            groups[-1] = both
        else:
            groups.append(alone)
    return groups


def _of_group(V: Complexes, G: Complexes, layout: Layout) -> Complexes:
    mean_v = dof_means(V, layout.sensor_dofs, layout.n_dof)
    mean_g = dof_means(G.T, layout.force_dofs, layout.n_dof)
    S = np.linalg.lstsq(mean_v[layout.pairs], mean_g[layout.pairs], rcond=None)[0]
    T = scipy.linalg.sqrtm(0.5 * (S + S.T))
    seen = ~np.isnan(mean_v[:, :1].real)
    return np.asarray(np.where(seen, mean_v @ T, np.linalg.solve(T, mean_g.T).T))


def drive_point_motion(data: ModalData, layout: Layout) -> Floats:
    """Return how much each pole moves at the co-located DOFs, relative to its largest motion.

    Of poles that coincide, the least that any mixture of their shapes moves there.
    """
    seen = np.isin(layout.sensor_dofs, layout.pairs)
    size = np.abs(data.shapes)
    motion = np.asarray(size[seen].max(axis=0) / size.max(axis=0))
    for group in _groups(data, layout):
        if len(group) > 1:
            motion[group] = _least_motion(data.shapes[:, group], layout)
    motion[data.pairs + 1] = motion[data.pairs]
    return motion


def _least_motion(V: Complexes, layout: Layout) -> float:
    """Return the least motion at the co-located DOFs of all mixtures of shapes of size 1."""
    if min(len(V), len(layout.pairs)) < V.shape[1]:
        return 0.0
    unit = dof_means(np.linalg.qr(V)[0], layout.sensor_dofs, layout.n_dof)[layout.pairs]
    return float(np.linalg.svd(unit, compute_uv=False)[-1])


def _check_nodes(data: ModalData, layout: Layout) -> None:
    motion = drive_point_motion(data, layout)
    worst = int(np.argmin(motion))
    if motion[worst] < NODE:
        hertz = abs(data.poles[worst]) / (2 * np.pi)
        names = ", ".join(layout.dofs[k] for k in layout.pairs)
        together = max(len(group) for group in _groups(data, layout) if worst in group)
        if together > 1:
            raise DataError(
                f"{together} modes coincide at {hertz:.4g} Hz: their scale needs as many "
                f"co-located DOFs, at which they move differently; there is {names}. Add a "
                "co-located pair elsewhere."
            )
        raise DataError(
            f"The mode at {hertz:.4g} Hz has a node at {names}: its motion there is "
            f"{motion[worst]:.1e} of its largest, and no other DOF has a sensor and a force. "
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
