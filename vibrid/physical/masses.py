"""Masses: as given, or their ratios from the symmetry of K = M (M⁻¹K)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError
from ..mechanics import check_matrices
from ..record import Floats

VAGUE = 1e-6  # second smallest singular value, relative: below it ratios are not unique


def mass_ratios(normalized: Floats) -> Floats:
    """Return the ratios of lumped masses that make M (M⁻¹K) most symmetric, the first 1.

    Least squares of m_i N_ij = m_j N_ji over all pairs of DOFs. NaN where the data do not
    tell them (DOFs without coupling) or tell nonsense (a ratio that is not positive).

    Examples
    --------
    >>> mass_ratios(np.array([[3.0, -1.0], [-2.0, 2.0]])).round(12).tolist()
    [1.0, 0.5]
    """
    n = len(normalized)
    if n == 1:
        return np.ones(1)
    rows = []
    for i in range(n):
        for j in range(i + 1, n):
            row = np.zeros(n)
            row[i], row[j] = normalized[i, j], -normalized[j, i]
            rows.append(row)
    _, values, right = np.linalg.svd(np.array(rows))
    second = values[n - 2] if len(values) >= n - 1 else 0.0
    ratios = right[-1] / right[-1][0] if right[-1][0] else np.full(n, np.nan)
    known = second > VAGUE * np.abs(normalized).max() and (ratios > 0).all()
    return ratios if known else np.full(n, np.nan)


def given_mass(mass: ArrayLike, n_dof: int) -> Floats:
    """Return `mass` as a total (), or as a matrix from a vector or matrix; checked.

    Raises
    ------
    OptionError
        Wrong shape, values that are not positive (definite).
    """
    try:
        array = np.asarray(mass, dtype=np.float64)
    except (TypeError, ValueError):
        raise OptionError(
            f"mass must be the total, {n_dof} masses or a {n_dof} × {n_dof} matrix of numbers "
            f"[kg], in the order of the DOFs; got {mass!r}."
        ) from None
    if array.shape not in ((), (n_dof,), (n_dof, n_dof)):
        raise OptionError(
            f"mass must be the total, {n_dof} masses or a {n_dof} × {n_dof} matrix; got shape "
            f"{array.shape}."
        )
    if array.ndim < 2:
        if not (np.isfinite(array).all() and (array > 0).all()):
            raise OptionError("mass must be positive; it is not.")
        return array if array.ndim == 0 else np.diag(array)
    matrix = check_matrices(array)[0]
    off = np.abs(matrix - matrix.T).max()
    if off > 1e-9 * np.abs(matrix).max() or np.linalg.eigvalsh(matrix)[0] <= 0:
        raise OptionError("mass must be a symmetric, positive definite matrix; it is not.")
    return matrix


def asymmetry(matrix: Floats, least: float = 1e-300) -> float:
    """Return ‖X − Xᵀ‖_F / ‖X‖_F, the size of X taken as `least` at least."""
    return float(np.linalg.norm(matrix - matrix.T) / max(float(np.linalg.norm(matrix)), least))


def symmetric(matrix: Floats) -> Floats:
    return np.asarray(0.5 * (matrix + matrix.T))


def storey_stiffnesses(stiffness: ArrayLike) -> Floats:
    """Return the storey springs of a chain in the order of its DOFs, from the ground up.

    k_i is minus the mean of the two entries that join DOF i − 1 and i; the first is what
    remains of K₁₁.

    Examples
    --------
    >>> storey_stiffnesses([[5.0, -3.0], [-3.0, 3.0]])
    array([2., 3.])
    """
    (K,) = check_matrices(stiffness)
    upper = -0.5 * (np.diag(K, 1) + np.diag(K, -1))
    first = K[0, 0] - (upper[0] if len(upper) else 0.0)
    return np.append(first, upper)
