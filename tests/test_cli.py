"""The command: results, JSON, options from the methods' fields, info and demo."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from cli_cases import FRAME, HEADER, run_json

from vibrid import FrequencyResponses, load
from vibrid.cli import main
from vibrid.cli.options import option_type
from vibrid.excitation import white_noise
from vibrid.methods import METHODS
from vibrid.structures import chain

pytestmark = pytest.mark.usefixtures("warnings_count")


# -- identify


def test_identify_json_holds_the_true_modes(
    csv_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file with an input gives the frame's modes, the choices and the fits as numbers."""
    found = run_json(capsys, "identify", csv_file, "--inputs", "hammer")
    assert [mode["steady"] for mode in found["modes"]] == [True, True]
    f = [mode["frequency_hz"] for mode in found["modes"]]
    np.testing.assert_allclose(f, FRAME.frequencies_hz, rtol=1e-3)
    assert found["choices"]["method"] == "n4sid" and found["choices"]["order"] == 4
    assert found["record"]["inputs"][0]["unit"] == "N"
    assert found["fit"]["unseen"]["kind"] == "simulation"
    assert min(found["fit"]["unseen"]["fit_percent"]) > 98
    assert found["modes"][0]["frequency_std_hz"] is None


def test_summary_is_readable_when_piped(
    csv_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Away from a terminal there are no colour codes, no long lines and no blanks at the ends."""
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["identify", str(csv_file), "--inputs", "hammer", "--order", "4"]) == 0
    said = capsys.readouterr()
    lines = said.out.splitlines()
    assert said.err == "" and "\x1b" not in said.out
    assert all(len(line) <= 80 and line == line.rstrip() for line in lines)
    for words in ("run.csv: 2000 samples at 20 Hz", "order=4 as asked for", "ζ [%]", "unseen"):
        assert words in said.out


def test_saved_model_is_the_printed_one(
    csv_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What --save writes has the modes that were printed."""
    target = tmp_path / "run.vibrid.h5"
    found = run_json(
        capsys, "identify", csv_file, "--inputs", "hammer", "--order", 4, "--save", target
    )
    assert found["saved"] == str(target)
    printed = [mode["frequency_hz"] for mode in found["modes"]]
    np.testing.assert_allclose(load(target).model.frequencies_hz, printed, rtol=1e-12)


def test_band_filters_and_counts_the_modes_outside(
    csv_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--band decimates the record and lists the modes inside only."""
    found = run_json(
        capsys, "identify", csv_file, "--outputs", "a1,a2", "--band", 0, 2.5, "--order", 6
    )
    assert found["band"]["used_hz"] == [0, 2.5] and found["band"]["dt"] == pytest.approx(0.15)
    assert found["choices"]["method"] == "ssi"
    assert all(mode["frequency_hz"] <= 2.5 for mode in found["modes"])
    apart = [abs(mode["frequency_hz"] / FRAME.frequencies_hz[0] - 1) for mode in found["modes"]]
    assert min(apart) < 0.02  # six standard deviations of 100 s of unmeasured force


def test_labels_and_method_options_reach_the_fit(
    csv_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Units, DOFs and options of the method arrive as given; several labels follow one flag."""
    found = run_json(
        capsys, "identify", "--unit", "a1=g", "a2=mm/s2", csv_file, "--dof", "a1=top,hammer=top",
        "--inputs", "hammer", "--weighting", "moesp", "--block-rows", 12, "--order", 4,
        "--no-feedthrough",
    )  # fmt: skip
    assert [each["unit"] for each in found["record"]["outputs"]] == ["g", "mm/s2"]
    assert found["record"]["inputs"][0]["dof"] == "top"
    assert found["choices"]["options"]["weighting"] == "moesp"
    assert found["choices"]["options"]["block_rows"] == 12


def test_references_split_at_commas(csv_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A method's option that takes names takes them with commas."""
    found = run_json(
        capsys, "identify", csv_file, "--outputs", "a1", "--outputs", "a2", "--references",
        "a2,a1", "--order", 4,
    )  # fmt: skip
    assert found["choices"]["options"]["references"] == ["a2", "a1"]


def test_a_record_on_disk_is_loaded_for_a_band(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Filters load what fits into memory and refuse what does not, in words for the command."""
    rng = np.random.default_rng(1)
    record = FRAME.simulate(white_noise(2000, rng=rng), 0.05, forces=["f2"], noise=0.01, rng=rng)
    path = tmp_path / "run.npy"
    np.save(path, np.hstack([record.inputs[:], record.outputs[:]]))
    monkeypatch.setattr("vibrid.files.reading.MEMORY_BYTES", 1000)
    arguments = ["identify", path, "--dt", "0.05", "--inputs", "1", "--band", 0, 5, "--order", 4]
    found = run_json(capsys, *arguments)
    assert found["modes"][0]["frequency_hz"] == pytest.approx(FRAME.frequencies_hz[0], rel=0.01)
    monkeypatch.setattr("vibrid.cli.options.LARGEST_LOADED", 1000)
    assert main([str(each) for each in arguments]) == 2
    assert "--band needs the record in memory" in capsys.readouterr().err


def test_names_with_commas_are_quoted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Double quotes keep the comma in a channel's name."""
    path = tmp_path / "run.csv"
    rows = np.random.default_rng(2).standard_normal((300, 2))
    np.savetxt(path, rows, delimiter=",", header='"hammer, left",a', comments="")
    arguments = ["--dt", 0.1, "--inputs", '"hammer, left"', "--unit", '"hammer, left=N"']
    found = run_json(capsys, "info", path, *arguments)
    assert [each["role"] for each in found["channels"]] == ["input", "output"]
    assert found["channels"][0]["unit"] == "N"


# -- options


def test_help_lists_every_field_of_every_method(capsys: pytest.CaptureFixture[str]) -> None:
    """No field of a method's dataclass is missing in the help."""
    assert main(["identify", "--help"]) == 0
    said = capsys.readouterr().out
    for kind in METHODS.values():
        for each in dataclasses.fields(kind):
            assert f"--{each.name.replace('_', '-')}" in said


def test_a_new_method_needs_no_change_of_the_command() -> None:
    """Fields of any method become options that are None until given."""

    @dataclass(frozen=True)
    class Other:
        window: float = field(default=0.5, metadata={"help": "length in seconds"})
        block_rows: int | None = None

    made = option_type({**METHODS, "other": Other})
    assert made().window is None
    helps = {each.name: str(each.type) for each in dataclasses.fields(made)}
    assert "[other] length in seconds (default 0.5)." in helps["window"]
    assert "[n4sid, ssi] future horizon" in helps["block_rows"]


# -- info


def test_info_says_what_a_file_holds(
    csv_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Length, rate, units, gaps and constant channels are named."""
    data = np.genfromtxt(csv_file, delimiter=",", skip_header=1)
    data[300:310, 2] = np.nan
    data[:, 3] = 7.0
    path = tmp_path / "worn.csv"
    np.savetxt(path, data, delimiter=",", header=HEADER, comments="")
    assert main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    for words in ("2000 samples at 20 Hz", "1 gap", "m/s2", "constant", "Nyquist"):
        assert words in said
    found = run_json(capsys, "info", path)
    assert found["n_gaps"] == 1 and found["channels"][2]["is_constant"]
    assert found["channels"][0]["unit"] == "N"


def test_frequency_responses_are_told_and_identified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file of an analyser's frequency responses is described by info and realized by ERA."""
    frame = chain([1.0, 1.5], [900.0, 700.0], damping_ratio=0.02)
    lines = np.arange(257) / (512 * 0.05)
    model = frame.state_space(forces=["f1"]).to_discrete(0.05)
    responses = FrequencyResponses(model.frequency_response(lines), lines)
    monkeypatch.setattr("vibrid.cli.options.read_record", lambda *_, **__: responses)
    monkeypatch.chdir(tmp_path)
    Path("plate.uff").touch()
    assert main(["info", "plate.uff"]) == 0
    assert "frequency responses, not a time record: 257 lines" in capsys.readouterr().out
    assert run_json(capsys, "info", "plate.uff")["n_lines"] == 257
    assert main(["identify", "plate.uff", "--save", "plate.vibrid.h5"]) == 0
    assert "method=era because these are frequency responses" in capsys.readouterr().out
    found = run_json(capsys, "identify", "plate.uff", "--order", "4")
    frequencies = [mode["frequency_hz"] for mode in found["modes"]]
    np.testing.assert_allclose(frequencies, frame.frequencies_hz, rtol=1e-6)
    assert main(["identify", "plate.uff", "--band", "1", "2"]) == 2
    assert "--band filters time records" in capsys.readouterr().err
    assert main(["identify", "plate.uff", "--method", "n4sid"]) == 2
    assert "N4SID takes records" in capsys.readouterr().err


def test_info_shows_a_saved_model_and_identify_refuses_it(
    csv_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What --save wrote can be looked at, and is not taken for a record."""
    target = tmp_path / "run.vibrid.h5"
    run_json(capsys, "identify", csv_file, "--inputs", "hammer", "--order", 4, "--save", target)
    assert main(["info", str(target)]) == 0
    assert "a saved model at 20 Hz: order 4" in capsys.readouterr().out
    assert run_json(capsys, "info", target)["order"] == 4
    assert main(["info", str(target), "--dt", "1"]) == 2
    assert "options for records do not apply" in capsys.readouterr().err
    assert main(["identify", str(target)]) == 1
    assert "holds a saved model, not a record" in capsys.readouterr().err


# -- demo, version


def test_version_and_empty_command(capsys: pytest.CaptureFixture[str]) -> None:
    """--version prints a number; no command prints the help."""
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip()[0].isdigit()
    assert main([]) == 0
    assert "identify" in capsys.readouterr().out


def test_demo_takes_options_with_a_file_only(capsys: pytest.CaptureFixture[str]) -> None:
    """Options that would be ignored are refused."""
    assert main(["demo", "--order", "4"]) == 2
    assert "only with a FILE" in capsys.readouterr().err


def test_demo_of_a_file_writes_the_model(
    csv_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """demo FILE identifies the file and saves the model in ./vibrid-demo."""
    monkeypatch.chdir(tmp_path)
    found = run_json(capsys, "demo", csv_file, "--inputs", "hammer", "--order", 4)
    assert found["saved"] == "vibrid-demo/run.vibrid.h5"
    assert load(tmp_path / "vibrid-demo" / "run.vibrid.h5").order == 4


@pytest.mark.slow
def test_demo_finds_published_and_true_modes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The building's published frequencies and the frame's true modes are found."""
    monkeypatch.chdir(tmp_path)
    building, shaker = run_json(capsys, "demo")["demo"]
    assert building["reference"]["found"] and shaker["reference"]["found"]
    assert min(shaker["fit"]["unseen"]["fit_percent"]) > 95
    truth = np.array(shaker["reference"]["damping_ratios"])
    found = [shaker["modes"][k]["damping_ratio"] for k in shaker["reference"]["modes"]]
    np.testing.assert_allclose(found, truth, rtol=0.02)
