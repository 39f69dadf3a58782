"""OKID of noisy records: damping, gain, whitening, orders, outputs that precede inputs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from okid_cases import DT, noisy_test, structure

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.kalman import riccati_gain
from vibrid.methods.era import ERADC
from vibrid.methods.okid import OKID
from vibrid.methods.okid.causal import causal_responses
from vibrid.record import Floats
from vibrid.scores import fit_percent

# -- damping


def damping_bias(method: OKID, records: list[vb.Record]) -> float:
    """Return the median relative error of the first mode's damping ratio."""
    frame, found = structure(5), []
    for record in records:
        model = method.realize(method.decompose(record), 10).model
        nearest = np.argmin(np.abs(model.frequencies_hz - frame.frequencies_hz[0]))
        found.append(model.damping_ratios[nearest] / frame.damping_ratios[0] - 1)
    return float(np.median(found))


def test_the_automatic_order_is_long_enough_for_damping(rng: np.random.Generator) -> None:
    """Damping comes out within 8 %, where the bound observer_order · outputs ≥ order fails."""
    records = [noisy_test(rng) for _ in range(12)]
    chosen = OKID().decompose(records[0])
    assert 16 <= chosen.method.observer_order <= 40
    assert "the order of the lowest information criterion" in chosen.reasons[0]
    assert abs(damping_bias(OKID(), records)) < 0.08  # measured 1 to 2 %
    assert damping_bias(OKID(observer_order=5), records) > 1  # measured 6
    short = OKID(observer_order=5).decompose(records[0])
    assert [finding.code for finding in short.remarks] == ["short-observer"]


def test_whitening_lets_a_short_observer_do(rng: np.random.Generator) -> None:
    """Five iterations take most of the bias away that 5 past samples leave."""
    records = [noisy_test(rng) for _ in range(12)]
    short = OKID(observer_order=5)
    white = damping_bias(replace(short, whitening=5), records)
    assert abs(white) < 0.15 * damping_bias(short, records)  # measured .04


def test_light_damping(rng: np.random.Generator) -> None:
    """Damping ratios of .3 % come out within 20 % of each, sampled 80 times a period."""
    frame = structure(3, 0.003)
    record = frame.simulate(
        white_noise(20_000, 1, rng=rng), 0.02, forces=frame.dofs[:1], noise=0.02, rng=rng
    )
    method = OKID()
    model = method.realize(method.decompose(record), 6).model
    np.testing.assert_allclose(model.frequencies_hz, frame.frequencies_hz, rtol=2e-3)
    np.testing.assert_allclose(model.damping_ratios, frame.damping_ratios, rtol=0.2)


@pytest.mark.slow
def test_damping_over_seeds() -> None:
    """Automatic observer orders, 60 tests of 5 DOF: small bias, spread as of long observers."""
    frame, errors = structure(5), []
    for seed in range(60):
        record = noisy_test(np.random.default_rng(seed))
        method = OKID()
        model = method.realize(method.decompose(record), 10).model
        nearest = np.abs(model.frequencies_hz[:, None] - frame.frequencies_hz).argmin(axis=0)
        errors.append(model.damping_ratios[nearest] / frame.damping_ratios - 1)
    # means .03 at most, and .18 .11 .07 .07 .06 for the spread of modes 1 to 5
    spread = np.std(errors, axis=0)
    error = spread / np.sqrt(len(errors))
    assert (np.abs(np.mean(errors, axis=0)) < np.maximum(4 * error, 0.02)).all()
    assert (np.abs(np.mean(errors, axis=0)) < 0.06).all()
    assert (spread < [0.25, 0.15, 0.1, 0.1, 0.08]).all()


# -- gain, order, units


def test_the_gain_predicts_as_well_as_the_true_one(rng: np.random.Generator) -> None:
    """One-step errors are within 3 % of the Kalman filter's; with L for K they are not."""
    frame, record = structure(5), noisy_test(rng, 20_000)
    method = OKID(observer_order=40)
    fit = method.realize(method.decompose(record), 10)
    full = frame.state_space(forces=frame.dofs).to_discrete(DT)
    C, D = full.C[[0, 2, 4]], full.D[[0, 2, 4]]
    noise = 0.3**2 * np.eye(5)
    # simulate() adds noise relative to each output; its variance is read off what is left
    measured = np.diag(0.05**2 / (1 + 0.05**2) * record.outputs.var(axis=0))
    best = riccati_gain(
        full.A, C, full.B @ noise @ full.B.T, D @ noise @ D.T + measured, full.B @ noise @ D.T
    )
    assert best is not None

    def error(gain: Floats) -> float:
        left = record.outputs - replace(fit, kalman_gain=gain).predict(record, "zero")
        return float(np.trace(np.cov(left[200:].T)))

    assert error(fit.kalman_gain) < 1.03 * np.trace(best[1])
    assert error(0 * fit.kalman_gain) > 1.03 * error(fit.kalman_gain)
    np.testing.assert_allclose(
        np.trace(fit.innovation_covariance), error(fit.kalman_gain), rtol=0.03
    )


