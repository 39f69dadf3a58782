"""Spectra of a motion and its derivatives under a smooth window: nothing is differentiated.

Multiplied by w(t) e^{−iωt}, w smooth and zero at both ends, derivatives are integrated by parts.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
import scipy.linalg as sla
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ..errors import DataError, OptionError
from ..modes import Complexes
from ..record import Floats

RAMP = 0.05  # of the record, at each end: of .1, .05 and .03 the shortest whose floor, 1e-8 of M⁻¹K
# in 10 s, no sensor reaches; what ramps cover is lost, 3 % of the deviation between .1 and .05
STEP = Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])  # from 0 to 1, four times smooth
FEWEST_CYCLES = 3  # in the record, of the lowest line used
BLOCKS = 64  # of lines, over which powers are averaged to find the band
QUIET = 4.0  # times the noise floor: below it a block of lines is noise
QUIET_SHARE = 0.1  # of all lines that must be noise, to measure it
LEVELS = (
    (8, 0.15),
    (16, 0.3),
    (32, 0.5),
)  # of so many lines, white noise is so low 1 in 5000 times
ROUNDING = 1e-13  # of a channel's largest line


def ramp_window(n_samples: int, share: float, derivative: int = 0) -> Floats:
    """Return w or a derivative (by samples): flat, with a smooth ramp at each end.

    The ramp is 126 x⁵ − 420 x⁶ + 540 x⁷ − 315 x⁸ + 70 x⁹, whose first four derivatives vanish
    at both of its ends: a jump there, not the noise, would set the floor.
    """
    x = np.arange(n_samples) / max(n_samples - 1, 1)
    part = STEP.deriv(derivative) if derivative else STEP
    scale = (1 / share / max(n_samples - 1, 1)) ** derivative
    rise = np.where(x < share, part(np.minimum(x / share, 1)), float(derivative == 0))
    fall = np.where(x > 1 - share, part(np.minimum((1 - x) / share, 1)), float(derivative == 0))
    if derivative == 0:
        return np.asarray(rise * fall)
    return np.asarray(scale * (rise + (-1) ** derivative * fall))


def window_energy(n_samples: int) -> float:
    """Return Σ w², the power of a line of windowed white noise of variance 1."""
    return float(np.sum(ramp_window(n_samples, RAMP) ** 2))


@dataclass(frozen=True, eq=False)
class Spectra:
    """Windowed spectra of the motion and its derivatives, of all records, line by line.

    Attributes
    ----------
    rates : array (n_lines,)
        ω [rad/s] of the lines in the band.
    motions : complex array (3, n_lines, n_dof)
        Of the acceleration-like signal and its first and second derivative, in units in which
        the lines of white noise have its variance.
    offsets : complex array (n_lines, n_records)
        F(w) at the lines of each record: what a constant in the motion, which the mean of the
        sensors hides, does to a row.
    noise : array (n_dof,)
        Variance of the noise of each channel.
    powers : int array (n_dof,)
        How many derivatives each channel was raised by to become alike.
    band_hz : (low, high)
    signal : array (n_dof,)
        Largest |F(w y)|² of each channel in the band, in the same units.
    quiet_lines : int
        How many lines told the noise.
    """

    rates: Floats
    motions: Complexes
    offsets: Complexes
    noise: Floats
    powers: NDArray[np.int64]
    band_hz: tuple[float, float]
    signal: Floats
    quiet_lines: int

    @property
    def unit(self) -> float:
        """ω₀ [rad/s] that makes all columns of the regression alike."""
        low, high = self.band_hz
        return float(2 * np.pi * np.sqrt(low * high))


def spectra_of(
    samples: tuple[Floats, ...],
    dt: float,
    powers: NDArray[np.int64],
    band_hz: tuple[float, float] | None = None,
    *,
    believed: bool = False,
) -> Spectra:
    """Return the spectra in a band, and the noise above it.

    Parameters
    ----------
    samples : tuple of arrays (n_samples, n_dof)
    dt : float
    powers : int array (n_dof,)
        0, 1, 2 for sensors of displacement, velocity, acceleration.
    band_hz : (low, high), optional
        Of the lines to use; by default up to where all channels fall to a level floor.
    believed : bool
        Take that floor for the sensors' noise even where the band shows less.

    Raises
    ------
    OptionError
        A band that the record does not hold.
    DataError
        No level floor above the band that would tell the noise.
    """
    low, high = _band(samples, dt, band_hz)
    # a force below a band given by hand may move the structure above it: that is no noise
    quiet = max(_quiet_above(y, dt, 0.0 if band_hz is None else high) for y in samples)
    high = quiet if band_hz is None else high
    raised = powers.max() - powers
    sizes = [np.sqrt(window_energy(len(y))) for y in samples]  # alike in noise, whatever the length
    parts = [windowed_motions(y - y.mean(axis=0), dt, raised, low, high) for y in samples]
    powered = [part.power / size**2 for part, size in zip(parts, sizes, strict=True)]
    # of exponentially distributed powers; what leaks over the band's edge does not move it
    above = [each[part.hertz > max(high, quiet)] for part, each in zip(parts, powered, strict=True)]
    quiet_powers = np.concatenate(above)
    noise = np.median(quiet_powers, axis=0) / np.log(2)
    inside = [each[part.inside] for part, each in zip(parts, powered, strict=True)]
    noise = noise if believed else _below_floors(noise, inside)
    signal = np.max([each.max(axis=0) for each in inside], axis=0)
    return Spectra(
        np.concatenate([part.rates for part in parts]),
        np.concatenate(
            [part.motions / size for part, size in zip(parts, sizes, strict=True)], axis=1
        ),
        np.asarray(sla.block_diag(*[part.window[:, None] for part in parts])),
        np.maximum(noise, ROUNDING**2 * signal),
        raised,
        (low, high),
        signal,
        len(quiet_powers),
    )


def _below_floors(noise: Floats, powers: list[Floats]) -> Floats:
    """Return the noise of channels (n_dof,), less where the band shows that a floor is none.

    A force that reaches the Nyquist frequency makes a floor of its own above the modes; below
    them the sensors show less than it. Where one channel does so, a higher floor of another is
    not believed either.
    """
    levels = noise
    for power in powers:
        for count, share in LEVELS:
            groups = len(power) // count
            if groups:
                whole = power[: groups * count].reshape(groups, count, len(noise))
                lowest = whole.mean(axis=1).min(axis=0)
                levels = np.where(lowest < share * noise, np.minimum(levels, lowest), levels)
    seen = levels < noise
    return np.minimum(levels, levels[seen].max()) if seen.any() else noise


def _band(
    samples: tuple[Floats, ...], dt: float, given: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the band to use; its upper end is Nyquist where none is given."""
    nyquist, lowest = 0.5 / dt, FEWEST_CYCLES / (min(len(y) for y in samples) * dt)
    if given is None:
        return lowest, nyquist
    if len(given) != 2 or not 0 <= given[0] < given[1]:
        raise OptionError(f"force_band must be (low, high) in hertz; got {given}.")
    low, high = given
    if high > (1 - QUIET_SHARE) * nyquist:
        raise OptionError(
            f"force_band ends at {high:g} Hz and the record at {nyquist:g} Hz; the noise is read "
            f"above the band: end it at {(1 - QUIET_SHARE) * nyquist:.4g} Hz, or sample faster."
        )
    return max(low, lowest), high


