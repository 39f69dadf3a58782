"""Poles and shapes that all records share, 𝒦 and 𝒟 from them, and the covariance of all.

Symbols: λ, s poles and displacement shapes, each with one component 1; P = [𝒦 𝒟] with
P [s; s λ] = −s λ², both poles of each pair (Han, Bohn & Bauer 2021, step III in closed form).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...modes import Complexes
from ...physical.scaling import normalized_of
from ...record import Floats
from ..coordinates import Powers
from .components import Mask
from .place import Place


@dataclass(frozen=True, eq=False)
class ModalEstimate:
    """Poles and shapes of the structure, with their covariance.

    Attributes
    ----------
    poles : complex array (n_modes,)
    shapes : complex array (n_dof, n_modes)
        Displacements; one component of each is 1.
    covariance : array (2 k + 2 n k, 2 k + 2 n k)
        Of ω, σ, then real parts of the shapes mode by mode, then imaginary parts.
    """

    poles: Complexes
    shapes: Complexes
    covariance: Floats

    @property
    def deviations(self) -> tuple[Floats, Floats]:
        """Standard deviations of the frequencies [Hz] and damping ratios."""
        k = len(self.poles)
        return _pole_deviations(self.poles, self.covariance[: 2 * k, : 2 * k])

    def normalized(self) -> tuple[Floats, Floats]:
        """Return [𝒦 𝒟] (n, 2 n) and the covariance of its columns stacked."""
        both = np.hstack([self.shapes, self.shapes.conj()])
        damping, stiffness = normalized_of(both, np.concatenate([self.poles, self.poles.conj()]))
        P = np.hstack([stiffness, damping])
        slope = self._slope(P)
        return P, np.asarray(slope @ self.covariance @ slope.T)

    def condition(self) -> float:
        return condition(self.poles, self.shapes)

    def _slope(self, P: Floats) -> Floats:
        """Return the derivatives of vec P: dP = −2 Re Σ (ds λ² + 2 s λ dλ + P d[s; s λ]) w."""
        n, k = self.shapes.shape
        rows = np.linalg.inv(_with_rates(self.shapes, self.poles))[:k]
        columns: list[list[Floats]] = [[], [], [], []]
        for pole, s, w in zip(self.poles, self.shapes.T, rows, strict=True):
            by_pole = 2 * s * pole + P[:, n:] @ s
            by_shape = pole**2 * np.eye(n) + P[:, :n] + pole * P[:, n:]
            moved = [1j * by_pole[:, None], -by_pole[:, None], by_shape, 1j * by_shape]
            for place, v in zip(columns, moved, strict=True):
                change = -2 * (v[:, None, :] * w[None, :, None]).real
                place.append(change.transpose(1, 0, 2).reshape(-1, v.shape[1]))
        return np.hstack([part for place in columns for part in place])


def condition(poles: Complexes, shapes: Complexes) -> float:
    """Return the condition of [s; s λ], DOFs, modes and rates in units of their own size."""
    s = shapes / np.linalg.norm(shapes, axis=0)
    size = np.linalg.norm(s, axis=1, keepdims=True)
    W = _with_rates(s / size, poles / np.exp(np.mean(np.log(np.abs(poles)))))
    return float(np.linalg.cond(W / np.linalg.norm(W, axis=0)))


def _with_rates(shapes: Complexes, poles: Complexes) -> Complexes:
    """Return [s; s λ], both poles of each pair."""
    both = np.vstack([shapes, shapes * poles])
    return np.hstack([both, both.conj()])


def _pole_deviations(poles: Complexes, covariance: Floats) -> tuple[Floats, Floats]:
    """Return the deviations of frequencies [Hz] and damping ratios, from those of ω and σ."""
    size, sigma, omega = np.abs(poles), -poles.real, poles.imag
    hertz = np.hstack([np.diag(omega), np.diag(sigma)]) / (2 * np.pi * size[:, None])
    ratio = np.hstack([np.diag(-sigma * omega), np.diag(omega**2)]) / size[:, None] ** 3
    stds = [np.sqrt(np.einsum("ij,jk,ik->i", each, covariance, each)) for each in (hertz, ratio)]
    return np.asarray(stds[0]), np.asarray(stds[1])


def swinging(P: Floats, covariance: Floats) -> tuple[Complexes, Complexes, tuple[Floats, Floats]]:
    """Return poles and shapes of P = [𝒦 𝒟], and the deviations of frequencies and damping ratios.

    `covariance` is of the columns of P stacked. Modes that do not swing are left out.
    """
    n = len(P)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-P]])
    poles, right = np.linalg.eig(A)
    left, up = np.linalg.inv(right), poles.imag > 0
    # dλ = l dA r, and only the lower half of A moves
    slope = -np.array([np.kron(right[:, k], left[k, n:]) for k in np.flatnonzero(up)])
    by_rates = np.vstack([slope.imag, -slope.real]).reshape(-1, 2 * n * n)
    V = by_rates @ covariance @ by_rates.T
    return poles[up], right[:n, up], _pole_deviations(poles[up], V)


def modal_estimate(place: Place, modes: Mask, powers: Powers) -> ModalEstimate:
    """Return the poles and shapes of the modes; shapes of several records are averaged.

    Records are weighed by their covariance, which for these errors is asymptotically maximum
    likelihood with one shape for all.

    Parameters
    ----------
    place : Place
        At the greatest likelihood.
    modes : array of bool (k,)
    powers : int array (n_dof,)
        0, 1, 2 for sensors of displacement, velocity, acceleration.
    """
    chosen = np.flatnonzero(modes)
    poles = place.components.poles[chosen]
    largest = sum(np.abs(place.shapes(r)[:, chosen]) for r in range(len(place.parts)))
    references = np.asarray(largest).argmax(axis=0)
    by_step = _pole_rows(place, chosen)
    values, slopes, owns = [], [by_step], [np.zeros((len(by_step),) * 2)]
    for record in range(len(place.parts)):
        shapes, slope, own = _shapes(place, record, chosen, references, powers)
        values.append(np.concatenate([shapes.T.real.ravel(), shapes.T.imag.ravel()]))
        slopes.append(slope)
        owns.append(own)
    slope = np.vstack(slopes)
    V = slope @ place.covariance @ slope.T + sla.block_diag(*owns)
    x = np.concatenate([-poles.real, *values])
    x, V = _averaged(np.concatenate([poles.imag, x]), V, len(values[0]), len(by_step))
    k, n = len(chosen), len(powers)
    parts = x[2 * k :].reshape(2, k, n)
    return ModalEstimate(-x[k : 2 * k] + 1j * x[:k], (parts[0] + 1j * parts[1]).T, V)


def _pole_rows(place: Place, chosen: NDArray[np.intp]) -> Floats:
    """Return the derivatives of ω and σ by the steps of the search."""
    k = len(place.components)
    rows = np.zeros((2 * len(chosen), len(place.covariance)))
    rows[np.arange(len(rows)), np.concatenate([chosen, k + chosen])] = 1 / place.signals.duration
    return rows


def _shapes(
    place: Place,
    record: int,
    chosen: NDArray[np.intp],
    references: NDArray[np.intp],
    powers: Powers,
) -> tuple[Complexes, Floats, Floats]:
    """Return shapes, their derivatives by the steps, and the covariance by amplitudes alone."""
    c, part = place.components, place.parts[record]
    n, k = len(powers), len(chosen)
    sine = len(c) + np.cumsum(~c.real) - 1
    a, b = place.pairs(record)
    seen = 0.5 * (a - 1j * b)[chosen].T  # real ones exactly
    s = np.empty((n, k), dtype=np.complex128)
    by_rate = np.zeros((n, k, len(place.covariance)), dtype=np.complex128)
    by_amplitude = np.zeros((n, k, n, len(part.root)), dtype=np.complex128)
    for i, (column, ref) in enumerate(zip(chosen, references, strict=True)):
        pole = c.poles[column]
        scale = pole ** (powers - powers[ref])
        moved = seen[:, i] / scale
        s[:, i] = moved / moved[ref]
        turn = s[:, i] * (powers[ref] - powers) / pole / place.signals.duration
        by_rate[:, i, column], by_rate[:, i, len(c) + column] = 1j * turn, -turn
        each = np.arange(n)
        for place_of, unit in ((column, 0.5), (sine[column], -0.5j))[: 1 + int(not c.real[column])]:
            by_amplitude[each, i, each, place_of] += unit / scale / moved[ref]
            by_amplitude[:, i, ref, place_of] -= s[:, i] * unit / moved[ref]
        # exactly, or rounding would look like knowledge
        s[ref, i], by_rate[ref, i], by_amplitude[ref, i] = 1, 0, 0
    F = np.concatenate([_flat(by_amplitude.real), _flat(by_amplitude.imag)])
    slope = np.concatenate([_flat(by_rate.real), _flat(by_rate.imag)])
    answered = np.tensordot(part.slopes, place.mixing[record], axes=1)
    slope = slope - np.einsum("yck,kqc->yq", F, answered, optimize=True)
    own = np.zeros((len(F), len(F)))
    for channel, variance in enumerate(place.noise(record)):
        root = sla.solve_triangular(part.root, F[:, channel].T, trans="T", check_finite=False)
        own += variance * (root.T @ root)
    return s, slope, own


def _flat(values: Floats) -> Floats:
    """Return values (n, k, …) as (k n, …)."""
    return np.asarray(values.swapaxes(0, 1).reshape(-1, *values.shape[2:]))


def _averaged(x: Floats, V: Floats, length: int, first: int) -> tuple[Floats, Floats]:
    """Return the poles and the mean of the shapes of all records, weighed by covariance."""
    n_records = (len(x) - first) // length
    if n_records == 1:
        return x, V
    design = np.zeros((len(x), first + length))
    design[:first, :first] = np.eye(first)
    design[first:, first:] = np.tile(np.eye(length), (n_records, 1))
    known = np.diag(V) > 0
    free = design[known].any(axis=0)
    root = sla.cholesky(V[np.ix_(known, known)], lower=True)
    A = sla.solve_triangular(root, design[np.ix_(known, free)], lower=True)
    b = sla.solve_triangular(root, x[known], lower=True)
    mean, spread = np.zeros(first + length), np.zeros((first + length,) * 2)
    mean[: first + length] = design.T @ x / design.sum(axis=0)
    mean[free] = np.linalg.lstsq(A, b, rcond=None)[0]
    spread[np.ix_(free, free)] = np.linalg.inv(A.T @ A)
    return mean, spread
