"""Refinement in innovations form: steps, slopes and deviations against explicit Jacobians."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from refining_cases import DT, bench, flat, sensed, shaken, started

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import white_noise
from vibrid.identification.refining import refine
from vibrid.kalman import spectral_radius
from vibrid.record import Floats
from vibrid.refinement import innovations
from vibrid.refinement.place import starts_of
from vibrid.refinement.result import fit_of
from vibrid.statespace import StateSpace
from vibrid.varpro.marquardt import _System


def with_flat(fit: vb.Fit, values: Floats) -> vb.Fit:
    """Return the fit with other A, B, C, D, K, initial states and offset."""
    model, parts, at = fit.model, [], 0
    shapes = [each.shape for each in (model.A, model.B, model.C, model.D, fit.kalman_gain)]
    for shape in (*shapes, fit.initial_states.shape, fit.output_offset.shape):
        size = int(np.prod(shape))
        parts.append(values[at : at + size].reshape(shape))
        at += size
    A, B, C, D, K, x0, offset = parts
    return replace(
        fit,
        model=StateSpace(A, B, C, D, model.dt),
        kalman_gain=K,
        initial_states=x0,
        output_offset=offset,
    )


def errors(fit: vb.Fit, record: vb.Record) -> Floats:
    """Return the one-step prediction errors."""
    return np.asarray(record.outputs - fit.predict(record, fit.initial_states))


def slopes(fit: vb.Fit, of: Callable[[vb.Fit], Floats]) -> Floats:
    """Return the explicit Jacobian (n_values, n_parameters) by central differences."""
    values, columns = flat(fit), []
    for k in range(len(values)):
        step = 1e-6 * max(abs(values[k]), 1e-2 * np.abs(values).mean())
        ends = []
        for sign in (-1, 1):
            moved = values.copy()
            moved[k] += sign * step
            ends.append(of(with_flat(fit, moved)))
        columns.append((ends[1] - ends[0]) / (2 * step))
    return np.array(columns).T


def explicit(fit: vb.Fit, record: vb.Record) -> tuple[Floats, Floats, Floats]:
    """Return H, gradient and inverse of H over all parameters, from the explicit Jacobian."""
    e = errors(fit, record)
    whiten = np.linalg.cholesky(np.linalg.inv(e.T @ e / len(e)))
    J = slopes(fit, lambda each: (errors(each, record) @ whiten).ravel())
    size = np.linalg.norm(J, axis=0)
    unit = (J / size).T @ (J / size)
    values, vectors = np.linalg.eigh(unit)
    kept = values > 1e-8
    inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / size / size[:, None]
    return J.T @ J, J.T @ (e @ whiten).ravel(), inverse


def place_of(fit: vb.Fit, record: vb.Record) -> innovations.Prediction:
    """Return the fit as a point of the search."""
    stream = open_stream(record)
    return innovations._start_of(fit, stream, starts_of(fit, stream, predicts=True))


# -- against the full parametrization


@pytest.mark.parametrize("inputs", [1, 0])
def test_steps_are_those_of_the_full_parametrization(rng: np.random.Generator, inputs: int) -> None:
    """A full step promises what Gauss-Newton over (A, B, C, D, K, x0, offset) promises."""
    record = shaken(rng, inputs=inputs)
    place = place_of(started(record), record)
    # the same place in explicit form: C, D and offset are those that fit best
    fit = fit_of(started(record), place, {})
    _, gradient, inverse = explicit(fit, record)
    promised = _System(place).step(0.0)[1]
    assert promised == pytest.approx(gradient @ inverse @ gradient, rel=1e-4)
    e = errors(fit, record)
    S = e.T @ e / len(e) / np.outer(*[place.stream.output_scale] * 2)
    assert place.cost == pytest.approx(len(e) * np.linalg.slogdet(S)[1], rel=1e-9)


def test_gradient_is_the_slope_of_the_likelihood(rng: np.random.Generator) -> None:
    """Central differences of N ln det S along random steps."""
    record = shaken(rng, 300)
    place = place_of(started(record), record)
    for _ in range(3):
        step = (
            1e-5
            * rng.standard_normal(len(place.gradient))
            / np.sqrt(np.maximum(np.diag(place.information), 1e-300))
        )
        step[np.diag(place.information) == 0] = 0
        slope = (place.moved(step).cost - place.moved(-step).cost) / 4
        assert place.gradient @ step == pytest.approx(slope, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("noise", ["innovations", "output_error"])
def test_deviations_are_those_of_the_full_information(rng: np.random.Generator, noise: str) -> None:
    """Frequencies, damping and shapes from the inverse information over all parameters."""
    mixed = [("displacement", "f1"), ("acceleration", "f2")]
    record = shaken(rng) if noise == "innovations" else sensed(rng, sensors=mixed)
    fit = refine(started(record), record, noise=noise)
    e = errors(fit, record)
    if noise == "output_error":  # errors independent between outputs, gain known to be none
        fit = replace(fit, innovation_covariance=np.diag(np.diag(fit.innovation_covariance)))
    inverse = _inverse(fit, record, e, free_gain=noise == "innovations")

    def quantities(each: vb.Fit) -> Floats:
        modes = vb.modes_of(each)
        shapes = modes.shapes.T.ravel()
        return np.concatenate(
            [modes.frequencies_hz, modes.damping_ratios, shapes.real, shapes.imag]
        )

    J = slopes(fit, quantities)
    std = np.sqrt(np.maximum(np.einsum("qi,ij,qj->q", J, inverse, J), 0))
    figures, n = fit.diagnostics.figures, 2
    np.testing.assert_allclose(figures["frequencies_std"], std[:n], rtol=0.05)
    np.testing.assert_allclose(figures["damping_std"], std[n : 2 * n], rtol=0.05)
    shapes = np.hypot(*std[2 * n :].reshape(2, n, -1)).T
    np.testing.assert_allclose(figures["shapes_std"], shapes, rtol=0.05, atol=1e-9)
    assert fit.parameter_covariance is not None
    assert fit.parameter_covariance.shape == (4, 4)


def _inverse(fit: vb.Fit, record: vb.Record, e: Floats, *, free_gain: bool) -> Floats:
    weights = np.linalg.cholesky(np.linalg.inv(fit.innovation_covariance))
    J = slopes(fit, lambda each: (errors(each, record) @ weights).ravel())
    n, m, p = fit.order, record.n_inputs, record.n_outputs
    gain = n * n + n * m + p * n + p * m + np.arange(n * p)
    if not free_gain:
        J[:, gain] = 0
    direct = n * n + n * m + p * n + np.arange(p * m).reshape(p, m)
    J[:, direct[~fit.feedthrough].ravel()] = 0
    size = np.linalg.norm(J, axis=0)
    size[size == 0] = np.inf
    values, vectors = np.linalg.eigh((J / size).T @ (J / size))
    kept = values > 1e-8
    return np.asarray((vectors[:, kept] / values[kept]) @ vectors[:, kept].T / size / size[:, None])


# -- refined models


@pytest.mark.parametrize("inputs", [1, 0])
def test_predictions_improve(rng: np.random.Generator, inputs: int) -> None:
    """From a spoiled start: lower ln det, as predicted anew; model and predictor are stable."""
    record = shaken(rng, 3000, inputs=inputs)
    start = started(record)
    spoiled = replace(start, kalman_gain=0.7 * start.kalman_gain)
    fit = refine(spoiled, record, noise="innovations")
    figures = fit.diagnostics.figures
    assert figures["converged"]
    assert figures["cost"] < figures["start_cost"]
    e = errors(fit, record)
    S = e.T @ e / len(e) / np.outer(record.outputs.std(axis=0), record.outputs.std(axis=0))
    assert figures["cost"] == pytest.approx(np.linalg.slogdet(S)[1], abs=1e-6)
    np.testing.assert_allclose(fit.innovation_covariance, e.T @ e / len(e), rtol=0.01)
    assert fit.model.is_stable
    assert spectral_radius(fit.predictor().A) < 1
    np.testing.assert_allclose(vb.modes_of(fit).frequencies_hz, bench().frequencies_hz, rtol=0.01)


def test_pieces_with_offsets_of_their_own(rng: np.random.Generator) -> None:
    """Two records with gaps and other offsets give the model of the records without."""
    records, plain = [], []
    for k in range(2):
        record = shaken(rng, 1500)
        y = np.array(record.outputs)
        y[700:705] = np.nan
        plain.append(replace_outputs(record, y))
        records.append(replace_outputs(record, y + np.array([3.0 * (k + 1), -2.0])))
    fit, same = (refine(started(each), each, noise="innovations") for each in (records, plain))
    np.testing.assert_allclose(
        vb.modes_of(fit).damping_ratios, vb.modes_of(same).damping_ratios, rtol=1e-3
    )
    first, other = (each.diagnostics.figures["record_offsets"] for each in (fit, same))
    np.testing.assert_allclose(first - other, [[3, -2], [6, -2]], atol=1e-4)
    assert fit.initial_states.shape == (4, 4)


def replace_outputs(record: vb.Record, outputs: Floats) -> vb.Record:
    """Return the record with other outputs."""
    return vb.Record(
        outputs,
        record.inputs,
        dt=record.dt,
        output_channels=record.output_channels,
        input_channels=record.input_channels,
    )


def test_exact_data_need_no_gain(rng: np.random.Generator) -> None:
    """Without noise the innovations form keeps the exact model."""
    record = bench().simulate(white_noise(600, rng=rng), DT, forces=["f1"])
    fit = refine(started(record), record, noise="innovations")
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, 0.01, rtol=1e-6)


def test_displacements_have_no_feedthrough(rng: np.random.Generator) -> None:
    """Rows of D that the fit holds at zero stay zero, some or all of them."""
    force = white_noise(1500, 2, rng=rng)
    for sensors in (
        [("displacement", "f1"), ("acceleration", "f2")],
        [("displacement", "f1"), ("displacement", "f2")],
    ):
        record = bench().simulate(
            force, DT, sensors=sensors, forces=["f1", "f2"], noise=0.02, rng=rng
        )
        record = record.select(inputs=[record.input_names[0]])
        fit = refine(started(record), record, noise="innovations")
        assert fit.diagnostics.figures["cost"] <= fit.diagnostics.figures["start_cost"]
        assert not fit.model.D[~fit.feedthrough].any()
