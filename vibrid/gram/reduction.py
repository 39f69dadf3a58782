"""Reduce a stream to its BlockGram: lagged sums, block after block."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import scipy.fft as fft
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from ..chunks import Segment, Stream
from ..errors import DataError
from ..linalg import one_blas_thread
from ..record import Floats, rows_per_chunk
from .blocks import BlockGram

TIME_BLOCKS = 50  # partial sums kept, for resampling; fewer on short records
SHORTEST_BLOCK = 8  # in units of block rows: shorter time blocks would hardly be independent
FFT_LENGTHS = 4  # FFT length in units of block rows: flat optimum between 3 and 6
DIRECT_LIMIT = 2000  # lags times squared channels up to which plain products beat transforms
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
    used = [k for k, segment in enumerate(stream.segments) if segment.length >= n_rows]
    if not used:
        most = max(segment.length for segment in stream.segments)
        raise DataError(
            f"{n_rows} block rows need a piece of at least {n_rows} samples without gaps; the "
            f"longest has {most}. Use fewer block rows or a longer record."
        )
    with one_blas_thread():
        parts = [_reduce_segment(stream, stream.segments[k], n_rows, longest) for k in used]
    edges = [part[0] for part in parts]
    lags, sums, heads, tails = map(np.concatenate, list(zip(*parts, strict=True))[1:])
    return BlockGram(
        lags=lags,
        sums=sums,
        heads=heads,
        tails=tails,
        columns=np.concatenate([np.diff(inner) for inner in edges]),
        owners=np.repeat(used, [len(inner) - 1 for inner in edges]),
        segments=stream.segments,
        centre=stream.centre,
        scale=stream.scale,
        n_inputs=stream.n_inputs,
        offset=stream.offset,
    )


def _is_direct(n_lags: int, c: int) -> bool:
    return n_lags * c**2 <= DIRECT_LIMIT


def _hop(n_lags: int, c: int, columns: int) -> int:
    """Return how many Hankel columns make a piece, the unit of the work."""
    if _is_direct(n_lags, c):
        return DIRECT_HOP
    length = min(n_lags + columns - 1, max(FFT_LENGTHS * n_lags, 64))
    return int(fft.next_fast_len(length, real=True)) - n_lags + 1


def _block_sums(z: Floats, n_lags: int, edges: Edges, hop: int) -> tuple[Floats, Floats]:
    """Return lagged sums (parts, n_lags, c, c) and sums (parts, c) between consecutive edges.

    All edges but the last are multiples of `hop`. Pieces of `hop` columns are multiplied with
    the samples that the lags reach into: as they are where lags and channels are few, else
    after a Fourier transform (overlap-save). A part's pieces are the inner dimension of the
    matrix products; parts of as many pieces are taken together.
    """
    c = z.shape[1]
    sizes = -(-np.diff(edges) // hop) * hop
    if len(sizes) > 1 and sizes[-2] < 2 * sizes[-1] < 2 * sizes[-2]:
        sizes[-1] = sizes[-2]  # a few zeros more, and it goes with the others
    columns = int(sizes.sum())
    multiply = _products if _is_direct(n_lags, c) else _transformed
    here = _padded(z[: edges[-1]], columns)
    ahead = _padded(z, columns + -(-(n_lags - 1) // hop) * hop)
    lags, sums = np.empty((len(sizes), n_lags, c, c)), np.empty((len(sizes), c))
    changes = np.flatnonzero(np.diff(sizes)) + 1
    for first, stop in pairwise([0, *changes.tolist(), len(sizes)]):
        start, size = int(edges[first]), int(sizes[first])
        parts = here[start : start + (stop - first) * size].reshape(stop - first, size, c)
        lags[first:stop] = multiply(parts, ahead[start:], n_lags, hop)
        sums[first:stop] = np.ones(size) @ parts  # by BLAS: faster than a sum
    return lags, sums


def _padded(z: Floats, rows: int) -> Floats:
    """Return z with zeros after it, at least `rows` long."""
    if len(z) >= rows:
        return z
    return np.concatenate([z, np.zeros((rows - len(z), z.shape[1]))])


def _products(here: Floats, ahead: Floats, n_lags: int, hop: int) -> Floats:
    """Return the lagged sums of parts (parts, columns, c) by products of pieces.

    Each piece (hop · c) is multiplied with itself and the pieces that follow, which are views
    of the samples; then products of the same lag are added. `ahead` is contiguous and reaches
    as many pieces beyond `here` as the lags do.
    """
    parts, columns, c = here.shape
    reach, piece, pieces = 1 + -(-(n_lags - 1) // hop), hop * c, columns // hop
    left = here.reshape(parts, 1, pieces, piece).transpose(0, 1, 3, 2)
    size, step = here.itemsize, piece * here.itemsize
    right = as_strided(ahead, (parts, reach, pieces, piece), (pieces * step, step, step, size))
    products = np.empty((parts, piece, reach, piece))
    np.matmul(left, right, out=products.transpose(0, 2, 1, 3))
    row = reach * step  # bytes from one channel of one column to the next
    by_lag = as_strided(
        products, (parts, hop, c, n_lags * c), (piece * row, c * row + c * size, row, size)
    )
    return np.asarray(by_lag.sum(axis=1).reshape(parts, c, n_lags, c).transpose(0, 2, 1, 3))


def _transformed(here: Floats, ahead: Floats, n_lags: int, hop: int) -> Floats:
    """Return the lagged sums of parts (parts, columns, c) by transforms of pieces."""
    parts, columns, c = here.shape
    pieces, length = columns // hop, hop + n_lags - 1
    left = here.reshape(parts, pieces, hop, c)
    sample, channel = ahead.strides
    step = hop * sample
    right = as_strided(ahead, (parts, pieces, length, c), (pieces * step, step, sample, channel))
    batch = min(pieces, max(1, BATCH_BYTES // (16 * length * c)))
    alone = np.zeros((batch, length, c))  # pieces without the samples ahead
    sums = np.empty((parts, n_lags, c, c))
    for part in range(parts):
        spectra = np.zeros((length // 2 + 1, c, c), dtype=complex)
        for first in range(0, pieces, batch):
            some = slice(first, min(first + batch, pieces))
            count = some.stop - first
            alone[:count, :hop] = left[part, some]
            X, Y = fft.rfft(alone[:count], axis=1), fft.rfft(right[part, some], axis=1)
            spectra += X.conj().transpose(1, 2, 0) @ Y.transpose(1, 0, 2)
        sums[part] = fft.irfft(spectra, n=length, axis=0)[:n_lags]
    return sums


def _reduce_segment(
    stream: Stream, segment: Segment, n_rows: int, longest: int
) -> tuple[Edges, Floats, Floats, Floats, Floats]:
    """Return edges, lags, sums, heads and tails of a segment's time blocks, chunk by chunk.

    Edges (n_blocks + 1,) count Hankel columns; the rest is as in `BlockGram`.
    """
    c, columns = len(stream.scale), segment.length - n_rows + 1
    hop = _hop(n_rows, c, columns)
    edges = _time_blocks(columns, longest, hop)
    count = len(edges) - 1
    lags, sums = np.zeros((count, n_rows, c, c)), np.zeros((count, c))
    at_edges = np.empty((count + 1, n_rows - 1, c))
    step = max(1, rows_per_chunk(c) // hop) * hop
    for start in range(0, columns, step):
        stop = min(start + step, columns)
        z = stream.read(segment, start, stop + n_rows - 1)
        inside = np.flatnonzero((edges > start) & (edges < stop))
        cuts = np.concatenate([[start], edges[inside], [stop]])
        first = int(np.searchsorted(edges, start, side="right")) - 1
        blocks = slice(first, first + len(cuts) - 1)
        more = _block_sums(z, n_rows, cuts - start, hop)
        lags[blocks] += more[0]
        sums[blocks] += more[1]
        for k in np.flatnonzero((edges >= start) & (edges <= stop)):
            at_edges[k] = z[edges[k] - start :][: n_rows - 1]
    return edges, lags, sums, at_edges[:-1], at_edges[1:]


def _time_blocks(columns: int, longest: int, hop: int) -> Edges:
    """Return the edges of time blocks of about `longest` Hankel columns, in whole pieces."""
    count = max(1, columns // longest)
    size = hop * -(-columns // (hop * count))
    edges = np.arange(0, columns, size)
    kept = len(edges) > 1 and 2 * (columns - int(edges[-1])) < size  # a short rest joins the last
    return np.append(edges[:-1] if kept else edges, columns)
