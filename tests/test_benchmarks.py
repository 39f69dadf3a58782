"""Every benchmark still runs."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.slow
def test_benchmarks_run_at_small_size() -> None:
    """`python -m benchmarks --quick` runs each benchmark to its end."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks", "--quick"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    written = len(list((ROOT / "benchmarks").glob("bench_*.py")))
    assert done.stdout.count("== bench_") == written > 0