def _quiet_above(y: Floats, dt: float, start: float) -> float:
    """Return the frequency above which all channels are at their floor, read above `start`."""
    windowed = (y - y.mean(axis=0)) * ramp_window(len(y), RAMP)[:, None]
    power = np.abs(np.fft.rfft(windowed, axis=0)) ** 2
    hertz = np.fft.rfftfreq(len(y), dt)
    edges = np.linspace(0, len(power), min(BLOCKS, len(power) // 8) + 1).astype(int)
    blocks = np.add.reduceat(power, edges[:-1], axis=0) / np.diff(edges)[:, None]
    count = len(blocks)
    last_quarter = max(3 * count // 4, int(np.searchsorted(hertz[edges[:-1]], start)))
    floor = np.median(blocks[min(last_quarter, count - 1) :], axis=0)
    loud = np.flatnonzero((blocks > QUIET * floor).any(axis=1))
    last = int(loud[-1]) + 1 if len(loud) else 1
    if count - last < QUIET_SHARE * count:
        raise DataError(
            "The sensors show no level floor below the Nyquist frequency, so their noise cannot "
            "be told from the motion; sample faster, so that there is a quiet band above it."
        )
    return float(hertz[edges[last] - 1])


@dataclass(frozen=True, eq=False)
class Motions:
    """Windowed spectra of one record.

    Attributes
    ----------
    hertz : array (n_all,)
        Of all lines.
    power : array (n_all, n_dof)
        |F(w y)|².
    inside : array of bool (n_all,)
        Lines of the band.
    motions : complex array (3, n_lines, n_dof)
        In the band: F(w x), F(w x'), F(w x''), x the outputs raised to one derivative.
    window : complex array (n_lines,)
        F(w).
    """

    hertz: Floats
    power: Floats
    inside: NDArray[np.bool_]
    motions: Complexes
    window: Complexes

    @property
    def rates(self) -> Floats:
        return 2 * np.pi * self.hertz[self.inside]


def windowed_motions(
    y: Floats, dt: float, raised: NDArray[np.int64], low: float, high: float
) -> Motions:
    """Return spectra of the outputs, each raised by some derivatives, and of two more.

    F(w x⁽ᵈ⁾) = (−1)ᵈ Σ_m C(d, m) (−iω)^(d−m) F(w⁽ᵐ⁾ x), by parts: nothing is differentiated.
    """
    hertz = np.asarray(np.fft.rfftfreq(len(y), dt), dtype=np.float64)
    inside = (hertz >= low) & (hertz <= high) & (hertz > 0)
    turn = -2j * np.pi * hertz[inside, None]
    windowed = [
        np.fft.rfft(y * (ramp_window(len(y), RAMP, m) / dt**m)[:, None], axis=0)
        for m in range(int(raised.max()) + 3)
    ]
    each = range(len(windowed))
    raised_by = np.array(
        [
            (-1) ** d
            * sum(comb(d, m) * turn ** (d - m) * windowed[m][inside] for m in range(d + 1))
            for d in each
        ]
    )
    columns = np.arange(y.shape[1])
    motions = np.array([raised_by[raised + d, :, columns].T for d in range(3)])
    window = np.fft.rfft(ramp_window(len(y), RAMP))[inside]
    return Motions(hertz, np.abs(windowed[0]) ** 2, inside, motions, window)
