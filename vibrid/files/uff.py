"""Universal file format, data set 58: time signals and frequency responses, text or binary."""

from __future__ import annotations

import dataclasses
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, OptionError
from ..record import Channel, FrequencyResponses, Quantity
from .labels import channel_of
from .tables import Columns, Part, Table, check_unique_names, reading, uniform_step

MARKER = re.compile(rb" {4}-1(?= *[\r\n]| *\Z)")
TIME, FREQUENCY_RESPONSE, COHERENCE = 1, 4, 6
FUNCTIONS = {
    **{0: "general function", 1: "time response", 2: "auto spectrum", 3: "cross spectrum"},
    **{4: "frequency response", 5: "transmissibility", 6: "coherence", 7: "auto correlation"},
    **{8: "cross correlation", 9: "power spectral density", 10: "energy spectral density"},
    **{11: "probability density", 12: "spectrum", 18: "mode indicator function"},
    **{24: "shock response spectrum", 25: "impulse response filter", 26: "multiple coherence"},
    27: "order function",
}
QUANTITIES: dict[int, Quantity] = {
    **{8: "displacement", 9: "force", 11: "velocity", 12: "acceleration", 13: "force"}
}
AXES = {0: "S", 1: "X", 2: "Y", 3: "Z", 4: "RX", 5: "RY", 6: "RZ"}

Set = dict[str, Any]


def read_uff(path: Path, **_: Any) -> Table | FrequencyResponses:
    """Read the data sets 58 of a file: all time signals, or all frequency responses.

    A channel is named by node and direction (12Z+), or by its entity where there is no node;
    the quantity follows a slash where two channels would share a name (1Z+/force). A sensor
    in a negative direction has sign −1 at the DOF of the positive one. Other data sets
    (geometry, units) are left out.
    """
    sets = _sets(path)
    kinds = {s["func_type"] for s in sets}
    if kinds == {TIME}:
        return _time_signals(path, sets)
    if FREQUENCY_RESPONSE in kinds and kinds <= {FREQUENCY_RESPONSE, COHERENCE}:
        return _frequency_responses(path, sets)
    names = ", ".join(sorted(FUNCTIONS.get(kind, f"function type {kind}") for kind in kinds))
    raise FileError(
        f"{path} holds {names}; only time responses alone, or frequency responses with their "
        "coherence, are read. Export those to a file of their own."
    )


def _sets(path: Path) -> list[Set]:
    import pyuff

    with reading(path, "a UFF file"):
        _check_frame(path)
        file = pyuff.UFF(str(path))
        types = [int(kind) for kind in file.get_set_types()]
        if 58 not in types:
            listed = ", ".join(str(kind) for kind in sorted(set(types))) or "none"
            raise FileError(f"{path} has no data set 58 (it has: {listed}); export the signals.")
        sets = [file.read_sets(k) for k, kind in enumerate(types) if kind == 58]
        for number, s in enumerate(sets, start=1):
            _check_set(path, number, s)
        return sets


def _check_frame(path: Path) -> None:
    """Refuse a file whose data sets are not all opened and closed; pyuff would drop the rest."""
    content = path.read_bytes()
    marks = [match.span() for match in MARKER.finditer(content)]
    if not marks or content[: marks[0][0]].strip():
        raise FileError(f"{path} is not a universal file: it does not begin with '    -1'.")
    if len(marks) % 2 or content[marks[-1][1] :].strip():
        raise FileError(f"{path} is truncated: its last data set is not closed. Copy it again.")
    for (_, end), (start, _) in zip(marks[1::2], marks[2::2], strict=False):
        if content[end:start].strip():
            raise FileError(f"{path} is damaged: there are data between two data sets.")


def _check_set(path: Path, number: int, s: Set) -> None:
    points = len(s["data"])
    if points != s["num_pts"] or points == 0:
        raise FileError(
            f"{path} is damaged or truncated: data set {number} announces {s['num_pts']} points "
            f"and holds {points}."
        )
    if not (np.isfinite(s["data"]).all() and np.isfinite(s["x"]).all()):
        raise FileError(f"{path} is damaged: data set {number} holds values that are not finite.")


# -- time signals


def _time_signals(path: Path, sets: Sequence[Set]) -> Table:
    for s in sets:
        if np.iscomplexobj(s["data"]):
            raise FileError(f"{path} holds complex time signals; export them as real numbers.")
    _check_equal(path, sets, "num_pts", "samples")
    steps = [_step(path, s) for s in sets]
    if max(steps) - min(steps) > 1e-6 * min(steps):
        raise FileError(
            f"{path} has channels of different sampling interval: {min(steps):g} s to "
            f"{max(steps):g} s. Export those of one rate."
        )
    _check_equal(path, sets, "abscissa_min", "s as first instant")
    channels = _distinct(path, [_channel(s, "rsp", "ordinate") for s in sets])
    signal = Columns(tuple(Part(s["data"]) for s in sets), path)
    return Table(signal, tuple(channels), dt=steps[0], name=path.name)


