"""Standard deviations of the modes of a refined model.

Symbols: a step changes A by δA = δF + δK C + K δC (F and K are A and 0 of a model that
simulates). With left and right eigenvectors w v = 1 of A, δμ = w δA v; a shape component C_o v
changes by δC_o v + Σ_l C_o v_l w_l δA v / (μ − μ_l).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..fit import Fit
from ..modes import DERIVATIVES
from ..modes.values import eigenvectors_of
from ..record import Floats
from ..varpro import (
    derived_covariance,
    frequency_and_damping,
    parameter_covariance,
    pole_covariance,
)
from .place import Place
from .result import covariance_of

Complexes = NDArray[np.complex128]


def with_deviations(fit: Fit, place: Place) -> Fit:
    """Return the fit with standard deviations of its modes, and of its poles' coefficients.

    Figures "frequencies_std" [Hz], "damping_std" (n_modes,) and "shapes_std" (n_outputs,
    n_modes), the root mean square of |δφ|, in the order of `modes_of`. `parameter_covariance`
    is that of the coefficients of each pair's q² + a₁ q + a₂ and each real pole's q + a₁: of a
    model that simulates in the order of the blocks in A, of one that predicts pairs first,
    each by ascending magnitude of ln μ.
    """
    S = covariance_of(place)
    slopes = _Slopes.of(fit, place, S)
    figures = slopes.figures(fit)
    if place.projected.indirect:
        covariance = slopes.coefficients()
    else:
        covariance = pole_covariance(place.projected, S)
    return replace(
        fit, parameter_covariance=covariance, diagnostics=fit.diagnostics.joined(figures)
    )


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Derivatives of poles and shapes by everything that was estimated.

    Attributes
    ----------
    values, right, left : complex arrays (n,), (n, n), (n, n)
        Eigenvalues of A, eigenvectors as columns, and the rows of their inverse.
    C, gain : array (p, n), (n, p)
        In the stream's units.
    """

    place: Place
    covariance: Floats
    spread: Floats
    values: Complexes
    right: Complexes
    left: Complexes
    C: Floats
    gain: Floats

    @classmethod
    def of(cls, fit: Fit, place: Place, covariance: Floats) -> _Slopes:
        y = place.stream.output_scale
        values, right = np.linalg.eig(fit.model.A)
        return cls(
            place,
            covariance,
            parameter_covariance(place.projected, covariance),
            values.astype(complex),
            right.astype(complex),
            np.linalg.pinv(right.astype(complex)),
            fit.model.C / y[:, None],
            fit.kalman_gain * y,
        )

    def figures(self, fit: Fit) -> dict[str, Any]:
        """Return the standard deviations in the order of `modes_of`."""
        dt = fit.model.dt or 1.0
        power = np.array([DERIVATIVES[channel.quantity] for channel in fit.output_channels])
        places = self._places(fit)
        found = [self._mode(k, power, dt) for k in places]
        p = len(self.C)
        return {
            "frequencies_std": np.array([each[0] for each in found]) / dt,
            "damping_std": np.array([each[1] for each in found]),
            "shapes_std": np.array([each[2] for each in found]).reshape(-1, p).T,
        }

    def _places(self, fit: Fit) -> list[int]:
        """Return which eigenvalue each mode of `modes_of` is."""
        return [
            int(np.argmin(np.abs(self.values - mu))) for mu in eigenvectors_of(fit.model).values
        ]

    def _mode(self, k: int, power: NDArray[np.int64], dt: float) -> tuple[float, float, Floats]:
        """Return the deviations of frequency [1 / samples], damping ratio and shape."""
        mu, v = self.values[k], self.right[:, k]
        gaps = mu - self.values
        gaps[k] = np.inf
        with np.errstate(divide="ignore", invalid="ignore"):  # of coinciding poles: NaN
            resolvent = (self.C @ self.right / gaps) @ self.left
        lefts = np.vstack([self.left[k], np.nan_to_num(resolvent, nan=0.0, posinf=0.0, neginf=0.0)])
        by_step, by_rows = self._derivatives(lefts, v)
        self._add_own(by_rows, v)
        rate = np.log(mu) / dt
        turn = _of_shape(self.C @ v, self.place.stream.output_scale, power, rate)
        turn[:, 0] /= mu * dt
        first = np.hstack([frequency_and_damping(complex(mu))[:, None], np.zeros((2, len(power)))])
        all_turns = np.vstack([first, turn, -1j * turn])
        covariance = derived_covariance(
            self.place.projected,
            self.covariance,
            self.spread,
            (all_turns @ by_step).real,
            np.tensordot(all_turns, by_rows, axes=1).real,
        )
        variance = np.maximum(np.diag(covariance), 0)
        shape = variance[2:].reshape(2, -1).sum(axis=0)
        return float(np.sqrt(variance[0])), float(np.sqrt(variance[1])), np.sqrt(shape)

    def coefficients(self) -> Floats:
        """Return the covariance of the coefficients of pairs, then of real poles (n, n)."""
        with np.errstate(divide="ignore"):
            rank = np.abs(np.log(self.values))
        pairs = [int(k) for k in np.argsort(rank) if self.values[k].imag > 0]
        real = [int(k) for k in np.argsort(rank) if self.values[k].imag == 0]
        steps, rows = [], []
        for k in (*pairs, *real):
            by_step, by_rows = self._derivatives(self.left[[k]], self.right[:, k])
            turns = [-2.0, 2 * np.conj(self.values[k])] if k in pairs else [-1.0]
            for turn in turns:
                steps.append((turn * by_step[0]).real)
                rows.append((turn * by_rows[0]).real)
        return derived_covariance(
            self.place.projected, self.covariance, self.spread, np.array(steps), np.array(rows)
        )

    def _derivatives(self, lefts: Complexes, v: Complexes) -> tuple[Complexes, Complexes]:
        """Return the derivatives of ℓ A v, for some rows ℓ, by the step and the linear part."""
        projected = self.place.projected
        blocks, m = projected.blocks, self.place.stream.n_inputs
        k, families, p = blocks.n_blocks, 1 + len(blocks.inputs) + len(blocks.starts), len(self.C)
        used = blocks.used.ravel()
        row = np.zeros((len(lefts), 2 * k), dtype=complex)
        row[:, used] = lefts
        column = np.zeros(2 * k, dtype=complex)
        column[used] = v
        apart, both = row.reshape(-1, k, 2), column.reshape(k, 2)
        by_step = np.zeros((len(lefts), families, k, 2), dtype=complex)
        first = np.where(blocks.single, both[:, 1], both[:, 0])
        by_step[:, 0] = -apart * (blocks.spread * first)[:, None]
        if projected.indirect:
            seen = (self.C @ v)[:, None, None]
            by_step[:, 1 + m : 1 + m + p] = seen * apart[:, None]
        rows = len(projected.linear.stacked())
        by_rows = np.zeros((len(lefts), rows, p), dtype=complex)
        by_rows[:, : 2 * k] = column[:, None] * (lefts @ self.gain)[:, None, :]
        return by_step.reshape(len(lefts), -1), by_rows

    def _add_own(self, by_rows: Complexes, v: Complexes) -> None:
        """Add the derivatives of C_o v by C_o to the rows that stand for shapes."""
        column = np.zeros(2 * self.place.projected.blocks.n_blocks, dtype=complex)
        column[self.place.projected.blocks.used.ravel()] = v
        each = np.arange(len(self.C))
        by_rows[1 + each, : len(column), each] += column


def _of_shape(seen: Complexes, scale: Floats, power: NDArray[np.int64], rate: complex) -> Complexes:
    """Return what makes δφ (p,) of (δ ln-pole rate, δ(C v)) (p, 1 + p).

    φ_o = (c_o / c_r) λ^(a_r − a_o) with the component r that is largest, λ the continuous pole
    and a the number of derivatives that a sensor measures.
    """
    c = scale * seen
    size = np.abs(c) / np.abs(rate) ** power
    r, p = int(np.argmax(size)), len(c)
    turn = np.zeros((p, 1 + p), dtype=complex)
    if size[r] == 0:
        return turn
    factor = rate ** (power[r] - power) / c[r]
    turn[:, 0] = factor * c * (power[r] - power) / rate
    turn[np.arange(p), 1 + np.arange(p)] = factor * scale
    turn[:, 1 + r] -= factor * c / c[r] * scale[r]
    return turn
