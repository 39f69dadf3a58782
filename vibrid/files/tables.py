"""What every format hands over: a table of signals on disk or in memory, with their labels."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, OptionError, VibridError, check_positive
from ..record import Channel, Floats, Signal

DT_AGREEMENT = 1e-3  # a given dt and the file's may differ by 0.1 %
STEP_TOLERANCE = 1e-3  # of the step: beyond it a time axis is uneven
LARGEST_ROUNDING = 0.5  # of the step: times printed coarser than this are uneven
RESOLUTION_SAMPLE = 200
SHORTEST_DT, LONGEST_DT = 1e-12, 1e9  # s: beyond, a slip of the pen


@dataclass(frozen=True, eq=False)
class Part:
    """One array of a file: time along its first axis, or along its last when `time_last`.

    `reversed_axes` tells that the file stores the axes in reverse, as MATLAB v7.3 does.
    """

    base: Any
    reversed_axes: bool = False
    time_last: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Axes as the author of the file sees them, time first."""
        shape = tuple(int(n) for n in self.base.shape)
        shape = shape[::-1] if self.reversed_axes else shape
        return (shape[-1], *shape[:-1]) if self.time_last else shape

    @property
    def n_columns(self) -> int:
        return math.prod(self.shape[1:])

    def read(self, start: int, stop: int) -> Any:
        """Return rows [start, stop) as (rows, n_columns)."""
        rows = slice(start, stop)
        stored_first = self.reversed_axes == self.time_last
        values = np.asarray(self.base[rows] if stored_first else self.base[..., rows])
        values = values.T if self.reversed_axes else values
        values = np.moveaxis(values, -1, 0) if self.time_last else values
        return values.reshape(stop - start, -1)


@dataclass(frozen=True, eq=False)
class Columns:
    """Arrays of one length side by side, read a stretch of rows at a time.

    A read that fails later, because the file is damaged inside, is a `FileError` too.
    """

    parts: tuple[Part, ...]
    path: Path

    @property
    def shape(self) -> tuple[int, int]:
        return (self.parts[0].shape[0], sum(part.n_columns for part in self.parts))

    @property
    def ndim(self) -> int:
        return 2

    @property
    def dtype(self) -> Any:
        return np.result_type(*(part.base.dtype for part in self.parts))

    def __getitem__(self, rows: slice) -> Any:
        start, stop, step = rows.indices(self.shape[0])
        with reading(self.path):
            return np.hstack([part.read(start, max(start, stop)) for part in self.parts])[::step]


@dataclass(frozen=True, eq=False)
class Table:
    """The content of a file before names are chosen; `numbered` when the file has no names."""

    outputs: Signal
    output_channels: tuple[Channel, ...]
    inputs: Signal | None = None
    input_channels: tuple[Channel, ...] = ()
    dt: float | None = None
    name: str = ""
    numbered: bool = False


@contextmanager
def reading(path: Path, kind: str = "") -> Iterator[None]:
    """Turn whatever a reading library raises into one `FileError`; keep its warnings quiet.

    Parsers raise anything on damaged bytes (struct, zlib, key, memory and value errors), so
    every exception that is not our own is caught here, and only here.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except VibridError:
        raise
    except Exception as problem:
        reason = str(problem).strip().split("\n")[0].rstrip(".")[:160] or type(problem).__name__
        what = f"as {kind} " if kind else ""
        raise FileError(
            f"{path} cannot be read {what}({reason}); it is damaged, truncated or of another kind. "
            "Export or copy it again."
        ) from None


def check_unique_names(path: Path, names: Sequence[str]) -> None:
    """Raise `FileError` when two channels of a file bear one name."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise FileError(f"{path} has two channels called {name!r}; rename one of them.")
        seen.add(name)


def settle_dt(path: Path, found: float | None, given: float | None, hint: str = "") -> float:
    """Return the sampling interval [s]: given, found in the file, or asked for."""
    if given is not None:
        check_positive("dt", given, "s")
        if not SHORTEST_DT <= given <= LONGEST_DT:
            raise OptionError(
                f"dt = {given:g} s is no sampling interval; give seconds from {SHORTEST_DT:g} to "
                f"{LONGEST_DT:g}."
            )
        if found is not None and abs(given - found) > DT_AGREEMENT * found:
            raise OptionError(
                f"dt = {given:g} s disagrees with {path}, whose samples are {found:g} s apart; "
                "leave dt (--dt) out or correct the file."
            )
        return float(given)
    if found is None:
        raise OptionError(
            f"The sampling interval cannot be known from {path}{hint}; give dt (--dt S)."
        )
    if not SHORTEST_DT <= found <= LONGEST_DT:
        raise FileError(
            f"{path} states a sampling interval of {found:g} s; it must be from {SHORTEST_DT:g} "
            f"to {LONGEST_DT:g} s. Correct it."
        )
    return found


def uniform_step(path: Path, what: str, times: Floats) -> float:
    """Return the step of an evenly rising time axis, or raise `FileError`.

    Steps may differ by 0.1 %, or by what the printed digits of the times cannot resolve.
    """
    _check_times(path, what, times)
    steps = np.diff(times)
    step = float(times[-1] - times[0]) / len(steps)
    usual = float(np.median(steps))
    uneven = np.abs(steps - usual)
    line = np.abs(times - times[0] - step * np.arange(len(times)))
    rounded = line.max() <= _resolution(times) and uneven.max() <= LARGEST_ROUNDING * step
    if usual > 0 and (uneven.max() <= STEP_TOLERANCE * usual or rounded):
        return step
    worst = int(np.argmax(uneven))
    raise FileError(
        f"{what} of {path} is uneven: row {worst + 2} is {steps[worst]:g} after the row before, "
        f"where {usual:g} is usual. Resample to even steps, or insert rows with empty cells "
        "where samples are missing."
    )


def _check_times(path: Path, what: str, times: Floats) -> None:
    if len(times) < 2:
        raise FileError(f"{path} holds {len(times)} sample; a record needs at least 2.")
    bad = np.flatnonzero(~np.isfinite(times))
    if len(bad):
        raise FileError(
            f"{what} of {path} has no number in row {bad[0] + 1}; fill in the time, and leave "
            "only the measured cells empty."
        )


def _resolution(times: Floats) -> float:
    """Return the unit of the last printed digit, read from the last times of the axis."""
    digits = 0
    for value in times[-RESOLUTION_SAMPLE:]:
        mantissa, _, exponent = repr(float(value)).partition("e")
        decimals = len(mantissa.partition(".")[2].rstrip("0")) - int(exponent or 0)
        digits = max(digits, decimals)
    return float(10.0**-digits)
