"""Files of named arrays (NPZ, MAT, HDF5): which arrays are signals, labels, time or interval."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import DataError, FileError, OptionError, check_names
from ..record import Channel, Signal
from .labels import ALIAS, channel_of
from .tables import DT_AGREEMENT, Columns, Part, Table, check_unique_names, uniform_step

INTERVAL_NAMES = ("dt", "ts", "delta_t", "sampling_interval", "sample_interval", "sampling_period")
RATE_NAMES = ("fs", "rate", "sampling_rate", "sample_rate", "sampling_frequency", "samplerate")
TIME_NAMES = ("t", "time")
ROLE_NAMES = (("y", "u"), ("outputs", "inputs"), ("output", "input"))


@dataclass(frozen=True, eq=False)
class Arrays:
    """The named arrays of a file.

    Parameters
    ----------
    numeric : name → Part
        Real or complex arrays with at least one axis, still on disk where the format allows.
    texts : name → list of str
        One-dimensional arrays of text: candidates for labels.
    scalars : name → float
        Single numbers: candidates for the sampling interval or rate.
    units : name → str
        Units of numeric arrays, where the file states them.
    """

    path: Path
    numeric: Mapping[str, Part]
    texts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    scalars: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)


def table_of(arrays: Arrays, variable: str | Sequence[str] | None = None) -> Table:
    """Return the table in a file of named arrays.

    Arrays called y and u (or outputs and inputs) are taken as such; otherwise the only
    signal, or all one-dimensional signals of one length. What remains undecided is asked for:
    `variable` names the array, or several of one length.
    """
    outputs, inputs = _roles(arrays, variable)
    lengths = {name: arrays.numeric[name].shape[0] for name in (*outputs, *inputs)}
    if len(set(lengths.values())) > 1:
        listed = ", ".join(f"{name}: {n}" for name, n in lengths.items())
        raise FileError(
            f"{arrays.path} has signals of different length ({listed}); give variable "
            "(--variable NAME) to read one."
        )
    for name in (*outputs, *inputs):
        _check_signal(arrays, name)
    y, y_channels = _side(arrays, outputs, "ch" if variable or not inputs else "y")
    u, u_channels = _side(arrays, inputs, "u") if inputs else (None, ())
    check_unique_names(arrays.path, [c.name for c in (*u_channels, *y_channels)])
    found = _interval(arrays, tuple(lengths))
    numbered = all(ALIAS.match(channel.name) for channel in y_channels)
    return Table(y, y_channels, u, u_channels, found, arrays.path.name, numbered)


# -- which arrays are the signals


def _roles(
    arrays: Arrays, variable: str | Sequence[str] | None
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the arrays of outputs and of inputs."""
    if variable is not None:
        wanted = tuple(variable.split(",")) if isinstance(variable, str) else tuple(variable)
        check_names("array", wanted, tuple(arrays.numeric) or ("none",))
        return wanted, ()
    by_stem = {_stem(name).lower(): name for name in arrays.numeric}
    for y, u in ROLE_NAMES:
        if y in by_stem and u in by_stem:
            return (by_stem[y],), (by_stem[u],)
    names = _candidates(arrays)
    if not names:
        raise FileError(f"{arrays.path} holds no signal: no numeric array of two samples or more.")
    wide = [name for name in names if arrays.numeric[name].n_columns > 1]
    lengths = {arrays.numeric[name].shape[0] for name in names}
    if len(names) == 1 or (not wide and len(lengths) == 1):
        return tuple(names), ()
    shown = ", ".join(f"{name} {arrays.numeric[name].shape}" for name in names[:12])
    raise OptionError(
        f"{arrays.path} holds several arrays that could be the signals: {shown}; give variable "
        "(--variable NAME, or several of one length as NAME,NAME)."
    )


def _candidates(arrays: Arrays) -> list[str]:
    """Return the arrays that are neither time nor the numbers of another array's columns."""
    axes = {n for part in arrays.numeric.values() for n in part.shape[1:] if n > 1}
    return [
        name
        for name, part in arrays.numeric.items()
        if _stem(name).lower() not in (*TIME_NAMES, *INTERVAL_NAMES, *RATE_NAMES)
        and not (len(part.shape) == 1 and part.shape[0] in axes)
    ]


