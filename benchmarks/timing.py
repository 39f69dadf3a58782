"""CPU seconds and peak memory of a piece of work."""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Callable
from typing import Any


def seconds(work: Callable[[], Any], repeats: int) -> float:
    """Return the median CPU time of `repeats` runs."""
    spent = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        spent.append(time.process_time() - start)
    return statistics.median(spent)


def peak_megabytes(work: Callable[[], Any]) -> float:
    """Return the largest memory that the work held at once, NumPy arrays included."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()
