"""The command's exit statuses and messages: wrong use, bad data, defects, interrupts."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import vibrid.cli.app as app
from vibrid.cli import main

pytestmark = pytest.mark.usefixtures("warnings_count")


# -- wrong use


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


# -- bad data


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


# -- defects and interrupts


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
