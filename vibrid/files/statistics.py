"""Sums over a record of any size, a stretch of rows at a time: moments, gaps, clipping."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..record import Floats, Record

LARGEST_VALUE = 1e100
CLIPPED_RUN = 3  # equal extreme samples in a row that look clipped


@dataclass(frozen=True, eq=False)
class Statistics:
    """One entry a channel, inputs first; NaN where a channel has no sample."""

    count: Floats
    mean: Floats
    std: Floats
    smallest: Floats
    largest: Floats
    drift: Floats  # last tenth less first tenth, in standard deviations
    clipped: Floats  # samples in long runs of an extreme value
    clipped_runs: Floats
    n_gaps: int
    n_missing: int  # rows with a missing sample


def statistics_of(record: Record) -> Statistics:
    """Look through a record in two passes."""
    sums = _moments(record)
    clipped, runs = _clipped(record, sums)
    nothing = sums.count == 0
    std = np.sqrt(sums.squares / np.maximum(sums.count, 1))
    first, last = (tail[0] / np.maximum(tail[1], 1) for tail in (sums.first_tenth, sums.last_tenth))
    empty = (sums.first_tenth[1] == 0) | (sums.last_tenth[1] == 0)
    drift = np.divide(last - first, std, out=np.zeros_like(std), where=std > 0)
    return Statistics(
        sums.count,
        np.where(nothing, np.nan, sums.mean),
        np.where(nothing, np.nan, std),
        np.where(nothing, np.nan, sums.smallest),
        np.where(nothing, np.nan, sums.largest),
        np.where(empty, np.nan, drift),
        clipped,
        runs,
        sums.n_gaps,
        sums.n_missing,
    )


@dataclass
class _Moments:
    """Sums over the rows read so far (each an array with one entry a channel)."""

    count: Floats
    mean: Floats
    squares: Floats  # sum of squared deviations
    smallest: Floats
    largest: Floats
    first_tenth: Floats  # sum, then count
    last_tenth: Floats
    n_gaps: int = 0
    n_missing: int = 0
    in_gap: bool = False


def _moments(record: Record) -> _Moments:
    n = record.n_inputs + record.n_outputs
    zeros = np.zeros(n)
    sums = _Moments(
        zeros.copy(),
        zeros.copy(),
        zeros.copy(),
        np.full(n, np.inf),
        np.full(n, -np.inf),
        np.zeros((2, n)),
        np.zeros((2, n)),
    )
    tenth = max(1, record.n_samples // 10)
    for start, rows in record.chunks():
        if np.isinf(rows).any():
            record.segments()  # names the sample in its error
        _refuse_huge(record, start, rows)
        _add_chunk(sums, rows)
        _add_gaps(sums, rows)
        last = max(0, record.n_samples - tenth - start)
        _add_tail(sums.first_tenth, rows[: max(0, tenth - start)])
        _add_tail(sums.last_tenth, rows[last:])
    return sums


def _refuse_huge(record: Record, start: int, rows: Floats) -> None:
    """Raise `DataError` for values whose squares would overflow: no sensor gives them."""
    huge = np.abs(rows) > LARGEST_VALUE
    if huge.any():
        row, column = np.argwhere(huge)[0]
        channel = (*record.input_names, *record.output_names)[column]
        raise DataError(
            f"Sample {start + row} of channel {channel} is {rows[row, column]:g}; beyond "
            f"{LARGEST_VALUE:g} nothing can be computed. Write NaN (leave the cell empty) where a "
            "sample is missing, or change the unit."
        )


def _add_tail(tail: Floats, rows: Floats) -> None:
    good = ~np.isnan(rows)
    tail += np.stack([np.where(good, rows, 0.0).sum(axis=0), good.sum(axis=0)])


def _add_chunk(sums: _Moments, rows: Floats) -> None:
    """Merge means and squares of a chunk (Chan, Golub and LeVeque, 1983)."""
    good = ~np.isnan(rows)
    count = good.sum(axis=0)
    seen = np.maximum(count, 1)
    mean = np.where(good, rows, 0.0).sum(axis=0) / seen
    squares = np.square(np.where(good, rows - mean, 0.0)).sum(axis=0)
    total = np.maximum(sums.count + count, 1)
    step = mean - sums.mean
    sums.squares += squares + step**2 * sums.count * count / total
    sums.mean += step * count / total
    sums.count += count
    sums.smallest = np.minimum(sums.smallest, np.where(good, rows, np.inf).min(axis=0))
    sums.largest = np.maximum(sums.largest, np.where(good, rows, -np.inf).max(axis=0))


def _add_gaps(sums: _Moments, rows: Floats) -> None:
    missing: NDArray[np.bool_] = np.asarray(np.isnan(rows).any(axis=1))
    starts = np.diff(np.concatenate([[sums.in_gap], missing]).astype(np.int8)) == 1
    sums.n_gaps += int(starts.sum())
    sums.n_missing += int(missing.sum())
    sums.in_gap = bool(missing[-1])


def _clipped(record: Record, sums: _Moments) -> tuple[Floats, Floats]:
    """Count, for each channel, clipped samples and the runs that they form."""
    extremes = np.concatenate([sums.largest, sums.smallest])
    total = np.zeros((2, len(extremes)))  # samples, runs
    going_on = np.zeros(len(extremes))  # length of the run that the last chunk ended in
    for _, rows in record.chunks():
        hit = np.equal(np.hstack([rows, rows]), extremes)
        for k in range(len(extremes)):
            ended, going_on[k] = _runs(hit[:, k], going_on[k])
            total[:, k] += _long(ended)
    for k, length in enumerate(going_on):
        total[:, k] += _long(np.array([length]))
    samples, runs = total.reshape(2, 2, -1).sum(axis=1)
    return samples, runs


def _runs(hit: NDArray[np.bool_], before: float) -> tuple[Floats, float]:
    """Return the lengths of the runs of True that end here, and of the one that goes on."""
    breaks = np.flatnonzero(~hit)
    if not len(breaks):
        return np.zeros(0), before + len(hit)
    ended = np.diff(np.concatenate([[-1], breaks])) - 1.0
    ended[0] += before
    return ended, float(len(hit) - 1 - breaks[-1])


def _long(lengths: NDArray[Any]) -> tuple[float, float]:
    """Return how many samples the long runs hold, and how many such runs there are."""
    long = lengths[lengths >= CLIPPED_RUN]
    return float(long.sum()), float(len(long))
