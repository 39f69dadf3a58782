"""write_record: NPZ and CSV with everything that a record knows."""

from __future__ import annotations

import csv
import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OptionError, check_writable
from ..record import Channel, Record
from .numpy_files import STORED
from .text import MARK


def write_record(record: Record, path: str | os.PathLike[str]) -> Path:
    """Write a record as .npz or .csv; `read_record` gives the same record back.

    Names, units, quantities, DOFs, signs, delays, roles and dt are kept. The CSV file has a
    time column and one first comment line with the labels, so other programs read it too.

    Raises
    ------
    PathError
        The path cannot be written.
    OptionError
        Another extension.
    """
    writers: dict[str, Callable[[Record, Path], None]] = {".npz": _write_npz, ".csv": _write_csv}
    target = check_writable(path)
    if not isinstance(record, Record):
        raise OptionError(f"write_record takes a Record; got {type(record).__name__}.")
    if target.suffix.lower() not in writers:
        raise OptionError(f"A record is written as .npz or .csv; got {target}.")
    # written beside and moved, so that a failure leaves no half of a file
    partial = target.with_name(f".{target.name}.part")
    try:
        writers[target.suffix.lower()](record, partial)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)
    return target


def _labels(record: Record) -> str:
    """Return what the arrays do not say as one line of JSON."""
    channels = [
        {**dataclasses.asdict(channel), "role": role}
        for role, side in (("output", record.output_channels), ("input", record.input_channels))
        for channel in side
    ]
    head = {"name": record.name, "dt": record.dt, "n_samples": record.n_samples}
    return json.dumps({**head, "channels": channels})


def _write_npz(record: Record, path: Path) -> None:
    arrays: dict[str, Any] = {
        "outputs": np.asarray(record.outputs[:]),
        "inputs": np.asarray(record.inputs[:]),
        "dt": np.float64(record.dt),
        STORED: np.array(_labels(record)),
    }
    with path.open("wb") as file:
        np.savez(file, **arrays)


def _write_csv(record: Record, path: Path) -> None:
    headings = [_heading(c) for c in (*record.output_channels, *record.input_channels)]
    with path.open("w", encoding="utf-8", newline="") as file:
        file.write(f"{MARK}{_labels(record)}\n")
        csv.writer(file, lineterminator="\n").writerow(["time [s]", *headings])
        for start, rows in record.chunks():
            times = (start + np.arange(len(rows))) * record.dt
            y, u = rows[:, record.n_inputs :], rows[:, : record.n_inputs]
            np.savetxt(file, np.column_stack([times, y, u]), fmt="%.17g", delimiter=",")


def _heading(channel: Channel) -> str:
    heading = f"{channel.name} [{channel.unit}]" if channel.unit else channel.name
    return " ".join(heading.split())  # on one line
