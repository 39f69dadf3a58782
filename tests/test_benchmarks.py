"""The benchmarks: each still runs, and what goes wrong becomes a row that says so."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.others.harness import Limits, Row, accuracy, entries, run_process, run_row, tidy
from benchmarks.others.workloads import TABLES, structure, write
from benchmarks.report import facts, keep, write_page

ROOT = Path(__file__).resolve().parent.parent
OTHERS = ROOT / "benchmarks" / "others"

ADAPTER = """
import time
import numpy as np
from benchmarks.others.protocol import Task, Work, main

def fails(data):
    raise ValueError("order 20 refused\\nand more")

def waits(data):
    return Work(lambda: time.sleep(60), lambda found: [])

def fills(data):
    return Work(lambda: np.ones(2**28), lambda found: [])

def dies(data):
    raise SystemExit("no licence")

main(tuple(Task("W1", "", prepare) for prepare in (fails, waits, fills, dies)), "numpy")
"""


linux = pytest.mark.skipif(sys.platform != "linux", reason="limits of processes are Linux's")


@linux
def test_our_own_row_finds_every_mode(tmp_path: Path) -> None:
    """vibrid runs through the harness at small size and finds the three modes."""
    data = write("W1", tmp_path, quick=True)
    row = run_row(entries("W1")[0], data, tmp_path, Limits())
    assert row.package == "vibrid"
    assert row.message == ""
    assert row.modes == (3, 3)
    assert row.frequency_error < 0.01
    assert row.seconds > 0
    assert row.runs == 5


@linux
@pytest.mark.parametrize(
    ("number", "limits", "message"),
    [
        (0, Limits(), "ValueError: order 20 refused"),
        (1, Limits(seconds=2), "stopped after 2 s"),
        (2, Limits(gigabytes=1.5), "MemoryError"),
        (3, Limits(), "exit code 1: no licence"),
    ],
)
def test_what_goes_wrong_becomes_a_message(
    number: int,
    limits: Limits,
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A task that fails, waits, takes too much memory or ends its process has a message."""
    (tmp_path / "adapter.py").write_text(ADAPTER, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    answer = run_process(Path(sys.executable), "adapter", number, tmp_path, limits)
    assert message in tidy(answer["message"])


def test_package_that_is_not_installed_is_a_row(tmp_path: Path) -> None:
    """Without leave to install, a package that is not there is a row that says so."""
    modred = next(entry for entry in entries("W5 ERA") if entry.package == "modred")
    row = run_row(modred, tmp_path, tmp_path, Limits(), install=False)
    assert "not installed" in row.message


def test_accuracy_gives_each_mode_one_pole() -> None:
    """Exact poles have no error; a shifted damping ratio is seen; a lost mode is counted."""
    truth = structure(10).poles
    exact = accuracy(truth, truth)
    assert exact["modes"] == (10, 10)
    assert exact["frequency_error"] < 1e-12
    upper = truth[truth.imag > 0]
    less_damped = upper.real * 0.5 + 1j * upper.imag
    assert accuracy(less_damped, truth)["damping_error"] == pytest.approx(0.5, rel=1e-3)
    assert accuracy(upper[1:], truth)["modes"] == (9, 10)
    assert accuracy(np.zeros(0, complex), truth) == {"modes": (0, 10)}


def test_structure_is_the_one_described() -> None:
    """Ten masses have modes of 4.7 to 40 Hz at 1 % damping."""
    frequencies = structure(10).frequencies_hz
    np.testing.assert_allclose(frequencies[[0, -1]], [4.7, 40.0], rtol=5e-3)
    np.testing.assert_allclose(structure(10).damping_ratios, 0.01)


def test_page_holds_what_is_kept(tmp_path: Path) -> None:
    """The page has a line for each row: figures with their ratio to ours, or the message."""
    ours = Row("vibrid", "A", version="1", seconds=0.5, runs=5, megabytes=7, modes=(3, 3))
    rows = [ours, replace(ours, package="slow", seconds=10.0, runs=1), Row("none", "A", "no pins")]
    keep(tmp_path, "W1", {"rows": [row.as_dict() for row in rows], "facts": facts(Limits())})
    keep(tmp_path, "bench_some", {"text": "a | b", "facts": facts(Limits())})
    write_page(tmp_path, tmp_path / "page.md")
    page = (tmp_path / "page.md").read_text(encoding="utf-8")
    assert "| vibrid | A | 0.500 | 1.0 | 7 | 3 of 3 |" in page
    assert "| slow | A | 10.0 ¹ | 20 |" in page
    assert "| no pins |" in page
    assert "```text\na | b\n```" in page


def test_every_package_is_pinned_and_every_table_has_ours_first() -> None:
    """Pins are exact and hold no addresses; vibrid is the first row of every table."""
    for table in TABLES:
        found = entries(table.name)
        assert found[0].package == "vibrid"
        for adapter in {entry.adapter for entry in found} - {"vibrid", "octave"}:
            lines = (OTHERS / f"{adapter}.txt").read_text(encoding="utf-8").split()
            assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines), adapter


@pytest.mark.slow
def test_benchmarks_run_at_small_size(tmp_path: Path) -> None:
    """`python -m benchmarks --quick` runs each benchmark to its end, with no other package."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--quick", "--folder", str(tmp_path)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    written = len(list((ROOT / "benchmarks").glob("bench_*.py")))
    assert done.stdout.count("== bench_") == written > 0
    assert done.stdout.count("== W") == len(TABLES)
