"""Correlation functions of ambient records as free decays: NExT (James, Carne & Lauffer, 1995)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..errors import DataError, OptionError, check_names, check_whole
from ..record import Floats, Record, rows_per_chunk

LARGEST_DEFAULT = 2048  # lags
SMALLEST_DEFAULT = 64
PIECE_SHARE = 4  # default lags reach a quarter of the longest piece: fewer products beyond
BANDS = 5.0  # standard errors that a correlation must pass: chance does not in 1e5 of them
BLOCKS_PER_LAG = 4  # transform length over the number of lags
SMALLEST_TRANSFORM = 1024
SPECTRA_BYTES = 64 * 2**20  # of the cross spectra that are summed in one pass

Pieces = tuple[tuple[int, int], ...]


def next_correlations(
    record: Record,
    references: str | Sequence[str] | None = None,
    *,
    n_lags: int | None = None,
) -> tuple[Record, ...]:
    """Return the correlations of all outputs with each reference, as free decays.

    Of a structure under unmeasured white noise, the correlation of the outputs with a
    reference that lag behind it decay like the structure set free (NExT: James, Carne &
    Lauffer, Modal Analysis 10(4), 1995). They begin at lag 1: lag 0 holds the measurement
    noise. `ERA` takes the records together, as one system started in several ways.

    Parameters
    ----------
    record : Record
        Ambient, any length, in memory or on disk. Inputs are not used.
    references : str or sequence of str, optional
        Names of outputs; few that see every mode are enough. All outputs by default.
    n_lags : int, optional
        Lags 1 … n_lags, at least as many as outputs. By default up to the last lag at which
        the correlation of a reference with itself exceeds five standard errors (Bartlett,
        1946), but at least 64, and at most 2048 and a quarter of the longest piece: what comes
        later is chance.

    Returns
    -------
    tuple of Record
        One for each reference, named after it, of n_lags samples; sample k is lag k + 1. Its
        channels are the outputs': correlations of accelerations decay like accelerations, so
        quantity, DOF and sign hold; the unit is the channel's times the reference's, and a
        common factor does not matter.

    Raises
    ------
    OptionError
        Unknown references, n_lags too small.
    DataError
        No piece of the record is longer than n_lags.

    Notes
    -----
    R(l) = Σ_t y(t + l) y_ref(t) / count(l), the unbiased estimate, over all pairs of samples
    that no gap separates; means over the whole record are removed first. Its expectation is
    C A^(l−1) G for l ≥ 1.

    Examples
    --------
    >>> decay, = next_correlations(Record([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], dt=0.1), n_lags=2)
    >>> decay.outputs[:, 0], decay.name
    (array([-1.,  1.]), 'correlations with y1')
    """
    names = _reference_names(record, references)
    columns = [record.output_names.index(name) for name in names]
    pieces = record.segments()
    lags = n_lags if n_lags is not None else _largest_default(record, pieces)
    _check_lags(record, pieces, lags)
    mean = _mean(record, pieces)
    lagged = _lagged_means(record, pieces, mean, columns, lags)
    if n_lags is None:
        total = sum(stop - start for start, stop in pieces)
        lags = _significant(lagged[:, columns, range(len(columns))], total, record.n_outputs)
    title = f"{record.name}: correlations with" if record.name else "correlations with"
    return tuple(
        Record(
            np.ascontiguousarray(lagged[1 : lags + 1, :, k]),
            dt=record.dt,
            output_channels=record.output_channels,
            name=f"{title} {name}",
        )
        for k, name in enumerate(names)
    )


def _reference_names(record: Record, references: str | Sequence[str] | None) -> tuple[str, ...]:
    if references is None:
        return record.output_names
    names = (references,) if isinstance(references, str) else tuple(references)
    check_names("output", names, record.output_names)
    if not names or len(set(names)) != len(names):
        raise OptionError(f"Name each reference once, at least one; got {', '.join(names)!r}.")
    return names


def _longest(pieces: Pieces) -> int:
    return max((stop - start for start, stop in pieces), default=0)


def _largest_default(record: Record, pieces: Pieces) -> int:
    return max(record.n_outputs, min(LARGEST_DEFAULT, _longest(pieces) // PIECE_SHARE), 1)


def _check_lags(record: Record, pieces: Pieces, lags: int) -> None:
    check_whole("n_lags", lags, max(1, record.n_outputs))
    if lags >= _longest(pieces):
        raise DataError(
            f"{lags} lags need more than {lags} samples without a gap; the longest piece has "
            f"{_longest(pieces)}. Use fewer lags (at least {record.n_outputs}) or a longer record."
        )


def _rows(record: Record, start: int, stop: int) -> Floats:
    return np.asarray(record.outputs[start:stop], dtype=np.float64)


def _mean(record: Record, pieces: Pieces) -> Floats:
    """Return the outputs' means over all pieces."""
    total, count = np.zeros(record.n_outputs), 0
    step = rows_per_chunk(record.n_outputs)
    for start, stop in pieces:
        for first in range(start, stop, step):
            rows = _rows(record, first, min(first + step, stop))
            total += rows.sum(axis=0)
            count += len(rows)
    return total / count


