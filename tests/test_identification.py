"""identify(): automatic choices, completion, stability, real records."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import impulse, white_noise
from vibrid.identification import (
    assess,
    assess_unseen,
    complete,
    scan_orders,
    steady_modes,
)
from vibrid.identification.candidates import stretches
from vibrid.identification.held_out import held_out_errors, smallest_enough
from vibrid.identification.modal_basis import modal_basis
from vibrid.samples import timber_building
from vibrid.scores import fit_percent, relative_error
from vibrid.structures import Structure, chain, shear_frame

DT = 0.02


def shaker_test(
    rng: np.random.Generator, *, n_samples: int = 6000, noise: float = 0.02
) -> tuple[Structure, vb.Record]:
    """Return a four-storey frame of 1 % damping, shaken at the first floor."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.01)
    force = white_noise(n_samples, rng=rng, std=100.0)
    return frame, frame.simulate(force, DT, forces=["f1"], noise=noise, rng=rng)


# -- automatic choices


def test_automatic_order_finds_the_structure(rng: np.random.Generator) -> None:
    """Noisy shaker data of four modes give order 8, with reasons, and its modes."""
    frame, record = shaker_test(rng)
    fit = vb.identify(record)
    assert fit.order == 8
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=2e-3)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=0.1)
    horizon, order = fit.diagnostics.figures["choices"]
    assert f"block_rows={fit.method.block_rows}" in horizon
    assert "order=8 has the lowest information criterion" in order
    assert (fit.diagnostics.figures["persistence"] > 0.8).all()


def test_automatic_order_of_noise_free_data_is_exact(rng: np.random.Generator) -> None:
    """Without noise the criterion stops at the true order."""
    _, record = shaker_test(rng, noise=0.0)
    assert vb.identify(record).order == 8