def test_the_criterion_finds_the_order(rng: np.random.Generator) -> None:
    """The information criterion is lowest at the true order."""
    models = OKID(observer_order=30).decompose(noisy_test(rng, 20_000))
    values = [models.criterion(order)[0] for order in range(1, 21)]
    assert int(np.argmin(values)) + 1 == 10


def test_the_frame_on_the_shake_table(shared_data: Path) -> None:
    """Where noise is not white the order stays short, and three modes come out within 2 %."""
    acceleration = np.load(shared_data / "three_story_frame.npz")["acc"][:, :, 0]
    half = len(acceleration) // 2
    record = vb.Record(acceleration[:half, 1:], acceleration[:half, :1], dt=1 / 120)
    models = OKID().decompose(record)
    assert models.method.observer_order < 40
    assert "Akaike's falls on to the longest tried, 200" in models.reasons[0]
    model = models.method.realize(models, 6).model
    np.testing.assert_allclose(model.frequencies_hz, [3.682, 11.121, 16.606], rtol=0.02)
    np.testing.assert_allclose(100 * model.damping_ratios, [1.41, 0.93, 0.38], rtol=0.2)


def test_units_do_not_matter(rng: np.random.Generator) -> None:
    """Outputs and inputs in units that no power of two relates give the same poles."""
    record = noisy_test(rng)
    scaled = vb.Record(record.outputs * [1.42, 1.9e3, 0.71e-4], record.inputs * [3e4, 0.13], dt=DT)
    for method in (OKID(observer_order=12), OKID(observer_order=12, realization=ERADC())):
        first, second = (
            np.sort_complex(method.realize(method.decompose(each), 10).model.poles)
            for each in (record, scaled)
        )
        np.testing.assert_allclose(second, first, rtol=1e-8)


# -- outputs that precede their inputs


def test_the_causal_part_equals_partial_fractions() -> None:
    """(1 + 2.9 x) / ((1 − .5 x)(1 + 3 x)), x one lag: the pole at −3 answers at negative lags."""
    observer = np.array([[[1.0, 0.0]], [[2.9, -2.5]], [[0.0, 1.5]]])
    found = causal_responses(observer, 60)
    assert found is not None
    kept, other = (1 + 2.9 * 2) / 7, (1 - 2.9 / 3) * 6 / 7
    expected = kept * 0.5 ** np.arange(60)
    np.testing.assert_allclose(found.joint[:, 0, 0], expected, atol=1e-12)
    earlier = other**2 / 8
    np.testing.assert_allclose(found.left_out, earlier / (earlier + kept**2 / 3), rtol=1e-9)


@pytest.mark.parametrize("whitening", [0, 2])
def test_forces_measured_late_do_not_spoil_the_modes(
    whitening: int, rng: np.random.Generator
) -> None:
    """A force channel that lags by most of a sample: modes within 1 %, the lead reported."""
    frame = structure(3)
    force = white_noise(6000, 1, rng=rng)
    record = frame.simulate(force, DT, forces=frame.dofs[:1], noise=0.02, rng=rng)
    late = 0.5 * force[1:] + force[:-1]  # its inverse has a pole at −2
    method = OKID(observer_order=20, whitening=whitening)
    models = method.decompose(vb.Record(record.outputs[1:], late, dt=DT))
    codes = [finding.code for finding in models.findings]
    assert "outputs-precede-inputs" in codes
    model = method.realize(models, 6).model
    np.testing.assert_allclose(model.frequencies_hz, frame.frequencies_hz, rtol=3e-3)
    np.testing.assert_allclose(model.damping_ratios, frame.damping_ratios, rtol=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("observer_order", [5, 10, 20, 40, None])
def test_subframe_order_20(observer_order: int | None, shared_data: Path) -> None:
    """28 accelerations that lead their forces: fit above that of FIR and ERA elsewhere (56.5)."""
    path = shared_data / "flexible_subframe.mat"
    record = vb.read_record(path, dt=1 / 1024, inputs=["1", "2"])
    fit = vb.identify(record, OKID(observer_order=observer_order), order=20)
    modelled = fit.simulate_record(record, "least_squares")
    assert fit_percent(record.outputs, modelled).mean() > 61  # measured 61.4 to 64.9
    assert fit_percent(record.outputs, fit.predict(record)).mean() > 62  # measured 64.6 to 67.7
    codes = [finding.code for finding in fit.diagnostics.findings]
    assert "outputs-precede-inputs" in codes
