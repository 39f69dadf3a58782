"""survey: figures, findings and the suggested band."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from vibrid.errors import DataError
from vibrid.files import read_record
from vibrid.files.bands import friendly
from vibrid.files.survey import Survey, survey
from vibrid.record import Record
from vibrid.samples import timber_building


def vibration(rng: np.random.Generator, hz: list[float], n: int = 40_000) -> NDArray[np.float64]:
    """Return accelerations at 100 Hz of oscillators under noise, with 2 % damping."""
    total = np.zeros(n)
    for f in hz:
        pole = np.exp((-0.02 + 1j) * 2 * np.pi * f / 100)
        force = rng.normal(size=n)
        total += signal.lfilter([1, -2, 1], [1, -2 * pole.real, abs(pole) ** 2], force) / 100
    return total


def test_figures_and_flags(rng: np.random.Generator) -> None:
    """Each figure equals a direct computation; each fault is found in its own channel."""
    n = 8000
    x = rng.normal(size=(n, 5)) + 3.0
    x[:, 1] = 7.0
    x[:, 2] = np.clip(x[:, 2], 2.5, 3.5)
    x[:, 3] += np.linspace(0, 10, n)
    x[100:110, 4] = np.nan
    x[200, 4] = np.nan
    record = Record(x[:, :4], x[:, 4], dt=0.01, output_channels=["a", "b", "c", "d"])
    found = survey(record)
    assert [c.name for c in found.channels] == ["u1", "a", "b", "c", "d"]
    for k, channel in zip((4, 0, 1, 2, 3), found.channels, strict=True):
        assert channel.mean == pytest.approx(np.nanmean(x[:, k]), rel=1e-12)
        assert channel.std == pytest.approx(np.nanstd(x[:, k]), rel=1e-9, abs=1e-12)
        assert (channel.smallest, channel.largest) == (np.nanmin(x[:, k]), np.nanmax(x[:, k]))
    assert [c.is_constant for c in found.channels] == [False, False, True, False, False]
    assert [c.is_clipped for c in found.channels] == [False, False, False, True, False]
    assert [c.is_drifting for c in found.channels] == [False, False, False, False, True]
    assert found.channels[0].missing_fraction == pytest.approx(11 / n)
    assert (found.n_gaps, found.n_missing) == (2, 11)
    assert found.missing_duration == pytest.approx(0.11)
    assert (found.duration, found.rate) == (80.0, 100.0)
    text = "; ".join(found.findings)
    for part in ("channel b is constant", "channel c rests", "channel d drifts", "2 gaps"):
        assert part in text
    assert "channel a" not in text and "channel u1" not in text


def test_chunks_change_nothing(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs, gaps and tenths across chunk borders count as in one piece."""
    x = np.round(rng.normal(size=(3000, 2)), 1).clip(-1, 1)
    x[501:505] = np.nan  # 504 begins a chunk of 7
    record = Record(x, dt=0.1)
    whole = survey(record)
    in_chunks = Record.chunks
    monkeypatch.setattr(Record, "chunks", lambda self: in_chunks(self, 7))
    parts = survey(record)
    for a, b in zip(whole.channels, parts.channels, strict=True):
        figures = ("mean", "std", "drift", "clipped_fraction", "missing_fraction")
        for figure in figures:
            assert getattr(a, figure) == pytest.approx(getattr(b, figure), rel=1e-12)
    assert (whole.n_gaps, whole.n_missing) == (parts.n_gaps, parts.n_missing) == (1, 4)


def test_clipping_counts_long_runs() -> None:
    """Only runs of three or more at an extreme count, at both ends of the range."""
    x = np.sin(np.arange(40.0))
    x[5:8] = x[20:24] = 2.0
    x[30:33] = -2.0
    x[35:37] = -2.0
    assert survey(Record(x, dt=1.0)).channels[0].clipped_fraction == pytest.approx(10 / 40)


def test_a_two_level_input_is_not_called_clipped(rng: np.random.Generator) -> None:
    """A pseudo-random binary input rests on its extremes by design."""
    u = np.repeat(rng.integers(0, 2, 400), 5)
    assert not survey(Record(rng.normal(size=2000), u, dt=1.0)).channels[0].is_clipped