def test_automatic_choice_of_ambient_data_holds_the_modes(rng: np.random.Generator) -> None:
    """Outputs alone: the chosen order holds all four modes and names them steady."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.01)
    force = white_noise(20_000, 4, rng=rng, std=100.0)
    record = frame.simulate(force, DT, forces=frame.dofs, noise=0.05, rng=rng)
    fit = vb.identify(record.select(inputs=[]))
    modes = vb.modes_of(fit)
    steady = modes.select(np.flatnonzero(fit.diagnostics.figures["persistence"] > 0.8))
    nearest = np.abs(steady.frequencies_hz[:, None] - frame.frequencies_hz).min(axis=0)
    assert (nearest / frame.frequencies_hz < 5e-3).all()
    assert fit.order < 20


def test_scan_knows_which_modes_are_steady(rng: np.random.Generator) -> None:
    """Four modes persist over the orders and spurious ones do not."""
    frame, record = shaker_test(rng)
    method = vb.N4SID(block_rows=20)
    found = steady_modes(scan_orders(method, method.decompose(record)))
    assert found is not None
    order, steady = found
    assert order == 8
    np.testing.assert_allclose(steady.frequencies_hz, frame.frequencies_hz, rtol=5e-3)


def test_short_records_get_a_short_horizon(rng: np.random.Generator) -> None:
    """A record too short for the usual horizons is identified with the longest it allows."""
    _, record = shaker_test(rng, n_samples=90, noise=0.001)
    fit = vb.identify(record, order=8)
    assert fit.method.block_rows == 7
    assert "longest that this record" in fit.diagnostics.figures["choices"][0]


# -- completion


@pytest.mark.parametrize("form", ["simulation", "prediction"])
def test_fast_least_squares_equals_the_explicit_one(form: str, rng: np.random.Generator) -> None:
    """B, D, offset and x0 equal a plain least squares on one simulated column an unknown."""
    _, record = shaker_test(rng, n_samples=400)
    method = vb.N4SID(block_rows=12, completion=form)
    fit = vb.identify(record, method, order=4)
    A, C, K = fit.model.A, fit.model.C, fit.kalman_gain
    K = K if form == "prediction" else np.zeros_like(K)
    u, y = record.inputs - fit.input_offset, record.outputs
    n, p = 4, 4
    target, columns = np.empty((400, p)), []
    state = np.zeros(n)
    for t in range(400):
        target[t] = y[t] - C @ state
        state = (A - K @ C) @ state + K @ y[t]
    for j in range(n):  # B - K D
        columns.append(_free(A - K @ C, np.eye(n)[j], C, u[:, 0]))
    columns += [np.outer(u[:, 0], np.eye(p)[k]) for k in range(p)]
    columns += [np.tile(np.eye(p)[k], (400, 1)) for k in range(p)]
    columns += [_decay(A - K @ C, np.eye(n)[j], C, 400) for j in range(n)]
    weight = fit.diagnostics.figures["output_weights"]
    left = np.stack([(column @ weight.T).ravel() for column in columns], axis=1)
    answer = np.linalg.lstsq(left, (target @ weight.T).ravel(), rcond=None)[0]
    D = answer[n : n + p]
    np.testing.assert_allclose(fit.model.D[:, 0], D, rtol=1e-6, atol=1e-9 * abs(D).max())
    B = answer[:n] + K @ D
    np.testing.assert_allclose(fit.model.B[:, 0], B, rtol=1e-5, atol=1e-8 * abs(B).max())


def _free(A: Any, b: Any, C: Any, u: Any) -> Any:
    state, rows = np.zeros(len(A)), np.empty((len(u), len(C)))
    for t, value in enumerate(u):
        rows[t] = C @ state
        state = A @ state + b * value
    return rows


def _decay(A: Any, start: Any, C: Any, count: int) -> Any:
    rows = np.empty((count, len(C)))
    for t in range(count):
        rows[t] = C @ start
        start = A @ start
    return rows


def test_unseen_halves_choose_the_form(rng: np.random.Generator) -> None:
    """With sensor noise only, completion by simulation wins, and says by how much."""
    _, record = shaker_test(rng, noise=0.1)
    fit = vb.identify(record, order=8)
    assert fit.diagnostics.figures["completion"] == "simulation"
    assert "unseen halves" in fit.diagnostics.figures["completion_reason"]


def test_regression_completion_keeps_b_and_d(rng: np.random.Generator) -> None:
    """completion="regression" only adds initial states."""
    _, record = shaker_test(rng)
    method = vb.N4SID(block_rows=20, transition="regression", completion="regression")
    stream = open_stream(record)
    plain = method.realize(method.decompose(stream), 8)
    done = complete(plain, stream, "regression")
    np.testing.assert_allclose(done.model.B, plain.model.B, rtol=1e-12)
    np.testing.assert_allclose(done.model.D, plain.model.D, rtol=1e-12)
    assert np.isnan(plain.initial_states).all()
    assert np.isfinite(done.initial_states).all()


def test_modal_basis_says_when_poles_coincide() -> None:
    """A defective matrix has no modal basis; a diagonalizable one comes back exactly."""
    assert modal_basis(np.array([[0.5, 1.0], [0.0, 0.5]])) is None
    A = np.array([[0.9, 0.3, 0.0], [-0.3, 0.9, 0.1], [0.0, 0.0, -0.4]])
    basis = modal_basis(A)
    assert basis is not None
    V = basis.vectors
    np.testing.assert_allclose(V @ basis.blocks @ np.linalg.inv(V), A, atol=1e-14)


# -- stability


def test_unstable_models_are_never_silent(shared_data: Path) -> None:
    """The robot arm at order 8 without shift: raise names the pole and what to try."""
    z = np.loadtxt(shared_data / "robot_arm.dat")
    record = vb.Record(z[:, 1:], z[:, :1], dt=1.0)
    method = vb.N4SID(weighting="moesp", block_rows=20, transition="shift")
    unstable = [k for k in range(2, 13) if not _stable(method, record, k)]
    assert unstable
    for order in unstable:
        with pytest.raises(vb.UnstableModelError, match=r"magnitude 1\.\d+ at .* Hz.*project"):
            vb.identify(record, method, order=order)
        projected = vb.identify(record, method, order=order, stability="project")
        assert projected.model.is_stable
        assert "projected" in [finding.code for finding in projected.diagnostics.findings]
        left = vb.identify(record, method, order=order, stability="ignore")
        assert not left.model.is_stable
        assert "unstable" in [finding.code for finding in left.diagnostics.findings]


def _stable(method: Any, record: vb.Record, order: int) -> bool:
    return method.realize(method.decompose(record), order).model.is_stable


def test_automatic_order_is_stable(shared_data: Path) -> None:
    """Where many orders are unstable, the automatic choice is not one of them."""
    z = np.loadtxt(shared_data / "robot_arm.dat")
    fit = vb.identify(vb.Record(z[:, 1:], z[:, :1], dt=1.0))
    assert fit.model.is_stable


# -- refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "n4sid"}, r"method must be one of N4SID\(\)"),
        ({"order": "best"}, "order must be one of auto"),
        ({"stability": "projekt"}, "Did you mean 'project'"),
        ({"offset": "zero"}, "offset must be one of"),
        ({"feedthrough": [1, 0, 1, 1]}, "feedthrough must be True, False"),
    ],
)
def test_wrong_options_are_refused(
    options: dict[str, Any], message: str, rng: np.random.Generator
) -> None:
    """Wrong use raises OptionError with the choices."""
    _, record = shaker_test(rng, n_samples=500)
    with pytest.raises(vb.OptionError, match=message):
        vb.identify(record, **options)


def test_other_data_are_refused() -> None:
    """Plain arrays are not records, and responses are for ERA."""
    with pytest.raises(vb.OptionError, match="Expected a Record; got ndarray"):
        vb.identify(np.ones((5, 1)))  # type: ignore[arg-type]
    responses = vb.ImpulseResponses(np.ones((5, 1, 1)), dt=0.1)
    with pytest.raises(vb.OptionError, match="N4SID takes records; for ImpulseResponses use ERA"):
        vb.identify(responses, vb.N4SID())
    with pytest.raises(vb.OptionError, match="No record was given"):
        vb.identify([])


# -- real records


def test_timber_building_has_its_published_modes() -> None:
    """The embedded ambient record gives 1.882, 2.421 and 2.689 Hz within 1 %."""
    fit = vb.identify(timber_building().to_band(0.5, 10.0))
    found = vb.modes_of(fit)
    steady = found.select(np.flatnonzero(fit.diagnostics.figures["persistence"] >= 0.5))
    for published in (1.882, 2.421, 2.689):
        assert np.abs(steady.frequencies_hz / published - 1).min() < 0.01


@pytest.mark.parametrize(
    ("name", "inputs", "rows", "order", "weighting", "published"),
    [
        ("dryer", 1, 15, 4, "moesp", 0.015),
        ("robot_arm", 1, 20, 4, "moesp", 0.0360),
        ("flutter", 1, 20, 6, "moesp", 0.237),
        ("evaporator", 3, 10, 4, "moesp", 0.489),
    ],
)
def test_daisy_errors_are_the_published_ones(
    shared_data: Path,
    name: str,
    inputs: int,
    rows: int,
    order: int,
    weighting: str,
    published: float,
) -> None:
    """Relative output error of the simulation, raw data (Sima, SLICOT Note 2000-4)."""
    z = np.loadtxt(shared_data / f"{name}.dat")
    record = vb.Record(z[:, inputs : 2 * inputs], z[:, :inputs], dt=1.0)
    method = vb.N4SID(
        weighting=weighting, block_rows=rows, transition="shift", completion="simulation"
    )
    fit = vb.identify(record, method, order=order, offset="none")
    simulated = fit.simulate(record.inputs, fit.initial_states[0])
    assert relative_error(record.outputs, simulated) < 1.005 * published


def test_assessments_say_what_they_are(rng: np.random.Generator) -> None:
    """Seen and unseen scores carry kind, rule and stretch; the unseen one is honest."""
    _, record = shaker_test(rng)
    fit = vb.identify(record, order=8)
    seen, unseen = assess(fit, record), assess_unseen(record, fit)
    assert unseen is not None
    assert (seen.kind, unseen.kind) == ("simulation", "simulation")
    assert "MAP from the first 24 samples" in seen.rule
    assert "carried over" in unseen.rule
    assert (unseen.start, unseen.stop) == (90.0, 120.0)
    assert (unseen.seen, seen.seen) == (False, True)
    for each in (seen, unseen):
        np.testing.assert_allclose(each.fit_percent, 98, atol=0.5)  # 2 % noise
        np.testing.assert_allclose(each.vaf_percent, 99.96, atol=0.03)


def test_fit_on_unseen_data_needs_no_luck(rng: np.random.Generator) -> None:
    """A model of the first part simulates the second from MAP as well as from its truth."""
    _, record = shaker_test(rng)
    fit = vb.identify(record.slice(0, 4000), order=8)
    rest = record.slice(4000)
    modelled = fit.simulate_record(rest)
    assert (fit_percent(rest.outputs[24:], modelled[24:]) > 97).all()


# -- orders on unseen halves


def test_held_out_error_is_that_of_an_explicit_split(rng: np.random.Generator) -> None:
    """The curve's value is the mean of two identifications on halves, scored on the others."""
    _, record = shaker_test(rng, noise=0.3)
    method = vb.N4SID(block_rows=12, completion="simulation")
    errors = []
    halves = record.slice(0, 3000), record.slice(3000)
    for seen, unseen in (halves, halves[::-1]):
        fit = vb.identify(seen, method, order=6)
        modelled = fit.simulate_record(unseen)[20:]
        errors.append(1 - fit_percent(unseen.outputs[20:], modelled).mean() / 100)
    found = held_out_errors(open_stream(record), method, None, [6])
    # the stream's scale and centre are those of the whole record: rounding and no more
    np.testing.assert_allclose(found[6], np.mean(errors), rtol=2e-3)


