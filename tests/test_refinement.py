"""Refinement: exact on exact data, as good as the bound on noisy ones, never worse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from refining_cases import DT, bench

import vibrid as vb
from studies.bounds import shaker_bound
from vibrid.chunks import open_stream
from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.identification.refining import refine
from vibrid.record import Floats
from vibrid.refinement import Search, eliminate, held_out_curve, refine_output_error
from vibrid.scores import fit_percent, relative_error, start_samples
from vibrid.statespace import StateSpace
from vibrid.varpro import signals


def shaker_test(
    rng: np.random.Generator, n_samples: int = 1500, noise: float = 0.05, n_dof: int = 3
) -> vb.Record:
    """Return a record of one force and all accelerations."""
    force = white_noise(n_samples, rng=rng)
    return bench(n_dof).simulate(force, DT, forces=["f1"], noise=noise, rng=rng)


def spoiled(fit: vb.Fit, factor: float = 0.99) -> vb.Fit:
    """Return the fit with every pole drawn towards zero and its B changed."""
    model = fit.model
    other = StateSpace(factor * model.A, 1.1 * model.B, model.C, model.D, model.dt)
    return replace(fit, model=other)


def siso(poles: list[complex], outputs: int = 2) -> StateSpace:
    """Return a system with these poles, one input, full residues."""
    k = len(poles)
    A = np.diag(np.poly(poles)[1:] * 0) if k == 0 else np.eye(k, k=-1)
    A[0] = -np.poly(poles)[1:].real
    C = np.linspace(1, 2, outputs * k).reshape(outputs, k)
    return StateSpace(A, np.eye(k, 1), C, np.full((outputs, 1), 0.3), 1.0)


def driven(model: StateSpace, rng: np.random.Generator, noise: float = 0.0) -> vb.Record:
    """Return a record of the model under white noise."""
    u = rng.standard_normal((600, 1))
    y = model.simulate(u)
    return vb.Record(y + noise * rng.standard_normal(y.shape), u, dt=1.0)


def started_at(poles: list[complex], record: vb.Record) -> vb.Fit:
    """Return a fit to start from, with other poles than the data's."""
    fit = vb.identify(record, vb.N4SID(block_rows=6), order=len(poles), stability="project")
    return replace(
        fit, model=siso(poles), initial_states=np.full((len(fit.segments), len(poles)), np.nan)
    )


def figures(fit: vb.Fit) -> dict[str, object]:
    """Return the figures of the diagnostics."""
    return dict(fit.diagnostics.figures)


def own_simulation(fit: vb.Fit, record: vb.Record) -> Floats:
    """Return the simulation from the initial states that the fit has of the record."""
    return fit.simulate_record(record, fit.initial_states)


def test_exact_data_give_the_exact_model(rng: np.random.Generator) -> None:
    """From poles off by 1 % (damping five times too large), noise-free damping to 1e-9."""
    record = shaker_test(rng, noise=0.0)
    start = spoiled(vb.identify(record, vb.N4SID(block_rows=10), order=6))
    fit = refine(start, record)
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.damping_ratios, bench(3).damping_ratios, rtol=1e-9)
    np.testing.assert_allclose(modes.frequencies_hz, bench(3).frequencies_hz, rtol=1e-10)
    assert fit.diagnostics.figures["converged"]
    assert not fit.kalman_gain.any()


@pytest.mark.parametrize(
    ("truth", "start"),
    [
        ([0.9, 0.6], [0.8 + 0.2j, 0.8 - 0.2j]),
        ([0.7 + 0.1j, 0.7 - 0.1j], [0.85, 0.5]),
        ([0.3, 0.7 + 0.3j, 0.7 - 0.3j], [0.8, 0.6, 0.1]),
    ],
    ids=["pair becomes real", "real becomes pair", "odd order"],
)
def test_poles_change_their_kind(
    rng: np.random.Generator, truth: list[complex], start: list[complex]
) -> None:
    """Complex pairs and real poles turn into each other on the way to the truth."""
    record = driven(siso(truth), rng)
    fit = refine(started_at(start, record), record)
    np.testing.assert_allclose(
        np.sort_complex(fit.model.poles), np.sort_complex(np.array(truth, complex)), atol=1e-7
    )


def test_never_worse_than_the_start(rng: np.random.Generator) -> None:
    """The cost falls from a spoiled start; refining again changes nothing worth a word."""
    record = shaker_test(rng)
    start = spoiled(vb.identify(record, vb.N4SID(block_rows=10), order=6))
    once = refine(start, record)
    twice = refine(once, record)
    assert once.diagnostics.figures["cost"] < once.diagnostics.figures["start_cost"]
    assert twice.diagnostics.figures["cost"] <= twice.diagnostics.figures["start_cost"]
    np.testing.assert_allclose(
        vb.modes_of(twice).damping_ratios, vb.modes_of(once).damping_ratios, rtol=1e-3
    )
    error = record.outputs - own_simulation(once, record)
    np.testing.assert_allclose(np.cov(error.T), once.innovation_covariance, rtol=0.02, atol=1e-6)


