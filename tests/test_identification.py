"""identify(): stability, refusals, real records, scores, and doubts about the data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identification_cases import DT, shaker_test

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.identification import assess, assess_unseen
from vibrid.samples import timber_building
from vibrid.scores import fit_percent, relative_error
from vibrid.structures import chain, shear_frame

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


# -- scores


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


# -- doubts about the data


def test_disagreeing_damping_is_said(rng: np.random.Generator) -> None:
    """A horizon far shorter than the memory of a lightly damped mode gives a doubt."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.002)
    force = white_noise(3000, rng=rng, std=100.0)
    record = frame.simulate(force, DT, forces=["f1"], noise=0.3, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=5), order=8)
    codes = [finding.code for finding in fit.diagnostics.findings]
    assert "damping-doubt" in codes


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