def test_held_out_halves_stop_a_criterion_that_falls_for_ever(rng: np.random.Generator) -> None:
    """A hardening spring lets the criterion ask for many states; unseen halves do not."""
    force = white_noise(8000, rng=rng)
    y = np.zeros((8000, 1))
    position = velocity = 0.0
    for t in range(8000):
        velocity += 0.02 * (force[t, 0] - 0.6 * velocity - 100 * position - 3e4 * position**3)
        position += 0.02 * velocity
        y[t] = position
    record = vb.Record(y, force, dt=0.02)
    fit = vb.identify(record)
    curve = fit.diagnostics.figures["held_out_errors"]
    by_criterion = fit.diagnostics.figures["orders"][
        np.nanargmin(fit.diagnostics.figures["criterion"])
    ]
    assert fit.order < by_criterion
    assert "unseen halves" in fit.diagnostics.figures["choices"][1]
    limit = 1.05 * curve[:, 1].min()
    assert (curve[curve[:, 0] < fit.order, 1] > limit).all()


def test_smallest_enough_allows_five_percent() -> None:
    """The smallest order within 5 % of the least error wins."""
    assert smallest_enough({2: 0.5, 4: 0.209, 6: 0.2, 8: 0.21}) == 4
    assert smallest_enough({2: 0.5, 4: 0.211, 6: 0.2}) == 6


