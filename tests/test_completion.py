"""Completion of a model: B, D, offsets and initial states by simulation or prediction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identification_cases import DT, shaker_test

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import impulse, white_noise
from vibrid.identification import complete
from vibrid.identification.modal_basis import modal_basis
from vibrid.structures import chain, shear_frame

# -- against explicit solutions


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


# -- simulation or prediction


def test_unseen_halves_choose_the_form(rng: np.random.Generator) -> None:
    """With sensor noise only, completion by simulation wins, and says by how much."""
    _, record = shaker_test(rng, noise=0.1)
    fit = vb.identify(record, order=8)
    assert fit.diagnostics.figures["completion"] == "simulation"
    assert "unseen halves" in fit.diagnostics.figures["completion_reason"]


def test_a_quiet_half_does_not_judge_the_other(rng: np.random.Generator) -> None:
    """A record that dies out is completed by simulation: its end cannot judge its beginning."""
    frame = shear_frame(2, 100.0, 2e5, damping_ratio=0.02)
    force = white_noise(4000, rng=rng, std=100.0) * (np.arange(4000) < 1500)[:, None]
    record = frame.simulate(force, DT, forces=["f1"], noise=0.02, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=20), order=4)
    assert fit.diagnostics.figures["completion"] == "simulation"
    assert "hardly moves" in fit.diagnostics.figures["completion_reason"]


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


# -- offsets and feedthrough


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