def test_an_unstable_start_is_reflected(rng: np.random.Generator) -> None:
    """Poles outside the circle do not stop the search, and the result is stable."""
    record = shaker_test(rng)
    start = spoiled(vb.identify(record, vb.N4SID(block_rows=10), order=6), 1.02)
    assert not start.model.is_stable
    fit = refine(start, record)
    assert fit.model.is_stable
    np.testing.assert_allclose(vb.modes_of(fit).frequencies_hz, bench(3).frequencies_hz, rtol=2e-3)


def test_several_records_with_gaps(rng: np.random.Generator) -> None:
    """Every record has its offset, every piece its initial state: as if nothing was missing."""
    whole = [shaker_test(rng, 800, noise=0.0) for _ in range(2)]
    records = []
    for k, record in enumerate(whole):
        y = record.outputs + np.array([5.0 * (k + 1), -3.0, 0.0])
        y[300:310] = np.nan
        records.append(vb.Record(y, record.inputs, dt=DT))
    start = spoiled(vb.identify(records, vb.N4SID(block_rows=10), order=6))
    fit = refine(start, records)
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, bench(3).damping_ratios, rtol=1e-8)
    assert fit.initial_states.shape == (4, 6)
    offsets = fit.diagnostics.figures["record_offsets"]
    np.testing.assert_allclose(offsets, [[5, -3, 0], [10, -3, 0]], atol=1e-6)