def _lagged_means(
    record: Record, pieces: Pieces, mean: Floats, columns: list[int], lags: int
) -> Floats:
    """Return R (lags + 1, n_outputs, n_references); a pass over the data for some references."""
    from scipy.fft import next_fast_len

    size = next_fast_len(max(SMALLEST_TRANSFORM, BLOCKS_PER_LAG * (lags + 1)), real=True)
    together = max(1, SPECTRA_BYTES // (8 * size * record.n_outputs))
    groups = [columns[k : k + together] for k in range(0, len(columns), together)]
    parts = [_lagged_sums(record, pieces, mean, group, size, lags) for group in groups]
    sums = np.concatenate(parts, axis=2)
    lengths = np.array([stop - start for start, stop in pieces])
    count = np.maximum(lengths[None, :] - np.arange(lags + 1)[:, None], 0).sum(axis=1)
    return np.asarray(sums / count[:, None, None])


def _lagged_sums(
    record: Record, pieces: Pieces, mean: Floats, columns: list[int], size: int, lags: int
) -> Floats:
    """Return Σ y(t + l) y_ref(t) by overlapped Fourier transforms of `size` samples.

    Each block of reference samples meets the outputs up to `lags` later; transforms are long
    enough that nothing wraps, and their products add up over all blocks before one inverse.
    """
    from scipy.fft import irfft, rfft

    total = np.zeros((size // 2 + 1, record.n_outputs, len(columns)), np.complex128)
    for later, now in _blocks(record, pieces, mean, columns, size - lags, lags):
        Y, R = rfft(later, size, axis=1), rfft(now, size, axis=1)
        total += Y.transpose(1, 2, 0) @ R.conj().transpose(1, 0, 2)
    return np.asarray(irfft(total, size, axis=0)[: lags + 1])


def _blocks(
    record: Record, pieces: Pieces, mean: Floats, columns: list[int], length: int, lags: int
) -> Iterator[tuple[Floats, Floats]]:
    """Yield outputs (n_blocks, length + lags, …) and the references they are met by.

    Blocks are read several at a time; the end of a piece is padded by zeros.
    """
    together = max(1, rows_per_chunk(record.n_outputs) // (4 * length))
    for start, stop in pieces:
        for first in range(start, stop, together * length):
            last = min(first + together * length, stop)
            n_blocks = -(-(last - first) // length)
            x = np.zeros((n_blocks * length + lags, len(mean)))
            known = min(last + lags, stop) - first
            x[:known] = _rows(record, first, first + known) - mean
            later = np.stack([x[k * length : (k + 1) * length + lags] for k in range(n_blocks)])
            yield later, x[: n_blocks * length, columns].reshape(n_blocks, length, len(columns))


def _significant(own: Floats, n_samples: int, smallest: int) -> int:
    """Return the last lag where a reference's own correlation (lags + 1, n) is not chance."""
    error = np.sqrt((own[0] ** 2 + 2 * (own[1:] ** 2).sum(axis=0)) / n_samples)
    above = np.flatnonzero((np.abs(own) > BANDS * error).any(axis=1))
    last = int(above[-1]) if len(above) else 0
    return min(max(last, SMALLEST_DEFAULT, smallest), len(own) - 1)