def test_short_records_have_no_held_out_errors(rng: np.random.Generator) -> None:
    """Where halves are shorter than the horizon needs, there is no curve."""
    _, record = shaker_test(rng, n_samples=300)
    assert held_out_errors(open_stream(record), vb.N4SID(block_rows=20), None, [4]) == {}


def test_disagreeing_damping_is_said(rng: np.random.Generator) -> None:
    """A horizon far shorter than the memory of a lightly damped mode gives a doubt."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.002)
    force = white_noise(3000, rng=rng, std=100.0)
    record = frame.simulate(force, DT, forces=["f1"], noise=0.3, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=5), order=8)
    codes = [finding.code for finding in fit.diagnostics.findings]
    assert "damping-doubt" in codes


# -- automatic choices on what test halls deliver


@pytest.mark.parametrize("damping_ratio", [0.0, 0.01])
@pytest.mark.parametrize("n_dof", [2, 3, 5, 8])
def test_automatic_order_of_a_free_decay_is_its_rank(
    n_dof: int, damping_ratio: float, rng: np.random.Generator
) -> None:
    """Noise-free decays, damped or not, show all their modes without an order given."""
    frame = chain(np.ones(n_dof), np.full(n_dof, 800.0), damping_ratio=damping_ratio)
    start = rng.standard_normal(2 * n_dof)
    fit = vb.identify(frame.simulate(None, 0.05, initial_state=start, n_samples=1500))
    assert fit.order == 2 * n_dof
    assert "rank" in fit.diagnostics.figures["choices"][1]
    np.testing.assert_allclose(vb.modes_of(fit).frequencies_hz, frame.frequencies_hz, rtol=1e-8)


def test_a_hammer_blow_near_the_start_keeps_feedthrough(rng: np.random.Generator) -> None:
    """An impulse that no Hankel column sees as u(t) still gives the accelerations their D."""
    frame = chain(np.ones(3), np.full(3, 800.0), damping_ratio=0.01)
    force = impulse(2000, sample=5)
    record = frame.simulate(force, 0.05, forces=["f1"], noise=0.002, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=20), order=6)
    exact = frame.state_space(forces=["f1"]).to_discrete(0.05).markov_parameters(40)
    error = np.linalg.norm(fit.model.markov_parameters(40) - exact) / np.linalg.norm(exact)
    assert error < 2e-3
    assert fit.feedthrough.all()


def test_records_may_have_offsets_of_their_own(rng: np.random.Generator) -> None:
    """Two records with different offsets are exact together, and a finding says so."""
    frame, first = shaker_test(rng, n_samples=1500, noise=0.0)
    _, second = shaker_test(rng, n_samples=1200, noise=0.0)
    moved = [
        vb.Record(each.outputs + shift, each.inputs, dt=DT)
        for each, shift in ((first, 5.0), (second, -5.0))
    ]
    fit = vb.identify(moved, vb.N4SID(block_rows=12), order=8)
    exact = frame.state_space(forces=["f1"]).to_discrete(DT).markov_parameters(40)
    np.testing.assert_allclose(
        fit.model.markov_parameters(40), exact, atol=1e-8 * np.abs(exact).max()
    )
    offsets = fit.diagnostics.figures["record_offsets"]
    np.testing.assert_allclose(offsets, [[5.0] * 4, [-5.0] * 4], atol=1e-6)
    assert "record-offsets" in [finding.code for finding in fit.diagnostics.findings]


def test_many_short_records_are_refused_or_identified(rng: np.random.Generator) -> None:
    """Pieces that a constant each uses up are refused by message, never by an index."""
    _, record = shaker_test(rng, n_samples=3000)
    short = [record.slice(12 * k, 12 * k + 12) for k in range(250)]
    fit = vb.identify(short, order=6, stability="project")
    assert 2 * fit.method.block_rows < 12
    pieces = [record.slice(60 * k, 60 * k + 60) for k in range(40)]
    assert vb.identify(pieces, vb.N4SID(block_rows=10)).order > 1


def test_a_lonely_sample_between_gaps_is_harmless(rng: np.random.Generator) -> None:
    """A piece of one sample has nothing to hold out."""
    _, record = shaker_test(rng)
    y = record.outputs.copy()
    y[[3000, 3002]] = np.nan
    assert vb.identify(vb.Record(y, record.inputs, dt=DT)).order == 8


def test_asking_for_what_was_chosen_gives_the_same_model(rng: np.random.Generator) -> None:
    """The automatic horizon and order, given by hand, are the same identification."""
    _, record = shaker_test(rng, n_samples=900, noise=0.1)
    chosen = vb.identify(record)
    again = vb.identify(record, chosen.method, chosen.order)
    np.testing.assert_allclose(again.model.A, chosen.model.A, atol=1e-12)
    np.testing.assert_allclose(again.model.B, chosen.model.B, rtol=1e-9)


def test_a_long_past_limits_the_automatic_future(rng: np.random.Generator) -> None:
    """past_rows given and block_rows left out: horizons that do not fit are not tried."""
    _, record = shaker_test(rng, n_samples=1500)
    fit = vb.identify(record, vb.N4SID(past_rows=200), order=8)
    assert fit.diagnostics.figures["past_rows"] == 200


# -- stochastic models


def test_innovations_model_comes_back() -> None:
    """Outputs of a known innovations model give its gain, covariance and prediction error."""
    rng = np.random.default_rng(3)
    A = np.array([[0.95, 0.25, 0.0], [-0.25, 0.95, 0.0], [0.0, 0.0, 0.6]]) * 0.98
    C = np.array([[1.0, 0.2, 0.5], [0.3, -0.7, 1.0]])
    K = np.array([[0.3, 0.1], [0.1, -0.3], [0.1, 0.2]])
    assert np.abs(np.linalg.eigvals(A - K @ C)).max() < 0.9
    B, D = np.array([[1.0], [0.5], [-0.3]]), np.array([[0.2], [0.1]])
    root = np.array([[1.0, 0.0], [0.4, 0.6]])
    u, e = rng.standard_normal((60_000, 1)), rng.standard_normal((60_000, 2)) @ root.T
    y = vb.StateSpace(A, np.hstack([B, K]), C, np.hstack([D, np.eye(2)]), 1.0).simulate(
        np.hstack([u, e])
    )
    units = np.array([1e3, 1e-2])
    for data, method in (
        (vb.Record(y * units, u, dt=1.0), vb.N4SID(block_rows=25, completion="prediction")),
        (vb.Record(y * units, u, dt=1.0), vb.N4SID(block_rows=25, transition="regression")),
    ):
        fit = vb.identify(data, method, order=3)
        np.testing.assert_allclose(
            fit.innovation_covariance, root @ root.T * np.outer(units, units), rtol=0.05
        )
        # Markov parameters C A^k K of the noise path do not depend on the basis
        for k in range(4):
            exact = C @ np.linalg.matrix_power(A, k) @ K
            found = (
                (fit.model.C / units[:, None])
                @ np.linalg.matrix_power(fit.model.A, k)
                @ (fit.kalman_gain * units)
            )
            np.testing.assert_allclose(found, exact, atol=0.03)
        spread = fit.state_covariance @ fit.model.C.T
        explained = np.diag(fit.model.C @ spread) / units**2
        expected = np.var(y - e - u @ D.T, axis=0)
        np.testing.assert_allclose(explained, expected, rtol=0.05)


def test_prediction_states_start_where_the_filter_does() -> None:
    """Prediction from the fitted initial states is best: its first errors are no larger."""
    rng = np.random.default_rng(4)
    _, record = shaker_test(rng, n_samples=3000, noise=0.05)
    moved = vb.Record(record.outputs + 40.0, record.inputs, dt=DT)
    fit = vb.identify(moved, vb.N4SID(block_rows=15, completion="prediction"), order=8)
    assert fit.diagnostics.figures["completion"] == "prediction"
    errors = moved.outputs - fit.predict(moved, fit.initial_states)
    spread = np.sqrt(np.diag(fit.innovation_covariance))
    assert (np.abs(errors[:20]).max(axis=0) < 6 * spread).all()
    np.testing.assert_allclose(errors.std(axis=0), spread, rtol=0.05)
    np.testing.assert_allclose(fit.output_offset, 40.0, atol=3 * spread.max())


@pytest.mark.parametrize("noise", [1e-4, 1e-3])
def test_automatic_order_of_a_hammer_test(noise: float) -> None:
    """A blow leaves one half of the record without force: that half is not a judge."""
    rng = np.random.default_rng(1)
    frame = chain(np.ones(3), np.full(3, 4000.0), damping_ratio=0.01)
    force = np.zeros((1500, 1))
    force[50:54] = 100.0
    clean = frame.simulate(force, 0.01, forces=["f1"])
    y = clean.outputs + noise * np.abs(clean.outputs).max() * rng.standard_normal((1500, 3))
    fit = vb.identify(vb.Record(y, force, dt=0.01))
    found = vb.modes_of(fit).frequencies_hz
    nearest = np.abs(found[:, None] - frame.frequencies_hz).min(axis=0)
    assert (nearest < 2e-3 * frame.frequencies_hz).all()


def test_automatic_order_with_offsets_of_each_record(rng: np.random.Generator) -> None:
    """Records with far offsets still give the true order, and are simulated with their own."""
    _, record = shaker_test(rng, n_samples=3600)
    spread = record.outputs.std()
    parts = [record.slice(1200 * k, 1200 * (k + 1)) for k in range(3)]
    moved = [
        vb.Record(part.outputs + 10 * k * spread, part.inputs, dt=DT)
        for k, part in enumerate(parts)
    ]
    fit = vb.identify(moved)
    assert fit.order == 8
    offsets = fit.diagnostics.figures["record_offsets"]
    for k, part in enumerate(moved):
        modelled = fit.simulate_record(part, fit.initial_states[[k]], output_offset=offsets[k])
        assert (fit_percent(part.outputs, modelled) > 97).all()


def test_an_output_that_dies_does_not_end_the_choice(rng: np.random.Generator) -> None:
    """A sensor that rests in one half is not scored there; the rest decides."""
    _, record = shaker_test(rng)
    y = record.outputs.copy()
    y[3000:, 1] = 0
    assert vb.identify(vb.Record(y, record.inputs, dt=DT), stability="project").order > 1


def test_unstable_noise_free_data_follow_the_policy(rng: np.random.Generator) -> None:
    """The rank of data of an unstable system is its order, and the policy decides."""
    angle = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    A = np.block([[1.005 * angle, np.zeros((2, 2))], [np.zeros((2, 2)), 0.9 * angle @ angle]])
    system = vb.StateSpace(A, np.ones((4, 1)), rng.standard_normal((2, 4)), np.zeros((2, 1)), 1.0)
    u = white_noise(800, rng=rng)
    record = vb.Record(system.simulate(u), u, dt=1.0)
    with pytest.raises(vb.UnstableModelError, match="order 4 is unstable"):
        vb.identify(record)
    assert vb.identify(record, stability="project").model.is_stable
    left = vb.identify(record, stability="ignore")
    np.testing.assert_allclose(left.model.spectral_radius, 1.005, rtol=1e-8)


def test_two_sines_are_identified_and_doubted() -> None:
    """Inputs of four frequencies' rank make wild models on the way; the finding says what lacks."""
    rng = np.random.default_rng(5)
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    t = 0.05 * np.arange(3000)
    force = np.sin(2 * np.pi * 1.1 * t) + np.sin(2 * np.pi * 2.3 * t)
    record = frame.simulate(force, 0.05, forces=["f1"], noise=0.02, rng=rng)
    fit = vb.identify(record)
    assert fit.diagnostics.figures["simulation_error"] < 0.1
    assert "excitation" in [finding.code for finding in fit.diagnostics.findings]


