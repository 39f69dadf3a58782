"""Gramians and balancing."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from ..errors import DataError
from ..record import Floats


def gramian(A: Floats, B: Floats, discrete: bool) -> Floats:
    """Return Σ A^k B Bᵀ A^kᵀ, or its integral in continuous time, for a stable A.

    The discrete sum is doubled (Smith 1968, squared): k steps add 2^k terms, all of them
    positive, so that poles close to the unit circle cost a few more steps and no accuracy.
    """
    Q = B @ B.T
    if not discrete:
        P = np.asarray(scipy.linalg.solve_continuous_lyapunov(A, -Q), dtype=np.float64)
        return np.asarray(0.5 * (P + P.T))
    P, power = Q, A
    while np.linalg.norm(power) > 1e-10:  # what is left out is smaller by its square
        P = P + power @ P @ power.T
        power = power @ power
    return np.asarray(0.5 * (P + P.T))


def balancing(controllability: Floats, observability: Floats) -> tuple[Floats, Floats, Floats]:
    """Return T, T⁻¹ and the Hankel singular values; x = T x_balanced (square-root method).

    Raises
    ------
    DataError
        A state is unreachable or unobservable: there is no balanced basis.
    """
    reach, observe = _root(controllability), _root(observability)
    U, values, Vt = np.linalg.svd(observe.T @ reach)
    if not values[-1] > len(values) * np.finfo(float).eps * values[0]:
        raise DataError(
            f"The smallest Hankel singular value is {values[-1]:.2e} of {values[0]:.2e}: a state "
            "is unreachable or unobservable and cannot be balanced. Use a lower order."
        )
    scale = 1 / np.sqrt(values)
    return reach @ Vt.T * scale, scale[:, None] * (U.T @ observe.T), values


def _root(P: Floats) -> Floats:
    """Return R with R Rᵀ = P, P symmetric and not negative but for rounding."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0)))
