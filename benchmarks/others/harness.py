"""Run one task in a process of its own, with limits, and judge its poles."""

from __future__ import annotations

import importlib
import json
import os
import pkgutil
import re
import resource
import signal
import subprocess
import tempfile
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

import benchmarks.others
from benchmarks.others.environments import ROOT, NotInstalled, python_of
from benchmarks.others.protocol import Task

ONE_THREAD = {
    f"{name}_NUM_THREADS": "1"
    for name in ("OPENBLAS", "OMP", "MKL", "VECLIB", "BLIS", "NUMEXPR", "NUMBA")
}
FOUND = 0.1  # a mode counts as found when a pole lies within this share of its own size


@dataclass(frozen=True)
class Limits:
    """What one process may use."""

    seconds: int = 180
    gigabytes: float = 12.0


@dataclass(frozen=True)
class Row:
    """One line of a table; a message stands for figures that do not exist."""

    package: str
    computes: str
    message: str = ""
    version: str = ""
    numpy: str = ""
    seconds: float = float("nan")
    runs: int = 0
    megabytes: float = float("nan")
    modes: tuple[int, int] = (0, 0)
    frequency_error: float = float("nan")
    damping_error: float = float("nan")

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Entry:
    """A task of an adapter: what will become one row."""

    adapter: str
    package: str
    number: int
    task: Task


def entries(table: str) -> list[Entry]:
    """Return what every run_<adapter>.py has for a table, vibrid first."""
    modules = [module.name for module in pkgutil.iter_modules(benchmarks.others.__path__)]
    names = sorted(name.removeprefix("run_") for name in modules if name.startswith("run_"))
    names.sort(key=lambda name: name != "vibrid")
    found = []
    for name in names:
        adapter = importlib.import_module(f"benchmarks.others.run_{name}")
        for number, task in enumerate(adapter.TASKS):
            if task.table == table:
                found.append(Entry(name, adapter.NAME, number, task))
    return found


def run_row(entry: Entry, data: Path, folder: Path, limits: Limits, install: bool = True) -> Row:
    """Return the row of one task on the data of folder `data`."""
    row = Row(entry.package, entry.task.computes)
    try:
        python = python_of(entry.adapter, folder, install)
    except NotInstalled as problem:
        return replace(row, message=tidy(str(problem)))
    module = f"benchmarks.others.run_{entry.adapter}"
    answer = run_process(python, module, entry.number, data, limits)
    if "message" in answer:
        return replace(row, message=tidy(answer["message"]))
    poles = np.array([complex(*pole) for pole in answer.pop("poles")])
    return replace(row, **answer, **accuracy(poles, np.load(data / "truth.npy")))


def run_process(
    python: Path, module: str, number: int, data: Path, limits: Limits
) -> dict[str, Any]:
    """Run task `number` of an adapter module; its answer, or {"message": why there is none}."""

    with tempfile.TemporaryDirectory() as scratch:
        answer = Path(scratch) / "answer.json"
        command = [str(python), "-m", module, str(number), str(data), str(answer)]
        code, errors = _limited(command, limits)
        if answer.exists():
            return dict(json.loads(answer.read_text(encoding="utf-8")))
    if code is None:
        return {"message": f"stopped after {limits.seconds} s"}
    last = [line.strip() for line in errors.splitlines() if line.strip()]
    ended = f"ended by {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
    return {"message": f"{ended}: {last[-1]}" if last else ended}


def _limited(command: list[str], limits: Limits) -> tuple[int | None, str]:
    """Return exit code (None when stopped for time) and standard error of a command.

    The clock is the wall's: a kernel that watches a limit of CPU time counts it in ticks of
    milliseconds, and short work could not be timed.
    """
    size = int(limits.gigabytes * 2**30)
    process = subprocess.Popen(
        command,
        cwd=ROOT,
        env=os.environ | ONE_THREAD,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size)),
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        start_new_session=True,
    )
    try:
        errors = process.communicate(timeout=limits.seconds)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        return None, ""
    return process.returncode, errors


def tidy(message: str) -> str:
    """Return the first line of a message, short, without addresses and places."""
    line = message.strip().splitlines()[0] if message.strip() else "no message"
    line = re.sub(r"https?://\S+", "…", line)
    line = re.sub(r"(?<![\w.])/(?:[\w.+-]+/)+", "", line).replace("|", "/")
    return line if len(line) <= 160 else line[:159] + "…"


def accuracy(poles: NDArray[np.complex128], truth: NDArray[np.complex128]) -> dict[str, Any]:
    """Return modes found and the largest relative errors of their frequencies and damping.

    Every true mode is given one pole, so that the sum of relative distances is smallest; it
    is found when that distance is at most FOUND.
    """
    true = truth[truth.imag > 0]
    upper = poles[poles.imag > 0]
    distance = np.abs(upper[None] - true[:, None]) / np.abs(true)[:, None]
    rows, columns = linear_sum_assignment(np.minimum(distance, 1.0))
    near = distance[rows, columns] <= FOUND
    t, p = true[rows[near]], upper[columns[near]]
    found: dict[str, Any] = {"modes": (int(near.sum()), len(true))}
    if near.any():
        found["frequency_error"] = float(np.max(np.abs(np.abs(p) / np.abs(t) - 1)))
        ratio = (p.real / np.abs(p)) / (t.real / np.abs(t))
        found["damping_error"] = float(np.max(np.abs(ratio - 1)))
    return found
