"""Pulses of one force channel: its noise floor, where pulses begin and end, second peaks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..record import Floats

NOISE_FACTOR = 10.0  # of the noise floor: what chance does not reach in any record
FOOT_FACTOR = 3.0  # of the noise floor: where a pulse begins and ends
FOOT_SHARE = 0.01  # of the peak: likewise, for the ringing of anti-alias filters
SECOND_SHARE = 0.1  # of the peak: a second peak as high is another hit
FLAT_SAMPLES = 3  # equal ones at the peak: no pulse has them, a limiter does
FLAT_TO = 1e-6  # of the peak
FULL_SCALE = 0.99


@dataclass(frozen=True)
class Pulse:
    """Samples [start, end) of a hit, its highest sample, and the second peak (0 without)."""

    start: int
    end: int
    peak_sample: int
    peak: float
    second_sample: int
    second_ratio: float
    is_clipped: bool


def centred(force: Floats) -> tuple[Floats, float]:
    """Return a force less its median (missing samples 0), and its noise floor.

    The floor is 1.4826 times the median deviation: the standard deviation of Gaussian noise,
    and blind to hits, which fill a small part of the time.
    """
    good = ~np.isnan(force)
    if not good.any():
        return np.zeros_like(force), 0.0
    moved = np.where(good, force - np.median(force[good]), 0.0)
    return moved, 1.4826 * float(np.median(np.abs(moved[good])))


def groups(force: Floats, level: float, gap: int) -> list[tuple[int, int]]:
    """Return [first, last + 1) of samples above a level, joined over gaps up to `gap`."""
    above = np.flatnonzero(np.abs(force) >= level)
    if not len(above):
        return []
    parts = np.split(above, np.flatnonzero(np.diff(above) > gap) + 1)
    return [(int(part[0]), int(part[-1]) + 1) for part in parts]


def pulse_in(force: Floats, first: int, stop: int, floor: float, full_scale: float | None) -> Pulse:
    """Return the pulse with the highest sample of [first, stop), double or not."""
    peak_sample = first + int(np.abs(force[first:stop]).argmax())
    peak = float(force[peak_sample])
    relative = force / peak
    foot = max(FOOT_SHARE, FOOT_FACTOR * floor / abs(peak))
    peaks = _peaks(relative, first, stop, max(SECOND_SHARE, NOISE_FACTOR * floor / abs(peak)))
    others = [k for k in peaks if k != min(peaks, key=lambda k: abs(k - peak_sample))]
    second = max(others, key=lambda k: relative[k], default=0)
    ends = sorted([peak_sample, *others])
    low = relative <= foot  # an undershoot of the other sign is no longer the pulse
    return Pulse(
        start=_last_true(low, ends[0]) + 1,
        end=_first_true(low, ends[-1]),
        peak_sample=peak_sample,
        peak=peak,
        second_sample=second,
        second_ratio=float(relative[second]) if others else 0.0,
        is_clipped=_is_clipped(relative, peak_sample)
        or (full_scale is not None and abs(peak) >= FULL_SCALE * full_scale),
    )


def _peaks(relative: Floats, first: int, stop: int, share: float) -> list[int]:
    """Return the samples of peaks of the main one's sign that stand out by their share."""
    from scipy.signal import find_peaks

    padded = np.concatenate([[0.0], relative[first:stop], [0.0]])
    found, _ = find_peaks(padded, height=share, prominence=share)
    return [first - 1 + int(k) for k in found]


def _is_clipped(relative: Floats, peak_sample: int) -> bool:
    low = relative < 1 - FLAT_TO
    return _first_true(low, peak_sample) - _last_true(low, peak_sample) - 1 >= FLAT_SAMPLES


def _first_true(flags: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], start: int) -> int:
    """Return the first index from `start` on that is true, or the length."""
    ahead = flags[start:]
    return start + int(ahead.argmax()) if ahead.any() else len(flags)


def _last_true(flags: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], start: int) -> int:
    """Return the last index before `start` that is true, or −1."""
    behind = flags[:start][::-1]
    return start - 1 - int(behind.argmax()) if behind.any() else -1
