"""Reduce a stream to its BlockGram: lagged sums by FFT, block after block."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy.fft as fft

from ..chunks import Segment, Stream
from ..errors import DataError
from ..linalg import one_blas_thread
from ..record import Floats, rows_per_chunk
from .blocks import BlockGram

TIME_BLOCKS = 50  # partial sums kept, for resampling; fewer on short records
SHORTEST_BLOCK = 8  # in units of block rows: shorter time blocks would hardly be independent
FFT_LENGTHS = 6  # FFT length in units of block rows: flat optimum between 4 and 8
BATCH_BYTES = 8 * 2**20  # segments transformed together stay in cache


def reduce(stream: Stream, n_rows: int) -> BlockGram:
    """Reduce all segments of a stream to one BlockGram of `n_rows` block rows.

    One pass, a stretch of samples in memory at a time. A segment shorter than `n_rows`
    samples has no Hankel column and is left out.

    Raises
    ------
    DataError
        No segment is as long as `n_rows` samples.
    """
    parts = [
        (owner, start, stop)
        for owner, segment in enumerate(stream.segments)
        for start, stop in _time_blocks(segment, n_rows, stream.n_samples)
    ]
    if not parts:
        longest = max(segment.length for segment in stream.segments)
        raise DataError(
            f"{n_rows} block rows need a piece of at least {n_rows} samples without gaps; the "
            f"longest has {longest}. Use fewer block rows or a longer record."
        )
    with one_blas_thread():
        blocks = [
            _block(stream, stream.segments[owner], start, stop, n_rows)
            for owner, start, stop in parts
        ]
    lags, sums, heads, tails = (np.stack(each) for each in zip(*blocks, strict=True))
    return BlockGram(
        lags=lags,
        sums=sums,
        heads=heads,
        tails=tails,
        columns=np.array([stop - start for _, start, stop in parts]),
        owners=np.array([owner for owner, _, _ in parts]),
        segments=stream.segments,
        centre=stream.centre,
        scale=stream.scale,
        n_inputs=stream.n_inputs,
        offset=stream.offset,
    )


def lagged_sums(z: Floats, n_lags: int) -> Floats:
    """Return R[l] = Σ_t z(t) z(t+l)ᵀ for l < n_lags over t < len(z) − n_lags + 1.

    Overlap-save: pieces of `hop` columns are transformed with and without the samples that
    the lags reach into; the products add up in the frequency domain, pieces being the inner
    dimension of a batched matrix product, and one inverse transform ends it.

    Parameters
    ----------
    z : array (n_samples, c)
    n_lags : int

    Returns
    -------
    array (n_lags, c, c)
    """
    columns, c = len(z) - n_lags + 1, z.shape[1]
    length = _fft_length(n_lags, columns)
    hop = length - n_lags + 1
    batch = max(1, BATCH_BYTES // (16 * length * c))
    product = np.zeros((length // 2 + 1, c, c), dtype=np.complex128)
    for first in range(0, columns, hop * batch):
        ahead, here = _pieces(z, range(first, min(first + hop * batch, columns), hop), hop, length)
        left = np.conj(fft.rfft(here, axis=1)).transpose(1, 2, 0)
        product += left @ fft.rfft(ahead, axis=1).transpose(1, 0, 2)
    return np.asarray(fft.irfft(product, n=length, axis=0)[:n_lags])


def _pieces(z: Floats, starts: range, hop: int, length: int) -> tuple[Floats, Floats]:
    columns = len(z) - (length - hop)
    ahead = np.zeros((len(starts), length, z.shape[1]))
    for k, start in enumerate(starts):
        piece = z[start : start + length]
        ahead[k, : len(piece)] = piece
    here = ahead.copy()
    here[:, hop:] = 0
    here[-1, max(0, columns - starts[-1]) :] = 0
    return ahead, here


def _fft_length(n_lags: int, columns: int) -> int:
    longest = n_lags + columns - 1
    return int(fft.next_fast_len(min(longest, max(FFT_LENGTHS * n_lags, 64)), real=True))


def _block(
    stream: Stream, segment: Segment, start: int, stop: int, n_rows: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return lags, sums, head and tail of columns [start, stop), a stretch in memory at a time."""
    c = len(stream.scale)
    lags, sums = np.zeros((n_rows, c, c)), np.zeros(c)
    for first in range(start, stop, rows_per_chunk(c)):
        last = min(first + rows_per_chunk(c), stop)
        z = stream.read(segment, first, last + n_rows - 1)
        lags += lagged_sums(z, n_rows)
        sums += z[: last - first].sum(axis=0)
        if first == start:
            head = z[: n_rows - 1].copy()
    return lags, sums, head, z[last - first :].copy()


def _time_blocks(segment: Segment, n_rows: int, n_samples: int) -> list[tuple[int, int]]:
    """Cut a segment's Hankel columns into blocks of about 1/50 of all samples."""
    columns = segment.length - n_rows + 1
    if columns < 1:
        return []
    longest = max(SHORTEST_BLOCK * n_rows, -(-n_samples // TIME_BLOCKS))
    count = max(1, columns // longest)
    edges = np.linspace(0, columns, count + 1).round().astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]
