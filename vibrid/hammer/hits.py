"""Find the hits of a hammer in a record, and what is wrong with each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import DataError, OptionError, check_names, check_positive
from ..fit import Finding
from ..record import Record
from .pulses import NOISE_FACTOR, Pulse, centred, groups, pulse_in

THRESHOLD = 0.1
SEPARATION = 0.25  # s; a hammer bounces within a tenth of a second
GUARD = 8  # samples kept before a pulse: the foot that is below what counts as its beginning
SHORT_SHARE = 0.5  # of the usual decay
CROSSTALK = 0.1  # of another channel's hit at the same time

FAULTS = ("double", "clipped", "short", "cut")


@dataclass(frozen=True)
class Hit:
    """One hit: where it is, how strong, and its faults.

    Attributes
    ----------
    channel : str
        Name of the force channel.
    start, end : int
        Samples [start, end) of the pulse, second peak included.
    stop : int
        One past the last sample before the next hit, a gap or the end of the record.
    piece : tuple (start, stop)
        The piece without gaps that the hit is in.
    peak_sample, peak : int, float
        The highest sample and its force, less the channel's median [channel's unit].
    second_seconds, second_ratio : float
        A second peak: time after the main one [s] (negative before), share of it; 0 without.
    faults : tuple of str
        Of "double", "clipped", "short" (decay not recorded), "cut" (the pulse itself is).
    """

    channel: str
    start: int
    end: int
    stop: int
    piece: tuple[int, int]
    peak_sample: int
    peak: float
    second_seconds: float
    second_ratio: float
    faults: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Hits:
    """All hits of a record in order of time, and findings about them."""

    hits: tuple[Hit, ...]
    dt: float
    findings: tuple[Finding, ...]

    def __len__(self) -> int:
        return len(self.hits)

    def __iter__(self) -> Iterator[Hit]:
        return iter(self.hits)

    def __getitem__(self, index: int) -> Hit:
        return self.hits[index]

    def without(self, *faults: str) -> tuple[Hit, ...]:
        """Return the hits that have none of the faults; of no fault at all by default."""
        refused = set(faults or FAULTS)
        return tuple(hit for hit in self.hits if not refused & set(hit.faults))


def find_hits(
    record: Record,
    inputs: str | Sequence[str] | None = None,
    *,
    threshold: float = THRESHOLD,
    separation: float = SEPARATION,
    decay_seconds: float | None = None,
    full_scale: float | None = None,
) -> Hits:
    """Find the hits of one or several hammers.

    A hit is where a force, less its median, exceeds both `threshold` times the channel's
    largest and ten times its noise floor (1.4826 times the median deviation).

    Parameters
    ----------
    record : Record
        With the forces among its inputs, in memory or on disk.
    inputs : str or sequence of str, optional
        The force channels; by default all inputs of quantity "force", or all inputs.
    threshold : float
        Share of a channel's largest force, between 0 and 1.
    separation : float
        Peaks nearer than this [s] are one hit: double, when the second is at least a tenth of
        the first, has its sign, and the force falls between them.
    decay_seconds : float, optional
        How long each decay must be recorded [s]; a shorter one is "short". By default half of
        the median of what the hits have.
    full_scale : float, optional
        Limit of the force channel [its unit]; hits within 1 % of it are "clipped". Without it,
        three equal samples at the peak say so.

    Returns
    -------
    Hits
        Faulty ones too; `hit_segments` leaves them out. A force at the same time as a tenfold
        larger one of another hammer is crosstalk: left out, with a finding.

    Raises
    ------
    OptionError
        No inputs, unknown names, threshold not between 0 and 1, other limits not positive.
    DataError
        No hit.

    Examples
    --------
    >>> force = np.zeros(1000)
    >>> force[[100, 101, 102]] = 1.0, 2.0, 1.0
    >>> hits = find_hits(Record(np.zeros(1000), force, dt=0.01))
    >>> len(hits), hits[0].start, hits[0].end, hits[0].peak, hits[0].faults
    (1, 100, 103, 2.0, ())
    """
    names = _force_names(record, inputs)
    for name, value in (("separation", separation), ("decay_seconds", decay_seconds)):
        if value is not None:
            check_positive(name, value, "s")
    if full_scale is not None:
        check_positive("full_scale", full_scale)
    if not 0 < threshold < 1:
        raise OptionError(f"threshold must be between 0 and 1; got {threshold:g}.")
    pieces = record.segments()
    gap = max(1, round(separation / record.dt))
    found = [
        _hit(record, name, pulse, pieces)
        for name in names
        for pulse in _pulses(record, name, pieces, threshold, gap, full_scale)
    ]
    if not found:
        raise DataError(
            f"No hit in {', '.join(names)}: no force exceeds {NOISE_FACTOR:g} times its noise "
            "floor. Check which channel is the hammer's."
        )
    hits, crosstalk = _without_crosstalk(sorted(found, key=lambda hit: hit.start), gap)
    hits = _with_ends(hits, record.dt, decay_seconds)
    return Hits(tuple(hits), record.dt, (*_crosstalk(crosstalk, record.dt), *_faults(hits, record)))


def _force_names(record: Record, inputs: str | Sequence[str] | None) -> tuple[str, ...]:
    if record.n_inputs == 0:
        raise OptionError(
            "Hits are found in a force; the record has no inputs. Name the hammer when reading "
            "(inputs=…) or by select(inputs=…)."
        )
    if inputs is not None:
        names = (inputs,) if isinstance(inputs, str) else tuple(inputs)
        check_names("input", names, record.input_names)
        return names
    forces = [channel.name for channel in record.input_channels if channel.quantity == "force"]
    return tuple(forces) or record.input_names


def _pulses(
    record: Record,
    name: str,
    pieces: Sequence[tuple[int, int]],
    threshold: float,
    gap: int,
    full_scale: float | None,
) -> Iterator[Pulse]:
    column = record.input_names.index(name)
    raw = np.full(record.n_samples, np.nan)
    for start, stop in pieces:  # where any channel is missing there is nothing to use
        raw[start:stop] = record.inputs[start:stop][:, column]
    force, floor = centred(raw)
    level = max(threshold * float(np.abs(force).max()), NOISE_FACTOR * floor)
    if level == 0:
        return
    for start, stop in pieces:
        piece = force[start:stop]
        parts = groups(piece, level, gap)
        limits = [first for first, _ in parts[1:]] + [stop - start] * bool(parts)
        for (first, last), limit in zip(parts, limits, strict=True):
            pulse = pulse_in(piece, first, min(last + gap, limit), floor, full_scale)
            yield _moved(pulse, start)


def _moved(pulse: Pulse, by: int) -> Pulse:
    return replace(
        pulse,
        start=pulse.start + by,
        end=pulse.end + by,
        peak_sample=pulse.peak_sample + by,
        second_sample=pulse.second_sample + by,
    )


def _hit(record: Record, name: str, pulse: Pulse, pieces: Sequence[tuple[int, int]]) -> Hit:
    piece = next(each for each in pieces if each[0] <= pulse.peak_sample < each[1])
    is_double = pulse.second_ratio > 0
    marks = {
        "double": is_double,
        "clipped": pulse.is_clipped,
        "cut": pulse.start == piece[0] or pulse.end == piece[1],
    }
    return Hit(
        channel=name,
        start=pulse.start,
        end=pulse.end,
        stop=piece[1],
        piece=piece,
        peak_sample=pulse.peak_sample,
        peak=pulse.peak,
        second_seconds=(pulse.second_sample - pulse.peak_sample) * record.dt if is_double else 0.0,
        second_ratio=pulse.second_ratio,
        faults=tuple(name for name, is_so in marks.items() if is_so),
    )


def _without_crosstalk(hits: list[Hit], gap: int) -> tuple[list[Hit], list[Hit]]:
    """Part hits from what much larger hits of other channels left at the same time."""

    def is_crosstalk(hit: Hit) -> bool:
        return any(
            other.channel != hit.channel
            and abs(other.peak_sample - hit.peak_sample) <= gap
            and abs(hit.peak) < CROSSTALK * abs(other.peak)
            for other in hits
        )

    left_out = [hit for hit in hits if is_crosstalk(hit)]
    return [hit for hit in hits if hit not in left_out], left_out


def _with_ends(hits: list[Hit], dt: float, decay_seconds: float | None) -> list[Hit]:
    """Return the hits that stop before the next one, and are short where that is too soon."""
    following = [hit.start for hit in hits[1:]] + [hits[-1].piece[1] + GUARD]
    stopped = [
        replace(hit, stop=max(hit.end, min(hit.stop, after - GUARD)))
        for hit, after in zip(hits, following, strict=True)
    ]
    lengths = np.array([(hit.stop - hit.peak_sample) * dt for hit in stopped])
    wanted = SHORT_SHARE * float(np.median(lengths)) if decay_seconds is None else decay_seconds
    return [
        replace(hit, faults=(*hit.faults, "short")) if length < wanted else hit
        for hit, length in zip(stopped, lengths, strict=True)
    ]


# -- what is said


def _crosstalk(hits: Sequence[Hit], dt: float) -> list[Finding]:
    return [
        Finding(
            "crosstalk",
            "note",
            f"The force {hit.peak:.3g} of {hit.channel} at {hit.peak_sample * dt:.4g} s stands "
            f"beside a hit of another hammer more than {1 / CROSSTALK:g} times as strong and was "
            "not counted.",
        )
        for hit in hits
    ]


def _faults(hits: Sequence[Hit], record: Record) -> list[Finding]:
    return [
        _finding(fault, number, hit, record.dt)
        for number, hit in enumerate(hits, start=1)
        for fault in hit.faults
    ]


def _finding(fault: str, number: int, hit: Hit, dt: float) -> Finding:
    where = f"Hit {number} of {hit.channel} at {hit.peak_sample * dt:.4g} s"
    if fault == "double":
        return Finding(
            "double hit",
            "doubt",
            f"{where} is double: a second peak of {100 * hit.second_ratio:.3g} % "
            f"{abs(hit.second_seconds):.3g} s {'later' if hit.second_seconds > 0 else 'earlier'}.",
            "Its force is measured, so accept=['double'] is right in the time domain; in "
            "frequency responses its spectrum may have holes.",
        )
    if fault == "clipped":
        return Finding(
            "clipped force",
            "warning",
            f"{where} is clipped at {hit.peak:.4g}: the true force is larger and unknown.",
            "Leave it out, and measure with a larger range.",
        )
    if fault == "short":
        return Finding(
            "short decay",
            "doubt",
            f"After {where[0].lower()}{where[1:]} only {(hit.stop - hit.peak_sample) * dt:.3g} s "
            "are recorded.",
            "Right in the time domain (accept=['short']); frequency responses of it leak.",
        )
    return Finding(
        "cut pulse",
        "warning",
        f"{where} touches a gap or an end of the record: part of its force is missing.",
        "Leave it out; trigger earlier.",
    )