def _step(path: Path, s: Set) -> float:
    """Return the interval of a set; printed with 6 digits when even, checked when uneven."""
    if s["abscissa_spacing"] == 1:
        step = float(s["abscissa_inc"])
        if not step > 0:
            raise FileError(f"{path} states a sampling interval of {step:g} s; correct it.")
        return step
    return uniform_step(path, f"The time axis of {_name(s, 'rsp')}", np.asarray(s["x"]))


def _check_equal(path: Path, sets: Sequence[Set], key: str, what: str) -> None:
    values = [s[key] for s in sets]
    if len(set(values)) > 1:
        raise FileError(
            f"{path} has channels of different extent: {min(values):g} to {max(values):g} {what}. "
            "Export channels of one measurement."
        )


# -- frequency responses


def _frequency_responses(path: Path, sets: Sequence[Set]) -> FrequencyResponses:
    responses = [s for s in sets if s["func_type"] == FREQUENCY_RESPONSE]
    coherences = [s for s in sets if s["func_type"] == COHERENCE]
    lines = np.asarray(responses[0]["x"], np.float64)
    for s in sets:
        if len(s["x"]) != len(lines) or not np.allclose(s["x"], lines, rtol=1e-6, atol=0):
            raise FileError(f"{path} has functions with different frequency lines; export one set.")
    rows = list(dict.fromkeys(_pair(s)[0] for s in responses))
    columns = list(dict.fromkeys(_pair(s)[1] for s in responses))
    values = _matrix(path, responses, rows, columns, "frequency response")
    outputs = {_pair(s)[0]: _channel(s, "rsp", "ordinate") for s in responses}
    inputs = {_pair(s)[1]: _channel(s, "ref", "orddenom") for s in responses}
    labels = _distinct(path, [*inputs.values(), *outputs.values()])
    return FrequencyResponses(
        values,
        lines,
        output_channels=labels[len(columns) :],
        input_channels=labels[: len(columns)],
        coherence=_matrix(path, coherences, rows, columns, "coherence").real
        if coherences
        else None,
    )


def _pair(s: Set) -> tuple[str, str]:
    return _name(s, "rsp"), _name(s, "ref")


def _matrix(
    path: Path, sets: Sequence[Set], rows: list[str], columns: list[str], what: str
) -> np.ndarray[Any, np.dtype[np.complex128]]:
    """Arrange functions as (lines, responses, references); every pair must be there once."""
    counts = Counter(_pair(s) for s in sets)
    every = [(row, column) for row in rows for column in columns]
    wrong = [pair for pair in every if counts[pair] != 1] + [p for p in counts if p not in every]
    if wrong:
        listed = ", ".join(f"{row} by {column}" for row, column in wrong[:8])
        raise FileError(
            f"{path} must hold each {what} once for every response and reference; missing or "
            f"repeated: {listed}."
        )
    values = np.empty((len(sets[0]["data"]), len(rows), len(columns)), np.complex128)
    for s in sets:
        row, column = _pair(s)
        values[:, rows.index(row), columns.index(column)] = s["data"]
    return values


# -- labels


def _name(s: Set, side: str) -> str:
    """Return node and direction, such as 12Z+, or the entity where there is no node."""
    node, direction = s[f"{side}_node"], s[f"{side}_dir"]
    entity = str(s[f"{side}_ent_name"]).strip()
    if node == 0 and entity not in ("", "NONE"):
        return entity
    if abs(direction) not in AXES:
        raise OptionError(f"A UFF direction runs from -6 to 6; got {direction}.")
    sign = "" if direction == 0 else "+" if direction > 0 else "-"
    return f"{node}{AXES[abs(direction)]}{sign}"


def _channel(s: Set, side: str, axis: str) -> Channel:
    name = _name(s, side)
    unit = str(s[f"{axis}_axis_units_lab"]).strip()
    channel = channel_of(name, "" if unit == "NONE" else unit)
    quantity = QUANTITIES.get(s[f"{axis}_spec_data_type"], channel.quantity)
    is_dof = s[f"{side}_node"] != 0
    return dataclasses.replace(
        channel,
        quantity=quantity,
        dof=re.sub("-$", "+", name) if is_dof else None,
        sign=-1 if is_dof and s[f"{side}_dir"] < 0 else 1,
    )


def _distinct(path: Path, channels: Sequence[Channel]) -> list[Channel]:
    """Add the quantity to names that occur twice: the driving point has two sensors."""
    counts = Counter(channel.name for channel in channels)
    named = [
        dataclasses.replace(c, name=f"{c.name}/{c.quantity}") if counts[c.name] > 1 else c
        for c in channels
    ]
    check_unique_names(path, [channel.name for channel in named])
    return named
