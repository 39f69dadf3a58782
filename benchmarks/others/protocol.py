"""What every adapter does alike: load the data, time the work, read the memory, return poles.

An adapter run_<package>.py lists its TASKS and calls `main`. It runs in the package's own
environment, where NumPy is the only certain guest, so nothing else from outside is imported here.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.timing import seconds

REPEATS = 5
LONG = 5.0  # CPU seconds; a longer run is not repeated


@dataclass(frozen=True)
class Data:
    """The files of one workload: arrays beside a description."""

    folder: Path

    @cached_property
    def about(self) -> dict[str, Any]:
        """Sampling interval `dt` [s], `order`, `block_rows` and the like."""
        return dict(json.loads((self.folder / "about.json").read_text(encoding="utf-8")))

    @property
    def dt(self) -> float:
        return float(self.about["dt"])

    @property
    def order(self) -> int:
        return int(self.about["order"])

    @property
    def block_rows(self) -> int:
        return int(self.about["block_rows"])

    def array(self, name: str, mapped: bool = False) -> Any:
        """Return an array of the folder, in memory or mapped; both have been read once."""
        values = np.load(self.folder / f"{name}.npy", mmap_mode="r" if mapped else None)
        np.sum(values)  # a mapped file's pages count as data, not as memory of the work
        return values

    @cached_property
    def inputs(self) -> Any:
        """Inputs (n_samples, n_inputs)."""
        return self.array("inputs")

    @cached_property
    def outputs(self) -> Any:
        """Outputs (n_samples, n_outputs)."""
        return self.array("outputs")

    @cached_property
    def responses(self) -> Any:
        """Impulse responses (n_lags, n_outputs, n_inputs) from lag 0 on."""
        return self.array("responses")


@dataclass(frozen=True)
class Work:
    """What is timed, and how the poles [rad/s] are read from what it returns."""

    run: Callable[[], Any]
    poles: Callable[[Any], Any]


@dataclass(frozen=True)
class Task:
    """One row of a table: `prepare(data)` imports and converts, untimed, and returns Work."""

    table: str
    computes: str
    prepare: Callable[[Data], Any]


def continuous(A: Any, dt: float) -> Any:
    """Return the continuous poles of a discrete state matrix, or of its eigenvalues."""
    values = np.asarray(A)
    values = np.linalg.eigvals(values) if values.ndim == 2 else values
    return np.log(values[np.abs(values) > 0].astype(complex)) / dt


def poles_of_modes(frequencies_hz: Any, damping_ratios: Any) -> Any:
    """Return the upper poles [rad/s] that have these frequencies and damping ratios."""
    f, zeta = np.asarray(frequencies_hz, float), np.asarray(damping_ratios, float)
    return 2 * np.pi * f * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0)))


def measure(work: Work) -> dict[str, Any]:
    """Run once for the memory; if that is short, measure the time five times more."""
    _reset_peak()
    before = _kilobytes("VmRSS")
    start = time.process_time()
    result = work.run()
    spent, measured = time.process_time() - start, 1
    peak = _kilobytes("VmHWM") - before
    poles = np.asarray(work.poles(result), dtype=complex)
    del result
    if spent <= LONG:
        spent, measured = seconds(work.run, REPEATS), REPEATS
    return {
        "seconds": spent,
        "runs": measured,
        "megabytes": peak / 1024,
        "poles": [[p.real, p.imag] for p in poles[np.isfinite(poles)].tolist()],
    }


def _reset_peak() -> None:
    """Let the kernel's record of the peak begin here."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def _kilobytes(name: str) -> float:
    """Return VmRSS (resident now) or VmHWM (its peak) of this process."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="ascii").splitlines() if status.exists() else []
    return next((float(line.split()[1]) for line in lines if line.startswith(name)), math.nan)


def versions(distribution: str) -> dict[str, str]:
    """Return the versions of the package and of NumPy under it."""
    return {"version": importlib.metadata.version(distribution), "numpy": np.__version__}


def main(tasks: tuple[Task, ...], distribution: str) -> None:
    """Run task number ARGV[1] on the data folder ARGV[2]; write the figures to ARGV[3]."""
    number, folder, answer = int(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3])
    try:
        work = tasks[number].prepare(Data(folder))
        found = work if isinstance(work, dict) else measure(work) | versions(distribution)
    except Exception as error:  # whatever it is belongs in the table
        found = {"message": f"{type(error).__name__}: {error}"}
    answer.write_text(json.dumps(found), encoding="utf-8")
