"""Rows of 𝒦 and 𝒟 at degrees of freedom without force, whatever drives the others.

Where M⁻¹f has a zero row i, q̈_i + 𝒟_i q̇ + 𝒦_i q = 0. Multiplied by w(t) e^{−iωt}, w smooth and
zero at both ends, and integrated by parts, this is a regression on spectra: no input model, no
initial state, no integration that drifts. What a row leaves, in units of what the sensors'
noise leaves, tells whether it is forced.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..errors import DataError
from ..modes import Complexes
from ..record import Floats
from .windowed import Spectra

REWEIGHTED = 5
FREE = 3.0  # standard deviations above 1, up to which χ² per degree of freedom is noise
MEDIAN = (
    1 / np.log(2) ** 2
)  # variance of the noise's power, relative, times the lines it is read in
FORCED = 1.5  # χ² per degree of freedom above which a row is forced
TOO_QUIET = 0.5  # χ² per degree of freedom below which the noise is not what it seems
SINGLE = 1.5  # times the noise: what the next best relation of the same channels must leave
NOISE_FREE = 1e-14  # of the signal's power: less noise is none, and χ² says nothing
CHASM = 1e4  # between χ² of free and forced rows where there is no noise
GAP, TOLERATED = 10.0, 10.0  # the same, and the largest χ², where the user says what is forced


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
    spread : float
        Standard deviation of the misfit of a free row: of χ² and of the noise it is measured by.
    noise_share : float
        Noise power over signal power of the clearest channel.
    """

    P: Floats
    covariances: Floats
    misfits: Floats
    seconds: Floats
    spread: float
    noise_share: float

    @property
    def limit(self) -> float:
        """The misfit up to which a row is taken as free."""
        return 1 + FREE * self.spread

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

    @property
    def ambiguous(self) -> NDArray[np.bool_]:
        """Which rows leave no more than the noise, but so does another relation."""
        return np.asarray((self.misfits < self.limit) & (self.seconds <= SINGLE))

    @property
    def too_quiet(self) -> bool:
        """Whether rows leave less than the noise, and nothing else speaks against them."""
        quiet = self.misfits < TOO_QUIET
        return bool(quiet.all() or (quiet.any() and not self.ambiguous.any()))

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

    Notes
    -----
    Near the Cramér-Rao bound of a row: of five masses under two random forces, 20 s, the RMS error
    of 𝒦 is 5.2e-4 at 40 dB (40 records; 5.3e-3 at 20 dB), the bound 4.97e-4, and single records
    reach twice the RMS. All free rows together, whose errors hang together by their sensors, have a
    bound 4 % lower.
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
        float(np.sqrt(2 / freedom + MEDIAN / spectra.quiet_lines)),
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
