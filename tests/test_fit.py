"""Fits of known systems: simulation and prediction with offsets, gaps and noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from known_fits import known_fit

from vibrid.errors import DataError, OptionError
from vibrid.fit import Diagnostics, Finding, Fit, feedthrough_mask
from vibrid.record import Channel, Floats, Record
from vibrid.statespace import StateSpace

DT = 0.1
INPUT_OFFSET = np.array([5.0, -3.0])
OUTPUT_OFFSET = np.array([100.0, -7.0, 0.5])
X0 = np.array([1.0, -2.0, 0.5])


def known(rng: np.random.Generator) -> Fit:
    """Return a stable 3-state model with D, a Kalman gain and offsets on both sides."""
    A = rng.standard_normal((3, 3))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    B, C, D = (rng.standard_normal(shape) for shape in ((3, 2), (3, 3), (3, 2)))
    return known_fit(
        StateSpace(A, B, C, D, DT),
        kalman_gain=0.1 * rng.standard_normal((3, 3)),
        input_offset=INPUT_OFFSET,
        output_offset=OUTPUT_OFFSET,
        innovation_covariance=1e-6 * np.eye(3),
    )


def run(fit: Fit, u: Floats, start: Floats, errors: Floats | None = None) -> Floats:
    """Return x⁺ = A x + B (u − u₀) + K e, y = C x + D (u − u₀) + e + y₀ by a plain loop."""
    model, x, y = fit.model, start, []
    for k, now in enumerate(u - fit.input_offset):
        e = np.zeros(model.n_outputs) if errors is None else errors[k]
        y.append(model.C @ x + model.D @ now + e + fit.output_offset)
        x = model.A @ x + model.B @ now + fit.kalman_gain @ e
    return np.array(y)


# -- simulation


def test_simulation_includes_the_offsets(rng: np.random.Generator) -> None:
    """The model relates deviations; inputs and outputs are in the record's own level."""
    fit, u = known(rng), rng.standard_normal((300, 2)) + 4
    np.testing.assert_allclose(fit.simulate(u, X0), run(fit, u, X0), rtol=1e-11)
    level = fit.simulate(np.tile(INPUT_OFFSET, (5, 1)))
    np.testing.assert_allclose(level, np.tile(OUTPUT_OFFSET, (5, 1)), rtol=1e-14)
    zero = run(fit, np.zeros((20, 2)), 0 * X0)
    np.testing.assert_allclose(fit.simulate(n_samples=20), zero, rtol=1e-11)


@pytest.mark.parametrize("shape", [(10,), (10, 1), (10, 3), (10, 2, 1)])
def test_inputs_that_do_not_fit_are_refused(rng: np.random.Generator, shape: Any) -> None:
    """One column is not spread over two inputs."""
    with pytest.raises(OptionError, match=r"shape \(n_samples, 2\)"):
        known(rng).simulate(np.ones(shape))


def test_simulation_of_bad_inputs_is_refused(rng: np.random.Generator) -> None:
    """Neither inputs nor length; a NaN in the inputs."""
    with pytest.raises(OptionError, match="Give inputs, or n_samples"):
        known(rng).simulate()
    with pytest.raises(DataError, match="Input sample 3 is NaN"):
        known(rng).simulate(np.where(np.arange(20).reshape(10, 2) == 7, np.nan, 1.0))


def test_simulating_a_record_gives_it_back(rng: np.random.Generator) -> None:
    """Without noise, each piece is rebuilt from its inputs, its initial state found by MAP."""
    fit, u = known(rng), rng.standard_normal((400, 2))
    y = run(fit, u, X0)
    y[150:160, 1] = np.nan
    record = Record(y, u, dt=DT)
    simulated = fit.simulate_record(record, "least_squares")
    assert np.isnan(simulated[150:160]).all()
    good = ~np.isnan(y).any(axis=1)
    np.testing.assert_allclose(simulated[good], y[good], atol=1e-5)
    np.testing.assert_allclose(fit.simulate_record(record)[good], y[good], atol=1e-3)


# -- prediction


def test_prediction_errors_are_the_innovations(rng: np.random.Generator) -> None:
    """With the true gain and state, what is left is the noise that drove the model."""
    fit, u = known(rng), rng.standard_normal((500, 2))
    e = rng.standard_normal((500, 3))
    record = Record(run(fit, u, X0, e), u, dt=DT)
    predicted = fit.predict(record, X0[None, :])
    np.testing.assert_allclose(record.outputs - predicted, e, atol=1e-10)


