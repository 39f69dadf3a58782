"""Power spectra: equal to SciPy's on whole records, and blind to gaps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from vibrid.errors import DataError, OptionError
from vibrid.record import Record
from vibrid.spectra import power_spectrum


def test_equals_scipy_however_it_is_read(rng: np.random.Generator) -> None:
    """Stretches of 32 windows give the same average as one call over all."""
    x = rng.normal(size=(20_000, 3))
    record = Record(x[:, 1:], x[:, 0], dt=0.01)
    frequencies_hz, psd = power_spectrum(record, segment_seconds=1.28)
    expected = signal.welch(x, 100.0, nperseg=128, axis=0)
    np.testing.assert_allclose(frequencies_hz, expected[0])
    np.testing.assert_allclose(psd, expected[1], rtol=1e-12)


def test_gaps_are_left_out(rng: np.random.Generator) -> None:
    """Two pieces average by their number of windows; NaN never spreads."""
    x = rng.normal(size=3000)
    x[1000:1010] = np.nan
    _, psd = power_spectrum(Record(x, dt=1.0), segment_seconds=100)
    parts = [signal.welch(part, 1.0, nperseg=100)[1] for part in (x[:1000], x[1010:])]
    counts = [19, 38]  # windows of 100, half overlapping
    expected = (counts[0] * parts[0] + counts[1] * parts[1]) / sum(counts)
    np.testing.assert_allclose(psd[:, 0], expected, rtol=1e-12)


def test_energy_is_the_variance(rng: np.random.Generator) -> None:
    """The integral over frequency is the mean square (Parseval), whatever the length chosen."""
    x = rng.normal(size=50_000) * 3
    frequencies_hz, psd = power_spectrum(Record(x, dt=0.02))
    energy = psd[:, 0].sum() * frequencies_hz[1]
    assert energy == pytest.approx(9.0, rel=0.03)  # about 4 standard errors at 50,000 samples


def test_bad_lengths_are_refused() -> None:
    """Windows longer than record or pieces, too short or negative."""
    x = np.arange(200.0)
    with pytest.raises(OptionError, match="at most the record's 200"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=300)
    with pytest.raises(OptionError, match="at least 16"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=4)
    with pytest.raises(OptionError, match="must be positive"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=-1)
    x[::20] = np.nan
    with pytest.raises(DataError, match="the longest stretch has 19"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=32)
