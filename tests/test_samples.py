"""The embedded record is what its description says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from vibrid.samples import timber_building


def test_timber_building_is_as_described() -> None:
    """15 minutes of 6 accelerations at 100 Hz, finite, none of them constant or clipped."""
    record = timber_building()
    assert record.outputs.shape == (90000, 6)
    assert record.inputs.shape == (90000, 0)
    assert record.dt == 0.01
    assert {channel.quantity for channel in record.output_channels} == {"acceleration"}
    assert np.isfinite(record.outputs).all()
    assert (np.diff(record.outputs, axis=0) != 0).mean() > 0.999


@pytest.mark.parametrize("published_hz", [1.882, 2.421, 2.689])
def test_timber_building_has_the_published_peaks(published_hz: float) -> None:
    """Near each published frequency a spectrum has a peak, as near as its lines are apart."""
    y = timber_building().outputs
    lines, psd = signal.welch(y, fs=100, nperseg=8192, axis=0, detrend="linear")
    band = (lines > 1.5) & (lines < 3.2)
    total = (psd[band] / psd[band].sum(axis=0)).sum(axis=1)
    peaks, _ = signal.find_peaks(10 * np.log10(total), prominence=5)
    assert np.abs(lines[band][peaks] - published_hz).min() < 0.02  # two lines of 0.012 Hz