def _check_signal(arrays: Arrays, name: str) -> None:
    part = arrays.numeric[name]
    if part.base.dtype.kind not in "iuf":
        kind = "complex numbers" if part.base.dtype.kind == "c" else f"dtype {part.base.dtype}"
        raise DataError(f"{name} in {arrays.path} holds {kind}; a record holds real numbers.")
    if math.prod(part.shape) < 2:
        raise FileError(
            f"{name} in {arrays.path} has the shape {part.shape}; a record needs at least 2 "
            "samples."
        )
    if part.shape[0] < max(2, part.n_columns):
        raise FileError(
            f"{name} in {arrays.path} has {part.shape[0]} samples of {part.n_columns} channels "
            f"(shape {part.shape}): time runs along axis 0. If it runs along the last axis, give "
            "transpose=True (--transpose)."
        )


def _stem(name: str) -> str:
    return name.rpartition("/")[2]


# -- names of the channels


def _side(arrays: Arrays, names: Sequence[str], prefix: str) -> tuple[Signal, tuple[Channel, ...]]:
    channels = [c for name in names for c in _channels(arrays, name, prefix, len(names) == 1)]
    return Columns(tuple(arrays.numeric[name] for name in names), arrays.path), tuple(channels)


def _channels(arrays: Arrays, name: str, prefix: str, alone: bool) -> list[Channel]:
    """Name the columns of an array: by labels beside it, or by numbers.

    A single two-axis array gives short names (its labels, or ch1, ch2, …); otherwise the
    name of the array goes first: acc/1st Floor/x.
    """
    part = arrays.numeric[name]
    unit = arrays.units.get(name, "")
    if len(part.shape) == 1 and not (alone and prefix != "ch"):
        return [channel_of(_stem(name), unit)]
    axes = [_axis_labels(arrays, name, n) for n in part.shape[1:]]
    if alone and len(part.shape) <= 2:
        labels = axes[0] if axes else ["1"]
        return [channel_of(f"{prefix}{x}" if x.isdigit() else x, unit) for x in labels]
    grid: list[str] = [_stem(name)]
    for labels in axes:
        grid = [f"{head}/{label}" for head in grid for label in labels]
    return [channel_of(label, unit) for label in grid]


def _axis_labels(arrays: Arrays, name: str, count: int) -> list[str]:
    """Return distinct labels of a fitting length beside the array, or 1, 2, …

    Text goes before whole numbers; when two sets fit, none is preferred to the other.
    """
    folder = name.rpartition("/")[0]
    texts = [list(labels) for other, labels in arrays.texts.items() if _is_beside(other, folder)]
    numbers = [
        [str(int(x)) for x in part.read(0, count)[:, 0]]
        for other, part in arrays.numeric.items()
        if _is_beside(other, folder) and part.shape == (count,) and part.base.dtype.kind in "iu"
    ]
    for sets in (texts, numbers):
        fitting = [labels for labels in sets if _is_labelling(labels, count)]
        if len(fitting) == 1:
            return fitting[0]
    return [str(k + 1) for k in range(count)]


def _is_beside(other: str, folder: str) -> bool:
    return other.rpartition("/")[0] == folder


def _is_labelling(labels: Sequence[str], count: int) -> bool:
    return len(labels) == count and len(set(labels)) == count and all(labels)


# -- the sampling interval


def _interval(arrays: Arrays, names: Sequence[str]) -> float | None:
    """Return the interval [s] of the named arrays by dt, fs or time, checked to agree."""
    stated: dict[str, float] = {}
    for name, value in arrays.scalars.items():
        stem = _stem(name).lower()
        if not _belongs(name, names) or stem not in (*INTERVAL_NAMES, *RATE_NAMES):
            continue
        if not (value > 0 and math.isfinite(value)):
            raise FileError(f"{arrays.path} states {name} = {value:g}; it must be positive.")
        stated[name] = value if stem in INTERVAL_NAMES else 1.0 / value
    length = arrays.numeric[names[0]].shape[0]
    for name, part in arrays.numeric.items():
        is_time = _stem(name).lower() in TIME_NAMES and math.prod(part.shape) == length
        if is_time and _belongs(name, names) and name not in names:
            times = np.asarray(part.base[()], np.float64).reshape(-1)
            stated[name] = uniform_step(arrays.path, f"Time array {name!r}", times)
    for name, value in stated.items():
        first = next(iter(stated.values()))
        if abs(value - first) > DT_AGREEMENT * first:
            raise FileError(
                f"{arrays.path} contradicts itself: {next(iter(stated))} means {first:g} s between "
                f"samples, {name} means {value:g} s. Correct one of them."
            )
    return next(iter(stated.values()), None)


def _belongs(name: str, signals: Sequence[str]) -> bool:
    """Tell whether a number stands beside or above one of the signals, or on it."""
    folder = name.rpartition("/")[0]
    return not folder or any(s == folder or s.startswith(f"{folder}/") for s in signals)
