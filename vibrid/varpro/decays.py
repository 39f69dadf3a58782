"""Sums of decaying and undamped sines in noise, by separable least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import DataError, OptionError
from ..record import Floats
from .blocks import Blocks, split_poles
from .deviations import mode_deviations, pole_covariance
from .likelihood import Likely
from .marquardt import Progress, Projecting, descend
from .projection import Linear
from .signals import SignalSums

Complexes = NDArray[np.complex128]
PROMISE = 1e-6  # fall of −2 × log-likelihood: a full step that promises less ends the search
LARGEST_SEARCH = 100  # steps
LARGEST_START = 1e3  # magnitudes of start poles beyond it are mistakes: continuous poles, say


@dataclass(frozen=True, eq=False)
class Decays:
    """A sum of exponentials y(t) = constant + Σ_k Re(r_k μ_k^t), t = 0, 1, … in each record.

    Attributes
    ----------
    poles : complex array (k,)
        Discrete μ; one of each conjugate pair, by ascending angle; real ones among them.
    residues : complex array (n_records, p, k)
        r of each record: one shape for each pole, times an amplitude of each record.
    constants : array (n_records, p)
    covariance : array (p, p)
        Of the errors, which are taken as white.
    frequencies_std, damping_std : array (n_oscillating,)
        Of |ln μ| / 2π [1 / samples] and of the damping ratios, by ascending frequency; 0 for
        the damping of poles held on the circle.
    cost : float
        N ln det of the errors' covariance.
    iterations : int
    converged : bool
    """

    poles: Complexes
    residues: Complexes
    constants: Floats
    covariance: Floats
    frequencies_std: Floats
    damping_std: Floats
    cost: float
    iterations: int
    converged: bool

    def modelled(self, n_samples: int, record: int = 0) -> Floats:
        """Return the sum at samples 0 … n_samples − 1 of a record (n_samples, p)."""
        powers = self.poles ** np.arange(n_samples)[:, None]
        return np.asarray((powers @ self.residues[record].T).real + self.constants[record])


@dataclass(frozen=True, eq=False)
class _Sum(Projecting):
    """A point of the search: blocks on the records."""

    records: tuple[Floats, ...]
    projected: Likely

    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        return self.projected.pushed_out(step)

    def moved(self, step: Floats) -> _Sum:
        return self.at(*self.projected.moved(step))

    def at(self, blocks: Blocks, linear: Linear) -> _Sum:
        sums = SignalSums(blocks, linear)
        for k, record in enumerate(self.records):
            sums.begin(k, k)
            sums.add(record)
        return replace(self, projected=replace(self.projected, sums=sums.total()))


def decays(
    records: Sequence[ArrayLike],
    poles: ArrayLike,
    *,
    undamped: Sequence[bool] | None = None,
    constants: bool = True,
    largest: int = LARGEST_SEARCH,
    progress: Progress | None = None,
) -> Decays:
    """Return the sum of exponentials that is most likely, starting from some poles.

    All outputs and records share the poles; every record has an amplitude and phase of its own
    for each, and the outputs share its shape, as free decays of one structure do. The errors
    are white with unknown covariance between outputs.

    Parameters
    ----------
    records : sequence of arrays (n_samples, p)
        At one rate; lengths may differ.
    poles : complex array (k,)
        Discrete start values, one of each conjugate pair, exp((−ζ + i √(1 − ζ²)) ω dt). Real
        ones decay without oscillating.
    undamped : sequence of bool (k,), optional
        Which poles are held on the unit circle: sines that last.
    constants : bool
        Whether each record has an offset.
    largest : int
        Number of steps taken at most.
    progress : callable (what, done, total), optional

    Returns
    -------
    Decays

    Raises
    ------
    OptionError
        No poles, poles that coincide or are not discrete, or a real one to be undamped.
    DataError
        Records of different widths, with NaN, or too short.

    Notes
    -----
    Variable projection (Golub & Pereyra 1973; Kaufman 1975).

    Examples
    --------
    >>> t = np.arange(400)
    >>> y = np.cos(0.3 * t)[:, None] + 0.98**t[:, None] * np.sin(0.5 * t)[:, None]
    >>> found = decays([y], [np.exp(0.301j), 0.97 * np.exp(0.49j)], undamped=[True, False])
    >>> np.abs(found.poles).round(6), np.angle(found.poles).round(6)
    (array([1.  , 0.98]), array([0.3, 0.5]))
    """
    start = _checked_poles(poles)
    held = np.zeros(len(start), dtype=bool) if undamped is None else np.asarray(undamped, bool)
    if held.shape != start.shape or (held & (start.imag == 0)).any():
        raise OptionError(
            f"undamped must be True or False for each of the {len(start)} poles, and False for "
            "real ones."
        )
    data = _checked_records(records, 2 * len(start) + int(constants))
    blocks = _start_of(data, start, held, constants)
    p, count = data[0].shape[1], sum(len(record) for record in data)
    weights = 1 / np.maximum(np.vstack(data).var(axis=0), np.finfo(float).tiny)
    linear = Linear(
        np.zeros((blocks.n_blocks, 2, p)), np.zeros((0, p)), np.zeros((len(data) * constants, p))
    )
    none = np.zeros(p, dtype=bool)
    projected = Likely(SignalSums(blocks, linear).total(), weights, none, count=count)
    first = _Sum(data, projected).at(blocks, linear)
    first = first.at(blocks, first.projected.linear)
    found = descend(first, tolerance=0.0, negligible=PROMISE, largest=largest, progress=progress)
    return _result(found.point.projected, found.iterations, found.converged)


def _checked_poles(poles: ArrayLike) -> Complexes:
    start = np.atleast_1d(np.asarray(poles, dtype=np.complex128))
    if start.ndim != 1 or not len(start) or not np.isfinite(start).all():
        raise OptionError(f"poles must be a list of finite numbers; got shape {start.shape}.")
    if np.abs(start).max() > LARGEST_START:
        raise OptionError(
            f"A start pole has magnitude {np.abs(start).max():.3g}; discrete poles are near the "
            "unit circle: give exp(λ dt)."
        )
    start = np.where(start.imag < 0, start.conj(), start)
    gaps = np.abs(start[:, None] - start) + np.eye(len(start))
    if gaps.min() < np.sqrt(np.finfo(float).eps):
        raise OptionError("Two start poles coincide; move one, or leave it out.")
    return start


def _checked_records(records: Sequence[ArrayLike], unknowns: int) -> tuple[Floats, ...]:
    data = tuple(np.asarray(record, dtype=np.float64) for record in records)
    if not data or any(record.ndim != 2 for record in data):
        raise DataError("records must be one or more arrays (n_samples, n_outputs).")
    widths = {record.shape[1] for record in data}
    if len(widths) > 1 or 0 in widths:
        raise DataError(f"The records have {sorted(widths)} outputs; all must have the same.")
    if not all(np.isfinite(record).all() for record in data):
        raise DataError("A record holds NaN or infinite values; give the pieces between gaps.")
    shortest = min(len(record) for record in data)
    if shortest <= unknowns:
        raise DataError(
            f"A record has {shortest} samples; {unknowns} unknowns of each output need more. Use "
            "fewer poles or a longer record."
        )
    return data


def _start_of(
    data: tuple[Floats, ...], poles: Complexes, held: NDArray[np.bool_], constants: bool
) -> Blocks:
    """Return the blocks of the poles, with the amplitudes that suit each record best."""
    order = np.where(poles.imag > 0, 2, 1)
    places = np.cumsum(order) - order
    A = np.zeros((order.sum(),) * 2)
    states = np.zeros((len(data), order.sum()))
    amplitudes = _amplitudes(data, np.where(held, poles / np.abs(poles), poles), constants)
    for k, (mu, at) in enumerate(zip(poles, places, strict=True)):
        A[at, at] = mu.real
        states[:, at] = amplitudes[:, k].real
        if order[k] == 2:
            A[at : at + 2, at : at + 2] = [[mu.real, mu.imag], [-mu.imag, mu.real]]
            states[:, at + 1] = -amplitudes[:, k].imag
    blocks = split_poles(A, np.zeros((len(A), 0)), states, pair_real=False)
    if not held.any():
        return blocks
    values = np.where(blocks.single, blocks.centre + 0j, blocks.centre + 1j * blocks.spread)
    nearest = np.argmin(np.abs(values[:, None] - poles), axis=1)
    return blocks.on_circle(held[nearest])


def _amplitudes(data: tuple[Floats, ...], poles: Complexes, constants: bool) -> Complexes:
    """Return an amplitude for each record and pole (n_records, k), the shapes being shared."""
    if len(data) == 1:
        return np.ones((1, len(poles)), dtype=np.complex128)
    residues = np.array([_residues(record, poles, constants) for record in data])
    found = np.empty(residues.shape[::2], dtype=np.complex128)
    for k in range(len(poles)):
        left, size, _ = np.linalg.svd(residues[:, :, k], full_matrices=False)
        found[:, k] = left[:, 0] * size[0]
    size = np.abs(found).max(axis=0)
    return np.asarray(found / np.where(size > 0, size, 1))


def _residues(record: Floats, poles: Complexes, constants: bool) -> Complexes:
    powers = poles ** np.arange(len(record))[:, None]
    table = np.hstack([powers.real, -powers.imag, np.ones((len(record), int(constants)))])
    answer = np.linalg.lstsq(table, record, rcond=None)[0]
    k = len(poles)
    return np.asarray((answer[:k] + 1j * answer[k : 2 * k]).T)


def _result(projected: Likely, iterations: int, converged: bool) -> Decays:
    blocks, linear = projected.blocks, projected.linear
    poles, residues = [], []
    for b in range(blocks.n_blocks):
        rows = slice(1, 2) if blocks.single[b] else slice(0, 2)
        values, right = np.linalg.eig(blocks.transition[b][rows, rows].astype(complex))
        left = np.linalg.inv(right) @ blocks.starts[:, b, rows].T
        for k in np.flatnonzero(values.imag >= 0):
            twice = 2 if values[k].imag > 0 else 1
            poles.append(values[k])
            shape = linear.states[b, rows].T @ right[:, k]
            residues.append(twice * np.outer(left[k], shape))
    order = np.argsort(np.angle(poles), kind="stable")
    deviations = mode_deviations(blocks, pole_covariance(projected, projected.covariance))
    constants, n_records = linear.constants, len(blocks.starts)
    if not len(constants):
        constants = np.zeros((n_records, len(projected.weights)))
    return Decays(
        np.array(poles)[order],
        np.array(residues)[order].transpose(1, 2, 0),
        constants,
        projected.covariance,
        *deviations,
        projected.cost,
        iterations,
        converged,
    )
