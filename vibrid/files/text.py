"""CSV, TSV and headerless text: columns of numbers, with or without names and units."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ..errors import FileError
from ..record import Channel, Floats
from .labels import channel_of, split_unit
from .layout import Layout, Line, layout_of, number_of
from .tables import Table, check_unique_names, reading, settle_dt, uniform_step

MARK = "# vibrid "  # begins the line that write_record puts first
TIME_NAMES = ("t", "time", "zeit", "temps", "tiempo", "tempo", "tid", "timestamp", "elapsed time")
TIME_UNITS = {
    **dict.fromkeys(("", "s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "μs"), 1e-6),
    "min": 60.0,
    "h": 3600.0,
}
SAMPLE_LINES = 1000  # lines read before delimiter and decimal sign are settled
CHUNK_LINES = 50_000
SHORTEST_TIME = 8  # an unnamed column must rise at least this often to be taken for time


def read_text(path: Path, *, dt: float | None = None, **_: Any) -> Table:
    """Read columns of numbers; a first line of text names them, with units.

    Lines that begin with # or % are comments. Cells are separated by comma, semicolon, tab or
    white space; with semicolon or tab the decimal sign may be a comma. Empty cells and "nan"
    are missing samples. Channels of a file without names are ch1, ch2, …, counted without the
    time column.
    """
    with reading(path, "text"), path.open(encoding=_encoding(path)) as file:
        comments: list[str] = []
        lines = _lines(file, comments)
        sample = list(islice(lines, SAMPLE_LINES))
        if not sample:
            raise FileError(f"{path} holds no numbers; give a file with rows of samples.")
        layout, heading, n_heading_lines = layout_of(path, sample, comments)
        values = _values(path, chain(sample[n_heading_lines:], lines), layout)
        return _table(path, values, heading, _stored(comments), dt)


# -- lines


def _encoding(path: Path) -> str:
    """Return the encoding; a file with zero bytes is not text, other odd bytes are Latin-1."""
    with path.open("rb") as file:
        head = file.read(4)
        if head[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return "utf-16"
        file.seek(0)
        encoding = "utf-8-sig"
        while block := file.read(2**20):
            if b"\0" in block:
                raise FileError(f"{path} is not a text file: it holds binary data.")
            if not block.isascii():
                encoding = "latin-1" if not _is_utf8(path) else encoding
                break
        return encoding


def _is_utf8(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8") as file:
            while file.read(2**20):
                pass
    except UnicodeDecodeError:
        return False
    return True


def _lines(file: TextIO, comments: list[str]) -> Iterator[Line]:
    """Yield the lines that hold cells; collect the comments."""
    for number, line in enumerate(file, start=1):
        if "\0" in line:
            raise FileError(f"Line {number} of {file.name} holds binary data; export it again.")
        text = line.strip(" \r\n")
        if text[:1] in ("#", "%"):
            comments.append(text)
        elif text and not text.isspace():
            yield number, text


# -- numbers


def _values(path: Path, lines: Iterator[Line], layout: Layout) -> Floats:
    chunks = []
    while chunk := list(islice(lines, CHUNK_LINES)):
        chunks.append(_chunk(path, chunk, layout))
    return np.concatenate(chunks)


def _chunk(path: Path, lines: Sequence[Line], layout: Layout) -> Floats:
    texts = [_plain(text, layout) for _, text in lines]
    _check_widths(path, lines, texts, layout)
    try:
        values = _fast(texts, layout)
    except (ValueError, DeprecationWarning):
        values = _slow(path, lines, texts, layout)
    if np.isinf(values).any():
        k, column = np.argwhere(np.isinf(values))[0]
        raise FileError(
            f"Line {lines[k][0]}, column {column + 1} of {path} is infinite; leave the cell empty "
            "where a sample is missing."
        )
    return values


def _plain(text: str, layout: Layout) -> str:
    if layout.quoted:
        text = text.replace('"', "")
    if layout.trailing and layout.delimiter:
        text = text.removesuffix(layout.delimiter)
    return text


def _check_widths(path: Path, lines: Sequence[Line], texts: Sequence[str], layout: Layout) -> None:
    if layout.delimiter is None:
        widths = [len(text.split()) for text in texts]
    else:
        widths = [text.count(layout.delimiter) + 1 for text in texts]
    if set(widths) == {layout.n_columns}:
        return
    k = next(k for k, width in enumerate(widths) if width != layout.n_columns)
    raise FileError(
        f"Line {lines[k][0]} of {path} has {widths[k]} cells where {layout.n_columns} are "
        "expected; the file is truncated or its rows differ."
    )


def _fast(texts: Sequence[str], layout: Layout) -> Floats:
    """Convert cells that are all plain numbers; an exception when one is not.

    NumPy reads text ten times faster than float() does cell by cell, and stops with a
    warning (an error in time to come) where a cell is empty or not a number.
    """
    text = (layout.delimiter or " ").join(texts)
    if layout.decimal_comma:
        if "." in text:
            raise ValueError
        text = text.replace(",", ".")
    if layout.delimiter == "\t":  # NumPy would take two tabs for one
        if "," in text:
            raise ValueError
        text = text.replace("\t", ",")
    separator = {None: " ", "\t": ","}.get(layout.delimiter, layout.delimiter or " ")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        return np.fromstring(text, sep=separator).reshape(len(texts), layout.n_columns)


def _slow(path: Path, lines: Sequence[Line], texts: Sequence[str], layout: Layout) -> Floats:
    """Convert cell by cell: missing samples, and the place of a cell of text."""
    values = np.empty((len(texts), layout.n_columns))
    for k, text in enumerate(texts):
        for column, cell in enumerate(text.split(layout.delimiter)):
            try:
                values[k, column] = number_of(cell, layout.decimal_comma)
            except ValueError:
                raise FileError(
                    f"Line {lines[k][0]}, column {column + 1} of {path} holds "
                    f"{cell.strip()[:40]!r} where a number is expected; leave the cell empty "
                    "where a sample is missing."
                ) from None
    return values


# -- names, time, table


def _table(
    path: Path, values: Floats, heading: list[str], stored: dict[str, Any], dt: float | None
) -> Table:
    if heading and not all(heading):
        raise FileError(f"Column {heading.index('') + 1} of {path} has no name; name it.")
    labels = [_label(label) for label in heading]
    time, found = _time(path, values, labels, stored)
    _check_complete(path, len(values), stored)
    known = stored.get("dt")
    if known is not None:
        found = settle_dt(path, found, known)
    keep = [k for k in range(values.shape[1]) if k != time]
    if not keep:
        raise FileError(f"{path} holds a time column and no channel.")
    if np.isnan(values[:, keep]).all():
        raise FileError(f"{path} holds no numeric data: every cell is empty or NaN.")
    channels, marked = _channels(keep, labels, stored)
    check_unique_names(path, [channel.name for channel in channels])
    if found is None and dt is None and time is not None:
        settle_dt(path, None, None, ", whose first column only counts samples")
    outputs = [k for k, channel in zip(keep, channels, strict=True) if channel.name not in marked]
    inputs = [k for k in keep if k not in outputs]
    return Table(
        values[:, outputs],
        tuple(channel for channel in channels if channel.name not in marked),
        values[:, inputs],
        tuple(channel for channel in channels if channel.name in marked),
        found,
        stored.get("name", path.name),
        numbered=not labels,
    )


def _label(heading: str) -> tuple[str, str]:
    """Return name and unit; `time_ms` states its unit too."""
    name, unit = split_unit(heading)
    stem, _, suffix = name.rpartition("_")
    return (stem, suffix) if not unit and _is_time(stem) and suffix in TIME_UNITS else (name, unit)


def _channels(
    keep: Sequence[int], labels: Sequence[tuple[str, str]], stored: dict[str, Any]
) -> tuple[list[Channel], set[str]]:
    """Return the channels of the kept columns and the names of those marked as inputs."""
    described = stored.get("channels")
    if described is not None and len(described) == len(keep):
        roles = [fields.pop("role") for fields in described]
        channels = [Channel(**fields) for fields in described]
        return channels, {
            c.name for c, role in zip(channels, roles, strict=True) if role == "input"
        }
    if not labels:
        return [channel_of(f"ch{k + 1}") for k in range(len(keep))], set()
    return [channel_of(*labels[k]) for k in keep], set()


def _check_complete(path: Path, n_samples: int, stored: dict[str, Any]) -> None:
    """Refuse a file of write_record that has lost samples, or part of its last line."""
    if not stored:
        return
    with path.open("rb") as file:
        file.seek(-1, 2)
        is_cut = file.read() != b"\n"
    if is_cut or n_samples != stored.get("n_samples"):
        raise FileError(
            f"{path} holds {n_samples} of the {stored.get('n_samples')} samples that it announces; "
            "it is truncated. If you cut it on purpose, remove its first line."
        )


def _stored(comments: Sequence[str]) -> dict[str, Any]:
    """Return what write_record put into the first line, or nothing."""
    if not comments or not comments[0].startswith(MARK + "{"):
        return {}
    stored: dict[str, Any] = json.loads(comments[0].removeprefix(MARK))
    return stored


def _time(
    path: Path, values: Floats, labels: Sequence[tuple[str, str]], stored: dict[str, Any]
) -> tuple[int | None, float | None]:
    """Return the column of time and its step [s]; a bare sample counter has no step."""
    named = [0] if stored else [k for k, (name, _) in enumerate(labels) if _is_time(name)]
    if len(named) > 1:
        names = ", ".join(labels[k][0] for k in named)
        raise FileError(f"{path} has several time columns ({names}); keep one.")
    if named:
        unit = labels[named[0]][1]
        if unit not in TIME_UNITS:
            raise FileError(
                f"The unit {unit!r} of the time column of {path} is not known; write s, ms, us, "
                "min or h into the heading."
            )
        step = uniform_step(path, f"Time column {labels[named[0]][0]!r}", values[:, named[0]])
        return named[0], step * TIME_UNITS[unit]
    return _unnamed_time(path, values, *(labels[0] if labels else ("", "")))


def _is_time(name: str) -> bool:
    return name.lower() in TIME_NAMES and name != "T"  # T is a torque or a temperature


def _unnamed_time(
    path: Path, values: Floats, name: str, unit: str
) -> tuple[int | None, float | None]:
    """Take a first column that rises at every sample for time [s] or for a counter."""
    first = values[:, 0]
    rising = len(first) >= SHORTEST_TIME and bool((np.diff(first) > 0).all())
    if values.shape[1] < 2 or not rising:
        return None, None
    if unit.lower() in ("hz", "khz") or name.lower().startswith("freq"):
        raise FileError(
            f"{path} holds a function of frequency (column {name!r}); a record is a function of "
            "time. Export the time signals."
        )
    if unit not in TIME_UNITS:
        return None, None
    if (np.diff(first) == 1).all() and (first == np.round(first)).all():
        return 0, None
    return 0, uniform_step(path, "Rising first column", first) * TIME_UNITS[unit]
