"""Walk records in chunks: find their pieces, centre and scale them, read them in stretches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .errors import DataError, OptionError, check_choice
from .record import Channel, Floats, Record, joined, rows_per_chunk

OFFSETS = ("estimate", "mean", "none")
CONSTANT_LIMIT = 1e-12  # std relative to the largest magnitude: what rounding leaves of a constant


@dataclass(frozen=True)
class Segment:
    """A contiguous piece of one record: samples [start, stop)."""

    record: int
    start: int
    stop: int

    @property
    def length(self) -> int:
        return self.stop - self.start


@dataclass(frozen=True, eq=False)
class Stream:
    """Records as one source of scaled, pre-centred samples z = [u; y].

    Scaling by powers of two is exact; the centre is a rough mean that keeps the sums
    well conditioned (and is zero for offset "none").

    Attributes
    ----------
    records : tuple of Record
    segments : tuple of Segment
        Pieces without gaps, in order.
    centre, scale : array (c,)
        z = (measured − centre) / scale, c = n_inputs + n_outputs, in the channels' units.
    deviation : array (c,)
        Standard deviation of each channel over all segments, in its unit.
    offset : "estimate", "mean" or "none"
    """

    records: tuple[Record, ...]
    segments: tuple[Segment, ...]
    centre: Floats
    scale: Floats
    deviation: Floats
    offset: str

    @property
    def n_inputs(self) -> int:
        return self.records[0].n_inputs

    @property
    def n_outputs(self) -> int:
        return self.records[0].n_outputs

    @property
    def n_samples(self) -> int:
        return sum(segment.length for segment in self.segments)

    @property
    def input_scale(self) -> Floats:
        return self.scale[: self.n_inputs]

    @property
    def output_scale(self) -> Floats:
        return self.scale[self.n_inputs :]

    @property
    def output_deviation(self) -> Floats:
        """Standard deviation of each output."""
        return self.deviation[self.n_inputs :]

    @property
    def output_balance(self) -> Floats:
        """What makes the scaled outputs' standard deviations exactly one."""
        return self.output_scale / self.output_deviation

    @property
    def output_unit(self) -> float:
        """Geometric mean of the outputs' deviations: the unit of unweighted singular values."""
        return float(np.exp(np.mean(np.log(self.output_deviation))))

    def read(self, segment: Segment, start: int, stop: int) -> Floats:
        """Return samples [start, stop) of a segment, centred and scaled (rows, channels)."""
        rows = self.records[segment.record].read(segment.start + start, segment.start + stop)
        scaled = np.subtract(rows, self.centre, order="C")  # whatever order the record has
        scaled *= 1 / self.scale  # exact for powers of two, and faster than to divide
        return np.asarray(scaled)

    def chunks(self, segment: Segment, rows: int | None = None) -> Iterator[tuple[int, Floats]]:
        """Yield (first row, samples) of a segment from front to end."""
        step = rows or rows_per_chunk(len(self.scale))
        for start in range(0, segment.length, step):
            yield start, self.read(segment, start, min(start + step, segment.length))


def as_records(data: Record | Sequence[Record]) -> tuple[Record, ...]:
    """Return one or several records as a tuple, checked to belong together."""
    if isinstance(data, Record):
        return (data,)
    if not isinstance(data, Iterable):
        raise OptionError(f"Expected a Record or several; got {type(data).__name__}.")
    records = tuple(data)
    if not records:
        raise OptionError("No record was given; give at least one.")
    first = records[0]
    for other in records:
        if not isinstance(other, Record):
            raise OptionError(f"Expected a Record; got {type(other).__name__}.")
        if (other.output_names, other.input_names) != (first.output_names, first.input_names):
            raise DataError("The records have different channels; select the same in each.")
        if abs(other.dt - first.dt) > 1e-9 * first.dt:
            raise DataError(
                f"The records have different sampling intervals, {first.dt:g} s and "
                f"{other.dt:g} s; decimate to one."
            )
    return records


def open_stream(data: Record | Sequence[Record], offset: str = "estimate") -> Stream:
    """Walk the data once: find segments, means and scales, and refuse what cannot be used.

    Raises
    ------
    DataError
        No sample without NaN, infinite values, or a constant channel.
    """
    check_choice("offset", offset, OFFSETS)
    records = as_records(data)
    segments, mean, std = _surveyed(records)
    channels = records[0].input_channels + records[0].output_channels
    if not segments:
        raise DataError(
            f"No sample has all {len(channels)} channels: every row holds a NaN. Leave out the "
            "channels that are missing (select(), or --outputs without them), or check the file."
        )
    _refuse_constant(channels, mean, std)
    level = std if offset != "none" else np.hypot(mean, std)
    return Stream(
        records,
        segments,
        centre=np.zeros_like(mean) if offset == "none" else mean,
        scale=np.exp2(np.round(np.log2(level))),
        deviation=std,
        offset=offset,
    )


def _surveyed(records: Sequence[Record]) -> tuple[tuple[Segment, ...], Floats, Floats]:
    """Return segments, means and deviations of all records from one walk over the data.

    Means and sums of squares are pooled over stretches (Chan, Golub & LeVeque 1983).
    """
    segments: list[Segment] = []
    count = 0
    mean = np.zeros(records[0].n_inputs + records[0].n_outputs)
    squares = np.zeros_like(mean)
    for index, record in enumerate(records):
        pieces = []
        for first, rows in record.stretches():
            pieces.append((first, first + len(rows)))
            ones = np.ones(len(rows))  # sums by BLAS: several times faster
            stretch_mean = ones @ rows / len(rows)
            shift = stretch_mean - mean
            total = count + len(rows)
            moved = rows - stretch_mean
            squares += ones @ moved**2 + shift**2 * count * len(rows) / total
            mean += shift * len(rows) / total
            count = total
        segments += [Segment(index, start, stop) for start, stop in joined(pieces)]
    return tuple(segments), mean, np.sqrt(squares / max(count, 1))


def _refuse_constant(channels: Sequence[Channel], mean: Floats, std: Floats) -> None:
    still = (std <= CONSTANT_LIMIT * np.abs(mean)) | (std == 0)
    flat = [channels[int(k)].name for k in np.flatnonzero(still)]
    if flat:
        names = ", ".join(flat[:6]) + (" …" if len(flat) > 6 else "")
        raise DataError(
            f"{len(flat)} of {len(channels)} channels do not move: {names} (standard deviation 0, "
            f"or below {CONSTANT_LIMIT:g} of the mean). A constant channel says nothing about the "
            "structure; leave it out (select(), or --inputs and --outputs without it)."
        )
