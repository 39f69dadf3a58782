"""ERA and ERA/DC of given responses: exact realizations, published poles, noise, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.signal as ss
from era_cases import DT, EXACT, METHODS, assert_same_modes, fitted, pulses, structure, system

from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.methods.era import ERA, ERADC
from vibrid.modes import modes_of
from vibrid.record import Floats, FrequencyResponses, ImpulseResponses
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain

# -- pulse responses


@pytest.mark.parametrize("forces", ["one", "all"])
@pytest.mark.parametrize("n_dof", range(1, 9))
@pytest.mark.parametrize("method", METHODS, ids=str)
def test_pulse_responses_are_realized_exactly(method: Any, n_dof: int, forces: str) -> None:
    """Responses of chains, D among them, come back at lags that were not used too."""
    frame = structure(n_dof)
    fit = fitted(method, pulses(frame, forces=forces), 2 * n_dof)
    exact = system(frame, forces).markov_parameters(300)
    error = fit.model.markov_parameters(300) - exact
    assert np.abs(error).max() < EXACT * np.abs(exact).max()
    assert_same_modes(fit, frame)


@pytest.mark.parametrize("method", METHODS[:4], ids=str)
def test_rank_is_seen(method: Any) -> None:
    """Noise-free responses end at the order of the structure, and more is refused."""
    decomposition = method.decompose(pulses(structure(3)))
    assert decomposition.rank_limited
    assert decomposition.largest_order == 6
    with pytest.raises(OptionError, match="order=7 is more than the rank"):
        method.realize(decomposition, 7)


@pytest.mark.parametrize("method", METHODS, ids=str)
def test_units_and_channel_order_do_not_matter(method: Any, rng: np.random.Generator) -> None:
    """With noise, channels permuted and in other units give the same poles."""
    h = pulses(structure(3)).values
    h = h + 0.05 * h.std() * rng.standard_normal(h.shape)
    units = np.array([1e-8, 1.0, 1e5])[:, None] * np.array([1e4, 1.0, 1e-6])
    other = (h * units)[:, [2, 0, 1]][:, :, [1, 2, 0]]
    first = fitted(method, ImpulseResponses(h, dt=DT), 6).model
    second = fitted(method, ImpulseResponses(other, dt=DT), 6).model
    np.testing.assert_allclose(
        np.sort_complex(second.poles), np.sort_complex(first.poles), rtol=1e-7
    )


def test_too_few_lags_are_refused() -> None:
    """The message names the lags needed, those there are, and what to do."""
    data = pulses(structure(2), 20)
    with pytest.raises(DataError, match=r"rows=15 and columns=15 needs .* lag 30; they end at lag"):
        ERA(rows=15, columns=15).decompose(data)
    with pytest.raises(DataError, match=r"with 20 lags of shifts needs .* lag 22.*smaller shifts"):
        ERADC().decompose(data)
    assert ERADC(lag=3).highest_lag(10, 20) == 42


def test_zero_responses_are_refused() -> None:
    """Responses that are D alone hold no state."""
    values = np.zeros((20, 1, 1))
    values[0] = 1
    with pytest.raises(DataError, match="zero at every lag"):
        ERA().decompose(ImpulseResponses(values, dt=DT))


def test_displacements_have_no_feedthrough(rng: np.random.Generator) -> None:
    """D of displacements is zero unless asked for."""
    frame = structure(2)
    channels = frame.simulate(white_noise(9, rng=rng), DT, sensors="displacement", forces=["f1"])
    values = rng.standard_normal((40, 2, 1))
    data = ImpulseResponses(values, dt=DT, output_channels=channels.output_channels)
    assert not fitted(ERA(), data, 2).model.D.any()
    asked = ERA().realize(ERA().decompose(data, feedthrough=True), 2)
    np.testing.assert_array_equal(asked.model.D, values[0])


def test_fibonacci_numbers() -> None:
    """The pulse responses 1, 1, 2, 3, 5, … have two poles: the golden ratio and −1 over it."""
    numbers = [0.0, 1.0]
    while len(numbers) < 16:
        numbers.append(numbers[-1] + numbers[-2])
    data = ImpulseResponses(np.array(numbers)[:, None, None], dt=1.0)
    golden = (1 + np.sqrt(5)) / 2
    for method in (ERA(rows=2, columns=2), ERADC(2, 2, lag=1, row_shifts=1, column_shifts=1)):
        fit = fitted(method, data, 2)
        poles = np.sort(fit.model.poles.real)
        np.testing.assert_allclose(poles, [-1 / golden, golden], rtol=1e-9)
        assert fit.diagnostics.figures["spectral_radius"] == pytest.approx(golden)


# -- known answers


def four_masses(stiffness_factor: float, divisor: float) -> Structure:
    """Return the system of Crassidis & Junkins, examples 6.6 and 7.6."""
    K = stiffness_factor * (10 * np.eye(4) - 5 * np.eye(4, k=1) - 5 * np.eye(4, k=-1))
    return Structure(np.eye(4), K / divisor, K, ())


def test_crassidis_junkins_without_noise() -> None:
    """Example 6.6: the published frequencies and damping ratios, to their digits."""
    frame = four_masses(1.0, 5.0)
    model = frame.state_space("displacement", list(frame.dofs)).to_discrete(0.1)
    fit = fitted(ERA(), ImpulseResponses(model.markov_parameters(200), dt=0.1), 8)
    modes = modes_of(fit)
    np.testing.assert_allclose(
        2 * np.pi * modes.frequencies_hz, [1.38197, 2.62866, 3.61803, 4.25325], atol=5e-6
    )
    np.testing.assert_allclose(modes.damping_ratios, [0.1382, 0.26287, 0.3618, 0.42533], atol=5e-6)


def test_crassidis_junkins_with_noise(rng: np.random.Generator) -> None:
    """Example 7.6 at 5 % noise: the spread grows with damping, so each mode has its limit.

    Twice the 95 % quantiles of 20 seeded runs; the limit of ζ is absolute.
    """
    frame = four_masses(0.9, 10.0)
    model = frame.state_space("displacement", list(frame.dofs)).to_discrete(0.1)
    h = model.markov_parameters(501)
    noise = 0.05 * np.abs(h).max(axis=0) * rng.standard_normal(h.shape)
    modes = modes_of(fitted(ERA(60, 60), ImpulseResponses(h + noise, dt=0.1), 8))
    omega = np.array([1.31105, 2.49376, 3.43237, 4.03499])
    zeta = np.array([0.06555, 0.12469, 0.17162, 0.20175])
    limits = np.array([0.0026, 0.008, 0.021, 0.048])
    assert (np.abs(2 * np.pi * modes.frequencies_hz / omega - 1) < limits).all()
    assert (np.abs(modes.damping_ratios - zeta) < limits).all()


# -- noise


def test_criterion_finds_the_order(rng: np.random.Generator) -> None:
    """With noise on the responses the criterion is lowest at the true order."""
    h = pulses(structure(3)).values
    data = ImpulseResponses(h + 0.1 * h.std() * rng.standard_normal(h.shape), dt=DT)
    decomposition = ERA().decompose(data)
    values = [decomposition.criterion(order)[0] for order in range(1, 15)]
    assert 1 + int(np.argmin(values)) == 6


def test_figures_say_what_is_left_out(rng: np.random.Generator) -> None:
    """The tail is the energy of the discarded singular values; the error that of responses."""
    h = pulses(structure(3)).values
    size = np.sqrt(np.square(h[1:]).mean(axis=(0, 2)))[:, None]
    noisy = h + 0.1 * size * rng.standard_normal(h.shape)
    decomposition = ERA(rows=20, columns=30).decompose(ImpulseResponses(noisy, dt=DT))
    fit = ERA().realize(decomposition, 6)
    s = decomposition.singular_values
    assert fit.diagnostics.figures["tail"] == pytest.approx((s[6:] ** 2).sum() / (s**2).sum())
    # a model of 6 states keeps about 36 of 1071 parts of the noise
    assert fit.diagnostics.figures["reconstruction_error"] == pytest.approx(0.1, rel=0.1)
    assert fit.initial_states.shape == (0, 6)
    assert not fit.kalman_gain.any()
    assert "no-gain" in [finding.code for finding in fit.diagnostics.findings]


def two_masses(rng: np.random.Generator, memory: float) -> tuple[StateSpace, ImpulseResponses]:
    """Return a system and its responses in noise of 30 % rms, `memory` from lag to lag."""
    frame = chain([1.0, 1.5], [800.0, 800.0], damping_ratio=0.01)
    model = frame.state_space("displacement", [frame.dofs[0]]).to_discrete(0.02)
    h = model.markov_parameters(300)
    white = rng.standard_normal((500, *h.shape[1:]))
    noise = ss.lfilter([np.sqrt(1 - memory**2)], [1, -memory], white, axis=0)[200:]
    return model, ImpulseResponses(h + 0.3 * h.std() * noise, dt=0.02)


def median_errors(method: Any, memory: float) -> Floats:
    """Return the median relative error of each pole over seeded runs."""
    errors = []
    for seed in range(15):
        model, data = two_masses(np.random.default_rng(seed), memory)
        true = modes_of(model).poles
        poles = fitted(method, data, 4).model.continuous_poles
        errors.append(np.abs(poles[:, None] - true).min(axis=0) / np.abs(true))
    return np.asarray(np.median(errors, axis=0))


CORRELATING = ERADC(rows=30, columns=200, lag=10, row_shifts=3, column_shifts=3)


def test_correlated_noise_is_where_data_correlations_help() -> None:
    """Pole errors are less than two thirds of those of ERA of the same rows and columns."""
    ratio = median_errors(CORRELATING, 0.9) / median_errors(ERA(rows=30, columns=200), 0.9)
    assert (ratio < 2 / 3).all()


def test_white_noise_is_where_they_do_not() -> None:
    """In white noise ERA of all lags is better, by some percent, than ERA/DC of all lags."""
    ratio = median_errors(CORRELATING, 0.0) / median_errors(ERA(rows=150, columns=149), 0.0)
    assert (ratio > 0.95).all()


# -- frequency responses


@pytest.mark.parametrize("method", METHODS[::3], ids=str)
def test_frequency_responses_are_realized_exactly(method: Any) -> None:
    """Lines up to Nyquist of a lightly damped system: the wrap around the period is undone."""
    frame = structure(3)
    lines = np.arange(257) / (512 * DT)
    data = FrequencyResponses(system(frame).frequency_response(lines), lines)
    fit = fitted(method, data, 6)
    assert_same_modes(fit, frame)
    exact = system(frame).markov_parameters(50)
    np.testing.assert_allclose(
        fit.model.markov_parameters(50), exact, atol=EXACT * np.abs(exact).max()
    )
    assert fit.diagnostics.figures["wrap_undone"]
