"""Candidates: every horizon and weighting that a record allows, and how they simulate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..chunks import Stream
from ..errors import DataError
from ..gram import reduce
from ..methods.preparation import check_length
from .held_out import simulated, simulation_error
from .options import HasAlternatives

HORIZONS = (10, 20, 40, 80)
LARGEST_HANKEL = 2600  # rows: beyond it a factorization takes seconds
CLOSE = 0.02  # of the criterion a sample and output: a longer horizon must gain more
AS_GOOD = 1.02  # of the best simulation error: candidates within it are equal
STRETCH = 10_000  # samples of each stretch of a long stream, at most
LONGEST_RANKED = 20_000  # samples that candidates are ranked on

Mask = bool | Sequence[bool] | None
Candidate = tuple[Any, Any]  # method with every option, its decomposition


def horizons(stream: Stream, method: Any, order: int | str, feedthrough: Mask) -> list[Candidate]:
    """Return the method with every horizon that the record allows; one Gram serves all.

    Nearly noise-free data need no longer horizon than the first that shows their rank.
    """
    channels = stream.n_inputs + stream.n_outputs
    shortest = HORIZONS[0]
    if not isinstance(order, str):
        shortest = max(shortest, -(-order // stream.n_outputs) + 1)
    allowed = [
        rows
        for rows in sorted({shortest, *HORIZONS})
        if rows >= shortest
        and _rows(method, rows) * channels <= LARGEST_HANKEL
        and _fits(stream, _rows(method, rows))
    ]
    allowed = allowed or [_longest(stream, method, shortest)]
    gram = reduce(stream, _rows(method, allowed[-1]))
    found: list[Candidate] = []
    for rows in allowed:
        option = replace(method, block_rows=rows)
        compared = [option.decompose(stream, feedthrough=feedthrough, gram=gram)]
        if isinstance(option, HasAlternatives) and not compared[0].rank_limited:
            compared = option.alternatives(compared[0])
        found += [(each.method, each) for each in compared]
        if compared[-1].rank_limited:
            break
    return found


def _rows(method: Any, block_rows: int) -> int:
    return block_rows + (method.past_rows or block_rows)


def _fits(stream: Stream, n_rows: int) -> bool:
    try:
        check_length(stream, n_rows)
    except DataError:
        return False
    return True


def _longest(stream: Stream, method: Any, wanted: int) -> int:
    """Return the longest horizon up to `wanted` that the record allows."""
    for rows in range(wanted, 1, -1):
        if _fits(stream, _rows(method, rows)):
            return rows
    check_length(stream, _rows(method, 2))
    return 2


def first_simulating(stream: Stream, candidates: Sequence[Candidate], order: int) -> int | None:
    """Return the first candidate whose simulation is as good as the best; None if none is stable.

    At the same order no candidate has more parameters than another, so the data that they
    were identified on may judge; among nearly equal ones the prediction error does.
    """
    short = shortened(stream)
    errors = np.array([simulation_error_of(short, *each, order) for each in candidates])
    if not np.isfinite(errors).any():
        return None
    near = np.flatnonzero(errors <= AS_GOOD * np.nanmin(errors))
    found = [candidates[int(k)][1] for k in near]
    values = [each.criterion(order)[0] / each.n_columns for each in found]
    return int(near[first_close(values, stream.n_outputs)])


def simulation_error_of(short: Stream, method: Any, decomposition: Any, order: int) -> float:
    if not 1 <= order <= decomposition.largest_order:
        return np.inf
    fit = simulated(method, decomposition, order, short)
    return np.inf if fit is None else simulation_error(fit)


def shortened(stream: Stream) -> Stream:
    """Return the front of a long stream: enough to rank models by."""
    left, kept = LONGEST_RANKED, []
    for segment in stream.segments:
        length = min(left, segment.length)
        if length:
            kept.append(replace(segment, stop=segment.start + length))
        left -= length
    return replace(stream, segments=tuple(kept))


def stretches(stream: Stream, n_samples: int) -> Stream:
    """Return stretches spread evenly over a long stream, about `n_samples` in all."""
    step = -(-stream.n_samples // n_samples)
    if step == 1:
        return stream
    cut = []
    for segment in stream.segments:
        count = -(-segment.length // STRETCH)
        edges = np.linspace(segment.start, segment.stop, count + 1).round().astype(int).tolist()
        cut += [replace(segment, start=a, stop=b) for a, b in pairwise(edges)]
    return replace(stream, segments=tuple(cut[::step]))


def first_close(values: Sequence[float], n_outputs: int) -> int:
    limit = min(values) + CLOSE * n_outputs
    return next(k for k, value in enumerate(values) if value <= limit)
