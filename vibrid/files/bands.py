"""Where the energy of a record sits: spectrum, energy band, strongest line, suggested band.

The suggestion is for records whose structure vibrates far below the Nyquist frequency. Three
things hide that in a plain energy spectrum and are treated first: slow drift below the first
valley of the spectrum, narrow lines of machines (a running median along a constant relative
width), and the slow fall of an acceleration spectrum above the last mode, which carries much
energy and no mode.
"""

from __future__ import annotations

import math

import numpy as np

from ..record import Floats, Record
from ..spectra import power_spectrum

FEWEST_LINES = 32  # fewer show no shape
LARGEST_SPECTRUM = 2_000_000  # samples; longer records are sampled in stretches
STRETCHES = 8
ENERGY = 0.95  # of the energy lies in an energy band
DRIFT_RISE = 3.0  # the level after the valley, over the valley's
DRIFT_HEIGHT = 10.0  # the level at the lowest line over the valley's: then it is drift
VALLEY_OCTAVES = 0.25  # half width of the level that the valley is sought in
LINE_WIDTH = 0.02  # half width, relative to the frequency, of the median that removes lines
NOTABLE = 0.1  # of the highest level: ambient records, whose weak parts are mostly noise
NOTABLE_FORCED = 0.02  # with measured inputs, weaker modes can be identified too
MARGIN = 1.25
FAR_BELOW = 0.3  # of the Nyquist frequency
FRIENDLY = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)

Band = tuple[float, float]


def survey_spectrum(record: Record) -> tuple[Floats, Floats]:
    """Return lines [Hz] above the mean's leakage and the PSD of every channel there."""
    if record.n_samples <= LARGEST_SPECTRUM:
        lines, psd = power_spectrum(record)
    else:
        length = LARGEST_SPECTRUM // STRETCHES
        starts = np.linspace(0, record.n_samples - length, STRETCHES).astype(int)
        parts = [power_spectrum(record.slice(int(k), int(k) + length)) for k in starts]
        lines, psd = parts[0][0], np.mean([part[1] for part in parts], axis=0)
    return lines[2:], psd[2:]  # a Hann window spreads the mean over two lines


def energy_band(lines: Floats, psd: Floats) -> Band:
    """Return the band that holds 95 % of the channels' mean energy, half of the rest each side."""
    shares = _mean_share(psd)
    if shares is None:
        return (math.nan, math.nan)
    energy = np.cumsum(shares)
    low, high = np.searchsorted(energy, [(1 - ENERGY) / 2, (1 + ENERGY) / 2])
    return float(lines[low]), float(lines[min(high, len(lines) - 1)])


def strongest_line(lines: Floats, psd: Floats, *, above: float = 0.0) -> float:
    """Return the frequency of the highest density at or above a frequency [Hz]."""
    if not np.isfinite(psd).all() or not psd.any():
        return math.nan
    kept = lines >= above
    return float(lines[kept][np.argmax(psd[kept])])


def drift_of(lines: Floats, psd: Floats) -> tuple[float, float]:
    """Return the upper edge of slow drift [Hz] and its share of the energy; 0, 0 without."""
    shares = _mean_share(psd)
    if shares is None or len(lines) < FEWEST_LINES:
        return 0.0, 0.0
    valley = drift_edge(lines, shares)
    return valley, float(shares[lines < valley].sum())


def suggest_band(lines: Floats, psd: Floats, *, is_forced: bool) -> Band | None:
    """Return a band worth filtering to, when what vibrates sits far below Nyquist.

    The upper edge is the higher of two: where 95 % of the energy of the velocities (the
    channels taken as accelerations) is reached, and the last frequency whose level is notable.
    The lower edge is 0 where there is no drift.
    """
    shares = _mean_share(psd)
    if shares is None or len(lines) < FEWEST_LINES:
        return None
    valley = drift_edge(lines, shares)
    kept = lines >= valley
    above, lines_above = psd[kept], lines[kept]
    quiet = _without_lines(lines_above, above)
    level, velocity = _mean_share(quiet), _mean_share(quiet / lines_above[:, None] ** 2)
    if level is None or velocity is None:
        return None
    notable = NOTABLE_FORCED if is_forced else NOTABLE
    last = lines_above[level >= notable * level.max()][-1]
    most = lines_above[min(int(np.searchsorted(np.cumsum(velocity), ENERGY)), len(level) - 1)]
    high = friendly(MARGIN * max(float(last), float(most)), up=True)
    if high > FAR_BELOW * lines[-1]:
        return None
    return (friendly(valley / 2, up=False) if valley > 0 else 0.0), high


def drift_edge(lines: Floats, level: Floats) -> float:
    """Return the frequency of the valley between drift and vibration, 0 without drift [Hz]."""
    count = int(6 * np.log2(lines[-1] / lines[0])) + 2
    centres = np.geomspace(lines[0], lines[-1], count)
    spread = 2**VALLEY_OCTAVES
    first = np.searchsorted(lines, centres / spread)
    last = np.searchsorted(lines, centres * spread, side="right")
    smooth = np.array(
        [np.median(level[max(a - 1, 0) : b + 1]) for a, b in zip(first, last, strict=True)]
    )
    rises = np.flatnonzero(smooth > DRIFT_RISE * np.minimum.accumulate(smooth))
    if not len(rises):
        return 0.0
    valley = int(np.argmin(smooth[: rises[0]]))
    return float(centres[valley]) if smooth[0] > DRIFT_HEIGHT * smooth[valley] else 0.0


def friendly(value: float, *, up: bool) -> float:
    """Round to a number that people write.

    >>> friendly(8.9, up=True), friendly(0.55, up=False), friendly(130.0, up=True)
    (10.0, 0.5, 150.0)
    """
    decade = 10.0 ** math.floor(math.log10(value))
    steps = np.array(FRIENDLY) * decade
    chosen = steps[steps >= value * (1 - 1e-9)][0] if up else steps[steps <= value * (1 + 1e-9)][-1]
    return float(f"{chosen:.3g}")


def _mean_share(psd: Floats) -> Floats | None:
    """Return the mean over channels of each one's share of energy per line; None without any."""
    total = psd.sum(axis=0)
    alive = np.isfinite(total) & (total > 0)
    if not alive.any():
        return None
    return np.asarray((psd[:, alive] / total[alive]).mean(axis=1))


def _without_lines(lines: Floats, psd: Floats) -> Floats:
    """Return the running median along a constant relative width: narrow lines vanish."""
    half = (LINE_WIDTH * lines / (lines[1] - lines[0])).astype(int)
    return np.stack([np.median(psd[max(0, k - h) : k + h + 1], axis=0) for k, h in enumerate(half)])