@pytest.mark.parametrize("amount", [1.0, 5.0])
def test_a_wandering_offset_is_said(amount: float, rng: np.random.Generator) -> None:
    """A random walk of the sensors' zero takes a real pole, slow for the record or the modes."""
    _, record = shaker_test(rng, n_samples=3000)
    walk = np.cumsum(rng.standard_normal((3000, 1)), axis=0) / 30
    y = record.outputs + amount * record.outputs.std() * walk
    fit = vb.identify(vb.Record(y, record.inputs, dt=DT), vb.N4SID(block_rows=20), order=9)
    said = {finding.code: str(finding) for finding in fit.diagnostics.findings}
    assert "they play a drift" in said["drift-pole"]


def test_a_weak_measured_force_does_not_cost_the_modes() -> None:
    """Where unmeasured forces do nearly all, simulation cannot judge orders: the criterion does."""
    rng = np.random.default_rng(2)
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    forces = white_noise(6000, 3, rng=rng) * [0.1, 1.0, 1.0]
    record = frame.simulate(forces, 0.05, forces=frame.dofs, noise=0.02, rng=rng)
    fit = vb.identify(record.select(inputs=[record.input_names[0]]))
    assert fit.order == 6 and "cannot judge" in fit.diagnostics.figures["choices"][-1]
    found = vb.modes_of(fit).frequencies_hz
    np.testing.assert_allclose(found, frame.frequencies_hz, rtol=0.01)


