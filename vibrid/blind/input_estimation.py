"""estimate_input(): the input of a known model, from its outputs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError, OptionError, check_choice, check_positive
from ..exosystem import augmented_observability, finite_signal
from ..fit import Fit
from ..gram.factor import stacked_qr
from ..kalman import STABLE_TO, spectral_radius
from ..record import Floats, Record
from ..statespace import StateSpace

KINDS = ("smoother", "filter")
ROOM = 1.5  # period of the signal model over the record: what is not periodic needs room
RANK = 1e-10  # singular values below this share say nothing
REWEIGHTINGS = 3
LARGEST = 10**8  # numbers in the regression, 800 MB
RUN = 4096  # samples that are whitened at a time
VAGUE = 100.0  # prior deviation of amplitudes over what the outputs would make them


@dataclass(frozen=True, eq=False)
class InputEstimate:
    """The input of a known model, with its uncertainty.

    Attributes
    ----------
    inputs : array (n_samples, n_inputs)
    inputs_std : array (n_samples, n_inputs)
        From the noise alone; what lies outside the band is not in it.
    residuals : array (n_samples, n_outputs)
        Outputs less what the model predicts of them (innovations), given all data.
    noise_covariance : array (n_outputs, n_outputs)
        As given, or of the residuals.
    frequencies_hz : array
        Lines of the signal model.
    dt : float
    kind : "smoother" or "filter"
    """

    inputs: Floats
    inputs_std: Floats
    residuals: Floats
    noise_covariance: Floats
    frequencies_hz: Floats
    dt: float
    kind: str


def estimate_input(
    model: Fit | StateSpace,
    outputs: Record | ArrayLike,
    *,
    highest_hz: float,
    lowest_hz: float = 0.0,
    kind: str = "smoother",
    kalman_gain: ArrayLike | None = None,
    noise_covariance: ArrayLike | None = None,
    period: float | None = None,
    input_scale: float | None = None,
) -> InputEstimate:
    """Estimate a band-limited input, periodic or not, from the outputs of a known model.

    Parameters
    ----------
    model : Fit or discrete StateSpace
        A Fit brings its gain, noise covariance and offsets.
    outputs : Record or array (n_samples, n_outputs)
    highest_hz, lowest_hz : float
        Band of the input; a constant belongs to it where `lowest_hz` is 0. Where there is next
        to no noise, a line or two (1 / period) more keep the band's edge exact.
    kind : "smoother" or "filter"
        All samples for each estimate, or only those up to it (Kalman filter).
    kalman_gain : array (n, n_outputs), optional
        G of x⁺ = A x + B u + G e, y = C x + D u + e; zero is noise on the outputs alone.
    noise_covariance : array (n_outputs, n_outputs), optional
        Of e; by default that of what remains.
    period : float, optional
        Of the signal model [s]; by default 1.5 times the record, so that the signal need
        not end where it began.
    input_scale : float, optional
        Filter only: prior deviation of each amplitude. By default a hundred times what the
        outputs would make it, so that only the first samples feel it.

    Raises
    ------
    OptionError
        A continuous model, shapes or dt that do not fit, a regression too large.
    DataError
        A line of the band that the outputs do not show; values that are not finite; a
        predictor that is not stable; a record shorter than its unknowns.

    Notes
    -----
    The model is augmented by the finite-length signal model (Han, Bohn & Bauer 2021, eq. 18,
    67, example 4.2). That has no process noise: in innovations form all that is unknown is
    the initial state, so the fixed-interval smoother is a least squares on its responses, and
    the Kalman filter, in these coordinates, a recursive one. With a line every 1 / period the
    signal is any function of its band; the error of the estimate is the noise's share in
    2 · bandwidth · length amplitudes.
    """
    check_choice("kind", kind, KINDS)
    system, gain, known, offsets = _of_model(model, kalman_gain, noise_covariance)
    y = _samples(outputs, system) - offsets[1]
    signal, signals = _signal_models(system, y, (lowest_hz, highest_hz), period)
    _check_seen(system, signals)
    problem = _regression(system, gain, signals, y)
    noise, solved = _solve(problem, known)
    basis = signal.observability_matrix(len(y))
    n = system.order
    if kind == "smoother":
        inputs, std = _smoothed(basis, solved, n, system.n_inputs)
    else:
        prior = _prior(system, signals, y, input_scale)
        inputs, std = _filtered(basis, problem, noise, prior, n)
    return InputEstimate(
        inputs + offsets[0],
        std,
        (problem.right - problem.left @ solved.state).reshape(y.shape),
        noise,
        np.sort(signal.frequencies_hz),
        float(system.dt or np.nan),
        kind,
    )


def _of_model(
    model: Fit | StateSpace, kalman_gain: ArrayLike | None, noise_covariance: ArrayLike | None
) -> tuple[StateSpace, Floats, Floats | None, tuple[Floats, Floats]]:
    """Return the system, G, the covariance of e and the offsets of inputs and outputs."""
    gain: Any = kalman_gain
    noise: Any = noise_covariance
    if isinstance(model, Fit):
        system, offsets = model.model, (model.input_offset, model.output_offset)
        gain = model.kalman_gain if gain is None else gain
    else:
        system, offsets = model, (np.zeros(model.n_inputs), np.zeros(model.n_outputs))
    if system.dt is None:
        raise OptionError("estimate_input needs a discrete model; call to_discrete(dt, hold).")
    if not system.n_inputs:
        raise OptionError("The model has no inputs that could be estimated.")
    p, shape = system.n_outputs, (system.order, system.n_outputs)
    G = np.zeros(shape) if gain is None else np.asarray(gain, dtype=np.float64)
    if G.shape != shape or not np.isfinite(G).all():
        raise OptionError(f"kalman_gain must have the shape {shape} and be finite; got {G.shape}.")
    radius = spectral_radius(system.A - G @ system.C)
    if radius > STABLE_TO:
        raise DataError(
            f"The predictor A − G C has the spectral radius {radius:.4g}; it must not exceed 1. "
            "Give the gain of the model's own noise, or none for noise on the outputs alone."
        )
    if noise is None:
        return system, G, None, offsets
    covariance = np.atleast_2d(np.asarray(noise, dtype=np.float64))
    if (
        covariance.shape != (p, p)
        or not np.isfinite(covariance).all()
        or np.linalg.eigvalsh(covariance)[0] <= 0
    ):
        raise OptionError(f"noise_covariance must be {p} × {p} and positive definite.")
    return system, G, covariance, offsets


def _samples(outputs: Record | ArrayLike, system: StateSpace) -> Floats:
    if isinstance(outputs, Record):
        if abs(outputs.dt - float(system.dt or 0)) > 1e-9 * outputs.dt:
            raise OptionError(
                f"The record has dt={outputs.dt:g} s and the model {system.dt:g} s; they differ."
            )
        outputs = outputs.outputs
    y = np.asarray(outputs, dtype=np.float64)
    y = y[:, None] if y.ndim == 1 else y
    if y.ndim != 2 or y.shape[1] != system.n_outputs:
        raise OptionError(
            f"outputs must have the shape (n_samples, {system.n_outputs}); got {y.shape}."
        )
    if not np.isfinite(y).all():
        raise DataError("The outputs hold NaN or infinite values; take a piece without gaps.")
    return y


def _signal_models(
    system: StateSpace, outputs: Floats, band_hz: tuple[float, float], period: float | None
) -> tuple[StateSpace, StateSpace]:
    """Return the models of one input and of all, if the outputs can tell so many amplitudes."""
    low, high = band_hz
    n_samples, dt = len(outputs), float(system.dt or np.nan)
    whole = ROOM * n_samples * dt if period is None else period
    check_positive("period", whole, "s")
    check_positive("highest_hz", high, "Hz")
    lines = max(0, np.floor(whole * (min(high, 0.5 / dt) - low)))
    _check_size(outputs.size, system.order + 2 * system.n_inputs * int(lines))
    one, every = (
        finite_signal(n_samples, dt, high, lowest_hz=low, period=whole, n_signals=count)
        for count in (1, system.n_inputs)
    )
    return one, every


def _check_size(count: int, unknowns: int) -> None:
    """Refuse more unknowns than values, or than memory holds."""
    if count < unknowns:
        raise DataError(
            f"{count} values cannot tell {unknowns} unknowns; narrow the band, or shorten "
            "the period."
        )
    if count * unknowns > LARGEST:
        raise OptionError(
            f"{count} values on {unknowns} unknowns are too many at once; take a shorter "
            "stretch or a narrower band."
        )


def _check_seen(system: StateSpace, signal: StateSpace) -> None:
    unseen = augmented_observability(system, signal).unseen_hz
    if len(unseen):
        listed = ", ".join(f"{each:.4g}" for each in unseen[:5])
        raise DataError(
            f"The {system.n_outputs} outputs do not show {system.n_inputs} inputs at {listed} Hz: "
            "accelerations show no constant force, and fewer outputs than inputs never show all. "
            "Raise lowest_hz, or use more sensors."
        )


@dataclass(frozen=True, eq=False)
class _Regression:
    """Innovations of the data, `right` (N p,), less `left` (N p, n) times the initial state."""

    left: Floats
    right: Floats
    n_outputs: int


def _regression(
    system: StateSpace, gain: Floats, signal: StateSpace, outputs: Floats
) -> _Regression:
    """Run the predictor over the outputs, and over every unit initial state."""
    n, m = system.order, signal.order
    own = system.A - gain @ system.C
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[:n, n:] = own, (system.B - gain @ system.D) @ signal.C
    A[n:, n:] = signal.A
    C = np.hstack([system.C, system.D @ signal.C])
    free = StateSpace(A, np.zeros((n + m, 0)), C, np.zeros((len(C), 0)), system.dt)
    whitener = StateSpace(own, gain, -system.C, np.eye(system.n_outputs), system.dt)
    innovations = whitener.simulate(outputs)
    left = free.observability_matrix(len(outputs))
    return _Regression(left, innovations.ravel(), system.n_outputs)


@dataclass(frozen=True, eq=False)
class _Solved:
    """The initial state of structure and signal, and a root of its covariance."""

    state: Floats
    root: Floats


def _solve(problem: _Regression, noise: Floats | None) -> tuple[Floats, _Solved]:
    """Return the covariance of the innovations and the weighted least squares."""
    p = problem.n_outputs
    if noise is not None:
        return noise, _weighted(problem, noise)
    noise = np.diag(np.maximum(problem.right.reshape(-1, p).var(axis=0), 1e-300))
    for _ in range(REWEIGHTINGS if p > 1 else 1):
        solved = _weighted(problem, noise)
        left = (problem.right - problem.left @ solved.state).reshape(-1, p)
        free = max(1, len(left) - solved.root.shape[1] // p)
        floor = max((1e-15 * np.abs(problem.right).max()) ** 2, 1e-300)
        noise = left.T @ left / free + floor * np.eye(p)
    return noise, _weighted(problem, noise)


def _weighted(problem: _Regression, noise: Floats) -> _Solved:
    """Solve by QR of the whitened rows and the singular values of its triangle.

    Columns of unit length: states and inputs of any unit weigh alike.
    """
    n = problem.left.shape[1]
    size = np.linalg.norm(problem.left, axis=0)
    size[size == 0] = 1
    triangle = stacked_qr(_whitened(problem, noise, size), n + 1)
    left, values, right = np.linalg.svd(triangle[:n, :n])
    rank = int(np.count_nonzero(values > RANK * values[0]))
    root = right[:rank].T / values[:rank] / size[:, None]
    return _Solved(root @ (left[:, :rank].T @ triangle[:n, n]), root)


def _whitened(problem: _Regression, noise: Floats, size: Floats) -> Iterator[Floats]:
    """Yield [left / size, right] in rows of unit noise, run by run."""
    p, n = problem.n_outputs, problem.left.shape[1]
    inverse = np.linalg.inv(np.linalg.cholesky(noise))
    run = p * max(RUN, n)
    for start in range(0, len(problem.right), run):
        part = slice(start, start + run)
        rows = np.hstack([problem.left[part] / size, problem.right[part, None]])
        yield np.matmul(inverse, rows.reshape(-1, p, n + 1)).reshape(-1, n + 1)


def _smoothed(basis: Floats, solved: _Solved, n: int, n_inputs: int) -> tuple[Floats, Floats]:
    states = solved.state[n:].reshape(n_inputs, -1)
    roots = solved.root[n:].reshape(n_inputs, basis.shape[1], -1)
    std = [np.linalg.norm(basis @ root, axis=1) for root in roots]
    return np.asarray(basis @ states.T), np.stack(std, axis=1)


def _prior(
    system: StateSpace, signal: StateSpace, outputs: Floats, input_scale: float | None
) -> Floats:
    """Return prior deviations of the initial state (n + n_signal,)."""
    size = float(np.sqrt(np.mean(outputs**2))) or 1.0
    if input_scale is None:
        G = system.frequency_response(signal.frequencies_hz)
        gains = np.linalg.svd(G, compute_uv=False)[:, -1]
        input_scale = VAGUE * size / float(np.median(gains))
    check_positive("input_scale", input_scale)
    states = VAGUE * size / np.linalg.norm(system.C, 2) * np.sqrt(system.order)
    return np.concatenate(
        [np.full(system.order, states), np.full(signal.order, float(input_scale))]
    )


def _filtered(
    basis: Floats, problem: _Regression, noise: Floats, prior: Floats, n: int
) -> tuple[Floats, Floats]:
    """Run the Kalman filter, in coordinates in which the state stands still."""
    p, lines = problem.n_outputs, basis.shape[1]
    n_inputs = (len(prior) - n) // lines
    state, P = np.zeros(len(prior)), np.diag(prior**2)
    inputs, std = np.empty((len(basis), n_inputs)), np.empty((len(basis), n_inputs))
    rows = problem.left.reshape(-1, p, len(prior))
    values = problem.right.reshape(-1, p)
    for k, (h, value) in enumerate(zip(rows, values, strict=True)):
        Ph = P @ h.T
        gain = np.linalg.solve(h @ Ph + noise, Ph.T).T
        state = state + gain @ (value - h @ state)
        P = P - gain @ Ph.T
        for j in range(n_inputs):
            part = slice(n + j * lines, n + (j + 1) * lines)
            inputs[k, j] = basis[k] @ state[part]
            std[k, j] = np.sqrt(max(0.0, basis[k] @ P[part, part] @ basis[k]))
    return inputs, std
