"""Excitation signals: shapes, spectra and levels as promised."""

from __future__ import annotations

import numpy as np
import pytest

from vibrid import excitation
from vibrid.errors import OptionError


def rng(seed=3):
    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    "signal",
    [
        excitation.impulse(64, 2),
        excitation.chirp(64, 0.1, 0.5, 4.0),
        excitation.multisine(64, 0.1, 2, band_hz=(1.0, 4.0), rng=rng()),
        excitation.prbs(64, 2, rng=rng(), hold_samples=5),
        excitation.white_noise(64, 2, rng=rng()),
        excitation.coloured_noise(64, 0.1, 2, rng=rng(), exponent=1.0),
    ],
)
def test_every_signal_is_two_dimensional(signal):
    """(n_samples, n_channels), float64, finite."""
    assert signal.shape in ((64, 1), (64, 2))
    assert signal.dtype == np.float64 and np.isfinite(signal).all()


def test_random_signals_repeat_with_their_seed():
    """The generator passed in is the only source of randomness."""
    for make in (
        lambda g: excitation.white_noise(50, rng=g),
        lambda g: excitation.prbs(50, rng=g),
        lambda g: excitation.coloured_noise(50, 0.1, rng=g),
        lambda g: excitation.multisine(50, 0.1, band_hz=(1, 3), rng=g),
    ):
        np.testing.assert_array_equal(make(rng()), make(rng()))
        assert (make(rng()) != make(rng(4))).any()


def test_impulse_is_one_sample():
    """One entry, where it was asked for."""
    signal = excitation.impulse(10, 3, channel=2, sample=4, amplitude=7.0)
    assert signal[4, 2] == 7 and np.count_nonzero(signal) == 1


def test_chirp_sweeps_between_its_frequencies():
    """Half of the sweep's zero crossings fit the mean frequency, energy stays in the band."""
    signal = excitation.chirp(4000, 0.01, 1.0, 9.0, amplitude=2.0)[:, 0]
    crossings = np.count_nonzero(np.diff(np.signbit(signal)))
    assert abs(crossings - 2 * 5.0 * 40) <= 2
    first = np.count_nonzero(np.diff(np.signbit(signal[:1000])))
    assert abs(first - 2 * 2.0 * 10) <= 2
    assert 1.99 < np.abs(signal).max() <= 2


def test_multisine_has_exactly_its_lines():
    """Every line of the band has the amplitude asked for, no other line any."""
    signal = excitation.multisine(200, 0.01, band_hz=(5.0, 20.0), amplitude=3.0)[:, 0]
    amplitude = 2 * np.abs(np.fft.rfft(signal)) / 200
    hertz = np.fft.rfftfreq(200, 0.01)
    inside = (hertz >= 4.999) & (hertz <= 20.001)
    np.testing.assert_allclose(amplitude, 3.0 * inside, atol=1e-12)


def test_multisine_by_band_and_by_list_agree():
    """The FFT and the sum of cosines are the same signal; Schroeder phases keep it low."""
    lines = np.arange(5, 41) * 0.5
    by_list = excitation.multisine(200, 0.01, frequencies_hz=list(lines))
    by_band = excitation.multisine(200, 0.01, band_hz=(2.5, 20.0))
    np.testing.assert_allclose(by_list, by_band, atol=1e-10)
    crest = np.abs(by_band).max() / by_band.std()
    assert crest < 2.0  # cosines in phase have √(2 · 36) = 8.5


def test_prbs_switches_only_after_a_hold():
    """Two levels, equal within each hold, both met."""
    signal = excitation.prbs(1003, rng=rng(), hold_samples=4, amplitude=2.0)[:, 0]
    assert set(np.unique(signal)) == {-2.0, 2.0}
    assert (np.flatnonzero(np.diff(signal)) % 4 == 3).all()
    assert abs(signal.mean()) < 0.5


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0])
def test_coloured_noise_has_its_slope_and_level(exponent):
    """The periodogram falls as f^−exponent in the band and is empty outside; std as asked."""
    signal = excitation.coloured_noise(
        2**16, 0.01, 4, rng=rng(), low_hz=0.5, high_hz=40.0, exponent=exponent, std=3.0
    )
    power = (np.abs(np.fft.rfft(signal, axis=0)) ** 2).mean(axis=1)
    hertz = np.fft.rfftfreq(2**16, 0.01)
    inside = (hertz > 0.501) & (hertz < 39.99)
    slope = np.polyfit(np.log(hertz[inside]), np.log(power[inside]), 1)[0]
    assert abs(slope + exponent) < 0.05
    assert power[(hertz < 0.499) | (hertz > 40.01)].max() < 1e-20 * power.max()
    np.testing.assert_allclose(signal.std(), 3.0, rtol=0.05)


@pytest.mark.parametrize("n_samples", [2, 3, 4])
def test_coloured_noise_level_of_the_shortest(n_samples):
    """The Nyquist line, alone in its pair, counts once."""
    signal = excitation.coloured_noise(n_samples, 1.0, 40000, rng=rng(), std=3.0)
    np.testing.assert_allclose(signal.std(), 3.0, rtol=0.02)


def test_white_noise_is_white():
    """Level as asked, channels and samples uncorrelated."""
    signal = excitation.white_noise(20000, 2, rng=rng(), std=5.0)
    np.testing.assert_allclose(signal.std(axis=0), 5.0, rtol=0.03)
    assert abs(np.corrcoef(signal.T)[0, 1]) < 0.03
    assert abs(np.corrcoef(signal[1:, 0], signal[:-1, 0])[0, 1]) < 0.03


def test_refusals():
    """Frequencies above Nyquist, empty bands, equal channels and odd sizes are named."""
    with pytest.raises(OptionError, match="Nyquist frequency 5 Hz"):
        excitation.chirp(10, 0.1, 1.0, 6.0)
    with pytest.raises(OptionError, match="No spectral line"):
        excitation.multisine(10, 0.1, band_hz=(1.2, 1.3))
    with pytest.raises(OptionError, match="either frequencies_hz or band_hz"):
        excitation.multisine(10, 0.1)
    with pytest.raises(OptionError, match="pass rng"):
        excitation.multisine(10, 0.1, 2, band_hz=(1, 3))
    with pytest.raises(OptionError, match="n_samples"):
        excitation.white_noise(0, rng=rng())
    with pytest.raises(OptionError, match="channel must be"):
        excitation.impulse(10, channel=1)
