"""Inputs of known models: example 4.2, naive filters as oracles, calibrated errors."""

from __future__ import annotations

import numpy as np
import pytest

from vibrid.blind.input_estimation import estimate_input
from vibrid.errors import DataError, OptionError
from vibrid.exosystem import augmented_model, finite_signal
from vibrid.record import Record
from vibrid.statespace import StateSpace
from vibrid.structures import chain

GAIN = np.array([[1.0], [0.5]])
SYSTEM = StateSpace(np.diag([0.5, 0.6]), GAIN, [[1.0, 1.0]], [[0.0]], 1e-4)


def piece(rng, n_samples=10_000):
    """Return a piece of a 6 s signal band-limited to 50 Hz: it does not end where it began."""
    k = np.arange(1, 301)
    amplitudes = rng.standard_normal(300) / np.sqrt(150)
    phases = rng.uniform(0, 2 * np.pi, 300)
    t = 1e-4 * (rng.integers(50_000) + np.arange(n_samples))
    return np.cos(2 * np.pi * t[:, None] * k / 6 + phases) @ amplitudes


def outputs_of(v, variance, rng):
    """Return the outputs of system (68): x⁺ = A x + B v + G e, y = C x + e."""
    e = np.sqrt(variance) * rng.standard_normal(len(v))
    both = StateSpace(SYSTEM.A, np.hstack([SYSTEM.B, GAIN]), SYSTEM.C, [[0.0, 1.0]], SYSTEM.dt)
    return both.simulate(np.column_stack([v, e]))


def test_example_of_a_signal_that_is_not_periodic(rng):
    """Example 4.2, variance 1e-4: error 0.15 % of the signal, as large as it says."""
    v = piece(rng)
    found = estimate_input(SYSTEM, outputs_of(v, 1e-4, rng), highest_hz=50.0, kalman_gain=GAIN)
    off = found.inputs[:, 0] - v
    assert off.std() < 2.5e-3 * v.std()
    assert 0.7 < np.sqrt(np.mean((off / found.inputs_std[:, 0]) ** 2)) < 1.3
    np.testing.assert_allclose(found.noise_covariance, 1e-4, rtol=0.1)


def test_the_error_is_proportional_to_the_noise(rng):
    """Ten times the noise, ten times the error; nothing but the model's truncation is left."""
    v = piece(rng, 4000)
    spread = []
    for variance in (1e-4, 1e-6, 0.0):
        y = outputs_of(v, variance, np.random.default_rng(7))
        found = estimate_input(SYSTEM, y, highest_hz=55.0, kalman_gain=GAIN)
        spread.append((found.inputs[:, 0] - v).std())
    assert 8 < spread[0] / spread[1] < 12.5
    assert spread[2] < 1e-4 * v.std()


def test_a_period_as_long_as_the_record_leaks(rng):
    """The published period N T_s leaves a jump from end to start: per cents instead of 1e-4."""
    v = piece(rng, 4000)
    y = outputs_of(v, 0.0, rng)
    found = estimate_input(SYSTEM, y, highest_hz=55.0, kalman_gain=GAIN, period=0.4)
    assert (found.inputs[:, 0] - v).std() > 1e-2 * v.std()


def naive_kalman_filter(signal, variance, prior, y):
    """Return filtered inputs of the augmented model, by the textbook recursion."""
    augmented = augmented_model(SYSTEM, signal)
    A, C = augmented.A, augmented.C
    n = len(A)
    drive = np.vstack([GAIN, np.zeros((n - 2, 1))])
    x, P = np.zeros(n), np.diag(prior**2)
    Q, S = variance * drive @ drive.T, variance * drive
    made = []
    for value in y:
        inner = C @ P @ C.T + variance
        error = value - C @ x
        now = x + (P @ C.T / inner) @ error
        made.append(signal.C @ now[2:])
        gain = (A @ P @ C.T + S) / inner
        x = A @ x + gain @ error
        P = A @ P @ A.T + Q - gain @ inner @ gain.T
    return np.array(made)


def test_the_filter_is_the_kalman_filter(rng):
    """The recursive least squares equals the textbook filter with correlated noises."""
    N, variance = 200, 1e-2
    v = np.cos(2 * np.pi * 100.0 * 1e-4 * np.arange(N))
    y = outputs_of(v, variance, rng)
    found = estimate_input(
        SYSTEM,
        y,
        highest_hz=200.0,
        kind="filter",
        kalman_gain=GAIN,
        noise_covariance=[[variance]],
        input_scale=2.0,
        period=N * 1e-4,
    )
    signal = finite_signal(N, 1e-4, 200.0)
    states = 100 * np.sqrt(np.mean(y**2)) / np.sqrt(2) * np.sqrt(2)
    prior = np.concatenate([np.full(2, states), np.full(signal.order, 2.0)])
    naive = naive_kalman_filter(signal, variance, prior, y)
    np.testing.assert_allclose(found.inputs, naive, atol=1e-6)


def test_filter_and_smoother_agree_at_the_end(rng):
    """At the last sample both know the same; before, the filter knows less."""
    v = piece(rng, 1000)
    y = outputs_of(v, 1e-4, rng)
    smoothed, filtered = (
        estimate_input(SYSTEM, y, highest_hz=50.0, kalman_gain=GAIN, kind=kind)
        for kind in ("smoother", "filter")
    )
    np.testing.assert_allclose(filtered.inputs[-1], smoothed.inputs[-1], atol=2e-3)
    middle = slice(200, 800)
    assert (filtered.inputs_std[middle] > smoothed.inputs_std[middle]).all()
    off = filtered.inputs[300:, 0] - v[300:]
    assert np.abs(off / filtered.inputs_std[300:, 0]).max() < 5