def test_memory_mapped_records_in_small_chunks(
    rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A record on disk, a few samples at a time, gives what the whole gives."""
    record = shaker_test(rng)
    start = spoiled(vb.identify(record, vb.N4SID(block_rows=10), order=6))
    whole = refine(start, record)
    np.save(tmp_path / "u.npy", record.inputs)
    np.save(tmp_path / "y.npy", record.outputs)
    mapped = record.__class__(
        np.load(tmp_path / "y.npy", mmap_mode="r"),
        np.load(tmp_path / "u.npy", mmap_mode="r"),
        dt=DT,
        output_channels=record.output_channels,
        input_channels=record.input_channels,
    )
    monkeypatch.setattr(signals, "CHUNK_ELEMENTS", 1)
    pieces = refine(start, mapped)
    np.testing.assert_allclose(
        np.sort_complex(pieces.model.poles), np.sort_complex(whole.model.poles), rtol=1e-9
    )


def test_free_decay_without_inputs(rng: np.random.Generator) -> None:
    """Outputs alone that ring down refine by their initial state."""
    frame = bench(3)
    record = frame.simulate(None, DT, initial_state=rng.standard_normal(6), n_samples=400)
    y = np.asarray(record.outputs)
    noisy = vb.Record(y + 0.01 * y.std() * rng.standard_normal(y.shape), dt=DT)
    fit = vb.identify(noisy, vb.SSI(kind="data", block_rows=10), order=6, stability="project")
    still = replace(fit, kalman_gain=np.zeros_like(fit.kalman_gain))
    refined = refine(still, noisy)
    np.testing.assert_allclose(vb.modes_of(refined).damping_ratios, frame.damping_ratios, rtol=0.03)


def test_outputs_without_feedthrough_keep_none(rng: np.random.Generator) -> None:
    """Rows of D that the fit holds at zero stay zero."""
    force = white_noise(1500, rng=rng)
    sensors = [("displacement", "f1"), ("acceleration", "f2")]
    record = bench(2).simulate(force, DT, sensors=sensors, forces=["f1"], noise=0.02, rng=rng)
    fit = refine(vb.identify(record, vb.N4SID(block_rows=10), order=4), record)
    assert fit.feedthrough.tolist() == [False, True]
    assert fit.model.D[0, 0] == 0
    assert fit.model.D[1, 0] != 0
    np.testing.assert_allclose(vb.modes_of(fit).frequencies_hz, bench(2).frequencies_hz, rtol=1e-3)


def test_noisy_sensors_weigh_less(rng: np.random.Generator) -> None:
    """White errors go over to maximum likelihood: weights are inverse noise deviations."""
    record = shaker_test(rng, noise=0.0)
    y = np.asarray(record.outputs)
    std = np.array([0.01, 0.3, 0.05]) * y.std(axis=0)
    noisy = vb.Record(y + std * rng.standard_normal(y.shape), record.inputs, dt=DT)
    fit = refine(vb.identify(noisy, vb.N4SID(block_rows=20), order=6), noisy)
    weights = np.diag(fit.diagnostics.figures["output_weights"])
    np.testing.assert_allclose(weights * std, 1, rtol=0.1)
    stream = open_stream(noisy)
    even = refine_output_error(fit, stream, Search(weights="balanced"))
    assert (fit.diagnostics.figures["damping_std"] < even.diagnostics.figures["damping_std"]).all()


def noisy_copy(record: vb.Record, level: float, seed: int) -> tuple[vb.Record, Floats]:
    """Return the record with white noise on its outputs, and the noise's deviations."""
    y = np.asarray(record.outputs)
    std = level * y.std(axis=0)
    noise = std * np.random.default_rng(seed).standard_normal(y.shape)
    return vb.Record(y + noise, record.inputs, dt=record.dt), std


def test_standard_deviations_are_the_bound(rng: np.random.Generator) -> None:
    """Those reported agree with the Cramér-Rao bound of the true system to 5 %."""
    clean = shaker_test(rng, noise=0.0)
    record, std = noisy_copy(clean, 0.02, 1)
    fit = refine(vb.identify(record, vb.N4SID(block_rows=20), order=6), record)
    truth = bench(3).state_space("acceleration", ["f1"]).to_discrete(DT)
    frequencies, damping = shaker_bound(truth, clean, std)
    np.testing.assert_allclose(fit.diagnostics.figures["frequencies_std"], frequencies, rtol=0.05)
    np.testing.assert_allclose(fit.diagnostics.figures["damping_std"], damping, rtol=0.05)
    assert fit.parameter_covariance is not None
    assert fit.parameter_covariance.shape == (6, 6)


def test_drift_is_kept_out(rng: np.random.Generator) -> None:
    """With a bound on real poles none is slower; without, one plays the drift."""
    record = shaker_test(rng, noise=0.02)
    drift = 3 * record.outputs.std() * np.linspace(0, 1, record.n_samples)[:, None] ** 2
    slow = vb.Record(record.outputs + drift, record.inputs, dt=DT)
    start = vb.identify(slow, vb.N4SID(block_rows=10), order=7, stability="project")
    stream = open_stream(slow)

    def slowest(fit: vb.Fit) -> float:
        return float(np.abs(np.log(fit.model.poles)).min() * slow.n_samples)

    assert slowest(refine_output_error(start, stream)) < 3
    assert slowest(refine_output_error(start, stream, Search(drift=10))) > 10 - 1e-6


def test_elimination_finds_the_true_order(rng: np.random.Generator) -> None:
    """From order 12 to 6 costs nothing, the next step does, and order 6 holds the true modes."""
    record = shaker_test(rng)
    stream = open_stream(record)
    over = vb.identify(record, vb.N4SID(block_rows=20), order=12, stability="project")
    found = eliminate(over, stream)
    assert found.orders[0] == 12
    assert (np.diff(found.orders) < 0).all()
    assert (np.diff(found.costs) >= 0).all()
    costs = dict(zip(found.orders.tolist(), found.costs.tolist(), strict=True))
    assert costs[6] < 1.02
    assert min(cost for order, cost in costs.items() if order < 6) > 5
    np.testing.assert_allclose(
        vb.modes_of(found.refined(6)).frequencies_hz, bench(3).frequencies_hz, rtol=1e-3
    )
    with pytest.raises(OptionError, match="order=0 is below"):
        found.at(0)


def test_elimination_costs_what_its_models_miss(rng: np.random.Generator) -> None:
    """The curve equals the squares of each model's own simulation error."""
    record = shaker_test(rng)
    over = vb.identify(record, vb.N4SID(block_rows=20), order=12, stability="project")
    found = eliminate(over, open_stream(record), Search(weights="balanced"))
    squares = []
    for order in found.orders:
        error = record.outputs - own_simulation(found.at(int(order)), record)
        squares.append(float((error**2 / record.outputs.var(axis=0)).sum()))
    np.testing.assert_allclose(np.array(squares) / squares[0], found.costs, rtol=1e-6)


def test_held_out_curve_falls_to_the_truth(rng: np.random.Generator) -> None:
    """More than the true order gains nothing on unseen data; unreachable orders are left out."""
    seen, unseen = shaker_test(rng), shaker_test(rng)
    over = vb.identify(seen, vb.N4SID(block_rows=20), order=12, stability="project")

    def error(fit: vb.Fit) -> float:
        skipped = start_samples(12)
        modelled = fit.simulate_record(unseen)[skipped:]
        return float(100 - fit_percent(unseen.outputs[skipped:], modelled).mean())

    curve = held_out_curve([(eliminate(over, open_stream(seen)), error)], [0, 4, 6, 10])
    assert set(curve) == {4, 6, 10}
    assert curve[6] < 1.01 * min(curve.values())
    assert curve[4] > 2 * curve[6]


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda fit, record: refine(fit, record, noise="white"), "noise must be one of"),
        (lambda fit, record: refine(fit, record.select(inputs=[])), "select the same"),
        (lambda fit, record: Search(weights="even"), "weights must be one of"),
    ],
)
def test_wrong_use_is_refused(
    rng: np.random.Generator, act: Callable[[vb.Fit, vb.Record], object], message: str
) -> None:
    """The message names what is wrong."""
    record = shaker_test(rng, 600)
    fit = vb.identify(record, vb.N4SID(block_rows=10), order=6)
    with pytest.raises((OptionError, DataError), match=f"(?i){message}"):
        act(fit, record)


