"""ERA and ERA/DC against exact realizations, naive loops, published poles and noise."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.signal as ss
from numpy.lib.array_utils import byte_bounds
from numpy.typing import NDArray

from vibrid.chunks import open_stream
from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.linalg import FULL_SVD_LIMIT
from vibrid.methods.era import ERA, ERADC
from vibrid.methods.era.hankel import balancing_weights, block_rows
from vibrid.methods.era.triplets import leading_triplets
from vibrid.modes import mac, modes_of
from vibrid.record import FrequencyResponses, ImpulseResponses, Record
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain

Floats = NDArray[np.float64]
EXACT = 1e-8  # relative, promised for noise-free data; measured 1e-12
DT = 0.05
METHODS = [
    ERA(),
    ERA(rows=18, columns=70),
    ERA(rows=60, columns=17),
    ERADC(),
    ERADC(rows=16, columns=60, lag=3, row_shifts=2, column_shifts=1),
    ERADC(rows=40, columns=16, lag=1, row_shifts=0, column_shifts=3),
    ERADC(rows=17, columns=40, lag=10, row_shifts=1, column_shifts=0),
]


def structure(n_dof: int) -> Structure:
    """Return a chain with modes spread below Nyquist and 1 to 2 % damping."""
    return chain(np.linspace(1.0, 1.5, n_dof), np.full(n_dof, 800.0), rayleigh=(0.1, 2e-4))


def system(frame: Structure, forces: str = "all") -> StateSpace:
    pushed = frame.dofs[:1] if forces == "one" else frame.dofs
    return frame.state_space(forces=list(pushed)).to_discrete(DT)


def pulses(frame: Structure, n_lags: int = 120, forces: str = "all") -> ImpulseResponses:
    return ImpulseResponses(system(frame, forces).markov_parameters(n_lags), dt=DT)


def fitted(method: Any, data: Any, order: int) -> Any:
    return method.realize(method.decompose(data), order)


def assert_same_modes(fit: Any, frame: Structure, tolerance: float = EXACT) -> None:
    modes = modes_of(fit)
    assert modes.n_modes == len(frame.frequencies_hz)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=tolerance)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=tolerance)


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


def naive_era(h: Floats, rows: int, columns: int, order: int) -> tuple[Floats, ...]:
    """Realize Markov parameters by loops and a full decomposition."""
    H0 = np.block([[h[1 + i + j] for j in range(columns)] for i in range(rows)])
    H1 = np.block([[h[2 + i + j] for j in range(columns)] for i in range(rows)])
    U, s, Vt = np.linalg.svd(H0)
    U, root, V = U[:, :order], np.sqrt(s[:order]), Vt[:order].T
    A = np.diag(1 / root) @ U.T @ H1 @ V @ np.diag(1 / root)
    return A, (np.diag(root) @ V.T)[:, : h.shape[2]], (U @ np.diag(root))[: h.shape[1]]


def naive_eradc(
    h: Floats, rows: int, columns: int, lag: int, xi: int, zeta: int, order: int
) -> tuple[Floats, ...]:
    """Realize by the equations of the chapter, R_q = O_p⁺ H(0)."""

    def hankel(k: int) -> Floats:
        return np.block([[h[1 + k + i + j] for j in range(columns)] for i in range(rows)])

    def correlations(k: int) -> Floats:
        grid = [[k + (i + j) * lag for j in range(zeta + 1)] for i in range(xi + 1)]
        return np.block([[hankel(each) @ hankel(0).T for each in row] for row in grid])

    U, s, Vt = np.linalg.svd(correlations(0))
    U, root, V = U[:, :order], np.sqrt(s[:order]), Vt[:order].T
    A = np.diag(1 / root) @ U.T @ correlations(1) @ V @ np.diag(1 / root)
    observed = (U @ np.diag(root))[: rows * h.shape[1]]
    B = (np.linalg.pinv(observed) @ hankel(0))[:, : h.shape[2]]
    return A, B, observed[: h.shape[1]]


@pytest.mark.parametrize("order", [4, 6, 9])
def test_equal_to_a_naive_realization(order: int, rng: np.random.Generator) -> None:
    """With noise and equal weights, the Markov parameters are those of explicit matrices."""
    h = pulses(structure(3), 60).values
    h = h + 0.1 * h.std() * rng.standard_normal(h.shape)
    ones = np.ones(3), np.ones(3)
    D = h[0]
    kernels = [
        (ERA().factor(h, 12, 20, ones), naive_era(h, 12, 20, order)),
        (
            ERADC(lag=2, row_shifts=1, column_shifts=2).factor(h, 12, 20, ones),
            naive_eradc(h, 12, 20, 2, 1, 2, order),
        ),
    ]
    for kernel, (A, B, C) in kernels:
        found = StateSpace(*kernel.triplet(order), D, DT).markov_parameters(30)
        expected = StateSpace(A, B, C, D, DT).markov_parameters(30)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(h).max())


def test_block_rows_are_a_view() -> None:
    """The Hankel matrix of many lags takes no more memory than the lags."""
    markov = np.arange(24.0).reshape(6, 2, 2)
    blocks = block_rows(markov, 3, 3)
    explicit = np.block([[markov[1 + i + j] for j in range(3)] for i in range(3)])
    np.testing.assert_array_equal(blocks.reshape(6, 6), explicit)
    low, high = byte_bounds(np.asarray(block_rows(np.zeros((2001, 2, 2)), 1000, 1000)))
    assert high - low < 2001 * 4 * 8


@pytest.mark.parametrize("method", [METHODS[1], METHODS[4]], ids=str)
def test_first_blocks_of_the_factors_are_the_model(method: Any, rng: np.random.Generator) -> None:
    """C leads the observability, B the controllability matrix; without noise powers follow."""
    exact = pulses(structure(2))
    noisy = ImpulseResponses(exact.values + 0.1 * rng.standard_normal(exact.values.shape), dt=DT)
    for data, order in ((exact, 4), (noisy, 5)):
        decomposition = method.decompose(data)
        model = method.realize(decomposition, order).model
        observed, reached = decomposition.factors(order)
        np.testing.assert_allclose(observed[:2], model.C, atol=1e-12)
        np.testing.assert_allclose(reached[:, :2], model.B, atol=1e-10 * np.abs(model.B).max())
        if data is exact:
            np.testing.assert_allclose(
                observed, model.observability_matrix(method.rows), atol=1e-10
            )
            np.testing.assert_allclose(
                reached, model.controllability_matrix(method.columns), atol=1e-10
            )


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


@pytest.mark.parametrize("shape", [(3, 2), (90, 1), (1, 4)])
def test_balancing_weights_level_every_channel(
    shape: tuple[int, int], rng: np.random.Generator
) -> None:
    """Afterwards all outputs have one mean square, and all inputs."""
    units = np.logspace(-6, 3, shape[0])[:, None] * np.logspace(4, 0, shape[1])
    markov = rng.standard_normal((50, *shape)) * units
    outputs, inputs = balancing_weights(markov)
    energy = np.square(markov * outputs[:, None] * inputs).sum(axis=0)
    np.testing.assert_allclose(energy.sum(axis=1), energy.sum() / shape[0])
    np.testing.assert_allclose(energy.sum(axis=0), energy.sum() / shape[1])


def test_a_silent_channel_keeps_its_weight() -> None:
    """A force that moves nothing, or a dead sensor, disturbs no other weight."""
    markov = np.ones((5, 3, 2))
    markov[:, 1] = 0
    outputs, inputs = balancing_weights(markov)
    assert np.isfinite(outputs).all()
    assert outputs[0] == pytest.approx(outputs[2])
    assert inputs[0] == pytest.approx(inputs[1])


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


# -- large matrices


def decaying(shape: tuple[int, int], values: Floats, rng: np.random.Generator) -> Floats:
    left = np.linalg.qr(rng.standard_normal((shape[0], len(values))))[0]
    right = np.linalg.qr(rng.standard_normal((shape[1], len(values))))[0]
    return left * values @ right.T


@pytest.mark.parametrize("kind", ["noise", "fast", "rank"])
@pytest.mark.parametrize("shape", [(700, 300), (260, 900)])
def test_leading_triplets_are_those_of_the_full_decomposition(
    shape: tuple[int, int], kind: str, rng: np.random.Generator
) -> None:
    """The truncated matrix is as near as the best of its rank, to rounding of the largest."""
    values = np.logspace(0, -11, 30) if kind == "rank" else np.logspace(0, -14, 250)
    matrix = decaying(shape, values, rng)
    if kind == "noise":
        matrix += 1e-4 * rng.standard_normal(shape)
    found = leading_triplets(matrix, 40)
    s = np.linalg.svd(matrix, compute_uv=False)
    assert found.kept == (30 if kind == "rank" else 40)
    np.testing.assert_allclose(found.values[: found.kept], s[: found.kept], atol=2e-15)
    left_out = matrix - found.left * found.values[: found.kept] @ found.right
    assert np.linalg.norm(left_out, 2) < s[found.kept] + 1e-14
    identity = np.eye(found.kept)
    np.testing.assert_allclose(found.left.T @ found.left, identity, atol=1e-12)
    np.testing.assert_allclose(found.right @ found.right.T, identity, atol=1e-12)


def test_large_hankel_matrices_are_never_laid_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sketched through views, a large matrix gives the same exact model."""
    monkeypatch.setattr("vibrid.methods.era.hankel.LARGEST_COPY", 10_000)
    monkeypatch.setattr("vibrid.methods.era.triplets.FULL_SVD_LIMIT", 100)
    monkeypatch.setattr("vibrid.linalg.FULL_SVD_LIMIT", 100)
    assert FULL_SVD_LIMIT > 100
    frame = structure(2)
    fit = fitted(ERA(rows=150, columns=140), pulses(frame, 300), 4)
    assert_same_modes(fit, frame)


