"""NPY and NPZ: arrays written by NumPy."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from ..record import Channel
from .arrays import Arrays, table_of
from .tables import Part, Table, reading

STORED = "vibrid"  # the array in which write_record keeps labels, as JSON


def read_npy(path: Path, *, transpose: bool = False, **_: Any) -> Table:
    """Map a NPY file into memory; its columns are ch1, ch2, …"""
    with reading(path, "an NPY file"):
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if array.offset + array.nbytes != path.stat().st_size:
            raise FileError(f"{path} holds more than one array; write them to an NPZ file.")
        if array.ndim == 0:
            raise FileError(f"{path} holds a single number; a record needs rows of samples.")
        part = Part(array, time_last=transpose)
        return table_of(Arrays(path, {path.stem: part}), path.stem)


def read_npz(path: Path, *, variable: Any = None, transpose: bool = False, **_: Any) -> Table:
    """Read the arrays of an NPZ file; labels and dt come from arrays beside the signals."""
    with reading(path, "an NPZ file"), path.open("rb") as file:
        archive = np.load(file, allow_pickle=False)
        content = {name: archive[name] for name in archive.files}
        if not all(isinstance(array, np.ndarray) for array in content.values()):
            raise FileError(f"{path} is a ZIP archive without NumPy arrays; export it as CSV.")
        if STORED in content:
            return _stored_table(content)
        return table_of(sort_arrays(path, content, transpose), variable)


def sort_arrays(path: Path, content: dict[str, Any], transpose: bool) -> Arrays:
    """Sort NumPy arrays into signals, texts and single numbers; other things are left out."""
    numeric: dict[str, Part] = {}
    texts: dict[str, list[str]] = {}
    scalars: dict[str, float] = {}
    for name, array in content.items():
        kind = array.dtype.kind
        if kind in "iuf" and array.size == 1:
            scalars[name] = float(array.reshape(-1)[0])
        elif kind in "iufc" and array.size > 1:
            numeric[name] = Part(array, time_last=transpose and array.ndim > 1)
        elif kind in "US" and array.ndim > 0:
            texts[name] = [
                text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
                for text in array.reshape(-1)
            ]
    return Arrays(path, numeric, texts, scalars)


def _stored_table(content: dict[str, Any]) -> Table:
    """Return the table that write_record stored."""
    stored = json.loads(str(content[STORED]))
    sides: dict[str, list[Channel]] = {"output": [], "input": []}
    for fields in stored["channels"]:
        sides[fields.pop("role")].append(Channel(**fields))
    return Table(
        content["outputs"],
        tuple(sides["output"]),
        content["inputs"],
        tuple(sides["input"]),
        stored["dt"],
        stored["name"],
    )
