"""Rows of 𝒦 and 𝒟 that a free force hides, as far as symmetry and balance close them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..physical.masses import given_mass
from ..record import Floats

COUPLED = 10.0  # standard deviations that 𝒦_ij is off zero, to tell the ratio of masses
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

    With lumped masses M 𝒦 and M 𝒟 are symmetric: 𝒦_ij = m_j 𝒦_ji / m_i from a free row j. A DOF
    that is said to have no spring to the ground has springs that sum to zero along its row. The
    diagonal of 𝒟 follows as that of αI + β𝒦 where the free rows are of that kind; its own rows
    need not sum to zero.

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
            for part in (slice(n), slice(n, 2 * n)):
                mirrored = ratio * source[:, part].T
                values[:, part][np.ix_(~free, free)] = mirrored[np.ix_(~free, free)]
        said.append("forced rows, where they meet free ones, are from the symmetry of K and D")
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
    """Fill what rows of 𝒟 lack by αI + β𝒦 where the free rows allow it and 𝒦 is known."""
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
    variance = np.einsum("aij,ab,bij->ij", rows, V, rows) + (beta * spread[whole, :n]) ** 2
    lacking = np.isnan(closed[whole, n:])
    closed[whole, n:] = np.where(lacking, alpha * rows[0] + beta * rows[1], closed[whole, n:])
    spread[whole, n:] = np.where(lacking, np.sqrt(variance), spread[whole, n:])
    said.append(
        "what symmetry leaves open of forced rows of M⁻¹D is that of αI + β M⁻¹K, "
        f"α = {alpha:.3g} 1/s, β = {beta:.3g} s"
    )


@dataclass(frozen=True)
class Lag:
    """How far 𝒟 of two free rows is from symmetric, as a lag between their sensors.

    Attributes
    ----------
    first, second : int
        The rows.
    seconds : float
        By which the second sensor would lag behind the first.
    certainty : float
        The asymmetry in its standard deviations.
    """

    first: int
    second: int
    seconds: float
    certainty: float


def lag_between(P: Floats, deviations: Floats, free: NDArray[np.bool_]) -> Lag | None:
    """Return the lag that stands out most among pairs of free rows, None where none can.

    The ratio of lumped masses follows from 𝒦: m_j / m_i = 𝒦_ij / 𝒦_ji, so that 𝒟_ij should be
    𝒟_ji 𝒦_ij / 𝒦_ji. A sensor j that lags by τ turns 𝒦_ij q_j into 𝒦_ij (q_j + τ q̇_j): it
    adds τ 𝒦_ij to 𝒟_ij, and takes τ 𝒦_ji from 𝒟_ji.
    """
    n, worst = len(P), None
    K, D, K_off, D_off = P[:, :n], P[:, n:], deviations[:, :n], deviations[:, n:]
    for i, j in combinations(np.flatnonzero(free), 2):
        sure = min(abs(K[i, j]) / K_off[i, j], abs(K[j, i]) / K_off[j, i])
        ratio = K[i, j] / K[j, i]
        if sure < COUPLED or ratio <= 0:
            continue
        gap = D[i, j] - ratio * D[j, i]
        certainty = abs(gap) / float(np.hypot(D_off[i, j], ratio * D_off[j, i]))
        if worst is None or certainty > worst.certainty:
            worst = Lag(int(i), int(j), float(gap / (2 * K[i, j])), certainty)
    return worst
