"""MATLAB files up to v7; v7.3 files are HDF5."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from .arrays import table_of
from .numpy_files import sort_arrays
from .tables import Table, reading


def read_mat(path: Path, *, variable: Any = None, transpose: bool = False, **_: Any) -> Table:
    """Read the arrays of a MAT file; fields of a structure are named structure/field."""
    with reading(path, "a MAT file"):
        content: dict[str, Any] = {}
        for name, value in loadmat(path).items():
            if not name.startswith("__"):
                _flatten(content, name, value)
        return table_of(sort_arrays(path, content, transpose), variable)


def _flatten(content: dict[str, Any], name: str, value: Any) -> None:
    """Add an array, the fields of a single structure, or a cell array of texts."""
    value = np.asarray(value)
    if value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            _flatten(content, f"{name}/{field}", value[field].reshape(-1)[0])
    elif value.dtype.kind == "O" and value.size:
        cells = [np.asarray(cell) for cell in value.reshape(-1)]
        if all(cell.dtype.kind == "U" and cell.size == 1 for cell in cells):
            content[name] = np.array([str(cell.reshape(-1)[0]) for cell in cells])
    else:
        content[name] = value
