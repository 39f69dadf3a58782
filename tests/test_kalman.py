"""Kalman gains against models in innovations form, whose gain is known."""

from __future__ import annotations

import numpy as np
import pytest

from vibrid.kalman import innovation_form, riccati_gain, spectral_radius
from vibrid.record import Floats


def innovations_model(rng: np.random.Generator) -> tuple[Floats, Floats, Floats, Floats]:
    """Return A, C, K, Λ with a stable predictor A − K C."""
    n, p = 5, 2
    A = rng.standard_normal((n, n))
    A *= 0.95 / spectral_radius(A)
    C = rng.standard_normal((p, n))
    root = rng.standard_normal((p, p))
    K = 0.05 * rng.standard_normal((n, p))
    assert spectral_radius(A - K @ C) < 1
    return A, C, K, root @ root.T + np.eye(p)


def test_gain_of_an_innovations_model(rng: np.random.Generator) -> None:
    """x⁺ = A x + K e, y = C x + e has the gain K and the innovation covariance Λ."""
    A, C, K, innovation = innovations_model(rng)
    found = riccati_gain(A, C, K @ innovation @ K.T, innovation, K @ innovation)
    assert found is not None
    np.testing.assert_allclose(found[0], K, atol=1e-9)
    np.testing.assert_allclose(found[1], innovation, rtol=1e-9)


def test_gain_solves_the_riccati_equation(rng: np.random.Generator) -> None:
    """The covariance that a long recursion settles on gives the same gain."""
    A, C, _, output_noise = innovations_model(rng)
    root = rng.standard_normal((7, 7))
    Q, R, S = root[:5] @ root[:5].T, root[5:] @ root[5:].T + output_noise, root[:5] @ root[5:].T
    P = np.eye(5)
    for _ in range(500):
        gain = (A @ P @ C.T + S) @ np.linalg.inv(C @ P @ C.T + R)
        P = A @ P @ A.T + Q - gain @ (C @ P @ C.T + R) @ gain.T
    found = riccati_gain(A, C, Q, R, S)
    assert found is not None
    np.testing.assert_allclose(found[0], gain, rtol=1e-8)


def test_scalar_gain_by_hand() -> None:
    """A random walk in unit noise: P = (1 + √5) / 2, gain P / (P + 1)."""
    one = np.ones((1, 1))
    found = riccati_gain(one, one, one, one, 0 * one)
    assert found is not None
    P = (1 + np.sqrt(5)) / 2
    np.testing.assert_allclose([found[0][0, 0], found[1][0, 0]], [P / (P + 1), P + 1], rtol=1e-12)


@pytest.mark.parametrize(
    ("a", "c", "q", "r"),
    [(1.2, 0.0, 1.0, 1.0), (1.0, 1.0, 0.0, 1.0), (0.5, 1.0, 0.0, 0.0), (0.5, 1.0, np.nan, 1.0)],
    ids=["not observed", "never driven on the circle", "noise free", "not a number"],
)
def test_no_gain_is_none(a: float, c: float, q: float, r: float) -> None:
    """Where no steady, stable predictor exists the answer is None, not a wrong gain."""
    matrices = (np.array([[value]]) for value in (a, c, q, r, 0.0))
    assert riccati_gain(*matrices) is None


def covariances(A: Floats, C: Floats, K: Floats, innovation: Floats) -> tuple[Floats, Floats]:
    """Return G and Λ(0) of an innovations model, its state covariance by summing powers."""
    P, power = np.zeros_like(A), K
    for _ in range(2000):
        P += power @ innovation @ power.T
        power = A @ power
    return A @ P @ C.T + K @ innovation, C @ P @ C.T + innovation


def test_innovation_form_of_exact_covariances(rng: np.random.Generator) -> None:
    """Covariances of an innovations model give back its gain, and need no white noise."""
    A, C, K, innovation = innovations_model(rng)
    found = innovation_form(A, C, *covariances(A, C, K, innovation))
    assert found is not None
    np.testing.assert_allclose(found[0], K, atol=1e-8)
    np.testing.assert_allclose(found[1], innovation, rtol=1e-8)
    np.testing.assert_allclose(
        found[2], A @ found[2] @ A.T + K @ innovation @ K.T, atol=1e-8 * abs(found[2]).max()
    )
    assert found[3] == 0


def test_covariances_of_no_process_get_white_noise(rng: np.random.Generator) -> None:
    """Where Λ(0) is too small for the rest, enough is added for a stable predictor."""
    A, C, K, innovation = innovations_model(rng)
    G, L0 = covariances(A, C, K, innovation)
    found = innovation_form(A, C, G, 0.3 * L0)
    assert found is not None
    gain, left, P, raised = found
    assert raised > 0
    assert spectral_radius(A - gain @ C) < 1
    assert np.linalg.eigvalsh(left)[0] > 0
    whitened = 0.3 * L0 + raised * np.diag(np.diag(0.3 * L0))
    np.testing.assert_allclose(C @ P @ C.T + left, whitened, rtol=1e-8)
    np.testing.assert_allclose(A @ P @ C.T + gain @ left, G, atol=1e-8 * abs(G).max())


def test_unstable_models_have_no_innovation_form() -> None:
    """No stationary process has a pole on or outside the circle."""
    one = np.ones((1, 1))
    assert innovation_form(one, one, one, 2 * one) is None


def test_spectral_radius() -> None:
    """The largest magnitude of complex eigenvalues; 0 without any."""
    rotation = 0.9 * np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert spectral_radius(rotation) == pytest.approx(0.9)
    assert spectral_radius(np.zeros((0, 0))) == 0


def test_white_noise_added_to_covariances_that_end() -> None:
    """Moving averages have a nilpotent A: 1 + 1.8 cos θ + 1.2 cos 2θ falls to −.5375."""
    A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    found = innovation_form(A, C, np.array([[0.9], [0.6]]), np.eye(1))
    assert found is not None
    assert 0.5375 <= found[3] <= 1.25 * 0.5375