def test_noise_driven_outputs_are_refused(rng: np.random.Generator) -> None:
    """A simulation says nothing of what unknown forces drive."""
    record = shaker_test(rng).select(inputs=[])
    fit = vb.identify(record, vb.SSI(block_rows=10), order=6)
    with pytest.raises(OptionError, match="noise drives the structure"):
        refine(fit, record, noise="output_error")


@pytest.mark.parametrize(
    ("name", "n_inputs", "order", "block_rows", "limit"),
    [
        ("robot_arm", 1, 4, 20, 0.0340),
        ("dryer", 1, 4, 15, 0.0120),
        ("evaporator", 3, 4, 10, 0.467),
        ("flutter", 1, 6, 20, 0.167),
    ],
)
def test_real_records(
    shared_data: Path, name: str, n_inputs: int, order: int, block_rows: int, limit: float
) -> None:
    """Relative output errors of raw records beat what is published for them."""
    raw = np.loadtxt(shared_data / f"{name}.dat")
    record = vb.Record(raw[:, n_inputs : 2 * n_inputs], raw[:, :n_inputs], dt=1.0)
    method = vb.N4SID(weighting="moesp", block_rows=block_rows)
    start = vb.identify(record, method, order, offset="none", stability="project")
    fit = refine(start, record, noise="output_error")
    assert relative_error(record.outputs, own_simulation(fit, record)) <= limit
    assert fit.diagnostics.figures["converged"]


@pytest.mark.parametrize(
    ("name", "n_inputs", "block_rows", "forms"),
    [
        ("robot_arm", 1, 20, {"output_error"}),
        ("dryer", 1, 15, {"output_error"}),
        ("evaporator", 3, 10, {"innovations", "none"}),
    ],
)
def test_real_records_choose_their_form(
    shared_data: Path, name: str, n_inputs: int, block_rows: int, forms: set[str]
) -> None:
    """The coloured noise of the evaporator makes a simulation fitted to it no better unseen."""
    raw = np.loadtxt(shared_data / f"{name}.dat")
    record = vb.Record(raw[:, n_inputs : 2 * n_inputs], raw[:, :n_inputs], dt=1.0)
    method = vb.N4SID(weighting="cva", block_rows=block_rows)
    start = vb.identify(record, method, 4, offset="none", stability="project")
    figures = refine(start, record).diagnostics.figures
    assert figures["refinement"] in forms
    assert "halves" in figures["refinement_reason"]


@pytest.fixture(scope="module")
def subframe(shared_data: Path) -> vb.Record:
    """Return the record of the steel subframe."""
    from scipy.io import loadmat

    raw = loadmat(shared_data / "flexible_subframe.mat")["flexible_structure_dat"]
    return vb.Record(raw[:, 2:], raw[:, :2], dt=1 / 1024)


OVER = vb.N4SID(weighting="moesp", block_rows=35, transition="shift", completion="simulation")


@pytest.mark.slow
def test_subframe_by_elimination(subframe: vb.Record) -> None:
    """Order 20 from 44 explains 76.3 % (mean fit) of the whole record."""
    over = vb.identify(subframe, OVER, order=44, stability="project")
    search = Search(weights="balanced")
    fit = eliminate(over, open_stream(subframe), search).refined(20)
    assert fit_percent(subframe.outputs, own_simulation(fit, subframe)).mean() >= 76.2


@pytest.mark.slow
def test_subframe_on_unseen_data(subframe: vb.Record) -> None:
    """Order 32 from the first half: 94.7 % of the second (MAP start, not scored)."""
    half = subframe.n_samples // 2
    seen, unseen = subframe.slice(0, half), subframe.slice(half, subframe.n_samples)
    over = vb.identify(seen, OVER, order=44, stability="project")
    fit = eliminate(over, open_stream(seen), Search(weights="balanced", drift=20)).refined(32)
    skipped = start_samples(32)
    modelled = fit.simulate_record(unseen)[skipped:]
    assert fit_percent(unseen.outputs[skipped:], modelled).mean() >= 94.7
