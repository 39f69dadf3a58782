"""Factor: the triangle of a block Hankel matrix, by Cholesky of its Gram or by streamed QR."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.linalg as sla
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..chunks import Segment, Stream
from ..linalg import one_blas_thread
from ..record import Floats
from .blocks import BlockGram

PIVOT_LIMIT = 1e-10  # squared scaled pivot; below it double precision loses statistical digits
QR_ASPECT = 4  # rows of a chunk per column: more hardly saves work


@dataclass(frozen=True, eq=False)
class Factor:
    """Hold the upper triangle R of chosen Hankel rows, RᵀR = their Gram.

    Attributes
    ----------
    triangle : array (n, n)
    path : "cholesky" or "qr"
    smallest_pivot : float
        Smallest squared pivot of the Gram scaled to unit diagonal. The relative error of
        coefficients from the Cholesky path is about 2e-16 over this; at most 1e-10 (or NaN,
        where the Cholesky failed) the QR path was taken.
    """

    triangle: Floats
    path: Literal["cholesky", "qr"]
    smallest_pivot: float


def factorize(gram: BlockGram, stream: Stream, rows: NDArray[np.int64]) -> Factor:
    """Factor the chosen rows of the block Hankel matrix, in the order given.

    Cholesky of the Gram; where its smallest scaled pivot says that double precision
    is not enough, a second pass over the data by QR of chunks (TSQR; Demmel, Grigori,
    Hoemmen & Langou 2012).

    Parameters
    ----------
    gram : BlockGram
    stream : Stream
        What `gram` was reduced from.
    rows : array of int
        Indices lag · n_channels + channel.
    """
    with one_blas_thread():
        triangle, pivot = scaled_cholesky(gram.matrix()[rows][:, rows])
        if triangle is not None:
            return Factor(triangle, "cholesky", pivot)
        return Factor(_streamed_qr(gram, stream, rows), "qr", pivot)


def scaled_cholesky(gram: Floats) -> tuple[Floats | None, float]:
    """Return the upper Cholesky factor, or None where it cannot be trusted, and the pivot.

    A column of zeros is left out of the test and has a zero row and column in the factor.
    """
    empty = np.flatnonzero(gram.diagonal() == 0)
    if len(empty):
        gram = gram.copy()
        gram[empty, empty] = 1
    # scaled to unit diagonal first, it would not be any more accurate (Demmel 1989)
    upper, failed = sla.lapack.dpotrf(gram.T)
    if failed:
        return None, np.nan
    pivot = float((upper.diagonal() ** 2 / gram.diagonal()).min(initial=1.0))
    if not pivot > PIVOT_LIMIT:
        return None, pivot
    upper[empty, empty] = 0
    return upper, pivot


def stacked_qr(blocks: Iterator[Floats], n_columns: int) -> Floats:
    """Return the triangle of row blocks stacked on each other, one block at a time."""
    triangle = np.zeros((0, n_columns))
    for block in blocks:
        triangle = np.asarray(
            sla.qr(np.vstack([triangle, block]), mode="r", overwrite_a=True, check_finite=False)[0]
        )[:n_columns]
    missing = n_columns - len(triangle)
    return np.vstack([triangle, np.zeros((missing, n_columns))]) if missing else triangle


def triangle_of(
    blocks: Callable[[], Iterator[Floats]], n_columns: int, pivot_limit: float = PIVOT_LIMIT
) -> Floats:
    """Return the triangle of a tall matrix that `blocks()` yields row block by row block.

    By Cholesky of the sum of products where its pivots allow, else by QR in a second pass.
    """
    with one_blas_thread():
        gram = np.zeros((n_columns, n_columns))
        for block in blocks():
            gram += block.T @ block
        triangle, pivot = scaled_cholesky(gram)
        if triangle is not None and not pivot > pivot_limit:
            triangle = None
        return stacked_qr(blocks(), n_columns) if triangle is None else triangle


def _streamed_qr(gram: BlockGram, stream: Stream, rows: NDArray[np.int64]) -> Floats:
    # a shortened Gram has fewer columns than its block rows would allow: take the same
    triangles = (
        _segment_triangle(
            stream,
            gram.segments[owner],
            rows,
            gram.n_rows,
            int(gram.columns[gram.owners == owner].sum()),
        )
        for owner in np.unique(gram.owners)
    )
    return stacked_qr(triangles, len(rows))


def _segment_triangle(
    stream: Stream, segment: Segment, rows: NDArray[np.int64], n_rows: int, columns: int
) -> Floats:
    """Return the triangle of one segment; a leading column of ones takes the constant out."""
    constant = int(stream.offset == "estimate")
    blocks = (
        np.hstack([np.ones((len(block), constant)), block])
        for block in _hankel_columns(stream, segment, rows, n_rows, columns)
    )
    return stacked_qr(blocks, len(rows) + constant)[constant:, constant:]


def _hankel_columns(
    stream: Stream, segment: Segment, rows: NDArray[np.int64], n_rows: int, columns: int
) -> Iterator[Floats]:
    step = QR_ASPECT * len(rows)
    for start in range(0, columns, step):
        z = stream.read(segment, start, min(start + step, columns) + n_rows - 1)
        windows = sliding_window_view(z, n_rows, axis=0).transpose(0, 2, 1)
        yield windows.reshape(len(windows), -1)[:, rows]
