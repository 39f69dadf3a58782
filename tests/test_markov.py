"""Markov parameters of the three kinds, against models and naive loops."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

import vibrid as vb
from vibrid.markov import (
    gain_markov,
    joint_markov,
    model_gain_markov,
    model_observer_markov,
    observer_markov,
    system_markov,
)

Floats = NDArray[np.float64]
ORDER, OBSERVER_ORDER, LAGS = 6, 8, 40


@pytest.fixture
def model(rng: np.random.Generator) -> vb.StateSpace:
    """Return a stable model of 6 states, 2 inputs and 3 outputs."""
    A = rng.standard_normal((ORDER, ORDER))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C = rng.standard_normal((ORDER, 2)), rng.standard_normal((3, ORDER))
    return vb.StateSpace(A, B, C, rng.standard_normal((3, 2)), 0.1)


@pytest.fixture
def gain(rng: np.random.Generator) -> Floats:
    """Return a Kalman gain K = −L."""
    return 0.1 * rng.standard_normal((ORDER, 3))


def naive(observer: Floats, n_lags: int, n_inputs: int) -> tuple[Floats, Floats]:
    """Run (40) and (41) of Pappalardo et al. (2022) as printed, lag by lag."""
    p = observer.shape[1]
    first, second = observer[:, :, :n_inputs], -observer[:, :, n_inputs:]
    system, gains = np.zeros((n_lags, p, n_inputs)), np.zeros((n_lags, p, p))
    system[0] = first[0]
    for n in range(1, n_lags):
        known = n < len(observer)
        system[n] = first[n] if known else 0
        gains[n] = second[n] if known else 0
        for h in range(1, min(n, len(observer) - 1) + 1):
            system[n] -= second[h] @ system[n - h]
            gains[n] -= second[h] @ gains[n - h]
    return system, gains


def test_recursions_equal_naive_loops(rng: np.random.Generator) -> None:
    """System and gain parameters go on beyond the observer order, as the loops do."""
    observer = 0.2 * rng.standard_normal((OBSERVER_ORDER + 1, 3, 5))
    observer[0, :, 2:] = 0
    system, gains = naive(observer, LAGS, 2)
    scale = np.abs(system).max()
    np.testing.assert_allclose(system_markov(observer, LAGS), system, atol=1e-12 * scale)
    np.testing.assert_allclose(gain_markov(observer, LAGS), gains, atol=1e-12 * np.abs(gains).max())
    np.testing.assert_allclose(system_markov(observer, 4), system[:4], atol=1e-12 * scale)


def test_parameters_of_a_model_come_back(model: vb.StateSpace, gain: Floats) -> None:
    """From the observer's parameters follow D, C A^(k−1) B and C A^(k−1) L with L = −K."""
    observer = model_observer_markov(model, gain, LAGS)
    exact = model.markov_parameters(LAGS)
    np.testing.assert_allclose(system_markov(observer, LAGS), exact, atol=1e-12)
    gains = gain_markov(observer, LAGS)
    np.testing.assert_allclose(gains, model_gain_markov(model, gain, LAGS), atol=1e-12)
    L = -gain
    expected = [model.C @ np.linalg.matrix_power(model.A, k) @ L for k in range(4)]
    np.testing.assert_allclose(gains[1:5], expected, atol=1e-12)
    assert not gains[0].any()
    np.testing.assert_array_equal(joint_markov(observer, LAGS)[:, :, 2:], gains)


def test_observer_parameters_follow_from_the_others(model: vb.StateSpace, gain: Floats) -> None:
    """The inverse direction returns [C Ā^(k−1) (B + L D), −C Ā^(k−1) L]."""
    system, gains = model.markov_parameters(LAGS), model_gain_markov(model, gain, LAGS)
    observer = observer_markov(system, gains)
    L = -gain
    closed = model.A + L @ model.C
    for k in (1, 2, 7):
        power = model.C @ np.linalg.matrix_power(closed, k - 1)
        expected = np.hstack([power @ (model.B + L @ model.D), -power @ L])
        np.testing.assert_allclose(observer[k], expected, atol=1e-12)
    np.testing.assert_allclose(observer[0], np.hstack([model.D, np.zeros((3, 3))]))


def test_past_residuals_change_the_gain_alone(rng: np.random.Generator) -> None:
    """With y = A y + B u + C e + e the gain's parameters are the response to e, negated."""
    observer = 0.2 * rng.standard_normal((4, 2, 3))
    observer[0, :, 1:] = 0
    weights = 0.3 * rng.standard_normal((3, 2, 2))
    joint = joint_markov(observer, 12, weights)
    np.testing.assert_array_equal(joint[:, :, :1], system_markov(observer, 12))
    for channel in range(2):
        e, y = np.zeros((12, 2)), np.zeros((12, 2))
        e[0, channel] = 1
        for t in range(12):
            y[t] = e[t]
            for k in range(1, min(t, 3) + 1):
                y[t] += observer[k, :, 1:] @ y[t - k] + weights[k - 1] @ e[t - k]
        np.testing.assert_allclose(-joint[1:, :, 1 + channel], y[1:], atol=1e-13)


def test_wrong_shapes_are_named(model: vb.StateSpace, gain: Floats) -> None:
    """Each error says which array has which shape."""
    with pytest.raises(vb.OptionError, match=r"shape \(n_lags, n_outputs, columns\)"):
        system_markov(np.zeros((3, 2)), 4)
    with pytest.raises(vb.OptionError, match="n_inputs \\+ n_outputs columns"):
        gain_markov(np.zeros((3, 2, 1)), 4)
    with pytest.raises(vb.OptionError, match=r"gain must have shape \(40, 3, 3\)"):
        observer_markov(model.markov_parameters(LAGS), np.zeros((LAGS, 2, 2)))
    with pytest.raises(vb.OptionError, match=r"kalman_gain must have shape \(6, 3\)"):
        model_observer_markov(model, gain.T, 3)
    with pytest.raises(vb.OptionError, match="n_lags must be at least 1"):
        system_markov(np.zeros((3, 2, 3)), 0)
