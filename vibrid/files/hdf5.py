"""HDF5 and MATLAB v7.3: datasets stay on disk and are read a stretch at a time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError
from .arrays import Arrays, table_of
from .fits import is_fit
from .tables import Part, Table, reading

HIDDEN = "#"  # MATLAB keeps the contents of cells under #refs#
UNIT_NAMES = ("units", "unit")


def read_hdf5(path: Path, *, variable: Any = None, transpose: bool = False, **_: Any) -> Table:
    """Read datasets by their path; labels, dt, fs and units come from beside or on them.

    Arrays that MATLAB wrote (they carry the attribute MATLAB_class) have their axes reversed
    in the file and are turned back. The file stays open as long as the record lives.
    """
    import h5py

    if is_fit(path):
        raise FileError(
            f"{path} holds a saved model, not a record; see it with load() or vibrid info."
        )
    with reading(path, "an HDF5 file"):
        file = h5py.File(path, "r")
        try:
            content = _Content(transpose)
            _attributes(content, "", file)
            file.visititems(content.add)
            arrays = Arrays(path, content.numeric, content.texts, content.scalars, content.units)
            return table_of(arrays, variable)
        except BaseException:
            file.close()
            raise


class _Content:
    """Collects what a walk through the file finds."""

    def __init__(self, transpose: bool) -> None:
        self.transpose = transpose
        self.numeric: dict[str, Part] = {}
        self.texts: dict[str, list[str]] = {}
        self.scalars: dict[str, float] = {}
        self.units: dict[str, str] = {}

    def add(self, name: str, item: Any) -> None:
        if name.startswith(HIDDEN):
            return
        _attributes(self, name, item)
        if hasattr(item, "shape") and item.shape is not None and "MATLAB_empty" not in item.attrs:
            self._add_dataset(name, item)

    def _add_dataset(self, name: str, item: Any) -> None:
        made_by = item.attrs.get("MATLAB_class")
        made_by = made_by.decode() if isinstance(made_by, bytes) else made_by
        if made_by in ("char", "cell", "struct", "function_handle", "logical"):
            texts = _matlab_texts(item) if made_by == "cell" else []
            self.texts.update({name: texts} if texts else {})
        elif item.dtype.kind in "iuf" and item.size == 1:
            self.scalars[name] = float(item[()].reshape(-1)[0] if item.shape else item[()])
        elif item.dtype.kind in "iufc" and item.size > 1:
            last = self.transpose and len(item.shape) > 1
            self.numeric[name] = Part(item, reversed_axes=made_by is not None, time_last=last)
        elif item.dtype.kind in "SO" and len(item.shape) == 1:
            self.texts[name] = _texts(item)


def _attributes(content: _Content, name: str, item: Any) -> None:
    """Note single numbers and the unit among the attributes of a group or dataset."""
    for key, value in item.attrs.items():
        if key.lower() in UNIT_NAMES and isinstance(value, str | bytes):
            content.units[name] = value.decode() if isinstance(value, bytes) else value
        elif np.size(value) == 1 and np.asarray(value).dtype.kind in "iuf":
            content.scalars[f"{name}/{key}"] = float(np.asarray(value).reshape(-1)[0])


def _texts(item: Any) -> list[str]:
    values = item[()]
    if all(isinstance(value, str | bytes) for value in values):
        return [v.decode("utf-8", "replace") if isinstance(v, bytes) else v for v in values]
    return []


def _matlab_texts(item: Any) -> list[str]:
    """Return the texts of a MATLAB cell array, or [] when a cell holds anything else."""
    cells = [item.file[reference] for reference in item[()].reshape(-1) if reference]
    if not all(_is_char(cell) for cell in cells):
        return []
    return ["".join(map(chr, cell[()].reshape(-1))) for cell in cells]


def _is_char(cell: Any) -> bool:
    kind = cell.attrs.get("MATLAB_class", b"")
    return (kind.decode() if isinstance(kind, bytes) else kind) == "char"
