"""The nearest [𝒦 𝒟] of a structure: known masses, symmetry, topology."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ...errors import DataError
from ...physical.projection import Topology, pattern_space
from ...record import Floats

STEPS = 30
SETTLED = 1e-10
SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class Constrained:
    """[𝒦 𝒟] of a structure, and how far the data are from it.

    Attributes
    ----------
    P : array (n, 2 n)
    covariance : array (2 n², 2 n²)
    distance : float
        χ² of what the structure changed.
    freedom : int
        Its degrees of freedom.
    """

    P: Floats
    covariance: Floats
    distance: float
    freedom: int

    @property
    def chance(self) -> float:
        """Probability of a distance this large if the structure were true."""
        from scipy.stats import chi2  # slow to import, and used only here

        return float(chi2.sf(self.distance, self.freedom)) if self.freedom else 1.0


def constrain(
    P: Floats, covariance: Floats, topology: Topology, mass: Floats | None = None
) -> Constrained:
    """Return the [𝒦 𝒟] = M⁻¹[K D] of a topology that is nearest by covariance.

    Asymptotically maximum likelihood. Without masses, their ratios are estimated too, diagonal
    and the first one 1.

    Parameters
    ----------
    P : array (n, 2 n)
    covariance : array (2 n², 2 n²)
        Of the columns of P, stacked.
    topology : Topology
    mass : array (n, n), optional

    Raises
    ------
    DataError
        The data do not determine the entries of this structure.
    """
    n = len(P)
    springs = pattern_space(topology.stiffness, n)
    dampers = pattern_space(topology.damping, n)
    # rounding may leave the smallest eigenvalues negative; shifting them is nothing
    size = np.sqrt(np.diag(covariance))
    unit = covariance / size / size[:, None]
    L = size[:, None] * sla.cholesky(unit + SINGULAR * np.eye(len(unit)), lower=True)
    wanted = P.ravel(order="F")
    if mass is not None:
        slope = _by_entries(np.asarray(np.linalg.inv(mass)), springs, dampers)
        values, spread = _solved(slope, wanted, L)
    else:
        slope, values, spread = _with_mass_ratios(wanted, L, springs, dampers)
    found = slope[:, : len(springs) + len(dampers)] @ values
    left = sla.solve_triangular(L, wanted - found, lower=True)
    covariance = slope @ spread @ slope.T
    freedom = len(wanted) - slope.shape[1]
    return Constrained(found.reshape(2 * n, n).T, covariance, float(left @ left), freedom)


def _with_mass_ratios(
    wanted: Floats, L: Floats, springs: Floats, dampers: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return slope, entries of K and D, and covariance, masses but the first one unknown too."""
    n, count = springs.shape[1], len(springs) + len(dampers)
    masses, values = np.ones(n), np.zeros(0)
    for _ in range(STEPS):
        slope = _by_entries(np.diag(1 / masses), springs, dampers)
        if not len(values):
            values = _solved(slope, wanted, L)[0]
        made = slope @ values
        slope = np.hstack([slope, -_by_masses(made, n)])
        step, spread = _solved(slope, wanted - made, L)
        values = values + step[:count]
        masses = masses * np.exp(np.clip(np.append(0.0, step[count:]), -1, 1))
        if np.abs(step[count:]).max(initial=0) < SETTLED:
            break
    return slope, values, spread


def _by_entries(inverse: Floats, springs: Floats, dampers: Floats) -> Floats:
    """Return the derivatives of vec M⁻¹[K D] by the entries of K and D."""
    n = len(inverse)
    left = np.array([np.hstack([inverse @ each, np.zeros((n, n))]) for each in springs])
    right = np.array([np.hstack([np.zeros((n, n)), inverse @ each]) for each in dampers])
    both = np.concatenate([left, right])
    return np.asarray(both.transpose(2, 1, 0).reshape(2 * n * n, -1))


def _by_masses(made: Floats, n: int) -> Floats:
    """Return minus the derivatives of vec M⁻¹[K D] by ln m of all masses but the first."""
    rows = np.tile(np.arange(n), 2 * n)
    return np.asarray((rows[:, None] == np.arange(1, n)) * made[:, None])


def _solved(slope: Floats, wanted: Floats, L: Floats) -> tuple[Floats, Floats]:
    """Return the least-squares step by covariance L Lᵀ, and its covariance."""
    A = sla.solve_triangular(L, slope, lower=True)
    size = np.linalg.norm(A, axis=0)
    if (size == 0).any():
        raise DataError("The data do not touch some entries of this structure.")
    left, values, right = np.linalg.svd(A / size, full_matrices=False)
    if values[-1] < SINGULAR * values[0]:
        raise DataError(
            f"The data do not determine the {slope.shape[1]} entries of this structure; give the "
            "masses, or a sparser structure."
        )
    b = sla.solve_triangular(L, wanted, lower=True)
    inverse = (right.T / values) / size[:, None]
    return np.asarray(inverse @ (left.T @ b)), np.asarray(inverse @ inverse.T)
