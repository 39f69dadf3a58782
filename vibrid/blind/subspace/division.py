"""Poles divided into structure and input, and the amplitudes of both in a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import DataError
from ...exosystem import signal_basis
from ...modes import Complexes
from ...record import Floats

NAMED = 0.01  # relative distance within which a pole is that of a frequency given
DECAYED = 3.0  # |σ|T of a pole near a frequency given: it is no sine, with any noise
DRAWS = 8  # of noise, to see what it makes of the phasors
ROUNDING = 1e-15  # of a channel: smaller residuals say nothing


@dataclass(frozen=True, eq=False)
class Division:
    """Which poles are the structure's, and which the input's.

    Attributes
    ----------
    structure : complex array (at most n_dof,)
        [rad/s], the fastest decay first.
    inputs : complex array
        Taken as undamped.
    given_hz : array
        Frequencies of the input that were given.
    found_hz : array
        Others that the poles show.
    missing_hz : array
        Of those given, the ones that no pole shows.
    """

    structure: Complexes
    inputs: Complexes
    given_hz: Floats
    found_hz: Floats
    missing_hz: Floats

    @property
    def input_hz(self) -> Floats:
        """All frequencies of the input, ascending."""
        return np.sort(np.concatenate([self.given_hz, self.found_hz]))


def divide(poles: Complexes, n_dof: int, duration: float, known_hz: Sequence[float]) -> Division:
    """Divide poles into structure and input.

    Poles at frequencies given are the input's; of the others, the n_dof that decay fastest
    are the structure's and the rest the input's too. (The closed form that follows is
    consistent for any n_dof pairs, so it cannot tell a wrong choice: the checks must.)
    """
    left = list(range(len(poles)))
    named: list[int] = []
    missing: list[float] = []
    for hertz in known_hz:
        nearest = _named(poles, left, hertz, duration)
        if nearest is None:
            missing.append(hertz)
        else:
            left.remove(nearest)
            named.append(nearest)
    structure, others = left[:n_dof], left[n_dof:]
    found = poles[others].imag / (2 * np.pi)
    given, unseen = (np.array(each, dtype=np.float64) for each in (known_hz, missing))
    return Division(poles[structure], poles[[*named, *others]], given, found, unseen)


def _named(poles: Complexes, left: list[int], hertz: float, duration: float) -> int | None:
    """Return the pole of an undamped sine of this frequency, or None."""
    if not left:
        return None
    off = np.abs(poles[left].imag / (2 * np.pi * hertz) - 1) / NAMED
    decay = np.abs(poles[left].real) * duration
    cost = np.where((off <= 1) & (decay <= DECAYED), off + decay, np.inf)
    best = int(np.argmin(cost))
    return left[best] if np.isfinite(cost[best]) else None


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Least squares of a record on its poles.

    Attributes
    ----------
    structure : complex array (n_channels, n_modes)
        c_i of Σ Re(c_i e^{λ_i t}).
    inputs : complex array (n_channels, n_frequencies)
    residuals : array (rows, n_channels)
    sizes : array (n_modes,)
        Of each mode in these rows, over what noise alone would make it.
    noise : complex array (n_draws, n_channels, n_frequencies)
        What `inputs` becomes of white noise as large as the residuals: samples of its error.
    """

    structure: Complexes
    inputs: Complexes
    residuals: Floats
    sizes: Floats
    noise: Complexes


def amplitudes(
    outputs: Floats, dt: float, division: Division, rows: slice = slice(None)
) -> Amplitudes:
    """Fit amplitudes of all channels, and a constant, to some rows of a record.

    This is the smoother of the autonomous model, which has no process noise: it needs no
    initial state, and the stretch need not be the start.

    Raises
    ------
    DataError
        Fewer rows than unknown amplitudes.
    """
    y, t = outputs[rows], _times(len(outputs), dt)[rows]
    free, sines = _free(t, division.structure), signal_basis(division.input_hz, t, offset=True)
    basis = np.hstack([free, sines])
    if len(t) <= basis.shape[1]:
        raise DataError(
            f"A stretch of {len(t)} samples does not tell {basis.shape[1]} amplitudes of modes and "
            f"sines; take more than {basis.shape[1] * dt:g} s."
        )
    p, n = y.shape[1], free.shape[1]
    probe = np.random.default_rng(0).standard_normal((len(t), DRAWS * p))
    solved = _least_squares(basis, np.hstack([y, probe]))
    noise = [_phasors(draw) for draw in np.split(solved[n + 1 :, p:], DRAWS, axis=1)]
    residuals = y - basis @ solved[:, :p]
    deviation = np.sqrt((residuals**2).sum(axis=0) / (len(t) - basis.shape[1]))
    floor = np.maximum(deviation, ROUNDING * np.sqrt(np.mean(y**2, axis=0)))
    modes = solved[:n, :p].reshape(-1, 2, p)
    parts = [free[:, 2 * k : 2 * k + 2] @ mode / floor for k, mode in enumerate(modes)]
    return Amplitudes(
        (modes[:, 0] + 1j * modes[:, 1]).T,
        _phasors(solved[n + 1 :, :p]),
        residuals,
        np.array([np.linalg.norm(part) for part in parts]) / np.sqrt(2 * p),
        np.array(noise) * deviation[:, None],
    )


def unexplained(fitted: Amplitudes, dt: float, division: Division) -> Floats:
    """Return what no poles near these would explain either (n_samples, n_channels).

    Poles are not exact: in long records with little noise their errors leave more than the
    noise does. Their slopes take that out, to first order: t e^{λt} of a mode, and of a sine
    what moves its frequency, not what would let it decay.
    """
    t = _times(len(fitted.residuals), dt)
    scale = t[:, None] / t[-1]
    free = _free(t, division.structure)
    sines = signal_basis(division.input_hz, t, offset=True)
    found = np.searchsorted(division.input_hz, division.found_hz)
    turning = np.exp(2j * np.pi * t[:, None] * division.found_hz)
    left = fitted.residuals.copy()
    for channel, phasors in enumerate(fitted.inputs[:, found]):
        basis = np.hstack([free, sines, scale * free, scale * (turning * phasors).imag])
        left[:, channel] -= basis @ _least_squares(basis, left[:, channel])
    return left


def _times(n_samples: int, dt: float) -> Floats:
    return np.asarray(dt * np.arange(n_samples), dtype=np.float64)


def _free(t: Floats, poles: Complexes) -> Floats:
    """Return the columns of Re e^{λt}, −Im e^{λt} of each pole (n_samples, 2 n_poles)."""
    decay = np.exp(np.outer(t, poles))
    return np.stack([decay.real, -decay.imag], axis=2).reshape(len(t), -1)


def _least_squares(basis: Floats, values: Floats) -> Floats:
    """Return the coefficients on columns of any size."""
    size = np.linalg.norm(basis, axis=0)
    size[size == 0] = 1
    solved = np.linalg.lstsq(basis / size, values, rcond=None)[0]
    return np.asarray((solved.T / size).T)


def _phasors(coefficients: Floats) -> Complexes:
    """Return c of Re(c e^{jωt}) from those of cos ωt, sin ωt, … (2 n, n_channels)."""
    pairs = coefficients.reshape(-1, 2, coefficients.shape[1])
    return np.asarray((pairs[:, 0] - 1j * pairs[:, 1]).T)
