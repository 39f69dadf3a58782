"""What is printed of a blind identification, and what goes into JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from studies.blind_records import REFERENCE, off, reference, under_noise, uniform_chain
from vibrid.blind import BlindFit, identify_blind
from vibrid.cli import main
from vibrid.cli.work import STEPS
from vibrid.excitation import white_noise
from vibrid.reporting.blind import blind_as_json, describe_blind


def printed(fit: BlindFit) -> str:
    console = Console(width=100, record=True, force_terminal=False, quiet=False, file=None)
    with console.capture() as capture:
        console.print(describe_blind(fit))
    return capture.get()


def test_an_answer_is_printed_whole() -> None:
    """Matrices, modes, frequencies of the force and its level."""
    text = printed(identify_blind(reference(0, 60).record, 3, mass=[2.0, 1.5, 1.0]))
    for word in (
        "M⁻¹K",
        "M⁻¹D",
        "K",
        "Modes",
        "frequencies 0.7, 1.9, 3.3",
        "force f, RMS",
        "periodic forces",
    ):
        assert word in text
    assert "nan" not in text


def test_a_refusal_names_its_rule(rng: np.random.Generator) -> None:
    """No matrix, but the rule, its figures and the cure."""
    case = under_noise(uniform_chain(3), [0, 1, 2], duration=20.0, snr_db=50, rng=rng)
    text = printed(identify_blind(case.record, 3, excitation="point"))
    assert "refused, in_band" in text and "M⁻¹K [" not in text


def test_an_assumption_is_printed(rng: np.random.Generator) -> None:
    """Ambient vibration is the user's word, and the answer repeats it."""
    structure = uniform_chain(2)
    force = white_noise(6000, 2, rng=rng)
    record = structure.simulate(force, 0.05, forces=structure.dofs, noise=0.01, rng=rng)
    text = printed(identify_blind(record.select(inputs=[]), 2, excitation="ambient"))
    assert "assumed: broadband forces act on every degree of freedom" in text


def test_rows_that_are_not_known_are_dashes(rng: np.random.Generator) -> None:
    """A partial answer keeps its rows, prints – for the others and says what is missing."""
    case = under_noise(uniform_chain(3), [2], duration=30.0, snr_db=50, rng=rng)
    text = printed(identify_blind(case.record, 3, excitation="point"))
    for word in ("–", "missing: the rows of f3", "forces act at f3"):
        assert word in text


def test_json_holds_plain_values() -> None:
    """The dictionary is JSON, with the verdict and its figures."""
    facts = json.loads(json.dumps(blind_as_json(identify_blind(reference(0, 60).record, 3))))
    assert facts["verdict"]["accepted"] is True
    assert np.shape(facts["normalized_stiffness"]) == (3, 3)
    assert len(facts["input_frequencies_hz"]) == 5


def written(path: Path, outputs: np.ndarray, dt: float) -> Path:
    """Return a CSV file of accelerations a1, a2, …"""
    names = [f"a{k + 1} [m/s2]" for k in range(outputs.shape[1])]
    columns = np.column_stack([dt * np.arange(len(outputs)), outputs])
    header = ",".join(["time [s]", *names])
    np.savetxt(path, columns, delimiter=",", header=header, comments="")
    return path


def run_json(capsys: pytest.CaptureFixture[str], status: int, *arguments: object) -> dict[str, Any]:
    """Run `vibrid blind` with --json, check its exit status and return what it printed."""
    assert main(["blind", *map(str, arguments), "--json"]) == status
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def test_command_with_masses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file under periodic forces, with masses: stiffness in N/m, frequencies of the force."""
    file = written(tmp_path / "run.csv", reference(0, 60).record.outputs[:], 0.02)
    found = run_json(capsys, 0, file, "--dofs", 3, "--mass", "2,1.5,1")
    assert off(np.array(found["stiffness"]), REFERENCE.stiffness) < 2e-3
    force = np.array(found["force_rms"]) / found["normalized_force_rms"]
    np.testing.assert_allclose(force, [2.0, 1.5, 1.0])
    np.testing.assert_allclose(found["input_frequencies_hz"], [0.7, 1.9, 3.3, 5.1, 6.4], rtol=1e-3)


def test_command_with_a_mass_matrix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Nine numbers for three DOFs are the matrix, row by row."""
    file = written(tmp_path / "run.csv", reference(0, 60).record.outputs[:], 0.02)
    found = run_json(capsys, 0, file, "--dofs", 3, "--mass", "2,0,0,0,1.5,0,0,0,1")
    assert found["mass"] == [[2, 0, 0], [0, 1.5, 0], [0, 0, 1]]


def test_progress_is_told_on_every_way(rng: np.random.Generator) -> None:
    """Each excitation says what it does while it runs, in words that the command line knows."""
    case = under_noise(uniform_chain(3), [2], duration=20.0, snr_db=50, rng=rng)
    for options in (
        {"excitation": "point"},
        {"excitation": "ambient"},
        {"excitation": "decay"},
        {"method": "subspace"},
    ):
        heard: list[str] = []
        identify_blind(case.record, 3, progress=lambda what, *_, h=heard: h.append(what), **options)
        assert heard and set(heard) <= set(STEPS)


def test_command_exits_1_when_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rng: np.random.Generator
) -> None:
    """The rule, no matrix, and status 1 that a script sees."""
    case = under_noise(uniform_chain(3), [0, 1, 2], duration=20.0, snr_db=50, rng=rng)
    file = written(tmp_path / "run.csv", case.record.outputs[:], case.record.dt)
    found = run_json(capsys, 1, file, "--dofs", 3, "--excitation", "point")
    assert found["verdict"]["accepted"] is False
    assert "in_band" in json.dumps(found["verdict"]["refusals"])
    assert main(["blind", str(file), "--dofs", "3", "--excitation", "point"]) == 1
    assert "refused, in_band" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--dofs", "2"], "the record has 3 outputs"),
        (["--dofs", "3", "--force-band", "1"], "must be two numbers"),
        (["--dofs", "3", "--save", "run.vibrid.h5"], "--save is for models"),
    ],
)
def test_command_with_wrong_options(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Status 2 and a message that names the numbers."""
    file = written(tmp_path / "run.csv", reference(0, 60).record.outputs[:], 0.02)
    assert main(["blind", str(file), *arguments]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


def test_command_on_a_real_frame_without_its_base(
    shared_data: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Storeys above the first come out, the ground storey does not; the channel stays hidden."""
    floors = ["1st Floor", "2nd Floor", "3rd Floor (Top floor)"]
    names = ",".join(f"acc/{floor}/x" for floor in floors)
    file = shared_data / "three_story_frame.npz"
    found = run_json(capsys, 0, file, "--outputs", names, "--dofs", 3, "--excitation", "base")
    known = np.array(found["normalized_stiffness"], dtype=float)
    assert np.isnan(known[0]).all() and np.isfinite(known[1:]).all()
    assert found["verdict"]["kind"] == "base"
