"""Reduce a stream to its BlockGram: lagged sums, block after block."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft as fft
from numpy.lib.stride_tricks import as_strided, sliding_window_view
from numpy.typing import NDArray

from ..chunks import Segment, Stream
from ..errors import DataError
from ..linalg import one_blas_thread
from ..record import Floats, rows_per_chunk
from .blocks import BlockGram

TIME_BLOCKS = 50  # partial sums kept, for resampling; fewer on short records
SHORTEST_BLOCK = 8  # in units of block rows: shorter time blocks would hardly be independent
FFT_LENGTHS = 6  # FFT length in units of block rows: flat optimum between 4 and 8
DIRECT_LIMIT = 800  # lags times squared channels up to which plain products beat transforms
DIRECT_HOP = 8  # columns of a piece that is multiplied as it is
BATCH_BYTES = 2**19  # pieces transformed together stay in cache

Edges = NDArray[np.int64]


def reduce(stream: Stream, n_rows: int) -> BlockGram:
    """Reduce all segments of a stream to one BlockGram of `n_rows` block rows.

    One pass, a stretch of samples in memory at a time. A segment shorter than `n_rows`
    samples has no Hankel column and is left out.

    Raises
    ------
    DataError
        No segment is as long as `n_rows` samples.
    """
    longest = max(SHORTEST_BLOCK * n_rows, -(-stream.n_samples // TIME_BLOCKS))
    edges = {
        owner: _time_blocks(segment, n_rows, longest)
        for owner, segment in enumerate(stream.segments)
        if segment.length >= n_rows
    }
    if not edges:
        most = max(segment.length for segment in stream.segments)
        raise DataError(
            f"{n_rows} block rows need a piece of at least {n_rows} samples without gaps; the "
            f"longest has {most}. Use fewer block rows or a longer record."
        )
    with one_blas_thread():
        parts = [
            _reduce_segment(stream, stream.segments[owner], inner, n_rows)
            for owner, inner in edges.items()
        ]
    lags, sums, heads, tails = (np.concatenate(each) for each in zip(*parts, strict=True))
    return BlockGram(
        lags=lags,
        sums=sums,
        heads=heads,
        tails=tails,
        columns=np.concatenate([np.diff(inner) for inner in edges.values()]),
        owners=np.repeat(list(edges), [len(inner) - 1 for inner in edges.values()]),
        segments=stream.segments,
        centre=stream.centre,
        scale=stream.scale,
        n_inputs=stream.n_inputs,
        offset=stream.offset,
    )


def lagged_sums(z: Floats, n_lags: int) -> Floats:
    """Return R[l] = Σ_t z(t) z(t+l)ᵀ for l < n_lags over t < len(z) − n_lags + 1.

    Parameters
    ----------
    z : array (n_samples, c)
    n_lags : int

    Returns
    -------
    array (n_lags, c, c)
    """
    return np.asarray(_lagged_sums(z, n_lags, np.array([0, len(z) - n_lags + 1]))[0])


def _lagged_sums(z: Floats, n_lags: int, edges: Edges) -> Floats:
    """Return the lagged sums over the columns between consecutive edges, (parts, n_lags, c, c).

    Pieces of `hop` columns are multiplied with the samples that the lags reach into, a part's
    pieces being the inner dimension of a batched matrix product: few Hankel rows as they are,
    many after a Fourier transform (overlap-save).
    """
    c, longest = z.shape[1], int(np.diff(edges).max())
    direct = n_lags * c**2 <= DIRECT_LIMIT
    length = DIRECT_HOP + n_lags - 1 if direct else _fft_length(n_lags, longest)
    hop = length - n_lags + 1
    multiply, finish = (_products, _diagonal_sums) if direct else (_spectra, _inverse)
    pieces = -(-longest // hop)
    batch = max(1, BATCH_BYTES // (16 * length * c))
    size = 8 * length * c**2 * (hop if direct else 2)
    together = max(1, min(batch // pieces, BATCH_BYTES // size))
    flat = np.concatenate([z.ravel(), np.zeros(length * c)])  # the last pieces reach beyond
    sums = np.empty((len(edges) - 1, n_lags, c, c))
    for k in range(0, len(sums), together):
        starts, stops = edges[:-1][k : k + together, None], edges[1:][k : k + together, None]
        product: Any = None
        for first in range(0, pieces, batch):
            at = starts + hop * np.arange(first, min(first + batch, pieces))
            at = np.minimum(at, len(z))  # where other parts are longer
            ahead = sliding_window_view(flat, length * c)[at * c].reshape(*at.shape, length, c)
            columns = at[..., None] + np.arange(hop) < stops[..., None]
            here = ahead[:, :, :hop] * columns[..., None]
            more = multiply(here, ahead)
            product = more if first == 0 else product + more
        sums[k : k + together] = finish(product, n_lags, length)
    return sums


def _products(here: Floats, ahead: Floats) -> Floats:
    """Return the products of columns and samples ahead (parts, hop, c, length, c)."""
    parts, pieces, length, c = ahead.shape
    hop = here.shape[2]
    left = here.reshape(parts, pieces, hop * c).transpose(0, 2, 1)
    found = left @ ahead.reshape(parts, pieces, length * c)
    return np.asarray(found.reshape(parts, hop, c, length, c))


def _diagonal_sums(products: Floats, n_lags: int, length: int) -> Floats:
    """Return the sums of products of the same lag (parts, n_lags, c, c)."""
    parts, hop, c, _, _ = products.shape
    each, column, channel, row, other = products.strides
    by_lag = as_strided(
        products, (parts, hop, n_lags, c, c), (each, column + row, row, channel, other)
    )
    return np.asarray(by_lag.sum(axis=1))


def _spectra(here: Floats, ahead: Floats) -> NDArray[np.complex128]:
    """Return the cross spectra of columns and samples ahead (parts, frequencies, c, c)."""
    left = np.conj(fft.rfft(here, n=ahead.shape[2], axis=2)).transpose(0, 2, 3, 1)
    return np.asarray(left @ fft.rfft(ahead, axis=2).transpose(0, 2, 1, 3))


def _inverse(spectra: NDArray[np.complex128], n_lags: int, length: int) -> Floats:
    return np.asarray(fft.irfft(spectra, n=length, axis=1)[:, :n_lags])


def _fft_length(n_lags: int, columns: int) -> int:
    longest = n_lags + columns - 1
    return int(fft.next_fast_len(min(longest, max(FFT_LENGTHS * n_lags, 64)), real=True))


def _reduce_segment(
    stream: Stream, segment: Segment, edges: Edges, n_rows: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return lags, sums, heads and tails of the blocks between edges, a chunk at a time."""
    c, count = len(stream.scale), len(edges) - 1
    lags, sums = np.zeros((count, n_rows, c, c)), np.zeros((count, c))
    at_edges = np.empty((count + 1, n_rows - 1, c))
    step = rows_per_chunk(c)
    for start in range(0, int(edges[-1]), step):
        stop = min(start + step, int(edges[-1]))
        z = stream.read(segment, start, stop + n_rows - 1)
        cuts = np.unique(np.clip(edges, start, stop))
        blocks = np.searchsorted(edges, cuts[:-1], side="right") - 1
        lags[blocks] += _lagged_sums(z, n_rows, cuts - start)
        sums[blocks] += np.add.reduceat(z[: stop - start], cuts[:-1] - start, axis=0)
        here = (edges >= start) & (edges <= stop)
        at_edges[here] = z[(edges[here] - start)[:, None] + np.arange(n_rows - 1)]
    return lags, sums, at_edges[:-1], at_edges[1:]


def _time_blocks(segment: Segment, n_rows: int, longest: int) -> Edges:
    """Return the edges of blocks of a segment's Hankel columns, each about `longest` long."""
    columns = segment.length - n_rows + 1
    count = max(1, columns // longest)
    return np.linspace(0, columns, count + 1).round().astype(np.int64)