# -- ERA/DC and noise


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


# -- free decays


def decay(n_dof: int, rng: np.random.Generator, n_samples: int = 500) -> Record:
    start = 0.1 * rng.standard_normal(2 * n_dof)
    return structure(n_dof).simulate(None, DT, initial_state=start, n_samples=n_samples)


@pytest.mark.parametrize("offset", ["estimate", "mean", "none"])
@pytest.mark.parametrize("n_records", [1, 3])
@pytest.mark.parametrize("method", [ERA(), ERA(rows=20, columns=60), ERADC()], ids=str)
def test_decays_are_realized_exactly(
    method: Any, n_records: int, offset: str, rng: np.random.Generator
) -> None:
    """Decays share A and C; each is reproduced from the initial state that is returned."""
    records = [decay(3, rng) for _ in range(n_records)]
    if offset == "mean":
        records = [Record(each.outputs - each.outputs.mean(axis=0), dt=DT) for each in records[:1]]
        offset = "estimate"
    decomposition = method.decompose(records, offset=offset)
    assert decomposition.rank_limited
    fit = method.realize(decomposition, 6)
    assert_same_modes(fit, structure(3))
    assert len(fit.initial_states) == len(records)
    for record, state in zip(records, fit.initial_states, strict=True):
        again = fit.simulate(None, state, n_samples=record.n_samples)
        np.testing.assert_allclose(again, record.outputs, atol=EXACT * record.outputs.std())
    assert np.diag(mac(modes_of(fit).shapes, structure(3).shapes)) == pytest.approx(1, abs=EXACT)


