"""How well a model explains data: fit measures, initial states of unseen data, folds."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import scipy.linalg as sla

from .errors import DataError, check_choice, check_whole
from .gram import triangle_of
from .record import Floats
from .statespace import StateSpace, simulate

InitialRule = Literal["map", "least_squares", "zero"]
INITIAL_RULES = ("map", "least_squares", "zero")
SHORTEST_START = 20  # samples a MAP initial state uses at least
START_PER_ORDER = 3
START_PIVOT = 1e-6  # normal equations are only taken where they cost few digits
DECAY_BLOCK = 512  # samples of the free responses made at once


def fit_percent(measured: Floats, modelled: Floats) -> Floats:
    """Return 100 (1 − ‖y − ŷ‖ / ‖y − ȳ‖) of each output (NRMSE fit), NaN rows left out.

    NaN for an output that does not move in the rows that are left.

    Parameters
    ----------
    measured, modelled : array (n_samples, n_outputs)

    Returns
    -------
    array (n_outputs,) [%]

    Examples
    --------
    >>> fit_percent(np.array([[0.0], [2.0]]), np.array([[0.0], [2.0]])).tolist()
    [100.0]
    """
    y, estimate = _complete_rows(measured, modelled)
    error = np.linalg.norm(y - estimate, axis=0)
    return 100 * (1 - _ratio(error, np.linalg.norm(y - y.mean(axis=0), axis=0)))


def vaf_percent(measured: Floats, modelled: Floats) -> Floats:
    """Return 100 (1 − var(y − ŷ) / var(y)) of each output, NaN rows left out."""
    y, estimate = _complete_rows(measured, modelled)
    return 100 * (1 - _ratio(np.var(y - estimate, axis=0), np.var(y, axis=0)))


def relative_error(measured: Floats, modelled: Floats) -> float:
    """Return the relative output error in the induced 1-norm (Sima, SLICOT Note 2000-4).

    The largest column sum of |y − ŷ| over the largest column sum of |y|.
    """
    y, estimate = _complete_rows(measured, modelled)
    return float(_ratio(np.abs(y - estimate).sum(axis=0).max(), np.abs(y).sum(axis=0).max()))


def start_samples(order: int) -> int:
    """Return how many samples the MAP rule uses: max(20, 3 n). They should not be scored."""
    return max(SHORTEST_START, START_PER_ORDER * order)


def initial_state(
    model: StateSpace,
    inputs: Floats,
    outputs: Floats,
    rule: InitialRule = "map",
    error_covariance: Floats | None = None,
    prior: Floats | None = None,
) -> Floats:
    """Return the initial state of unseen data.

    "map" weighs the first max(20, 3 n) samples against a prior state covariance, so slow
    poles cannot explode; "least_squares" uses all samples, which flatters; "zero" is rest.
    A state may also be carried over from the stretch before, see `carried_state`.

    Parameters
    ----------
    model : StateSpace
        Discrete; for a predictor, `inputs` holds inputs and outputs.
    inputs : array (n_samples, n_inputs)
    outputs : array (n_samples, n_outputs)
    rule : "map", "least_squares" or "zero"
    error_covariance : array (n_outputs, n_outputs), optional
        Of the output errors; identity scaled to the outputs when missing.
    prior : array (n, n), optional
        State covariance; without it "map" is least squares on its samples.

    Returns
    -------
    array (n,)
    """
    check_choice("initial", rule, INITIAL_RULES)
    n = model.order
    if rule == "zero":
        return np.zeros(n)
    count = min(len(outputs), start_samples(n)) if rule == "map" else len(outputs)
    missing = outputs[:count] - model.simulate(inputs[:count])
    root = whitener(error_covariance, outputs)
    known = _inverse_root(prior) if rule == "map" and prior is not None else np.zeros((0, n))

    def rows() -> Iterator[Floats]:
        yield np.hstack([known, np.zeros((len(known), 1))])
        yield from _weighted_decay(model, missing, root)

    triangle = triangle_of(rows, n + 1, START_PIVOT)
    return np.asarray(sla.lstsq(triangle[:, :n], triangle[:, n], cond=1e-12)[0])


def carried_state(model: StateSpace, inputs: Floats, state: Floats) -> Floats:
    """Return the state after a stretch of inputs: the initial state of what follows it.

    Parameters
    ----------
    model : StateSpace
        Discrete; for a predictor, `inputs` holds inputs and outputs.
    inputs : array (n_samples, n_inputs)
    state : array (n,)
        At the first sample of the stretch.

    Returns
    -------
    array (n,)
    """
    A, B, C, D = model.A, model.B, model.C, model.D
    return simulate(A, B, C[:1], D[:1], np.asarray(inputs, dtype=np.float64), state)[1]


def folds(n_samples: int, count: int = 4) -> tuple[tuple[int, int], ...]:
    """Return `count` consecutive stretches (start, stop) to hold out one at a time."""
    check_whole("count", count, 2)
    if n_samples < count:
        raise DataError(f"{count} folds need at least {count} samples; there are {n_samples}.")
    edges = np.linspace(0, n_samples, count + 1).round().astype(int)
    return tuple((int(a), int(b)) for a, b in pairwise(edges))


def _ratio(part: Any, whole: Any) -> Floats:
    return np.asarray(np.divide(part, whole, out=np.full(np.shape(whole), np.nan), where=whole > 0))


def _complete_rows(measured: Floats, modelled: Floats) -> tuple[Floats, Floats]:
    y, estimate = np.asarray(measured, float), np.asarray(modelled, float)
    if y.shape != estimate.shape:
        raise DataError(f"Measured has shape {y.shape}, modelled {estimate.shape}; must agree.")
    if y.ndim == 1:
        y, estimate = y[:, None], estimate[:, None]
    good = ~(np.isnan(y) | np.isnan(estimate)).any(axis=1)
    if good.sum() < 2:
        raise DataError(f"A score needs at least 2 complete samples; there are {good.sum()}.")
    return y[good], estimate[good]


def _weighted_decay(model: StateSpace, missing: Floats, root: Floats) -> Iterator[Floats]:
    """Yield rows [W C A^t, W (y − ŷ)] of the initial state's least squares, block by block."""
    n, p = model.order, model.n_outputs
    block = np.empty((min(len(missing), DECAY_BLOCK), p, n))
    row = root @ model.C
    for t in range(len(block)):
        block[t] = row
        row = row @ model.A
    power, step = np.eye(n), np.linalg.matrix_power(model.A, len(block))
    for start in range(0, len(missing), len(block)):
        target = missing[start : start + len(block)] @ root.T
        decay = block[: len(target)].reshape(-1, n) @ power
        yield np.hstack([decay, target.reshape(-1, 1)])
        power = step @ power


def whitener(covariance: Floats | None, outputs: Floats) -> Floats:
    """Return W with W covariance Wᵀ = I, floored at 1e-12 of the outputs' mean squares."""
    size = np.diag(np.mean(outputs**2, axis=0))
    if covariance is None:
        covariance = size
    # the floor keeps noise-free models from a singular weight
    covariance = covariance + 1e-12 * size + np.finfo(float).tiny * np.eye(len(size))
    lower = np.linalg.cholesky(covariance)
    return np.asarray(sla.solve_triangular(lower, np.eye(len(size)), lower=True))


def _inverse_root(prior: Floats) -> Floats:
    """Return W with WᵀW = prior⁻¹; directions that never move are held at zero."""
    values, vectors = np.linalg.eigh(prior)
    kept = np.maximum(values, 1e-12 * values.max()) + np.finfo(float).tiny
    return np.asarray((vectors / np.sqrt(kept)).T)