def test_predictor_without_gain_is_the_model(rng: np.random.Generator) -> None:
    """K = 0 leaves A and B, and does not look at the outputs."""
    fit = known(rng)
    plain, gained = fit.predictor(np.zeros((3, 3))), fit.predictor()
    np.testing.assert_array_equal(plain.A, fit.model.A)
    np.testing.assert_array_equal(plain.B, np.hstack([fit.model.B, np.zeros((3, 3))]))
    K, model = fit.kalman_gain, fit.model
    np.testing.assert_allclose(gained.A, model.A - K @ model.C)
    np.testing.assert_allclose(gained.B, np.hstack([model.B - K @ model.D, K]))
    np.testing.assert_array_equal(gained.D, np.hstack([model.D, np.zeros((3, 3))]))


def test_gaps_stay_gaps_and_pieces_start_anew(rng: np.random.Generator) -> None:
    """Missing rows are NaN; the piece behind a gap does not know what was before it."""
    fit, u = known(rng), rng.standard_normal((300, 2))
    record = Record(run(fit, u, X0, rng.standard_normal((300, 3))), u, dt=DT)
    record.inputs[100:105, 0] = np.nan
    predicted = fit.predict(record)
    assert np.isnan(predicted[100:105]).all()
    assert np.isfinite(predicted[:100]).all()
    np.testing.assert_allclose(predicted[105:], fit.predict(record.slice(105)), rtol=1e-9)


def test_unknown_initial_states_are_found(rng: np.random.Generator) -> None:
    """A row of NaN among given states is found by MAP, as if asked for."""
    fit, u = known(rng), rng.standard_normal((200, 2))
    record = Record(run(fit, u, X0), u, dt=DT)
    record.outputs[80:90] = np.nan
    states = np.array([X0, [np.nan] * 3])
    mixed, by_map = fit.predict(record, states), fit.predict(record)
    np.testing.assert_array_equal(mixed[90:], by_map[90:])
    np.testing.assert_allclose(mixed[:80], record.outputs[:80], atol=1e-10)
    for wrong in (X0, np.array([X0]), np.zeros((2, 4))):
        with pytest.raises(OptionError, match="3 states for each of the 2 pieces"):
            fit.predict(record, wrong)
    with pytest.raises(OptionError, match="initial must be one of"):
        fit.predict(record, "carried")  # type: ignore[arg-type]


# -- what fits to what


def test_records_of_another_kind_are_refused(rng: np.random.Generator) -> None:
    """Counts, order of channels and rate are compared; other names are allowed."""
    fit = known(rng)
    y, u = rng.standard_normal((50, 3)), rng.standard_normal((50, 2))
    fit.check_channels(Record(y, u, dt=DT, output_channels=["a", "b", "c"]))
    with pytest.raises(OptionError, match="2 inputs and 3 outputs; the record has 2 and 2"):
        fit.check_channels(Record(y[:, :2], u, dt=DT))
    with pytest.raises(OptionError, match=r"interval is 0.1 s, the record's 0.2 s; decimate"):
        fit.check_channels(Record(y, u, dt=2 * DT))
    with pytest.raises(OptionError, match=r"u1, u2, y1, y2, y3; the record has .*y3, y1.*select"):
        fit.check_channels(Record(y, u, dt=DT).select(["y3", "y1", "y2"]))


def test_channels_are_inputs_then_outputs(rng: np.random.Generator) -> None:
    """As in the joint signal z = [u; y]."""
    assert [channel.name for channel in known(rng).channels] == ["u1", "u2", "y1", "y2", "y3"]


def test_feedthrough_follows_the_quantity() -> None:
    """Displacements and velocities have no D; a mask may say otherwise, output by output."""
    quantities = ("displacement", "velocity", "acceleration", "other", "force")
    channels = [Channel(q, q) for q in quantities]
    assert feedthrough_mask(None, channels).tolist() == [False, False, True, True, True]
    assert feedthrough_mask(True, channels).all()
    assert not feedthrough_mask(False, channels).any()
    assert feedthrough_mask([True, False] * 2 + [True], channels).tolist()[:2] == [True, False]
    for wrong in ([True, False], 1, "yes", [0, 1, 0, 1, 0]):
        with pytest.raises(OptionError, match="feedthrough must be True, False, or 5 of these"):
            feedthrough_mask(wrong, channels)  # type: ignore[arg-type]


def test_diagnostics_join_without_change() -> None:
    """Figures and findings are added to a new value; a finding reads as sentence and cure."""
    finding = Finding("code", "doubt", "It drifts.", "Detrend it.")
    first = Diagnostics({"a": 1})
    both = first.joined({"b": 2}, [finding])
    assert (dict(first.figures), first.findings) == ({"a": 1}, ())
    assert (dict(both.figures), both.findings) == ({"a": 1, "b": 2}, (finding,))
    assert str(finding) == "It drifts. Detrend it."
    assert str(Finding("code", "note", "Fine.")) == "Fine."