def test_decays_in_pieces_and_in_noise(rng: np.random.Generator) -> None:
    """A gap starts another decay; noise of 1 % leaves damping within some percent."""
    record = decay(2, rng, 800)
    y = record.outputs + 0.01 * record.outputs.std() * rng.standard_normal(record.outputs.shape)
    y[90] = np.nan
    decomposition = ERA().decompose(Record(y, dt=DT))
    assert decomposition.method.responses == "decay"
    fit = ERA().realize(decomposition, 4)
    assert_same_modes(fit, structure(2), 0.05)
    assert np.isfinite(fit.initial_states).all()
    assert fit.initial_states.shape == (2, 4)
    values = [decomposition.criterion(order)[0] for order in range(1, 12)]
    assert 1 + int(np.argmin(values)) == 4


def test_decay_of_many_columns_equals_the_explicit_hankel_matrix(rng: np.random.Generator) -> None:
    """Poles from the triangle are those of a full decomposition of the data matrix."""
    record = decay(2, rng, 200)
    y = record.outputs + 0.02 * record.outputs.std() * rng.standard_normal(record.outputs.shape)
    stream = open_stream(Record(y, dt=DT), "none")
    fit = fitted(ERA(rows=10, responses="decay"), stream, 4)
    h = np.concatenate(
        [np.zeros((1, 2, 1)), (y * stream.output_balance / stream.output_scale)[:, :, None]]
    )
    A, _, _ = naive_era(h, 10, 190, 4)
    np.testing.assert_allclose(
        np.sort_complex(fit.model.poles), np.sort_complex(np.linalg.eigvals(A)), rtol=1e-8
    )