def test_band_is_suggested_for_low_modes(rng: np.random.Generator) -> None:
    """Modes at 2 and 5 Hz under drift and a machine at 30 Hz: all modes are in the band."""
    x = vibration(rng, [2.0, 5.0])
    t = np.arange(len(x)) / 100
    drift = np.cumsum(rng.normal(size=len(x))) * np.std(x) / 300
    disturbed = x + drift + 2 * np.std(x) * np.sin(2 * np.pi * 30 * t)
    for signal_, largest_low in ((x, 1.0), (disturbed, 1.9)):
        found = survey(Record(signal_, dt=0.01))
        assert found.suggested_band_hz is not None
        low, high = found.suggested_band_hz
        assert low < largest_low
        assert 5.5 < high <= 15


def test_no_band_for_a_full_spectrum(rng: np.random.Generator) -> None:
    """White noise and modes up to Nyquist are left alone, forced or not."""
    assert survey(Record(rng.normal(size=20_000), dt=0.01)).suggested_band_hz is None
    wide = vibration(rng, [3.0, 20.0, 41.0])
    assert survey(Record(wide, dt=0.01)).suggested_band_hz is None
    assert survey(Record(wide, rng.normal(size=len(wide)), dt=0.01)).suggested_band_hz is None


def test_short_dead_or_infinite_records() -> None:
    """A few samples or an empty channel give no spectrum and no failure; infinity is refused."""
    short = survey(Record(np.arange(6.0), dt=1.0))
    assert np.isnan(short.channels[0].peak_hz) and short.suggested_band_hz is None
    dead = survey(Record(np.column_stack([np.full(99, np.nan), np.arange(99.0)]), dt=1.0))
    assert isinstance(dead, Survey)
    assert "channel y1 holds no sample" in dead.findings
    with pytest.raises(DataError, match=r"Sample 3 .* infinite"):
        survey(Record([0.0, 1.0, 2.0, np.inf, 1.0], dt=1.0))
    with pytest.raises(DataError, match=r"Sample 2 of channel y1 is -1e\+300; beyond 1e\+100"):
        survey(Record([0.0, 1.0, -1e300, 0.0, 1.0], dt=1.0))


def test_timber_building() -> None:
    """Drift and machines do not hide that the building vibrates at 1.9 to 2.7 Hz."""
    found = survey(timber_building())
    assert found.suggested_band_hz is not None
    low, high = found.suggested_band_hz
    assert 0.3 <= low <= 1.0 and 6 <= high <= 12
    assert any("drift or quasi-static" in finding for finding in found.findings)
    assert found.suggestion.endswith(f"is worth trying (--band {low:g} {high:g})")
    assert found.suggestion not in found.findings
    assert any(1.8 < channel.peak_hz < 2.8 for channel in found.channels)


def test_friendly_numbers() -> None:
    """Rounding goes the asked way, keeps friendly numbers and crosses decades."""
    assert [friendly(x, up=True) for x in (0.91, 10.0, 10.1, 99.0)] == [1.0, 10.0, 12.0, 100.0]
    assert [friendly(x, up=False) for x in (0.91, 10.0, 11.9, 0.12)] == [0.8, 10.0, 10.0, 0.12]


def test_real_records(shared_data: Path) -> None:
    """A frame with modes to 11 Hz gets a band; a subframe tested to 512 Hz does not."""
    floors = [f"acc/{floor}/x" for floor in ("1st Floor", "2nd Floor", "3rd Floor (Top floor)")]
    frame = read_record(
        shared_data / "three_story_frame.npz", inputs=["acc/Ground Floor/x"], outputs=floors
    )
    assert isinstance(frame, Record)
    assert survey(frame).suggested_band_hz == (0.0, 15.0)
    subframe = read_record(shared_data / "flexible_subframe.mat", dt=1 / 1024, inputs=["1", "2"])
    assert isinstance(subframe, Record)
    assert survey(subframe).suggested_band_hz is None
