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


@pytest.mark.parametrize("kept", [slice(0, 256), slice(0, 220), slice(5, None), slice(1, 225)])
def test_lines_that_end_before_nyquist_show_no_false_rank(frame: Structure, kept: slice) -> None:
    """What a cut band rings has a numerical rank but is no structure: three modes are found."""
    lines = (np.arange(257) / (512 * DT))[kept]
    model = frame.state_space(forces=frame.dofs).to_discrete(DT)
    fit = vb.identify(vb.FrequencyResponses(model.frequency_response(lines), lines))
    assert fit.model.spectral_radius < 1
    modes = vb.modes_of(fit)
    for frequency, ratio in zip(frame.frequencies_hz, frame.damping_ratios, strict=True):
        k = int(np.abs(modes.frequencies_hz - frequency).argmin())
        assert modes.frequencies_hz[k] == pytest.approx(frequency, rel=1e-3)
        assert modes.damping_ratios[k] == pytest.approx(ratio, rel=0.1)


def test_two_masses_of_known_modal_mass(rng: np.random.Generator) -> None:
    """Cara's example: 10.72016 and 20.85853 rad/s, modal masses 23.8335 and 47.667."""
    stiffness = np.array([8750.0, 3500.0])  # 12250 less what joins both masses, and that
    two = chain([35.0, 17.5], stiffness, damping_ratio=0.02)
    force = white_noise(3000, rng=rng)
    labels = {
        "output_channels": [vb.Channel(f"a{k}", "acceleration") for k in (1, 2)],
        "input_channels": [vb.Channel("f1", "force")],
    }
    record = two.simulate(force, 0.02, forces=["f1"])
    pulses = two.state_space(forces=["f1"]).to_discrete(0.02).markov_parameters(400)
    for data, method in (
        (vb.Record(record.outputs, force, dt=0.02, **labels), vb.OKID()),
        (vb.ImpulseResponses(pulses, dt=0.02, **labels), vb.ERA()),
    ):
        modes = vb.modes_of(vb.identify(data, method))
        np.testing.assert_allclose(np.abs(modes.poles), [10.72016, 20.85853], rtol=1e-6)
        mass = modes.shapes[0] / (2j * modes.poles.imag * modes.participation[:, 0])
        np.testing.assert_allclose(mass, [23.8335, 47.667], rtol=1e-5)


@pytest.mark.parametrize("size", [1e-200, 1e-120, 1e120, 1e200])
def test_any_unit_of_responses(frame: Structure, size: float, rng: np.random.Generator) -> None:
    """Squares of the responses would leave the range of numbers; order and poles stay."""
    data = noisy_responses(frame, rng)
    fit = vb.identify(data, order=6)
    scaled = vb.identify(vb.ImpulseResponses(size * data.values, dt=DT))
    assert scaled.order == 6
    same = np.sort_complex(fit.model.poles)
    np.testing.assert_allclose(np.sort_complex(scaled.model.poles), same, rtol=1e-9)


def test_correlations_of_few_columns_have_no_rank(
    frame: Structure, rng: np.random.Generator
) -> None:
    """Stacked correlations have the rank of the responses' columns, which says nothing."""
    decomposition = vb.ERADC(rows=20, columns=10, lag=2).decompose(noisy_responses(frame, rng))
    assert not decomposition.rank_limited
    assert decomposition.largest_order == 30
    assert vb.identify(noisy_responses(frame, rng), decomposition.method, order=30).order == 30


def test_options_that_do_not_belong_are_refused(frame: Structure, rng: np.random.Generator) -> None:
    """What would be ignored is an error; each says where the option belongs."""
    data = noisy_responses(frame, rng)
    ambient = frame.simulate(white_noise(2000, rng=rng), DT, forces=["f1"])
    alone = ambient.select(inputs=[])
    with pytest.raises(vb.OptionError, match="ImpulseResponses are taken as they are"):
        vb.identify(data, vb.ERA(responses="decay"))
    with pytest.raises(vb.OptionError, match='with responses="decay" there are none'):
        vb.ERADC(references=("y1",), responses="decay")
    with pytest.raises(vb.OptionError, match="record has 1 inputs"):
        vb.identify(ambient, vb.ERA(references=alone.output_names[:1]))
    with pytest.raises(vb.OptionError, match="inside OKID it has the observer's responses"):
        vb.OKID(realization=vb.ERA(references=("y1",)))
    for twice in ((), alone.output_names[:1] * 2):
        with pytest.raises(vb.OptionError, match="each reference once"):
            vb.identify(alone, vb.ERA(references=twice))


def test_errors_speak_of_the_options_there_are(frame: Structure, rng: np.random.Generator) -> None:
    """Unstable models and short records name rows and columns, or the observer order."""
    growing = chain([1.0, 1.2], [800.0, 700.0], rayleigh=(-1.0, 0.0))
    record = growing.simulate(white_noise(400, rng=rng), DT, forces=["f1"])
    with pytest.raises(vb.UnstableModelError, match="use other observer_order, or"):
        vb.identify(record, vb.OKID())
    pulses = growing.state_space(forces=["f1"]).to_discrete(DT).markov_parameters(100)
    with pytest.raises(vb.UnstableModelError, match="use other rows and columns, or"):
        vb.identify(vb.ImpulseResponses(pulses, dt=DT))
    still = frame.simulate(None, DT, initial_state=0.1 * rng.standard_normal(6), n_samples=12)
    with pytest.raises(vb.DataError, match=r"rows=2 and columns=2.*responses=\"decay\" takes it"):
        vb.identify(still, vb.ERA())
    with pytest.raises(vb.DataError, match="rows=300 and columns=300 need responses of 601 lags"):
        vb.identify(record, vb.ERA(rows=300, columns=300))


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
    assert main(["identify", path, "--method", method, *named, "--json"]) == 0
    found = [mode["frequency_hz"] for mode in json.loads(capsys.readouterr().out)["modes"]]
    for expected in FRAME_HZ:
        assert np.abs(np.array(found) / expected - 1).min() < 0.02