def test_undamped_and_growing_motion_is_a_decay() -> None:
    """Noise-free free motion has a rank, so it needs no decay to be taken for one."""
    for pole in (0.0, 0.02):
        t = DT * np.arange(400)
        y = np.exp(pole * t) * np.cos(12.0 * t)
        decomposition = ERA().decompose(Record(y, dt=DT))
        assert decomposition.method.responses == "decay"
        fit = ERA().realize(decomposition, 2)
        np.testing.assert_allclose(fit.model.continuous_poles.real, pole, atol=1e-9)
        np.testing.assert_allclose(np.abs(fit.model.continuous_poles.imag), 12.0, rtol=1e-9)


def test_too_short_a_decay_is_refused(rng: np.random.Generator) -> None:
    """The message names the rows, the samples and the most rows."""
    with pytest.raises(DataError, match=r"rows=60 needs a decay of at least 62 samples.*58 rows"):
        ERA(rows=60, responses="decay").decompose(decay(2, rng, 60))


# -- ambient vibration


def ambient(rng: np.random.Generator, n_samples: int = 20_000) -> Record:
    frame = structure(3)
    force = white_noise(n_samples, 3, rng=rng)
    clean = frame.simulate(force, DT, forces=list(frame.dofs))
    noise = 0.2 * clean.outputs.std(axis=0) * rng.standard_normal(clean.outputs.shape)
    return Record(clean.outputs + noise, dt=DT)


@pytest.mark.parametrize("references", [None, ("y1", "y3")])
@pytest.mark.parametrize("method", [ERA, ERADC])
def test_ambient_record(
    method: Callable[..., Any], references: tuple[str, ...] | None, rng: np.random.Generator
) -> None:
    """Correlations give the modes within their spread, a stable predictor that predicts."""
    chosen = method(references=references)
    record = ambient(rng)
    decomposition = chosen.decompose(record)
    assert decomposition.method.responses == "correlations"
    assert "ambient" in decomposition.reasons[0]
    fit = chosen.realize(decomposition, 6)
    modes, frame = modes_of(fit), structure(3)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=5e-3)
    # 1000 s hold 11 bandwidths of the first mode: its damping is good to a third
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=0.5)
    assert np.diag(mac(modes.shapes, frame.shapes)).min() > 0.99
    errors = (record.outputs - fit.predict(record))[200:]
    assert (errors.var(axis=0) < 0.6 * record.outputs.var(axis=0)).all()
    np.testing.assert_allclose(
        np.diag(np.cov(errors.T)), np.diag(fit.innovation_covariance), rtol=0.25
    )


def test_forcing_what_a_record_is_taken_for(rng: np.random.Generator) -> None:
    """`responses` overrides the judgement, and refuses what cannot be."""
    record = ambient(rng, 2000)
    assert ERA(responses="decay").decompose(record).method.responses == "decay"
    with pytest.raises(OptionError, match="needs inputs"):
        ERA(responses="fir").decompose(record)
    forced = Record(record.outputs[:, :1], record.outputs[:, 1:2], dt=DT)
    with pytest.raises(OptionError, match="outputs alone; the record has 1 inputs"):
        ERA(responses="decay").decompose(forced)
    with pytest.raises(OptionError, match="No output is called 'y9'"):
        ERA(responses="correlations", references=("y9",)).decompose(record)


# -- inputs


def test_forced_record_by_finite_impulse_responses(rng: np.random.Generator) -> None:
    """A well damped structure's responses die within the lags and are realized."""
    frame = chain([1.0, 1.2], [800.0, 800.0], damping_ratio=0.1)
    record = frame.simulate(white_noise(2500, rng=rng), DT, forces=["f1"])
    fit = fitted(ERA(), record, 4)
    assert_same_modes(fit, frame, 1e-3)
    assert fit.diagnostics.figures["fir_truncation"] < 1e-3


def test_responses_that_are_cut_off_are_told(rng: np.random.Generator) -> None:
    """Too few lags for light damping is a warning."""
    frame = structure(2)
    record = frame.simulate(white_noise(3000, rng=rng), DT, forces=["f1"])
    fit = fitted(ERA(rows=20, columns=20), record, 4)
    assert "responses-cut-off" in [finding.code for finding in fit.diagnostics.findings]
