"""CPU seconds and peak memory of a piece of work."""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

SHORTEST = 0.05  # CPU seconds of one measurement: shorter runs are repeated within it


def seconds(work: Callable[[], Any], repeats: int) -> float:
    """Return the median CPU time of a run over `repeats` measurements, each of 50 ms or more."""
    return statistics.median(_measured(work) for _ in range(repeats))


def _measured(work: Callable[[], Any]) -> float:
    """Return the mean CPU time of a run: one, or as many as 50 ms hold."""
    start, runs = time.process_time(), 0
    while True:
        work()
        runs += 1
        spent = time.process_time() - start
        if spent >= SHORTEST:
            return spent / runs


def peak_megabytes(work: Callable[[], Any]) -> float:
    """Return the largest memory that the work held at once, NumPy arrays included."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
