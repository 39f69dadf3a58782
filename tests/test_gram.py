"""The Gram engine against an explicit block-Hankel matrix."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from vibrid import DataError, OptionError, Record
from vibrid.chunks import Stream, open_stream
from vibrid.gram import factorize, reduce, stacked_qr, triangle_of
from vibrid.gram.factor import _streamed_qr

Floats = NDArray[np.float64]
ROUNDING = 1e-12  # of the largest entry: sums of a few thousand products


def hankel(stream: Stream, n_rows: int) -> Floats:
    """Return the block Hankel matrix, one column of it a row, centred as the stream says."""
    parts = []
    for segment in stream.segments:
        if segment.length >= n_rows:
            z = stream.read(segment, 0, segment.length)
            columns = len(z) - n_rows + 1
            part = np.hstack([z[k : k + columns] for k in range(n_rows)])
            parts.append(part - part.mean(axis=0) if stream.offset == "estimate" else part)
    return np.vstack(parts)


def noisy(rng: np.random.Generator, n_samples: int, *, gap: bool = False) -> Record:
    """Return a record of uneven levels, offsets and colours."""
    y = rng.standard_normal((n_samples, 3)).cumsum(axis=0) * 0.1 + 5
    u = rng.standard_normal((n_samples, 2)) * [1e-8, 1e3] + [0, 1e4]
    if gap:
        y[n_samples // 3] = np.nan
        u[n_samples // 2, 0] = np.nan
    return Record(y, u, dt=0.01)


@pytest.mark.parametrize("offset", ["estimate", "mean", "none"])
@pytest.mark.parametrize(("n_samples", "gap"), [(61, False), (777, True), (5000, True)])
def test_gram_equals_the_explicit_product(
    rng: np.random.Generator, offset: str, n_samples: int, gap: bool
) -> None:
    """Displacement, edges, blocks, gaps and the projected constant are exact."""
    stream = open_stream(noisy(rng, n_samples, gap=gap), offset)
    H = hankel(stream, 7)
    expected = H.T @ H
    gram = reduce(stream, 7)
    assert gram.n_columns == len(H)
    np.testing.assert_allclose(gram.matrix(), expected, atol=ROUNDING * abs(expected).max())


def test_covariances_are_the_first_block_row(rng: np.random.Generator) -> None:
    """The lagged covariances are the Gram's first block row, gaps and constants included."""
    gram = reduce(open_stream(noisy(rng, 900, gap=True)), 6)
    row = gram.matrix()[:5].reshape(5, 6, 5).transpose(1, 0, 2)
    np.testing.assert_allclose(gram.covariances(), row, atol=ROUNDING * abs(row).max())


def test_shorter_gram_is_part_of_the_longer(rng: np.random.Generator) -> None:
    """Fewer block rows over the same columns are a corner of the matrix."""
    gram = reduce(open_stream(noisy(rng, 500)), 8)
    corner = gram.matrix()[: 5 * 5, : 5 * 5]
    np.testing.assert_allclose(gram.shorten(5).matrix(), corner, atol=ROUNDING * abs(corner).max())


def test_grams_of_two_machines_add_up(rng: np.random.Generator) -> None:
    """Segments reduced apart and joined are the Gram of all."""
    from dataclasses import replace

    stream = open_stream(noisy(rng, 900, gap=True))
    whole = reduce(stream, 6)
    parts = [reduce(replace(stream, segments=(segment,)), 6) for segment in stream.segments]
    joined = parts[0] + parts[1] + parts[2]
    np.testing.assert_allclose(
        joined.matrix(), whole.matrix(), atol=ROUNDING * abs(whole.matrix()).max()
    )
    with pytest.raises(OptionError, match="same block rows"):
        parts[0] + parts[1].shorten(4)


