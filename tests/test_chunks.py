"""Streams: segments, centre and scale of one or several records, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vibrid.chunks import Segment, as_records, open_stream
from vibrid.errors import DataError, OptionError
from vibrid.record import Record


def skewed(rng: np.random.Generator, n: int = 3000) -> Record:
    """Return a record whose channels differ in size and mean by orders of magnitude."""
    y = rng.standard_normal((n, 2)) * [1e-6, 3e4] + [5e-3, -1e5]
    return Record(y, rng.standard_normal(n) + 2, dt=0.01)


@pytest.mark.parametrize("offset", ["estimate", "mean", "none"])
def test_scale_is_a_power_of_two_near_the_standard_deviation(
    rng: np.random.Generator, offset: str
) -> None:
    """Scaling is exact, and scaled samples have a standard deviation (or rms) near 1."""
    record = skewed(rng)
    stream = open_stream(record, offset)
    z = record.read(0, record.n_samples)
    level = np.sqrt(np.mean(z**2, axis=0)) if offset == "none" else z.std(axis=0)
    assert (np.frexp(stream.scale)[0] == 0.5).all()
    assert (np.abs(np.log2(stream.scale / level)) <= 0.5 + 1e-9).all()
    expected = np.zeros(3) if offset == "none" else z.mean(axis=0)
    np.testing.assert_allclose(stream.centre, expected, rtol=1e-12)
    np.testing.assert_array_equal(stream.input_scale, stream.scale[:1])
    np.testing.assert_array_equal(stream.output_scale, stream.scale[1:])


def test_reading_centres_and_scales(rng: np.random.Generator) -> None:
    """Samples read back, unscaled and uncentred, are those of the record."""
    record = skewed(rng)
    record.outputs[100] = np.nan
    stream = open_stream(record)
    segment = stream.segments[1]
    assert segment == Segment(0, 101, 3000)
    assert stream.n_samples == 2999
    raw = stream.read(segment, 5, 9) * stream.scale + stream.centre
    np.testing.assert_allclose(raw, record.read(106, 110), rtol=1e-14)


def test_chunks_join_to_the_segment(rng: np.random.Generator) -> None:
    """Chunks follow each other, whatever their size."""
    stream = open_stream(skewed(rng))
    whole = stream.read(stream.segments[0], 0, 3000)
    parts = list(stream.chunks(stream.segments[0], rows=700))
    assert [start for start, _ in parts] == [0, 700, 1400, 2100, 2800]
    np.testing.assert_array_equal(np.vstack([rows for _, rows in parts]), whole)


def test_mean_and_scale_are_pooled_over_chunks_gaps_and_records(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Chunk sums joined over pieces and records equal those of all samples together."""
    monkeypatch.setattr("vibrid.record.signals.CHUNK_BYTES", 1)
    first, second = skewed(rng, 2500), skewed(rng, 1100)
    first.outputs[1200:1210, 1] = np.nan
    stream = open_stream([first, second])
    z = np.vstack([first.read(0, 1200), first.read(1210, 2500), second.read(0, 1100)])
    np.testing.assert_allclose(stream.centre, z.mean(axis=0), rtol=1e-12)
    assert (np.abs(np.log2(stream.scale / z.std(axis=0))) <= 0.5 + 1e-9).all()
    assert stream.segments == (Segment(0, 0, 1200), Segment(0, 1210, 2500), Segment(1, 0, 1100))


def test_constant_channels_are_refused_by_name(rng: np.random.Generator) -> None:
    """A channel at zero, at a constant, or at a constant with rounding does not move."""
    y = rng.standard_normal((500, 4))
    y[:, 0], y[:, 2] = 0, 0.1 + 0.2
    y[::7, 2] = 0.3
    for offset in ("estimate", "mean", "none"):
        with pytest.raises(
            DataError, match=r"2 of 4 channels do not move: y1, y3 \(.*select\(\), or --inputs"
        ):
            open_stream(Record(y, dt=1), offset)


def test_a_channel_without_samples_is_refused(rng: np.random.Generator) -> None:
    """NaN everywhere in one channel leaves no row; the message says so."""
    y = rng.standard_normal((50, 2))
    y[:, 1] = np.nan
    with pytest.raises(DataError, match="No sample has all 2 channels"):
        open_stream(Record(y, dt=1))
    y[3, 0] = np.inf
    with pytest.raises(DataError, match=r"Sample 3 .* infinite"):
        open_stream(Record(y, dt=1))


def test_records_must_belong_together(rng: np.random.Generator) -> None:
    """Other channels and other rates are refused; the same ones pass."""
    record = skewed(rng)
    assert len(as_records([record, record.slice(10)])) == 2
    with pytest.raises(DataError, match="different channels"):
        as_records([record, record.select(["y2", "y1"])])
    with pytest.raises(DataError, match=r"intervals, 0.01 s and 0.02 s; decimate"):
        as_records([record, record.decimate(2)])


@pytest.mark.parametrize("data", [None, 3, "run.csv", [], np.ones((5, 2)), [np.ones(5)]])
def test_what_is_no_record_is_refused(data: Any) -> None:
    """Arrays, names, nothing and None are told from records."""
    with pytest.raises(OptionError, match=r"Record|record"):
        as_records(data)


def test_unknown_offset_is_refused(rng: np.random.Generator) -> None:
    """The rule for offsets is one of three."""
    with pytest.raises(OptionError, match="offset must be one of estimate, mean, none"):
        open_stream(skewed(rng), "median")


def test_chunks_are_rows_in_memory_whatever_the_record(rng: np.random.Generator) -> None:
    """A record stored channel by channel is read as any other: kernels walk along rows."""
    y = np.asfortranarray(rng.standard_normal((100, 3)))
    stream = open_stream(Record(y, dt=0.1))
    z = stream.read(stream.segments[0], 10, 60)
    assert z.flags.c_contiguous
    np.testing.assert_allclose(z, (y[10:60] - stream.centre) / stream.scale, rtol=1e-15)
