"""Cut a record into one segment a hit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import DataError, OptionError, check_choice, check_positive
from ..record import Record
from .hits import FAULTS, GUARD, Hit, Hits, find_hits


def hit_segments(
    record: Record,
    hits: Hits | None = None,
    *,
    accept: Sequence[str] = (),
    pre_trigger: float | None = None,
    length: float | None = None,
    remove_baseline: bool = False,
) -> tuple[Record, ...]:
    """Return one Record for each accepted hit; `identify` takes them together.

    Parameters
    ----------
    record : Record
    hits : Hits, optional
        From `find_hits`, which is called when left out.
    accept : sequence of str
        Faults that do no harm: of "double", "short", "clipped", "cut"; none by default. A
        double hit is as good as any in the time domain, since its force is measured.
    pre_trigger : float, optional
        Time kept before each pulse [s], up to the gap or hit before; 8 samples by default.
    length : float, optional
        Largest length of a segment [s]; up to the next hit by default.
    remove_baseline : bool
        Subtract each channel's mean before the pulse: needed before an exponential window
        (which makes a decay of an offset) and before `hammer_responses`.

    Returns
    -------
    tuple of Record
        In memory, in order of time.

    Raises
    ------
    DataError
        Every hit has a fault; no sample before a pulse to take a baseline from.
    OptionError
        Unknown faults, times not positive.

    Examples
    --------
    >>> force = np.zeros(900)
    >>> force[[100, 400, 700]] = 2.0
    >>> [part.n_samples for part in hit_segments(Record(np.zeros(900), force, dt=0.01))]
    [300, 300, 208]
    """
    for fault in accept:
        check_choice("accept", fault, FAULTS)
    if hits is None:
        hits = find_hits(record)
    accepted = [hit for hit in hits if set(hit.faults) <= set(accept)]
    if not accepted:
        faults = sorted({fault for hit in hits for fault in hit.faults})
        raise DataError(
            f"None of the {len(hits)} hits is free of faults ({', '.join(faults)}). Accept those "
            "that do no harm, such as accept=['double'], or measure again."
        )
    before = _samples("pre_trigger", pre_trigger, record.dt, GUARD)
    longest = _samples("length", length, record.dt, record.n_samples)
    return tuple(
        _segment(record, hit, _first(hits, hit, before), longest, remove_baseline)
        for hit in accepted
    )


def _samples(name: str, seconds: float | None, dt: float, default: int) -> int:
    if seconds is None:
        return default
    if seconds != 0 or name == "length":
        check_positive(name, seconds, "s")
    return round(seconds / dt)


def _first(hits: Hits, hit: Hit, before: int) -> int:
    """Return the first sample of a segment: not in another hit, nor over a gap."""
    earlier = [other.end for other in hits if other.end <= hit.start]
    return max([hit.piece[0], hit.start - before, *earlier])


def _segment(record: Record, hit: Hit, first: int, longest: int, remove_baseline: bool) -> Record:
    part = record.slice(first, min(hit.stop, first + longest)).in_memory()
    y, u = np.asarray(part.outputs), np.asarray(part.inputs)
    if remove_baseline:
        known = hit.start - first
        if known < 1:
            raise OptionError(
                f"There is no sample before the hit at {hit.peak_sample * record.dt:.4g} s to "
                "take a baseline from; give a longer pre_trigger."
            )
        y, u = y - y[:known].mean(axis=0), u - u[:known].mean(axis=0)
    title = f"{record.name}, hit" if record.name else "hit"
    return Record(
        y,
        u,
        dt=record.dt,
        output_channels=record.output_channels,
        input_channels=record.input_channels,
        name=f"{title} of {hit.channel} at {hit.peak_sample * record.dt:.4g} s",
    )
