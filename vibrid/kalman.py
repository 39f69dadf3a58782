"""Kalman gains of innovations models."""

from __future__ import annotations

import numpy as np

from .record import Floats

# spectral radius of a model: an undamped structure is on the circle, and rounding splits the
# double pole of a rigid body by about the root of the working precision
STABLE_TO = 1 + 1e-7
DETECTABLE = 1 - 1e-10  # spectral radius that a usable predictor stays below
DOUBLINGS = 60
SETTLED = 1e-9  # last step of the doubling, relative: the next would be its square
GRID = 513  # angles at which a spectrum is looked at, the poles' own beside
RAISES = 20  # steps of raising Λ(0) before giving up
RAISE_FACTOR = 1.25
SMALLEST_RAISE = 1e-6


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
        P = state_error_covariance(A, C, state_noise, output_noise, cross_noise)
        innovation = C @ P @ C.T + output_noise
        gain = np.asarray(np.linalg.solve(innovation, (A @ P @ C.T + cross_noise).T).T, dtype=float)
    except (np.linalg.LinAlgError, ValueError):
        return None
    if not np.isfinite(innovation).all() or np.linalg.eigvalsh(innovation)[0] <= 0:
        return None
    if not np.isfinite(gain).all() or spectral_radius(A - gain @ C) >= DETECTABLE:
        return None
    return gain, innovation


def state_error_covariance(
    A: Floats, C: Floats, state_noise: Floats, output_noise: Floats, cross_noise: Floats
) -> Floats:
    """Return P = A P Aᵀ + Q − (A P Cᵀ + S) (C P Cᵀ + R)⁻¹ (A P Cᵀ + S)ᵀ that stabilizes.

    By doubling (Chu, Fan, Lin & Wang 2004): each step squares the predictor's transition, so
    few are needed, of matrix products only.

    Raises
    ------
    LinAlgError
        R is singular, or there is no such P.
    """
    inner = np.linalg.solve(output_noise, np.hstack([C, cross_noise.T]))
    n = len(A)
    F = (A - cross_noise @ inner[:, :n]).T
    G, H = C.T @ inner[:, :n], state_noise - cross_noise @ inner[:, n:]
    with np.errstate(over="ignore", invalid="ignore"):  # where there is no P
        for _ in range(DOUBLINGS):
            both = np.linalg.solve(np.eye(n) + G @ H, np.hstack([F, G]))
            step = F.T @ (H @ both[:, :n])
            after = F @ both
            G = G + after[:, n:] @ F.T
            H, F = H + (step + step.T) / 2, after[:, :n]
            if not np.isfinite(H).all():
                break
            if np.abs(step).max() <= SETTLED * np.abs(H).max():
                return np.asarray(H)
    raise np.linalg.LinAlgError("the Riccati equation has no stabilizing solution")


def innovation_form(
    A: Floats, C: Floats, G: Floats, L0: Floats
) -> tuple[Floats, Floats, Floats, float] | None:
    """Return the innovations model of output covariances Λ(0) = L0, Λ(l) = C A^(l−1) G.

    Estimated covariances need not be those of any process (their spectrum may turn negative).
    Then white noise, in proportion to the outputs' variances, is added to Λ(0) until they
    are; poles and shapes do not depend on it.

    Parameters
    ----------
    A : array (n, n)
        Stable; otherwise the answer is None.
    C : array (p, n)
    G : array (n, p)
        E x(t+1) y(t)ᵀ.
    L0 : array (p, p)
        E y(t) y(t)ᵀ.

    Returns
    -------
    gain : array (n, p)
    innovation_covariance : array (p, p)
    state_covariance : array (n, n)
    raised : float
        White noise added, as a share of the outputs' variances; 0 where none was needed.

    Notes
    -----
    P = A P Aᵀ + (G − A P Cᵀ) Λ⁻¹ (G − A P Cᵀ)ᵀ, Λ = Λ(0) − C P Cᵀ, K = (G − A P Cᵀ) Λ⁻¹: the
    minimal solution of the positive-real lemma (Faurre 1976; Van Overschee & De Moor 1996).
    """
    if spectral_radius(A) >= DETECTABLE:
        return None
    white = np.diag(np.diag(L0))
    found = _positive_real(A, C, G, L0)
    if found is not None:
        return *found, 0.0
    raised = max(0.0, -_lowest_spectrum(A, C, G, L0))
    for _ in range(RAISES):
        raised = max(SMALLEST_RAISE, RAISE_FACTOR * raised)
        found = _positive_real(A, C, G, L0 + raised * white)
        if found is not None:
            return *found, raised
    return None


def _positive_real(
    A: Floats, C: Floats, G: Floats, L0: Floats
) -> tuple[Floats, Floats, Floats] | None:
    try:
        P = state_error_covariance(A, C, np.zeros_like(A), -L0, -G)
        innovation = L0 - C @ P @ C.T
        gain = np.asarray(np.linalg.solve(innovation, (G - A @ P @ C.T).T).T, dtype=float)
    except (np.linalg.LinAlgError, ValueError):
        return None
    if not np.isfinite(P).all() or np.linalg.eigvalsh(innovation)[0] <= 0:
        return None
    if not np.isfinite(gain).all() or spectral_radius(A - gain @ C) >= DETECTABLE:
        return None
    return gain, innovation, (P + P.T) / 2


def _lowest_spectrum(A: Floats, C: Floats, G: Floats, L0: Floats) -> float:
    """Return the lowest eigenvalue of the spectrum on a grid, outputs scaled to variance one."""
    size = np.sqrt(np.diag(L0))
    angles = np.concatenate([np.linspace(0, np.pi, GRID), np.abs(np.angle(np.linalg.eigvals(A)))])
    shifted = np.exp(1j * angles)[:, None, None] * np.eye(len(A)) - A
    causal = C @ np.linalg.solve(shifted, G.astype(complex))  # A may lack eigenvectors
    spectrum = L0 + causal + causal.conj().transpose(0, 2, 1)
    return float(np.linalg.eigvalsh(spectrum / np.outer(size, size)).min())
