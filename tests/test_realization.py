"""From responses and real records to models by the realization family, as a user would."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vibrid as vb
from vibrid.cli import main
from vibrid.excitation import white_noise
from vibrid.samples import timber_building
from vibrid.structures import Structure, chain

DT = 0.05
FRAME_HZ = (3.682, 11.121, 16.606)  # one N4SID run over the first half, not truth
BUILDING_HZ = (1.882, 2.421, 2.689)  # published


@pytest.fixture
def frame() -> Structure:
    return chain([1.0, 1.2, 1.4], [800.0, 700.0, 600.0], damping_ratio=0.01)


def noisy_responses(frame: Structure, rng: np.random.Generator) -> vb.ImpulseResponses:
    exact = frame.state_space(forces=frame.dofs).to_discrete(DT).markov_parameters(300)
    noise = 0.02 * exact.std() * rng.standard_normal(exact.shape)
    return vb.ImpulseResponses(exact + noise, dt=DT)


@pytest.mark.parametrize("method", [None, vb.ERADC()])
def test_automatic_order_of_noisy_impulse_responses(
    frame: Structure, method: Any, rng: np.random.Generator
) -> None:
    """Three modes in noisy responses: order 6, and the reasons say why."""
    fit = vb.identify(noisy_responses(frame, rng), method)
    assert fit.order == 6
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=2e-3)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=0.1)
    assert any("criterion" in reason for reason in fit.diagnostics.figures["choices"])
    assert (vb.quality_of(fit).amplitude_coherence > 0.9).all()


def test_fits_of_responses_survive_a_file_and_simulate(
    frame: Structure, rng: np.random.Generator, tmp_path: Path
) -> None:
    """A realization is saved with its method, simulates, and scores a record it never saw."""
    fit = vb.identify(noisy_responses(frame, rng), vb.ERA(rows=40, columns=60), order=6)
    again = vb.load(vb.save(fit, tmp_path / "plate.vibrid.h5"))
    assert again.method == fit.method and again.gram is None
    np.testing.assert_array_equal(again.model.A, fit.model.A)
    force = white_noise(600, 3, rng=rng)
    record = frame.simulate(force, DT, forces=frame.dofs)
    unlabelled = vb.Record(record.outputs, record.inputs, dt=DT)
    simulated = fit.simulate_record(unlabelled, "zero")
    assert np.linalg.norm(simulated - record.outputs) < 0.05 * np.linalg.norm(record.outputs)
    np.testing.assert_allclose(fit.simulate_record(unlabelled)[50:], record.outputs[50:], atol=0.2)


def test_okid_remembers_its_realization_in_a_file(
    frame: Structure, rng: np.random.Generator, tmp_path: Path
) -> None:
    """The realization inside OKID comes back as what it was."""
    force = white_noise(2000, 3, rng=rng)
    record = frame.simulate(force, DT, forces=frame.dofs, noise=0.02, rng=rng)
    method = vb.OKID(observer_order=12, realization=vb.ERADC(rows=30, columns=40))
    fit = vb.identify(record, method, order=6)
    assert vb.load(vb.save(fit, tmp_path / "run.vibrid.h5")).method == fit.method
    assert fit.method.realization == vb.ERADC(rows=30, columns=40)


def test_frequency_responses_of_a_record_realize_it(
    frame: Structure, rng: np.random.Generator
) -> None:
    """Record to H1 to impulse responses to ERA: the analyser's way to the modes."""
    force = white_noise(60_000, rng=rng)
    record = frame.simulate(force, DT, forces=["f1"])
    responses = vb.frequency_responses(record, segment_seconds=200.0)
    modes = vb.modes_of(vb.identify(responses, order=6))
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=2e-3)


def test_ambient_record_by_correlations_and_era(frame: Structure, rng: np.random.Generator) -> None:
    """NExT: one decay a reference, from lag 1 on, and ERA takes them together."""
    force = white_noise(40_000, 3, rng=rng)
    ambient = frame.simulate(force, DT, forces=frame.dofs, noise=0.05, rng=rng).select(inputs=[])
    decays = vb.next_correlations(ambient, n_lags=200)
    fit = vb.identify(decays, vb.ERA(rows=60, responses="decay"), order=6)
    assert len(decays) == 3 and len(fit.initial_states) == 3
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=5e-3)
    straight = vb.modes_of(vb.identify(ambient, vb.ERA(), order=6))
    np.testing.assert_allclose(straight.frequencies_hz, frame.frequencies_hz, rtol=5e-3)


@pytest.mark.parametrize("method", [vb.ERA(), vb.ERADC()])
def test_timber_building_by_realization(method: Any) -> None:
    """The embedded ambient record has its published frequencies within 1 %."""
    modes = vb.modes_of(vb.identify(timber_building().to_band(0.5, 10.0), method))
    for published in BUILDING_HZ:
        assert np.abs(modes.frequencies_hz / published - 1).min() < 0.01


def test_a_forced_record_taken_for_a_decay_is_doubted(
    frame: Structure, rng: np.random.Generator
) -> None:
    """Ambient data forced to be a decay are misfitted, and a finding says so."""
    force = white_noise(4000, 3, rng=rng)
    ambient = frame.simulate(force, DT, forces=frame.dofs).select(inputs=[])
    fit = vb.identify(ambient, vb.ERA(responses="decay"), order=6, stability="project")
    said = [str(each) for each in fit.diagnostics.findings if each.code == "poor-simulation"]
    assert said and "As free decays" in said[0]


@pytest.mark.parametrize("method", ["okid", "era", "eradc"])
def test_three_storey_frame_on_the_command_line(
    method: str, shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The three modes of a real frame on a shake table come out within 2 %."""
    import json

    floors = "acc/1st Floor/x,acc/2nd Floor/x,acc/3rd Floor (Top floor)/x"
    path = str(shared_data / "three_story_frame.npz")
    named = ["--inputs", "acc/Ground Floor/x", "--outputs", floors]
    order = [] if method == "okid" else ["--order", "6"]
    assert main(["identify", path, "--method", method, *order, *named, "--json"]) == 0
    found = [mode["frequency_hz"] for mode in json.loads(capsys.readouterr().out)["modes"]]
    for expected in FRAME_HZ:
        assert np.abs(np.array(found) / expected - 1).min() < 0.02
