"""Test signals: impulse, chirp, multisine, binary, white and coloured noise.

Every function returns an array (n_samples, n_channels). Random signals take a NumPy
Generator; nothing here touches a global random state.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .errors import OptionError, check_positive, check_whole
from .record import Floats


def impulse(
    n_samples: int,
    n_channels: int = 1,
    *,
    channel: int = 0,
    sample: int = 0,
    amplitude: float = 1.0,
) -> Floats:
    """Return zeros with `amplitude` at one sample of one channel.

    Examples
    --------
    >>> impulse(3, amplitude=2.0)[:, 0]
    array([2., 0., 0.])
    """
    _check_size(n_samples, n_channels)
    check_whole("channel", channel, 0, n_channels - 1)
    check_whole("sample", sample, 0, n_samples - 1)
    signal = np.zeros((n_samples, n_channels))
    signal[sample, channel] = amplitude
    return signal


def chirp(
    n_samples: int, dt: float, low_hz: float, high_hz: float, amplitude: float = 1.0
) -> Floats:
    """Return a sine whose frequency runs linearly from `low_hz` to `high_hz` (n_samples, 1).

    The frequency at the first sample is `low_hz`, one dt after the last `high_hz`; running
    down (`low_hz` above `high_hz`) is allowed. `dt` in seconds.
    """
    _check_size(n_samples, 1)
    check_positive("dt", dt, "s")
    _check_below_nyquist([low_hz, high_hz], dt)
    t = dt * np.arange(n_samples)
    rate = (high_hz - low_hz) / (n_samples * dt)
    return amplitude * np.sin(2 * np.pi * (low_hz * t + 0.5 * rate * t**2))[:, None]


def multisine(
    n_samples: int,
    dt: float,
    n_channels: int = 1,
    *,
    frequencies_hz: Sequence[float] | None = None,
    band_hz: tuple[float, float] | None = None,
    rng: np.random.Generator | None = None,
    amplitude: float = 1.0,
) -> Floats:
    """Return a sum of cosines of one amplitude (n_samples, n_channels).

    Parameters
    ----------
    n_samples, dt : int, float
        Length, and sampling interval [s].
    n_channels : int
        More than one needs `rng`: equal phases would make the channels equal.
    frequencies_hz : sequence of float, optional
        Frequencies [Hz] below Nyquist.
    band_hz : (low, high), optional
        Instead: every line k / (n_samples dt) in the band, so that the signal has the period
        n_samples and does not leak.
    rng : numpy Generator, optional
        Draws the phases. Without it they are Schroeder's (1970), −π k (k − 1) / K, which
        keep the peaks low.
    amplitude : float
        Of each cosine.

    Examples
    --------
    >>> multisine(4, 0.25, frequencies_hz=[1.0])[:, 0].round(12)
    array([ 1.,  0., -1., -0.])
    """
    _check_size(n_samples, n_channels)
    check_positive("dt", dt, "s")
    if (frequencies_hz is None) == (band_hz is None):
        raise OptionError("Give either frequencies_hz or band_hz.")
    if rng is None and n_channels > 1:
        raise OptionError(
            f"{n_channels} channels with the same phases are one signal; pass rng for random ones."
        )
    if band_hz is not None:
        lines = _lines_in(band_hz, n_samples, dt)
        spectrum = np.zeros((n_samples // 2 + 1, n_channels), dtype=np.complex128)
        spectrum[lines] = np.exp(1j * _phases(len(lines), n_channels, rng))
        return np.asarray(np.fft.irfft(spectrum, n_samples, axis=0) * (amplitude * n_samples / 2))
    hertz = np.asarray(frequencies_hz, dtype=np.float64)
    _check_below_nyquist(hertz, dt)
    t = 2 * np.pi * dt * np.arange(n_samples)[:, None]
    signal = np.zeros((n_samples, n_channels))
    for f, phase in zip(hertz, _phases(len(hertz), n_channels, rng), strict=True):
        signal += np.cos(f * t + phase)
    return amplitude * signal


def prbs(
    n_samples: int,
    n_channels: int = 1,
    *,
    rng: np.random.Generator,
    hold_samples: int = 1,
    amplitude: float = 1.0,
) -> Floats:
    """Return a random binary signal ±`amplitude` that may switch every `hold_samples`."""
    _check_size(n_samples, n_channels)
    check_whole("hold_samples", hold_samples, 1)
    draws = rng.integers(0, 2, (-(-n_samples // hold_samples), n_channels))
    return amplitude * np.repeat(2.0 * draws - 1, hold_samples, axis=0)[:n_samples]


def white_noise(
    n_samples: int, n_channels: int = 1, *, rng: np.random.Generator, std: float = 1.0
) -> Floats:
    """Return independent Gaussian samples of standard deviation `std`."""
    _check_size(n_samples, n_channels)
    return std * rng.standard_normal((n_samples, n_channels))


def coloured_noise(
    n_samples: int,
    dt: float,
    n_channels: int = 1,
    *,
    rng: np.random.Generator,
    low_hz: float = 0.0,
    high_hz: float | None = None,
    exponent: float = 0.0,
    std: float = 1.0,
) -> Floats:
    """Return Gaussian noise of power spectral density ∝ f^(−exponent) within a band.

    Parameters
    ----------
    n_samples, dt : int, float
        Length, and sampling interval [s].
    rng : numpy Generator
    low_hz, high_hz : float
        Band [Hz]; `high_hz` None is Nyquist.
    exponent : float
        0 is flat, 1 pink, 2 red (a random walk), negative rises with frequency.
    std : float
        Expected standard deviation.

    Notes
    -----
    White noise shaped in the frequency domain: the band's edges are sharp, the mean is zero
    and the signal has the period n_samples.
    """
    _check_size(n_samples, n_channels)
    check_positive("dt", dt, "s")
    lines = _lines_in((low_hz, 0.5 / dt if high_hz is None else high_hz), n_samples, dt, True)
    gain = np.zeros(n_samples // 2 + 1)
    gain[lines] = lines ** (-exponent / 2.0)
    twice = np.where(2 * np.arange(len(gain)) == n_samples, 1, 2)  # Nyquist stands alone
    gain *= std * np.sqrt(n_samples / (twice @ gain**2))
    spectrum = np.fft.rfft(rng.standard_normal((n_samples, n_channels)), axis=0)
    return np.asarray(np.fft.irfft(gain[:, None] * spectrum, n_samples, axis=0))


def _phases(count: int, n_channels: int, rng: np.random.Generator | None) -> Floats:
    if rng is not None:
        return rng.uniform(0, 2 * np.pi, (count, n_channels))
    k = np.arange(count)
    return np.asarray((-np.pi * k * (k + 1) / max(1, count))[:, None])


def _lines_in(
    band_hz: tuple[float, float], n_samples: int, dt: float, nyquist: bool = False
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Return the numbers of the DFT lines in the band, without the mean."""
    low, high = band_hz
    lines = np.arange(1, n_samples // 2 + 1 if nyquist else (n_samples + 1) // 2)
    hertz = lines / (n_samples * dt)
    slack = 1e-9 / (n_samples * dt)
    inside = lines[(hertz >= low - slack) & (hertz <= high + slack)]
    if not inside.size:
        raise OptionError(
            f"No spectral line lies between {low:g} and {high:g} Hz: the lines are "
            f"{1 / (n_samples * dt):.4g} Hz apart and end at {0.5 / dt:g} Hz. Widen the band or "
            "take more samples."
        )
    return inside


def _check_below_nyquist(hertz: Sequence[float] | Floats, dt: float) -> None:
    for f in hertz:
        if not 0 <= f < 0.5 / dt:
            raise OptionError(
                f"{f:g} Hz is not between 0 and the Nyquist frequency {0.5 / dt:g} Hz; lower it "
                "or take a smaller dt."
            )


def _check_size(n_samples: int, n_channels: int) -> None:
    check_whole("n_samples", n_samples, 1)
    check_whole("n_channels", n_channels, 1)
