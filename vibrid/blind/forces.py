"""The history of the unknown force, M⁻¹f, from the motion and [𝒦 𝒟]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..modes import Complexes
from ..record import Floats
from .coordinates import dynamic_stiffness, periodic_force
from .windowed import windowed_motions

DIFFERENCE = 1e-5  # relative step of derivatives by [𝒦 𝒟]
NOISY = 0.2  # share of the force's power that noise may have
RISING = 10.0  # towards low frequency, of a power that is a window's leakage
KNOWN_FORCE = 0.5  # of a force's size: a larger error leaves nothing to be shown
SMOOTHING = 9  # lines over which powers are averaged


@dataclass(frozen=True, eq=False)
class PeriodicForce:
    """M⁻¹f of a sum of sines.

    Attributes
    ----------
    phasors : complex array (…, n_dof, n_frequencies)
    history : array (n_samples, n_dof)
        Of all records, one after the other.
    deviations : array (n_dof,)
        Root mean square of its expected error.
    """

    phasors: Complexes
    history: Floats
    deviations: Floats

    @property
    def known(self) -> bool:
        """Whether the errors leave something to be shown; no force at all is known too."""
        size = np.sqrt(np.mean(self.history**2, axis=0)).max()
        return not self.phasors.size or bool((self.deviations < KNOWN_FORCE * size).all())


def phasor_deviations(
    P: Floats,
    covariance: Floats,
    columns: Complexes,
    rates: Floats,
    powers: NDArray[np.int64],
    noise: Floats,
    n_samples: int,
    *,
    dt: float,
    hold: str,
) -> Floats:
    """Return the deviations E|δp|² ^½ of the phasors of M⁻¹f (n, n_frequencies).

    From the covariance of vec [𝒦 𝒟] and white noise of the given variances on the sensors,
    whose phasors then have the variance 4 s² / N. Derivatives by [𝒦 𝒟] are differences: exact
    for the continuous force, which is linear in them.

    Parameters
    ----------
    columns : complex array (n, n_frequencies)
        The sensors' phasors.
    """
    n, hertz = len(P), rates / (2 * np.pi)

    def behind(P: Floats, columns: Complexes) -> Complexes:
        return periodic_force(P[:, :n], P[:, n:], powers, hertz, columns, dt=dt, hold=hold)

    size = np.linalg.norm(P[:, :n])
    steps = DIFFERENCE * np.repeat([size, max(float(np.linalg.norm(P[:, n:])), size**0.5)], n * n)
    changes = np.array([each.reshape(2 * n, n).T for each in np.diag(steps)])
    slopes = [(behind(P + each, columns) - behind(P - each, columns)) for each in changes]
    slope = np.array(slopes) / (2 * steps[:, None, None])
    by_matrices = np.einsum("amf,ab,bmf->mf", slope.conj(), covariance, slope, optimize=True).real
    units = np.broadcast_to(np.eye(n)[:, :, None], (n, n, len(rates))).astype(np.complex128)
    by_noise = sum(s2 * np.abs(behind(P, u)) ** 2 for s2, u in zip(noise, units, strict=True))
    return np.asarray(np.sqrt(np.maximum(by_matrices, 0) + 4 / n_samples * by_noise))


def seen_band(
    P: Floats,
    powers: NDArray[np.int64],
    noise: Floats,
    n_samples: int,
    hertz: Floats,
    *,
    size: float,
    gain: float,
) -> tuple[float, float]:
    """Return the lowest and highest frequency at which a sine of M⁻¹f would be seen; NaN: none.

    A sine p of RMS |p| moves the sensors by G p and gains N Σ_i |G p|_i² / s_i² of 2 log L, s²
    the variance of white noise; p is distributed as is seen least.

    Parameters
    ----------
    hertz : array
        Frequencies to look at, ascending.
    size : float
        RMS of the sine at all DOFs together.
    gain : float
        Of 2 log L, by which an oscillation is told from noise.
    """
    # the least of G is one over the largest of its inverse
    inverse = _gains(P, 2 * np.pi * hertz, powers) * np.sqrt(noise)
    least = 1 / np.linalg.svd(inverse, compute_uv=False)[:, 0]
    seen = hertz[n_samples * (size * least) ** 2 > gain]
    return (float(seen[0]), float(seen[-1])) if len(seen) else (np.nan, np.nan)


def _gains(P: Floats, rates: Floats, powers: NDArray[np.int64]) -> Complexes:
    """Return what turns the sensors' phasors into M⁻¹f (n_frequencies, n, n)."""
    return np.asarray(dynamic_stiffness(P, rates) / (1j * rates[:, None, None]) ** powers)


