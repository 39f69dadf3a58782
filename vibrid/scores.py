"""How well a model explains data: fit measures, initial states of unseen data, folds."""

from __future__ import annotations

from itertools import pairwise
from typing import Any, Literal

import numpy as np
import scipy.linalg as sla

from .errors import DataError, check_choice, check_whole
from .record import Floats
from .statespace import StateSpace, simulate

InitialRule = Literal["map", "least_squares", "zero"]
INITIAL_RULES = ("map", "least_squares", "zero")
SHORTEST_START = 20  # samples a MAP initial state uses at least
START_PER_ORDER = 3


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
    decay = _free_responses(model, count)
    missing = outputs[:count] - model.simulate(inputs[:count])
    root = whitener(error_covariance, outputs)
    left = np.einsum("tpn,qp->tqn", decay, root).reshape(-1, n)
    right = (missing @ root.T).ravel()
    if rule == "map" and prior is not None:
        left = np.vstack([left, _inverse_root(prior)])
        right = np.concatenate([right, np.zeros(len(left) - len(right))])
    return np.asarray(sla.lstsq(left, right, cond=1e-12)[0])


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


def _free_responses(model: StateSpace, count: int) -> Floats:
    """Return C A^t for t < count: (count, n_outputs, n)."""
    rows = np.empty((count, model.n_outputs, model.order))
    rows[0] = model.C
    for t in range(1, count):
        rows[t] = rows[t - 1] @ model.A
    return rows


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
