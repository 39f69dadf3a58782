"""Rows of 𝒦 and 𝒟 at degrees of freedom without force, whatever drives the others.

Where M⁻¹f has a zero row i, q̈_i + 𝒟_i q̇ + 𝒦_i q = 0. Multiplied by w(t) e^{−iωt}, w smooth and
zero at both ends, and integrated by parts, this is a regression on spectra: no input model, no
initial state, no integration that drifts. What a row leaves, in units of what the sensors'
noise leaves, tells whether it is forced.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from ..errors import DataError, OptionError
from ..modes import Complexes
from ..record import Floats

RAMP = 0.1  # of the record, at each end
STEP = Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])  # from 0 to 1, four times smooth
FEWEST_CYCLES = 3  # in the record, of the lowest line used
BLOCKS = 64  # of lines, over which powers are averaged to find the band
QUIET = 4.0  # times the noise floor: below it a block of lines is noise
QUIET_SHARE = 0.1  # of all lines that must be noise, to measure it
ROUNDING = 1e-13  # of a channel's largest line
REWEIGHTED = 5
FREE = 3.0  # times √(2 / freedom) above 1, up to which χ² per degree of freedom is noise
FORCED = 1.5  # χ² per degree of freedom above which a row is forced
TOO_QUIET = 0.5  # χ² per degree of freedom below which the noise is not what it seems
SINGLE = 1.5  # times the noise: what the next best relation of the same channels must leave
NOISE_FREE = 1e-14  # of the signal's power: less noise is none, and χ² says nothing
CHASM = 1e4  # between χ² of free and forced rows where there is no noise
GAP, TOLERATED = 10.0, 10.0  # the same, and the largest χ², where the user says what is forced


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


@dataclass(frozen=True, eq=False)
class Spectra:
    """Windowed spectra of the motion and its derivatives, of all records, line by line.

    Attributes
    ----------
    rates : array (n_lines,)
        ω [rad/s] of the lines in the band.
    motions : complex array (3, n_lines, n_dof)
        Of the acceleration-like signal and its first and second derivative.
    offsets : complex array (n_lines, n_records)
        F(w) at the lines of each record: what a constant in the motion, which the mean of the
        sensors hides, does to a row.
    noise : array (n_dof,)
        E|F(w e)|² of the noise of each channel.
    powers : int array (n_dof,)
        How many derivatives each channel was raised by to become alike.
    band_hz : (low, high)
    signal : array (n_dof,)
        Largest |F(w y)|² of each channel in the band.
    """

    rates: Floats
    motions: Complexes
    offsets: Complexes
    noise: Floats
    powers: NDArray[np.int64]
    band_hz: tuple[float, float]
    signal: Floats

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
) -> Spectra:
    """Return the spectra in a band, and the noise above it.

    Parameters
    ----------
    samples : tuple of arrays (n_samples, n_dof)
    dt : float
    powers : int array (n_dof,)
        0, 1, 2 for sensors of displacement, velocity, acceleration.
    band_hz : (low, high), optional
        Of the force; by default up to where all channels fall to a level floor.

    Raises
    ------
    OptionError
        A band that the record does not hold.
    DataError
        No lines above the band that would tell the noise.
    """
    duration = min(len(y) for y in samples) * dt
    low, high = _band(samples, dt, band_hz, duration)
    raised = powers.max() - powers
    parts = [windowed_motions(y - y.mean(axis=0), dt, raised, low, high) for y in samples]
    # of exponentially distributed powers; what leaks over the band's edge does not move it
    above = np.concatenate([part.power[part.hertz > high] for part in parts])
    noise = np.median(above, axis=0) / np.log(2)
    signal = np.max([part.power[part.inside].max(axis=0) for part in parts], axis=0)
    return Spectra(
        np.concatenate([part.rates for part in parts]),
        np.concatenate([part.motions for part in parts], axis=1),
        np.asarray(sla.block_diag(*[part.window[:, None] for part in parts])),
        np.maximum(noise, ROUNDING**2 * signal),
        raised,
        (low, high),
        signal,
    )


def _band(
    samples: tuple[Floats, ...], dt: float, given: tuple[float, float] | None, duration: float
) -> tuple[float, float]:
    nyquist, lowest = 0.5 / dt, FEWEST_CYCLES / duration
    if given is None:
        high = max(_quiet_above(y, dt) for y in samples)
        return lowest, high
    low, high = given
    if not 0 <= low < high:
        raise OptionError(f"force_band must be (low, high) in hertz; got {given}.")
    if high > (1 - QUIET_SHARE) * nyquist:
        raise OptionError(
            f"force_band ends at {high:g} Hz and the record at {nyquist:g} Hz; the noise is read "
            f"above the band: end it at {(1 - QUIET_SHARE) * nyquist:.4g} Hz, or sample faster."
        )
    return max(low, lowest), high


def _quiet_above(y: Floats, dt: float) -> float:
    """Return the frequency above which all channels are at their floor."""
    windowed = (y - y.mean(axis=0)) * ramp_window(len(y), RAMP)[:, None]
    power = np.abs(np.fft.rfft(windowed, axis=0)) ** 2
    edges = np.linspace(0, len(power), min(BLOCKS, len(power) // 8) + 1).astype(int)
    blocks = np.add.reduceat(power, edges[:-1], axis=0) / np.diff(edges)[:, None]
    floor = np.median(blocks[3 * len(blocks) // 4 :], axis=0)
    loud = np.flatnonzero((blocks > QUIET * floor).any(axis=1))
    last = int(loud[-1]) + 1 if len(loud) else 1
    if len(blocks) - last < QUIET_SHARE * len(blocks):
        raise DataError(
            "The sensors show no level floor below the Nyquist frequency, so their noise cannot "
            "be told from the motion: give force_band=(low, high) in hertz, or sample faster."
        )
    return float(np.fft.rfftfreq(len(y), dt)[edges[last] - 1])


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


@dataclass(frozen=True, eq=False)
class Rows:
    """Every row of [𝒦 𝒟] as if it were free of force, and how well that goes.

    Attributes
    ----------
    P : array (n, 2 n)
        [𝒦 𝒟].
    covariances : array (n, 2 n, 2 n)
        Of each row.
    misfits : array (n,)
        χ² per degree of freedom.
    seconds : array (n,)
        What the next best relation of the same channels leaves, in units of the noise: near 1
        there are several, and the row is any mixture of them.
    freedom : int
    noise_share : float
        Noise power over signal power of the clearest channel.
    """

    P: Floats
    covariances: Floats
    misfits: Floats
    seconds: Floats
    freedom: int
    noise_share: float

    @property
    def limit(self) -> float:
        """The misfit up to which a row is taken as free."""
        return 1 + FREE * float(np.sqrt(2 / self.freedom))

    def free(self, stated: bool = False) -> NDArray[np.bool_]:
        """Return which rows are free of force.

        By χ²; without noise by a gap of four decades. With `stated` the user says that some
        rows are, and errors of the model up to three times the noise are tolerated.
        """
        single = self.seconds > SINGLE
        if self.noise_share < NOISE_FREE:
            return np.asarray(single & self._below_gap(CHASM, np.inf))
        believed = (self.misfits < self.limit) & (self.misfits > TOO_QUIET)
        if stated and not believed.any():
            believed = self._below_gap(GAP, TOLERATED)
        return np.asarray(single & believed)

    def forced(self, stated: bool = False) -> NDArray[np.bool_]:
        """Return which rows surely are not free of force."""
        free = self.free(stated)
        if self.noise_share < NOISE_FREE:
            return ~free
        return np.asarray(~free & (self.misfits > max(FORCED, self.limit)))

    def _below_gap(self, ratio: float, largest: float) -> NDArray[np.bool_]:
        """Return the rows below the widest gap of χ², none where it is narrow."""
        ranked = np.sort(self.misfits)
        steps = ranked[1:] / np.maximum(ranked[:-1], 1e-300)
        widest = int(np.argmax(steps)) if len(steps) else 0
        if not len(steps) or steps[widest] < ratio or ranked[widest] > largest:
            return np.zeros(len(ranked), dtype=bool)
        return np.asarray(self.misfits <= ranked[widest])


def regress_rows(spectra: Spectra) -> Rows:
    """Return all rows by errors-in-variables regression; noise is in every channel.

    The variance of what row i leaves, ½ Σ_j s_j² |δ_ij (iω)² + 𝒟_ij iω + 𝒦_ij|², depends on the
    row itself: five reweighted least squares, then Gauss-Newton on the weighted errors.

    Raises
    ------
    DataError
        Fewer lines in the band than a row has unknowns.
    """
    n = spectra.motions.shape[2]
    freedom = 2 * len(spectra.rates) - 2 * n - spectra.offsets.shape[1]
    if freedom <= 2 * n:
        raise DataError(
            f"The band {spectra.band_hz[0]:.3g} to {spectra.band_hz[1]:.3g} Hz has "
            f"{len(spectra.rates)} lines for {2 * n} unknowns a row; use a longer record."
        )
    rows = [_Row(spectra, row) for row in range(n)]
    solved = [row.solved() for row in rows]
    return Rows(
        np.array([values for values, _, _ in solved]),
        np.array([covariance for _, covariance, _ in solved]),
        np.array([squares / freedom for _, _, squares in solved]),
        np.array([row.second(each[0]) for row, each in zip(rows, solved, strict=True)]),
        freedom,
        float((spectra.noise / spectra.signal).min()),
    )


class _Row:
    """Weighted regression of one row: unknowns 𝒦_i / ω₀², 𝒟_i / ω₀."""

    def __init__(self, spectra: Spectra, row: int) -> None:
        low, middle, high = spectra.motions
        unit, n = spectra.unit, low.shape[1]
        self.s = 1j * spectra.rates / unit
        size = np.abs(low).max() / np.abs(spectra.offsets).max()
        self.columns = np.hstack([low, middle / unit, size * spectra.offsets])
        self.wanted = -high[:, row] / unit**2
        self.levels = spectra.noise * np.abs(spectra.rates[:, None]) ** (2 * spectra.powers)
        self.own = np.arange(n) == row
        self.scale = unit ** np.repeat([2.0, 1.0], n)

    def solved(self) -> tuple[Floats, Floats, float]:
        """Return the row, its covariance and χ²."""
        from scipy.optimize import least_squares  # slow to import, and used only here

        x = self._weighted(np.ones(len(self.s)))
        for _ in range(REWEIGHTED):
            x = self._weighted(self.variance(x))
        found = least_squares(self.errors, x, jac=self.jacobian, method="lm", x_scale="jac")
        J = self.jacobian(found.x)
        size = np.linalg.norm(J, axis=0)
        covariance = np.linalg.pinv((J / size).T @ (J / size)) / size / size[:, None]
        k = len(self.scale)
        return (
            found.x[:k] * self.scale,
            covariance[:k, :k] * self.scale * self.scale[:, None],
            float(2 * found.cost),
        )

    def second(self, values: Floats) -> float:
        """Return what the second best relation leaves, in units of the noise.

        The second eigenvalue of Σ Re(z z*) v relative to that of noise alone, z the columns
        and what they explain.
        """
        n = len(self.own)
        variance = self.variance(values / self.scale)
        weighed = np.hstack([self.columns, -self.wanted[:, None]]) / np.sqrt(variance)[:, None]
        z = np.hstack([weighed[:, : 2 * n], weighed[:, -1:]])
        levels, s = 0.5 * self.levels / variance[:, None], np.abs(self.s)[:, None]
        noise = np.diag(
            np.concatenate(
                [levels.sum(0), (levels * s**2).sum(0), (levels * s**4)[:, self.own].sum(0)]
            )
        )
        row = int(np.argmax(self.own))
        noise[row, 2 * n] = noise[2 * n, row] = -(levels * s**2)[:, row].sum()
        size = np.sqrt(np.diag(noise))
        power = 0.5 * (z.conj().T @ z).real / size / size[:, None]
        return float(sla.eigh(power, noise / size / size[:, None], eigvals_only=True)[1])

    def _weighted(self, variance: Floats) -> Floats:
        weight = 1 / np.sqrt(variance)
        A = _stacked(self.columns * weight[:, None])
        return np.asarray(np.linalg.lstsq(A, _stacked(self.wanted * weight), rcond=None)[0])

    def transfer(self, x: Floats) -> Complexes:
        """Return δ_ij s² + 𝒟_ij s + 𝒦_ij (n_lines, n), s = iω / ω₀."""
        stiffness, damping = np.split(x[: 2 * len(self.own)], 2)
        return np.asarray(self.own * self.s[:, None] ** 2 + self.s[:, None] * damping + stiffness)

    def variance(self, x: Floats) -> Floats:
        """Return that of the real and of the imaginary part of each error."""
        return np.asarray(0.5 * np.sum(self.levels * np.abs(self.transfer(x)) ** 2, axis=1))

    def errors(self, x: Floats) -> Floats:
        return _stacked((self.columns @ x - self.wanted) / np.sqrt(self.variance(x)))

    def jacobian(self, x: Floats) -> Floats:
        h, v = self.transfer(x), self.variance(x)
        pulled = self.levels * h.conj()
        free = np.zeros((len(v), self.columns.shape[1] - 2 * len(self.own)))
        slope = np.hstack([pulled.real, (pulled * self.s[:, None]).real, free])
        left = (self.columns @ x - self.wanted)[:, None]
        return _stacked((self.columns - 0.5 * left * slope / v[:, None]) / np.sqrt(v)[:, None])


def _stacked(values: NDArray[Any]) -> Floats:
    return np.concatenate([values.real, values.imag])
