"""Rows of 𝒦 and 𝒟 that a free force hides, as far as symmetry and balance close them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..physical.masses import given_mass
from ..record import Floats

PROPORTIONAL = 3.0  # standard deviations that 𝒟 of free rows may be off αI + β𝒦


@dataclass(frozen=True, eq=False)
class Closed:
    """[𝒦 𝒟] with forced rows closed where that is allowed; NaN where not.

    Attributes
    ----------
    P, deviations : arrays (n, 2 n)
    said : tuple of str
        A sentence for each assumption that was used.
    open_dofs : int array
        Rows that stay unknown, whole or in part.
    """

    P: Floats
    deviations: Floats
    said: tuple[str, ...]
    open_dofs: NDArray[np.intp]


def whole_mass(mass: ArrayLike | None, n_dof: int) -> Floats | None:
    """Return M (n, n) of masses or a matrix; None of a total, which tells no ratios."""
    if mass is None:
        return None
    matrix = given_mass(mass, n_dof)
    return matrix if matrix.ndim == 2 else None


def close_rows(
    P: Floats,
    deviations: Floats,
    free: NDArray[np.bool_],
    mass: Floats | None,
    ungrounded: NDArray[np.bool_],
) -> Closed:
    """Return what follows for forced rows from the free ones.

    With lumped masses M 𝒦 is symmetric: 𝒦_ij = m_j 𝒦_ji / m_i from a free row j. A DOF that is
    said to have no spring to the ground has springs that sum to zero along its row. 𝒟 follows
    as αI + β𝒦 where the free rows are of that kind; its own rows need not sum to zero.

    Parameters
    ----------
    P, deviations : arrays (n, 2 n)
        Of all rows; those that are not free do not count.
    free : array of bool (n,)
    mass : array (n, n), optional
        Diagonal to be of use here.
    ungrounded : array of bool (n,)
        DOFs without a spring to the ground.
    """
    n = len(P)
    closed, spread = np.where(free[:, None], P, np.nan), np.where(free[:, None], deviations, np.nan)
    said: list[str] = []
    lumped = mass is not None and np.count_nonzero(mass - np.diag(np.diag(mass))) == 0
    if lumped and mass is not None and free.any() and not free.all():
        ratio = np.diag(mass) / np.diag(mass)[:, None]  # m_j / m_i
        for values, source in ((closed, P), (spread, deviations)):
            K = values[:, :n]
            K[np.ix_(~free, free)] = (ratio * source[:, :n].T)[np.ix_(~free, free)]
        said.append("forced rows of M⁻¹K beside the diagonal are from the symmetry of K")
        _balance(closed, spread, ~free & ungrounded, said)
        _proportional(closed, spread, deviations, free, said)
    return Closed(closed, spread, tuple(said), np.flatnonzero(np.isnan(closed).any(axis=1)))


def _balance(closed: Floats, spread: Floats, rows: NDArray[np.bool_], said: list[str]) -> None:
    n = len(closed)
    for row in np.flatnonzero(rows):
        others = np.arange(n) != row
        if np.isfinite(closed[row, :n][others]).all():
            closed[row, row] = -closed[row, :n][others].sum()
            spread[row, row] = np.sqrt((spread[row, :n][others] ** 2).sum())
            said.append(f"row {row + 1} of M⁻¹K sums to zero, as no spring goes to the ground")


def _proportional(
    closed: Floats, spread: Floats, deviations: Floats, free: NDArray[np.bool_], said: list[str]
) -> None:
    """Fill rows of 𝒟 by αI + β𝒦 where the free rows allow it and 𝒦 is known."""
    n = len(closed)
    K, weight = closed[free, :n], 1 / deviations[free, n:].ravel()
    design = np.column_stack([np.eye(n)[free].ravel(), K.ravel()]) * weight[:, None]
    wanted = closed[free, n:].ravel() * weight
    (alpha, beta), *_ = np.linalg.lstsq(design, wanted, rcond=None)
    left = wanted - design @ np.array([alpha, beta])
    if np.sqrt(np.mean(left**2)) > PROPORTIONAL:
        return
    whole = ~free & np.isfinite(closed[:, :n]).all(axis=1)
    if not whole.any():
        return
    V = np.linalg.inv(design.T @ design)
    rows = np.stack([np.eye(n)[whole], closed[whole, :n]])
    closed[whole, n:] = alpha * rows[0] + beta * rows[1]
    variance = np.einsum("aij,ab,bij->ij", rows, V, rows) + (beta * spread[whole, :n]) ** 2
    spread[whole, n:] = np.sqrt(variance)
    said.append(f"forced rows of M⁻¹D are αI + β M⁻¹K, α = {alpha:.3g} 1/s, β = {beta:.3g} s")
