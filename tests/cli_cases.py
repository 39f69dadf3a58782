"""A frame, the header of its file and a runner of commands, which tests share."""

from __future__ import annotations

import json
from typing import Any

import pytest

from vibrid.cli import main
from vibrid.structures import shear_frame

FRAME = shear_frame(2, 100.0, 2e4, damping_ratio=0.01)  # 1.39 and 3.64 Hz
HEADER = "time [s],hammer [N],a1 [m/s2],a2 [m/s2]"


def run_json(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """Run a command with --json and return what it printed."""
    assert main([*map(str, arguments), "--json"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    found: dict[str, Any] = json.loads(said.out)
    return found