@pytest.mark.parametrize("kind", ["smoother", "filter"])
def test_units_do_not_matter(rng, kind):
    """Inputs in piconewtons and outputs in nanometres give the same estimate."""
    y = outputs_of(piece(rng, 2000), 1e-4, rng)
    small = StateSpace(SYSTEM.A, SYSTEM.B * 1e-12, SYSTEM.C, [[0.0]], 1e-4)
    options = {"highest_hz": 50.0, "kalman_gain": GAIN, "kind": kind}
    plain = estimate_input(SYSTEM, y, **options)
    for model, outputs, factor in ((small, y, 1e12), (SYSTEM, 1e-9 * y, 1e-9)):
        found = estimate_input(model, outputs, **options)
        np.testing.assert_allclose(found.inputs / factor, plain.inputs, atol=1e-6)
        np.testing.assert_allclose(found.inputs_std / factor, plain.inputs_std, rtol=1e-4)


def test_no_motion_needs_no_input():
    """Outputs of nothing but zeros."""
    found = estimate_input(SYSTEM, np.zeros(500), highest_hz=200.0)
    np.testing.assert_array_equal(found.inputs, 0)


@pytest.mark.parametrize("sensors", ["acceleration", "displacement"])
def test_two_forces_on_a_structure(rng, sensors):
    """Noise of unlike size on three sensors: weights from the residuals."""
    structure = chain([2.0, 1.5, 1.0], [600.0, 400.0, 300.0], dashpots=[0.6, 0.5, 0.4])
    t = 0.02 * np.arange(600)
    u = np.column_stack([np.cos(2 * np.pi * 0.83 * t), np.sin(2 * np.pi * 2.17 * t + 1)])
    model = structure.state_space(sensors, forces=["f1", "f3"]).to_discrete(0.02)
    clean = model.simulate(u, 0.01 * rng.standard_normal(6))
    noise = np.sqrt((clean**2).mean(axis=0)) * [1e-4, 1e-3, 1e-2]
    y = clean + noise * rng.standard_normal(clean.shape)
    record = Record(y, dt=0.02)
    found = estimate_input(model, record, highest_hz=3.0, lowest_hz=0.5)
    assert np.abs(found.inputs - u)[100:-100].max() < 0.05  # the ends know less, and say so
    np.testing.assert_allclose(np.sqrt(np.diag(found.noise_covariance)), noise, rtol=0.15)
    spread = np.sqrt(np.mean(((found.inputs - u) / found.inputs_std) ** 2))
    assert 0.5 < spread < 1.5


def test_what_cannot_be_seen_is_refused(rng):
    """Constants by accelerometers, two forces by one sensor, too many lines."""
    structure = chain([2.0, 1.0], [600.0, 400.0], dashpots=[0.6, 0.5])
    model = structure.state_space(forces=["f1"]).to_discrete(0.02)
    y = rng.standard_normal((100, 2))
    with pytest.raises(DataError, match="do not show 1 inputs at 0 Hz"):
        estimate_input(model, y, highest_hz=3.0)
    one = structure.state_space([("acceleration", "f1")], forces=["f1", "f2"]).to_discrete(0.02)
    with pytest.raises(DataError, match="fewer outputs than inputs"):
        estimate_input(one, y[:, 0], highest_hz=3.0, lowest_hz=0.5)
    with pytest.raises(DataError, match="cannot tell"):
        estimate_input(SYSTEM, y[:, 0], highest_hz=4900.0)
    with pytest.raises(DataError, match="100 values cannot tell 400002 unknowns"):
        estimate_input(SYSTEM, y[:, 0], highest_hz=200.0, period=1000.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "guess"}, "kind must be one of"),
        ({"kalman_gain": [[1.0]]}, "kalman_gain must have the shape"),
        ({"kalman_gain": [[np.nan], [0.0]]}, "finite"),
        ({"noise_covariance": [[-1.0]]}, "positive definite"),
        ({"noise_covariance": [[np.nan]]}, "positive definite"),
        ({"lowest_hz": -1.0}, "lowest_hz must not be negative"),
        ({"period": np.nan}, "period must be positive"),
        ({"outputs": np.ones((50, 2))}, r"\(n_samples, 1\)"),
        ({"outputs": Record(np.ones(50), dt=0.1)}, "they differ"),
        ({"model": StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], None)}, "discrete"),
        (
            {"model": StateSpace([[0.5]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)), 1e-4)},
            "no in",
        ),
    ],
)
def test_bad_options_are_refused(change, words):
    """The message names the number and the limit."""
    call = {"model": SYSTEM, "outputs": np.ones(50), "highest_hz": 500.0, **change}
    with pytest.raises(OptionError, match=words):
        estimate_input(call.pop("model"), call.pop("outputs"), **call)


def test_an_unstable_predictor_is_refused():
    """A gain that does not belong to the model."""
    with pytest.raises(DataError, match="spectral radius"):
        estimate_input(SYSTEM, np.ones(50), highest_hz=500.0, kalman_gain=[[9.0], [0.0]])
