"""Record: outputs and inputs sampled together, with their labels."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import DataError, OptionError, check_choice, check_names, check_positive, check_whole
from . import processing
from .channels import Channel, Labels, check_unique, make_channels
from .signals import Floats, Signal, as_signal, in_memory, rows_per_chunk, take


@dataclass(frozen=True, eq=False, init=False)
class Record:
    """Hold outputs and inputs that were sampled together.

    Time is always axis 0. A missing sample is NaN; the rows between gaps are the record's
    `segments`. Arrays on disk (memory-mapped, HDF5, Zarr) stay there: slicing and selecting
    are lazy, filters ask for `in_memory()` first.

    Parameters
    ----------
    outputs : array (n_samples, n_outputs) or (n_samples,)
        Measured responses.
    inputs : array (n_samples, n_inputs) or (n_samples,), optional
        Measured forces or base motion; without them the record is output-only.
    dt : float
        Sampling interval [s].
    output_channels, input_channels : sequence of Channel or str, optional
        Labels; by default y1, y2, … and u1, u2, … of quantity "other".
    name : str
        Shown in summaries.

    Raises
    ------
    DataError
        Complex or text data, wrong or transposed shape, unequal lengths, repeated names.
    OptionError
        dt not positive, labels that do not match the columns.

    Examples
    --------
    >>> record = Record([[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]], dt=0.5)
    >>> record.n_samples, record.n_outputs, record.n_inputs, record.duration
    (3, 2, 0, 1.5)
    """

    outputs: Any
    inputs: Any
    dt: float
    output_channels: tuple[Channel, ...]
    input_channels: tuple[Channel, ...]
    name: str

    def __init__(
        self,
        outputs: Any,
        inputs: Any = None,
        *,
        dt: float,
        output_channels: Labels = None,
        input_channels: Labels = None,
        name: str = "",
    ) -> None:
        check_positive("dt", dt, "s")
        y = as_signal(outputs, "outputs")
        u = as_signal(np.zeros((y.shape[0], 0)) if inputs is None else inputs, "inputs")
        _check_shapes(y, u)
        output_labels = make_channels(output_channels, y.shape[1], "y")
        input_labels = make_channels(input_channels, u.shape[1], "u")
        check_unique(input_labels + output_labels)
        for field, value in (
            ("outputs", y),
            ("inputs", u),
            ("dt", float(dt)),
            ("output_channels", output_labels),
            ("input_channels", input_labels),
            ("name", name),
        ):
            object.__setattr__(self, field, value)

    def __repr__(self) -> str:
        names = f" {self.name!r}" if self.name else ""
        return (
            f"<Record{names}: {self.n_samples} samples of {self.n_outputs} outputs and "
            f"{self.n_inputs} inputs, dt={self.dt:g} s>"
        )

    # -- what is in it

    @property
    def n_samples(self) -> int:
        return int(self.outputs.shape[0])

    @property
    def n_outputs(self) -> int:
        return int(self.outputs.shape[1])

    @property
    def n_inputs(self) -> int:
        return int(self.inputs.shape[1])

    @property
    def duration(self) -> float:
        """Number of samples times dt [s]."""
        return self.n_samples * self.dt

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.output_channels)

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.input_channels)

    @property
    def is_in_memory(self) -> bool:
        return in_memory(self.outputs) and in_memory(self.inputs)

    def read(self, start: int, stop: int) -> Floats:
        """Return rows [start, stop) of [inputs, outputs] as one float64 array."""
        u, y = self.inputs[start:stop], self.outputs[start:stop]
        if not self.n_inputs:
            return np.asarray(y, dtype=np.float64)
        rows = np.empty((len(y), self.n_inputs + self.n_outputs))
        rows[:, : self.n_inputs] = u
        rows[:, self.n_inputs :] = y
        return rows

    def chunks(self, rows: int | None = None) -> Iterator[tuple[int, Floats]]:
        """Yield (first row, rows of [inputs, outputs]) from front to end."""
        step = rows or rows_per_chunk(self.n_inputs + self.n_outputs)
        for start in range(0, self.n_samples, step):
            yield start, self.read(start, min(start + step, self.n_samples))

    def stretches(self) -> Iterator[tuple[int, Floats]]:
        """Yield (first row, rows) without NaN from front to end, cut at gaps and between chunks.

        Raises
        ------
        DataError
            A value is infinite.
        """
        for first, rows in self.chunks():
            with np.errstate(invalid="ignore", over="ignore"):
                whole = np.isfinite(rows.sum())  # a sum hides nothing: NaN and infinity stay
            if whole:
                yield first, rows
                continue
            if np.isinf(rows).any():
                row = first + int(np.flatnonzero(np.isinf(rows).any(axis=1))[0])
                raise DataError(
                    f"Sample {row} of {self.name or 'the record'} is infinite; write NaN where a "
                    "sample is missing."
                )
            for start, stop in _runs(np.asarray(~np.isnan(rows).any(axis=1))):
                yield first + start, rows[start:stop]

    def segments(self) -> tuple[tuple[int, int], ...]:
        """Return (start, stop) of every contiguous piece without NaN; one pass over the data.

        Raises
        ------
        DataError
            A value is infinite.
        """
        return joined((first, first + len(rows)) for first, rows in self.stretches())

    # -- parts of it

    def slice(self, start: int, stop: int | None = None) -> Record:
        """Return samples [start, stop); negative numbers count from the end."""
        begin, end, _ = slice(start, stop).indices(self.n_samples)
        if end <= begin:
            raise OptionError(
                f"Samples {start} to {stop} are empty: the record has {self.n_samples} samples."
            )
        return self._replace(take(self.outputs, begin, end), take(self.inputs, begin, end))

    def between(self, start: float, stop: float) -> Record:
        """Return the samples with start ≤ t < stop; times in seconds from the first sample."""
        edges = np.clip(np.array([start, stop]) / self.dt - 1e-9, 0, self.n_samples)
        first, last = (0, 0) if np.isnan(edges).any() else np.ceil(edges).astype(int).tolist()
        if last <= first:
            raise OptionError(
                f"There is no sample between {start:g} s and {stop:g} s: the record runs from "
                f"0 to {self.duration:g} s."
            )
        return self.slice(first, last)

    def select(
        self, outputs: Sequence[str] | None = None, inputs: Sequence[str] | None = None
    ) -> Record:
        """Return the channels of these names, in this order; any channel may be either side.

        `outputs` None keeps all outputs that were not made inputs; `inputs` None keeps all
        inputs that were not made outputs.
        """
        outputs = [outputs] if isinstance(outputs, str) else outputs
        inputs = [inputs] if isinstance(inputs, str) else inputs
        names = self.input_names + self.output_names
        check_names("channel", [*(outputs or ()), *(inputs or ())], names)
        if outputs is None:
            outputs = [name for name in self.output_names if name not in (inputs or ())]
        if inputs is None:
            inputs = [name for name in self.input_names if name not in outputs]
        both = sorted(set(outputs) & set(inputs))
        if both:
            raise OptionError(f"Channel {both[0]!r} cannot be input and output at once.")
        if not outputs:
            raise OptionError("No output is left; at least one channel must be an output.")
        y, y_labels = self._pick(outputs)
        u, u_labels = self._pick(inputs)
        return self._replace(y, u, output_channels=y_labels, input_channels=u_labels)

    def relabel(self, output_channels: Labels = None, input_channels: Labels = None) -> Record:
        """Return the record with other channel labels; None keeps the old ones."""
        return Record(
            self.outputs,
            self.inputs,
            dt=self.dt,
            output_channels=output_channels or self.output_channels,
            input_channels=input_channels or self.input_channels,
            name=self.name,
        )

    def in_memory(self) -> Record:
        """Return the record with its arrays read into memory as float64."""
        return self._replace(
            np.asarray(self.outputs[:], dtype=np.float64), np.asarray(self.inputs[:], np.float64)
        )

    # -- made from it

    def detrend(self, kind: str = "linear") -> Record:
        """Return the record less a constant or a straight line, fitted to each channel."""
        check_choice("kind", kind, ("constant", "linear"))
        self._need_memory("detrend")
        return self._each(lambda x: processing.detrend(x, kind))

    def bandpass(self, low_hz: float, high_hz: float, *, filter_order: int = 4) -> Record:
        """Return the record filtered forward and backward (zero phase) by a Butterworth.

        `low_hz` 0 makes it a low-pass, `high_hz` at or above Nyquist a high-pass. Pieces
        between gaps are filtered apart.
        """
        self._need_memory("bandpass")
        sections = processing.butterworth(low_hz, high_hz, self.dt, filter_order)
        return self._each(lambda x: processing.zero_phase(x, sections))

    def to_band(self, low_hz: float, high_hz: float) -> Record:
        """Return the record filtered (zero phase) and decimated to a band of interest.

        Decimated so that `high_hz` lies between 40 and 80 % of the new Nyquist frequency, and
        high-passed at `low_hz` unless that is 0. What the anti-alias filter leaves above
        `high_hz` stays: a sharper edge would add the filter's own poles to the modes.
        """
        nyquist = 0.5 / self.dt
        processing.check_band(low_hz, high_hz, nyquist)
        record = self.decimate(max(1, int(processing.PASSED_SHARE * nyquist / high_hz)))
        return record.bandpass(low_hz, np.inf) if low_hz > 0 else record

    def decimate(self, factor: int) -> Record:
        """Return every `factor`-th sample after a zero-phase anti-alias low-pass.

        The low-pass keeps 80 % of the new band to the new Nyquist frequency.
        """
        check_whole("factor", factor, 1)
        self._need_memory("decimate")
        if factor == 1:
            return self
        return self._each(lambda x: processing.decimate(x, factor), dt=self.dt * factor)

    def correct_delays(self) -> Record:
        """Return the record with every channel's `delay` removed by a fractional shift.

        A windowed-sinc interpolation, flat to 0.9 of Nyquist; the first and last 32 samples
        of a piece are extrapolated at the ends and less exact.
        """
        self._need_memory("correct_delays")
        moved = [
            processing.shift(
                np.asarray(signal), np.array([channel.delay / self.dt for channel in channels])
            )
            for signal, channels in (
                (self.outputs, self.output_channels),
                (self.inputs, self.input_channels),
            )
        ]
        return self._replace(
            *moved,
            output_channels=tuple(dataclasses.replace(c, delay=0.0) for c in self.output_channels),
            input_channels=tuple(dataclasses.replace(c, delay=0.0) for c in self.input_channels),
        )

    # -- helpers

    def _pick(self, names: Sequence[str]) -> tuple[Signal, tuple[Channel, ...]]:
        if len(set(names)) != len(names):
            raise OptionError(f"A channel is named twice in {', '.join(names)}.")
        if not names:
            return np.zeros((self.n_samples, 0)), ()
        for known, labels, signal in (
            (self.output_names, self.output_channels, self.outputs),
            (self.input_names, self.input_channels, self.inputs),
        ):
            if all(name in known for name in names):
                columns = tuple(known.index(name) for name in names)
                return take(signal, 0, self.n_samples, columns), tuple(labels[k] for k in columns)
        self._need_memory("select channels from inputs and outputs at once")
        every = self.output_channels + self.input_channels
        both = np.hstack([self.outputs, self.inputs])
        columns = tuple([channel.name for channel in every].index(name) for name in names)
        return both[:, columns], tuple(every[k] for k in columns)

    def _each(self, operation: Any, dt: float | None = None) -> Record:
        return self._replace(
            operation(np.asarray(self.outputs)), operation(np.asarray(self.inputs)), dt=dt
        )

    def _replace(
        self,
        outputs: Any,
        inputs: Any,
        *,
        dt: float | None = None,
        output_channels: tuple[Channel, ...] | None = None,
        input_channels: tuple[Channel, ...] | None = None,
    ) -> Record:
        made = object.__new__(Record)
        for field, value in (
            ("outputs", outputs),
            ("inputs", inputs),
            ("dt", dt or self.dt),
            ("output_channels", output_channels or self.output_channels),
            ("input_channels", self.input_channels if input_channels is None else input_channels),
            ("name", self.name),
        ):
            object.__setattr__(made, field, value)
        return made

    def _need_memory(self, what: str) -> None:
        if not self.is_in_memory:
            raise OptionError(
                f"To {what}, the record must be in memory; call in_memory() first, or on a part: "
                "record.slice(start, stop).in_memory(). On the command line, choose fewer channels."
            )


def _check_shapes(y: Signal, u: Signal) -> None:
    if y.shape[0] == 0 or y.shape[1] == 0:
        raise DataError(f"outputs are empty: shape {tuple(y.shape)}.")
    if y.shape[0] != u.shape[0]:
        raise DataError(
            f"outputs have {y.shape[0]} samples and inputs {u.shape[0]}; time is axis 0 in both, "
            "and they must be equally long."
        )
    if y.shape[0] < y.shape[1]:
        raise DataError(
            f"outputs have {y.shape[0]} sample{'s' * (y.shape[0] != 1)} of {y.shape[1]} channels: "
            "time is axis 0, and a record needs at least as many samples as channels. The record "
            "is too short, or the array must be transposed."
        )


def joined(stretches: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
    """Return (start, stop) of pieces from stretches in order, those that touch as one."""
    pieces: list[tuple[int, int]] = []
    for start, stop in stretches:
        if pieces and pieces[-1][1] == start:
            pieces[-1] = (pieces[-1][0], stop)
        else:
            pieces.append((start, stop))
    return tuple(pieces)


def _runs(good: np.ndarray[Any, np.dtype[np.bool_]]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
