"""CPU seconds and peak memory of a piece of work."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np


def seconds(work: Callable[[], Any], repeats: int) -> float:
    """Return the shortest CPU time of `repeats` runs."""
    best = np.inf
    for _ in range(repeats):
        start = time.process_time()
        work()
        best = min(best, time.process_time() - start)
    return best


def peak_megabytes(work: Callable[[], Any]) -> float:
    """Return the largest memory that the work held at once, NumPy arrays included."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