@dataclass(frozen=True, eq=False)
class InverseForce:
    """A force read from the motion, line by line of the spectrum.

    Attributes
    ----------
    values : array (n_samples, n)
        M⁻¹f, its ends tapered and everything below `lowest_hz` left out; NaN where a row of
        [𝒦 𝒟] is unknown.
    deviations : array (n,)
        Root mean square error that the sensors' noise leaves.
    lowest_hz : array (n,)
        The frequency above which noise permits a force; NaN where nowhere.
    """

    values: Floats
    deviations: Floats
    lowest_hz: Floats


def inverse_force(
    P: Floats,
    motion: Floats,
    dt: float,
    powers: NDArray[np.int64],
    noise: Floats,
    band_hz: tuple[float, float],
) -> InverseForce:
    """Return q̈ + 𝒟q̇ + 𝒦q from the spectra of the motion, without integration in time.

    Parameters
    ----------
    P : array (n, 2 n)
        [𝒦 𝒟]; rows of NaN stay unknown.
    motion : array (n_samples, n)
    dt : float
    powers : int array (n,)
        0, 1, 2 for sensors of displacement, velocity, acceleration.
    noise : array (n,)
        E|F(w e)|² of the sensors' noise under the window.
    band_hz : (low, high)
        What lies outside is left out.

    Notes
    -----
    In the weak form that is also used for the rows, so that the ends of the record do not leak:
    of accelerations it gives f̈, and f by −1/ω². The gain on noise, 1 + |𝒦|/ω², grows without
    limit at low frequency: of each row only the lines are kept above which noise has less than a
    fifth of the power.
    """
    N, n = motion.shape
    raised = powers.max() - powers
    low, high = band_hz
    spectra = windowed_motions(motion - motion.mean(axis=0), dt, raised, low, high)
    rates, (slow, middle, fast) = spectra.rates, spectra.motions
    turn = (1j * rates[:, None]) ** powers.max()
    found = (fast + middle @ P[:, n:].T + slow @ P[:, :n].T) / turn
    constant = spectra.window[:, None] / turn  # what the mean, taken out of the motion, leaves
    share = (constant.conj() * found).real.sum(axis=0) / (np.abs(constant) ** 2).sum()
    found = found - constant * share
    gains = dynamic_stiffness(P, rates)
    levels = rates[:, None] ** (2.0 * raised) * noise
    disturbed = np.einsum("fij,fj->fi", np.abs(gains) ** 2, levels) / np.abs(turn) ** 2
    kept = np.zeros(found.shape, dtype=bool)
    lowest = np.full(n, np.nan)
    for row in np.flatnonzero(np.isfinite(P).all(axis=1)):
        weight = rates ** (2.0 * powers.max())
        first = _first_line(np.abs(found[:, row]) ** 2, disturbed[:, row], weight)
        kept[first:, row] = True
        if first < len(rates):
            lowest[row] = rates[first] / (2 * np.pi)
    whole = np.zeros((N // 2 + 1, n), dtype=np.complex128)
    whole[np.rint(rates * N * dt / (2 * np.pi)).astype(int)] = np.where(kept, found, 0)
    values = np.fft.irfft(whole, N, axis=0)
    deviations = np.sqrt(2 * np.where(kept, disturbed, 0).sum(axis=0)) / N
    values[:, np.isnan(lowest)] = np.nan
    deviations[np.isnan(lowest)] = np.nan
    return InverseForce(values, deviations, lowest)


def _first_line(power: Floats, disturbed: Floats, weight: Floats) -> int:
    """Return the line above which the force stands out of noise and of what windows leak.

    Towards low frequency both rise; the force's strongest line is sought where its weighted
    power, that of its derivative as measured, is largest.
    """
    length = min(SMOOTHING, len(power))
    kernel = np.ones(length) / length
    smooth, noise = (np.convolve(each, kernel, mode="same") for each in (power, disturbed))
    clear = noise < NOISY * smooth
    if not clear.any():
        return len(power)
    strongest = int(np.argmax(np.where(clear, smooth * weight, 0)))
    hidden = np.flatnonzero(~clear[: strongest + 1])
    first = int(hidden[-1]) + 1 if len(hidden) else 0
    # a leak falls line by line; dips of a random force further on are its own
    falling = np.diff(smooth[first : strongest + 1]) < 0
    lowest = first + (int(np.argmin(falling)) if not falling.all() else len(falling))
    return lowest if smooth[first] > RISING * smooth[lowest] else first
