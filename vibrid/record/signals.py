"""Two-dimensional signals, in memory or on disk, read a stretch of rows at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError

Floats = NDArray[np.float64]
CHUNK_BYTES = 4 * 2**20


class Signal(Protocol):
    """What a record needs of an array: NumPy, memory-mapped, HDF5, Zarr or Dask."""

    @property
    def shape(self) -> tuple[int, ...]: ...
    @property
    def dtype(self) -> Any: ...
    def __getitem__(self, key: Any, /) -> Any: ...


@dataclass(frozen=True, eq=False)
class View:
    """Rows [start, stop) and chosen columns of a signal that stays where it is."""

    base: Signal
    start: int
    stop: int
    columns: tuple[int, ...]

    @property
    def shape(self) -> tuple[int, int]:
        return (self.stop - self.start, len(self.columns))

    @property
    def dtype(self) -> Any:
        return self.base.dtype

    @property
    def ndim(self) -> int:
        return 2

    def __getitem__(self, rows: slice) -> Floats:
        start, stop, step = rows.indices(self.shape[0])
        stretch = np.asarray(self.base[slice(self.start + start, self.start + stop)])
        if stretch.ndim == 1:
            stretch = stretch[:, None]
        return np.asarray(stretch[::step, self.columns])


def in_memory(signal: Signal) -> bool:
    """Tell whether a signal is a plain NumPy array, not one that stays on disk."""
    return isinstance(signal, np.ndarray) and not isinstance(signal, np.memmap)


def as_signal(values: Any, what: str) -> Signal:
    """Check shape and dtype of `values`; a 1-D array becomes one channel.

    Nothing is copied unless `values` is a list or an integer or single-precision array in
    memory; those become float64.
    """
    if not hasattr(values, "shape") or not hasattr(values, "dtype"):
        values = array_of(values, what)
    if isinstance(values, np.ma.MaskedArray):
        raise DataError(f"{what} are a masked array; pass a plain one with NaN where masked.")
    if values.dtype.kind not in "iuf":
        raise DataError(
            f"{what} must be real numbers; got {_kind_of(values.dtype)} (dtype {values.dtype})."
        )
    if len(values.shape) == 1:
        if isinstance(values, np.ndarray):
            values = values.reshape(-1, 1)
        else:
            values = View(values, 0, values.shape[0], (0,))
    if len(values.shape) != 2:
        raise DataError(
            f"{what} must have 2 axes (samples, channels); got shape {tuple(values.shape)}."
        )
    if in_memory(values):
        return np.asarray(values, dtype=np.float64)
    return values  # type: ignore[no-any-return]


def take(signal: Signal, start: int, stop: int, columns: tuple[int, ...] | None = None) -> Signal:
    """Return rows [start, stop) of the chosen columns, lazily where the signal is on disk."""
    if isinstance(signal, np.ndarray) and in_memory(signal):
        rows = signal[start:stop]
        return rows if columns is None else rows[:, columns]
    if isinstance(signal, View):
        picked = signal.columns if columns is None else tuple(signal.columns[k] for k in columns)
        return View(signal.base, signal.start + start, signal.start + stop, picked)
    every = tuple(range(signal.shape[1]))
    return View(signal, start, stop, every if columns is None else columns)


def rows_per_chunk(n_columns: int) -> int:
    """Return how many float64 rows of `n_columns` make a chunk of about 4 MiB."""
    return max(1024, CHUNK_BYTES // (8 * max(1, n_columns)))


def array_of(values: Any, what: str) -> NDArray[Any]:
    try:
        return np.asarray(values)
    except ValueError:
        raise DataError(f"{what} must be rectangular: channels of different length.") from None


def _kind_of(dtype: Any) -> str:
    return {"c": "complex numbers", "b": "booleans"}.get(dtype.kind, "text or objects")
