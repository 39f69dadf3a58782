"""The command: results, JSON, options from the methods' fields, exit statuses, messages."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vibrid.cli.app as app
from vibrid import FrequencyResponses, load
from vibrid.cli import main
from vibrid.cli.options import option_type
from vibrid.excitation import white_noise
from vibrid.methods import METHODS
from vibrid.structures import chain, shear_frame

FRAME = shear_frame(2, 100.0, 2e4, damping_ratio=0.01)  # 1.39 and 3.64 Hz
HEADER = "time [s],hammer [N],a1 [m/s2],a2 [m/s2]"


@pytest.fixture(autouse=True)
def warnings_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let warnings through, which the command hides from users, so that tests see them."""
    monkeypatch.setenv("VIBRID_DEBUG", "1")


@pytest.fixture(scope="module")
def csv_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a CSV file of 100 s at 20 Hz: force at the top, both accelerations."""
    rng = np.random.default_rng(3)
    record = FRAME.simulate(white_noise(2000, rng=rng), 0.05, forces=["f2"], noise=0.01, rng=rng)
    columns = np.column_stack([0.05 * np.arange(2000), record.inputs[:], record.outputs[:]])
    path = tmp_path_factory.mktemp("cli") / "run.csv"
    np.savetxt(path, columns, delimiter=",", header=HEADER, comments="")
    return path


def run_json(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """Run a command with --json and return what it printed."""
    assert main([*map(str, arguments), "--json"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    found: dict[str, Any] = json.loads(said.out)
    return found


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


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["FILE", "--kind", "data"], 2, "--kind is an option of ssi; n4sid takes --weighting"),
        (["FILE", "--weighting", "best"], 2, "weighting must be one of cva, moesp, n4sid"),
        (["FILE", "--method", "okid2"], 2, "--method must be one of n4sid, ssi"),
        (["FILE", "--order", "0"], 2, "--order must be auto or a whole number, at least 1"),
        (["FILE", "--order", "-3"], 2, "at least 1; got '-3'"),
        (["FILE", "--save", "FILE"], 2, "--save would overwrite"),
        (["-"], 2, "Standard input is not read"),
        (["x" * 5000], 2, "cannot be read: File name too long"),
        (["FILE", "--order", "many"], 2, "--order must be auto or a whole number"),
        (["FILE", "--order", "900"], 2, "900"),
        (["FILE", "--colour", "red"], 2, "Unknown option"),
        (["FILE", "--band", "3"], 2, "--band requires 2 values; got 1"),
        (["FILE", "--band", "4", "3"], 2, "low < high"),
        (["FILE", "--band", "1e-300", "3"], 2, "must begin at 0 or at least at"),
        (["FILE", "--unit", "a1"], 2, "--unit takes NAME=VALUE; got 'a1'"),
        (["FILE", "--offset", "some"], 2, "--offset must be one of estimate"),
        (["FILE", "--save", "/nowhere/x.h5"], 2, "There is no folder /nowhere"),
        (["FILE", "again"], 2, "Nothing takes the argument 'again'"),
        (["FILE", "--outputs", "a9"], 2, "No channel is called 'a9'"),
        (["none.csv"], 2, "There is no file none.csv"),
        (["FILE", "--dt", "0.1"], 2, "0.1"),
    ],
)
def test_wrong_use_is_one_sentence_and_status_2(
    arguments: list[str],
    status: int,
    words: str,
    csv_file: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Wrong use is told on stderr in a line, with nothing on stdout, also for JSON."""
    tokens = [str(csv_file) if each == "FILE" else each for each in arguments]
    assert main(["identify", *tokens, "--inputs", "hammer", "--json"]) == status
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("vibrid: ")
    assert words in said.err and said.err.count("\n") == 1


def test_wrong_options_are_refused_before_the_file_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An output path that cannot be written is named although the input does not exist."""
    assert main(["identify", "none.csv", "--save", str(tmp_path / "no" / "x.h5")]) == 2
    assert "There is no folder" in capsys.readouterr().err
    assert main(["identify", "none.csv", "--method", "ssi", "--weighting", "cva"]) == 2
    assert "--weighting is an option of n4sid" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.csv", "", "is empty"),
        ("one.csv", "a,b\n1,2\n", "1 sample of 2 channels: time is axis 0, and a record needs"),
        ("short.csv", "a,b\n" + "1,2\n2,1\n" * 4, "Record at least 11 samples in one piece"),
        ("huge.csv", "a,b\n" + "1,2\n2,1e300\n" * 40, "Sample 1 of channel b is 1e+300"),
        ("nan.csv", "a,b\n" + "nan,nan\n" * 50, "NaN"),
        ("flat.csv", "a,b\n" + "".join(f"{k % 7},5\n" for k in range(200)), "b"),
        ("text.csv", "a,b\nx,y\nz,w\n", "'x'"),
        ("bad.mat", "hello", "damaged"),
    ],
)
def test_bad_data_is_one_sentence_and_status_1(
    name: str, content: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Data that cannot be identified are told on stderr in a line, without a traceback."""
    path = tmp_path / name
    path.write_text(content)
    assert main(["identify", str(path), "--dt", "0.1"]) == 1
    said = capsys.readouterr()
    assert said.out == "" and words in said.err and said.err.count("\n") == 1


def test_too_large_a_horizon_is_refused_before_it_is_allocated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Block rows that the samples allow but no memory holds are refused at once."""
    path = tmp_path / "long.npy"
    np.save(path, np.random.default_rng(0).standard_normal((400_000, 1)))
    assert main(["identify", str(path), "--dt", "0.01", "--block-rows", "100000"]) == 1
    said = capsys.readouterr().err
    assert "block_rows=100000 with 1 output makes a matrix of 298 GiB" in said
    assert "Use at most 11585 block rows" in said


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


def test_a_defect_is_one_line_unless_debugging(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An unexpected exception asks for a report; the traceback comes with VIBRID_DEBUG."""

    def fail(*_: object) -> None:
        raise RuntimeError("wrong sign")

    monkeypatch.setattr(app, "identify_file", fail)
    monkeypatch.delenv("VIBRID_DEBUG", raising=False)
    assert main(["identify", "x.csv"]) == 1
    said = capsys.readouterr().err
    assert "internal error, please report it: RuntimeError: wrong sign" in said
    assert said.count("\n") == 1
    monkeypatch.setenv("VIBRID_DEBUG", "1")
    assert main(["identify", "x.csv"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_interrupt_is_quiet(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C ends with status 130 and one word."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app, "identify_file", interrupt)
    assert main(["identify", "x.csv"]) == 130
    assert capsys.readouterr().err == "Interrupted.\n"


def test_a_closed_pipe_is_silent(csv_file: Path) -> None:
    """A reader that goes away after one line, such as head, causes no message."""
    run = f"import sys; from vibrid.cli import main; sys.exit(main(['info', {str(csv_file)!r}]))"
    with subprocess.Popen(
        [sys.executable, "-c", run], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""


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
