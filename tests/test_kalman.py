"""Kalman gains against models in innovations form, whose gain is known."""

from __future__ import annotations

import numpy as np
import pytest

from vibrid.kalman import riccati_gain, spectral_radius
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


def test_spectral_radius() -> None:
    """The largest magnitude of complex eigenvalues; 0 without any."""
    rotation = 0.9 * np.array([[0.0, 1.0], [-1.0, 0.0]])
    assert spectral_radius(rotation) == pytest.approx(0.9)
    assert spectral_radius(np.zeros((0, 0))) == 0