def test_a_force_among_the_responses_is_said(rng: np.random.Generator) -> None:
    """A measured force without a role is taken as a response, with a warning and the cure."""
    _, record = shaker_test(rng)
    both = vb.Record(
        np.hstack([record.inputs, record.outputs]),
        dt=DT,
        output_channels=record.input_channels + record.output_channels,
    )
    fit = vb.identify(both, vb.SSI(block_rows=20), order=10, stability="project")
    found = {finding.code: finding for finding in fit.diagnostics.findings}
    assert "--inputs force_f1" in found["input-as-response"].cure


def test_coinciding_poles_leave_the_regression_as_it_is(rng: np.random.Generator) -> None:
    """A defective transition cannot be completed: B, D stay, what is missing is NaN, and said."""
    _, record = shaker_test(rng, n_samples=600)
    stream = open_stream(record)
    method = vb.N4SID(block_rows=8)
    plain = method.realize(method.decompose(stream), 2)
    model = vb.StateSpace([[0.5, 1.0], [0.0, 0.5]], plain.model.B, plain.model.C, plain.model.D, DT)
    defective = replace(plain, model=model, kalman_gain=np.zeros_like(plain.kalman_gain))
    done = complete(defective, stream)
    assert "coinciding-poles" in [finding.code for finding in done.diagnostics.findings]
    assert np.isnan(done.initial_states).all()
    assert done.diagnostics.figures["record_offsets"].shape == (1, 4)


