"""identify(): automatic horizons and orders, by criterion, by rank and on unseen halves."""

from __future__ import annotations

import numpy as np
import pytest
from identification_cases import DT, shaker_test

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import white_noise
from vibrid.identification import scan_orders, steady_modes
from vibrid.identification.candidates import stretches
from vibrid.identification.held_out import held_out_errors, smallest_enough
from vibrid.scores import fit_percent
from vibrid.structures import chain, shear_frame

# -- horizon and order


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


def test_stretches_spread_over_a_long_record(rng: np.random.Generator) -> None:
    """A share of a long record comes from all of it, and a short one is taken whole."""
    stream = open_stream(vb.Record(rng.standard_normal((95_000, 1)), dt=DT))
    assert stretches(stream, 100_000) is stream
    kept = stretches(stream, 20_000).segments
    assert [(each.start, each.stop) for each in kept] == [(0, 9500), (47_500, 57_000)]


# -- what test halls deliver


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


def test_an_output_that_dies_does_not_end_the_choice(rng: np.random.Generator) -> None:
    """A sensor that rests in one half is not scored there; the rest decides."""
    _, record = shaker_test(rng)
    y = record.outputs.copy()
    y[3000:, 1] = 0
    assert vb.identify(vb.Record(y, record.inputs, dt=DT), stability="project").order > 1


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
