"""Kalman gains of innovations models."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from .record import Floats

# spectral radius of a model: an undamped structure is on the circle, and rounding splits the
# double pole of a rigid body by about the root of the working precision
STABLE_TO = 1 + 1e-7
DETECTABLE = 1 - 1e-10  # spectral radius that a usable predictor stays below


def spectral_radius(matrix: Floats) -> float:
    """Return the largest magnitude of the eigenvalues; 0 for an empty matrix."""
    return float(np.abs(np.linalg.eigvals(matrix)).max()) if len(matrix) else 0.0


def riccati_gain(
    A: Floats,
    C: Floats,
    state_noise: Floats,
    output_noise: Floats,
    cross_noise: Floats,
) -> tuple[Floats, Floats] | None:
    """Return the steady Kalman gain and innovation covariance, or None where there is none.

    Parameters
    ----------
    A : array (n, n)
    C : array (p, n)
    state_noise, output_noise, cross_noise : array (n, n), (p, p), (n, p)
        Covariances Q, R, S of x⁺ = A x + w, y = C x + v.

    Notes
    -----
    P = A P Aᵀ + Q − K Λ Kᵀ, Λ = C P Cᵀ + R, K = (A P Cᵀ + S) Λ⁻¹ (Anderson & Moore 1979).
    """
    try:
        P = sla.solve_discrete_are(A.T, C.T, state_noise, output_noise, s=cross_noise)
        innovation = C @ P @ C.T + output_noise
        gain = np.linalg.solve(innovation, (A @ P @ C.T + cross_noise).T).T
    except (np.linalg.LinAlgError, ValueError):
        return None
    if not np.isfinite(innovation).all() or np.linalg.eigvalsh(innovation)[0] <= 0:
        return None
    if not np.isfinite(gain).all() or spectral_radius(A - gain @ C) >= DETECTABLE:
        return None
    return gain, innovation