def test_one_sensor_shows_all_modes_of_a_decay(rng: np.random.Generator) -> None:
    """Where the shortest horizon cannot hold the rank, the one that shows it is taken."""
    frame = chain(np.ones(8), np.full(8, 800.0), damping_ratio=0.01)
    record = frame.simulate(
        None,
        0.05,
        sensors=[("acceleration", "f1")],
        initial_state=rng.standard_normal(16),
        n_samples=1500,
    )
    fit = vb.identify(record)
    assert fit.order == 16
    np.testing.assert_allclose(vb.modes_of(fit).frequencies_hz, frame.frequencies_hz, rtol=1e-6)


def test_a_quiet_half_does_not_judge_the_other(rng: np.random.Generator) -> None:
    """A record that dies out is completed by simulation: its end cannot judge its beginning."""
    frame = shear_frame(2, 100.0, 2e5, damping_ratio=0.02)
    force = white_noise(4000, rng=rng, std=100.0) * (np.arange(4000) < 1500)[:, None]
    record = frame.simulate(force, DT, forces=["f1"], noise=0.02, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=20), order=4)
    assert fit.diagnostics.figures["completion"] == "simulation"
    assert "hardly moves" in fit.diagnostics.figures["completion_reason"]


def test_stretches_spread_over_a_long_record(rng: np.random.Generator) -> None:
    """A share of a long record comes from all of it, and a short one is taken whole."""
    stream = open_stream(vb.Record(rng.standard_normal((95_000, 1)), dt=DT))
    assert stretches(stream, 100_000) is stream
    kept = stretches(stream, 20_000).segments
    assert [(each.start, each.stop) for each in kept] == [(0, 9500), (47_500, 57_000)]
