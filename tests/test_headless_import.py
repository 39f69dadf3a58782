"""`import vibrid` is quick and needs no display."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
HEAVY = {
    "scipy.signal",
    "scipy.stats",
    "scipy.optimize",
    "matplotlib",
    "rich",
    "dask",
    "plotly",
    "cyclopts",
    "starlette",
    "h5py",
    "pyuff",
}


def test_import_loads_nothing_heavy_and_needs_no_display() -> None:
    """A fresh interpreter without a display imports vibrid and none of the heavy packages."""
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "MPLBACKEND")}
    program = "import json, sys, vibrid; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    loaded = set(json.loads(done.stdout))
    assert "vibrid" in loaded
    assert loaded & HEAVY == set()
