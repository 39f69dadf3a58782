"""One pinned virtual environment for each other package, made when first needed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parent.parent


class NotInstalled(Exception):
    """A package that cannot be had here; its message becomes a row."""


def python_of(adapter: str, folder: Path, install: bool = True) -> Path:
    """Return the interpreter of run_<adapter>.py, installing its pins if need be.

    vibrid and octave run in the interpreter at hand. An environment is made anew when its
    pins have changed. What must be there before the package is built stands in
    <adapter>.build.txt.
    """
    if adapter == "octave":
        _need_octave()
    pins = HERE / f"{adapter}.txt"
    if not pins.exists():
        return Path(sys.executable)
    home = folder / "environments" / adapter
    python, stamp = home / "bin" / "python", home / "pins"
    if stamp.exists() and stamp.read_text(encoding="utf-8") == pins.read_text(encoding="utf-8"):
        return python
    if not install:
        raise NotInstalled("not installed; a run without --quick installs it")
    _make(home, pins)
    shutil.copyfile(pins, stamp)
    return python


def _make(home: Path, pins: Path) -> None:
    _run([sys.executable, "-m", "venv", "--clear", str(home)])
    install = [str(home / "bin" / "python"), "-m", "pip", "install", "--quiet", "--no-deps"]
    first = pins.with_suffix(".build.txt")
    if first.exists():
        _run([*install, "--requirement", str(first)])
        install.append("--no-build-isolation")
    _run([*install, "--requirement", str(pins)])


def _run(command: list[str]) -> None:
    quiet = os.environ | {"PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=quiet)
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.strip()]
        telling = [line for line in errors if re.match(r"\s*(error|\w+Error)\b", line, re.I)]
        raise NotInstalled("does not install: " + (telling or errors or ["no message"])[-1].strip())


def _need_octave() -> None:
    if shutil.which("octave-cli") is None:
        raise NotInstalled(
            "octave-cli is not installed (Debian: octave, octave-control, libopenblas0)"
        )
