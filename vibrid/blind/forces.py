"""The history of the unknown force, M⁻¹f, from the motion and [𝒦 𝒟]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..modes import Complexes
from ..record import Floats
from .windowed import windowed_motions

NOISY = 0.2  # share of the force's power that noise may have
RISING = 10.0  # towards low frequency, of a power that is a window's leakage
SMOOTHING = 9  # lines over which powers are averaged


def phasor_deviations(
    P: Floats,
    covariance: Floats,
    phasors: Complexes,
    rates: Floats,
    powers: NDArray[np.int64],
    noise: Floats,
    n_samples: int,
) -> Floats:
    """Return the deviations E|δf|² ^½ of the phasors of M⁻¹f (n, n_frequencies).

    From the covariance of vec [𝒦 𝒟] and white noise of the given variances on the sensors,
    whose phasors then have the variance 4 s² / N.
    """
    n = len(P)
    blocks = covariance.reshape(2 * n, n, 2 * n, n)
    q = phasors / (1j * rates) ** powers[:, None]
    both = np.vstack([q, 1j * rates * q])
    by_matrices = np.einsum("mf,miki,kf->if", both.conj(), blocks, both).real
    gains = _gains(P, rates, powers)
    return np.asarray(np.sqrt(by_matrices + 4 / n_samples * (np.abs(gains) ** 2 @ noise).T))


def _gains(P: Floats, rates: Floats, powers: NDArray[np.int64]) -> Complexes:
    """Return what turns the sensors' phasors into M⁻¹f (n_frequencies, n, n)."""
    n = len(P)
    s = (1j * rates)[:, None, None]
    stiffness = s**2 * np.eye(n) + s * P[:, n:] + P[:, :n]
    return np.asarray(stiffness / s ** powers[None, None, :])


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
    s = 1j * rates[:, None, None]
    gains = s**2 * np.eye(n) + s * P[:, n:] + P[:, :n]
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
    kernel = np.ones(SMOOTHING) / SMOOTHING
    smooth, noise = (np.convolve(each, kernel, mode="same") for each in (power, disturbed))
    clear = noise < NOISY * smooth
    if not clear.any():
        return len(power)
    strongest = int(np.argmax(np.where(clear, smooth * weight, 0)))
    hidden = np.flatnonzero(~clear[: strongest + 1])
    first = int(hidden[-1]) + 1 if len(hidden) else 0
    lowest = first + int(np.argmin(smooth[first : strongest + 1]))
    leaks = smooth[first : lowest + 1].max() > RISING * smooth[lowest]
    return lowest if leaks else first