def test_chunks_make_no_difference(
    rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A memory-mapped record read in small pieces gives what the array in memory gives."""
    y = rng.standard_normal((20_000, 4)).cumsum(axis=0) * 0.01 + 3
    np.save(tmp_path / "y.npy", y)
    on_disk = Record(np.load(tmp_path / "y.npy", mmap_mode="r"), dt=0.01)
    whole = reduce(open_stream(Record(y, dt=0.01)), 12).matrix()
    monkeypatch.setattr("vibrid.record.signals.CHUNK_BYTES", 1)
    pieces = reduce(open_stream(on_disk), 12).matrix()
    np.testing.assert_allclose(pieces, whole, atol=ROUNDING * abs(whole).max())


@pytest.mark.parametrize("direct", [0, 10**9])
@pytest.mark.parametrize("n_lags", [1, 2, 17, 200])
@pytest.mark.parametrize("n_samples", [200, 201, 5000])
def test_lagged_sums_against_a_loop(
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    n_samples: int,
    n_lags: int,
    direct: int,
) -> None:
    """Products and transforms equal the plain sums for any length, block by block."""
    monkeypatch.setattr("vibrid.gram.reduction.DIRECT_LIMIT", direct)
    monkeypatch.setattr("vibrid.record.signals.CHUNK_BYTES", 1)  # several chunks
    stream = open_stream(Record(rng.standard_normal((n_samples, 2)), dt=1.0))
    gram = reduce(stream, n_lags)
    z, first = stream.read(stream.segments[0], 0, n_samples), 0
    for columns, lags, sums in zip(gram.columns, gram.lags, gram.sums, strict=True):
        own = z[first : first + columns]
        loop = np.stack([own.T @ z[first + lag :][:columns] for lag in range(n_lags)])
        np.testing.assert_allclose(lags, loop, atol=ROUNDING * n_samples)
        np.testing.assert_allclose(sums, own.sum(axis=0), atol=ROUNDING * n_samples)
        first += columns
    assert first == n_samples - n_lags + 1


@pytest.mark.parametrize("offset", ["estimate", "none"])
@pytest.mark.parametrize("amplitude", [3.7, 1.0, 0.123])
def test_rounding_of_transforms_is_no_signal(
    rng: np.random.Generator, offset: str, amplitude: float
) -> None:
    """A force that acts in the first sample alone leaves the later rows empty, exactly."""
    u = np.zeros((12_000, 1))
    u[0] = amplitude
    gram = reduce(open_stream(Record(rng.standard_normal((12_000, 7)), u, dt=1.0), offset), 40)
    force = np.diag(gram.matrix())[::8]
    assert force[0] > 0 and not force[1:].any()


@pytest.mark.parametrize("limit", [0, 10**9])
def test_products_and_transforms_give_the_same(
    limit: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lagged sums multiplied as they are, or in the frequency domain, have the loop's Gram."""
    monkeypatch.setattr("vibrid.gram.reduction.DIRECT_LIMIT", limit)
    stream = open_stream(noisy(rng, 700, gap=True))
    explicit = hankel(stream, 8)
    gram = reduce(stream, 8).matrix()
    expected = explicit.T @ explicit
    np.testing.assert_allclose(gram, expected, atol=ROUNDING * np.abs(expected).max())


def test_cholesky_and_qr_agree_on_noisy_data(rng: np.random.Generator) -> None:
    """Both paths have the singular values of the explicit matrix to 1e-12 of the largest."""
    stream = open_stream(noisy(rng, 3000, gap=True))
    gram = reduce(stream, 6)
    rows = rng.permutation(30)
    factor = factorize(gram, stream, rows)
    exact = np.linalg.svd(hankel(stream, 6)[:, rows], compute_uv=False)
    assert factor.path == "cholesky"
    for triangle in (factor.triangle, _streamed_qr(gram, stream, rows)):
        values = np.linalg.svd(triangle, compute_uv=False)
        np.testing.assert_allclose(values, exact, atol=1e-12 * exact[0])


def coloured_record(rng: np.random.Generator, noise: float) -> Record:
    """Return a resonance under an input that a low-pass leaves little above 2 % of Nyquist."""
    u = signal.sosfilt(signal.butter(4, 0.02, output="sos"), rng.standard_normal(4000))
    y = signal.lfilter([1.0, 0.5], [1.0, -1.9, 0.98], u)
    y = y / y.std() + noise * rng.standard_normal(4000)
    return Record(1e-8 * y, u, dt=0.01)


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_coloured_tiny_and_noise_free_data_are_as_accurate_as_qr(
    rng: np.random.Generator, noise: float
) -> None:
    """Where the pivot fails the QR path is taken, and its least squares is the explicit one."""
    stream = open_stream(coloured_record(rng, noise))
    gram = reduce(stream, 8)
    factor = factorize(gram, stream, np.arange(16))
    assert factor.path == "qr"
    H = hankel(stream, 8)
    q = np.linalg.qr(H, mode="r")
    exact = np.linalg.svd(q, compute_uv=False)
    np.testing.assert_allclose(
        np.linalg.svd(factor.triangle, compute_uv=False), exact, atol=1e-13 * exact[0]
    )
    # the residual of the last row on the others: what regressions live from
    last = abs(factor.triangle[-1, -1])
    np.testing.assert_allclose(last, abs(q[-1, -1]), rtol=1e-6 if noise else 0, atol=1e-12)


def test_cholesky_error_follows_its_pivot(rng: np.random.Generator) -> None:
    """Just above the limit, the Cholesky path still has the residual to 1e-5."""
    stream = open_stream(coloured_record(rng, 1e-2))
    gram = reduce(stream, 3)
    factor = factorize(gram, stream, np.arange(6))
    assert factor.path == "cholesky"
    assert 1e-10 < factor.smallest_pivot < 1e-4
    exact = np.linalg.qr(hankel(stream, 3), mode="r")
    np.testing.assert_allclose(abs(factor.triangle[-1, -1]), abs(exact[-1, -1]), rtol=1e-5)


def test_flutter_takes_the_qr_path(shared_data: Path) -> None:
    """On the wing flutter record the Cholesky fails, and the streamed QR is the explicit one."""
    z = np.loadtxt(shared_data / "flutter.dat")
    stream = open_stream(Record(z[:, 1:], z[:, :1], dt=1.0), "none")
    gram = reduce(stream, 40)
    factor = factorize(gram, stream, np.arange(80))
    assert factor.path == "qr"
    exact = np.linalg.svd(hankel(stream, 40), compute_uv=False)
    np.testing.assert_allclose(
        np.linalg.svd(factor.triangle, compute_uv=False), exact, atol=1e-13 * exact[0]
    )


def test_triangle_of_falls_back_to_qr(rng: np.random.Generator) -> None:
    """A tall matrix of dependent columns is factored in a second pass."""
    tall = rng.standard_normal((500, 4)) @ rng.standard_normal((4, 6))
    calls: list[int] = []

    def blocks() -> Any:
        calls.append(1)
        yield from np.array_split(tall, 7)

    triangle = triangle_of(blocks, 6)
    assert len(calls) == 2
    np.testing.assert_allclose(triangle.T @ triangle, tall.T @ tall, atol=1e-10)


def test_stacked_qr_pads_short_stacks(rng: np.random.Generator) -> None:
    """Fewer rows than columns give a square triangle with zero rows."""
    block = rng.standard_normal((2, 5))
    triangle = stacked_qr(iter([block]), 5)
    assert triangle.shape == (5, 5)
    np.testing.assert_allclose(triangle.T @ triangle, block.T @ block, atol=1e-14)


def test_too_short_pieces_are_named(rng: np.random.Generator) -> None:
    """A record without a piece as long as the block rows is refused with both numbers."""
    with pytest.raises(DataError, match=r"30 block rows .* longest has 20"):
        reduce(open_stream(Record(rng.standard_normal((20, 1)), dt=1.0)), 30)
