"""Whitening: extended least squares with lagged residuals, from the triangle alone."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from ...errors import DataError
from ...linalg import solve_upper
from ...markov import joint_markov
from ...record import Floats
from .causal import EXPLODED, GROWN, Responses, causal_responses, growth
from .regression import Regression


def whitened_responses(data: Regression, order: int, iterations: int, n_lags: int) -> Responses:
    """Return [Y_k, Y°_k] of an observer of `order` past samples and past residuals.

    y(t) = D u(t) + Σ h̄_k z(t−k) + Σ C_k e(t−k) + e(t), k = 1 … order: the residuals of one
    fit are regressors of the next (extended least squares, iterated; Ljung 1999). Residuals
    are combinations of present and past samples, which reach `order` samples further back
    each time, so the triangle of (iterations + 1) · order past samples holds every step and
    the data are not read again. The last iteration whose responses do not explode counts;
    where those of the observer without residuals grow too, the causal part of the last.

    Raises
    ------
    DataError
        There is none.
    """
    observer = data.observer(order)
    grown = growth(joint_markov(observer, n_lags)) > GROWN
    weights = np.zeros((0, data.n_outputs, data.n_outputs))
    residual = _residual(observer, weights, np.zeros((1, *observer.shape[1:])))
    steady = None
    for _ in range(iterations):
        observer, weights = _regressed(data, order, residual)
        # more past samples than the structure has states leave poles free, some of them outside
        # the circle with a zero on top: such an iteration is a step on the way, no result
        joint = joint_markov(observer, n_lags, weights)
        if growth(joint) <= EXPLODED:
            steady = Responses(joint)
        residual = _residual(observer, weights, residual)
    if steady is None and grown:
        steady = causal_responses(observer, n_lags, weights)
    if steady is None:
        raise DataError(
            f"whitening={iterations} with observer_order={order} gave only observers whose "
            f"responses grow {growth(joint):.1g}-fold over {n_lags} samples. Use about 5 "
            "iterations, another observer_order, or a longer one without whitening."
        )
    return steady


def _residual(observer: Floats, weights: Floats, previous: Floats) -> Floats:
    """Return F with e(t) = Σ_h F_h z(t−h), h = 0, 1, …, from the fit on previous residuals."""
    p, c = observer.shape[1:]
    filters = np.zeros((max(len(observer), len(weights) + len(previous)), p, c))
    filters[: len(observer)] = -observer
    filters[0, :, c - p :] += np.eye(p)
    for k, weight in enumerate(weights, start=1):
        filters[k : k + len(previous)] -= weight @ previous
    return filters


def _regressed(data: Regression, order: int, residual: Floats) -> tuple[Floats, Floats]:
    """Return h̄_0 … h̄_order and C_1 … C_order of the regression with past residuals."""
    R, (m, p, c) = data.triangle, (data.n_inputs, data.n_outputs, data.n_channels)
    stacked = residual.transpose(0, 2, 1).reshape(-1, p)
    past = [R[:, j * c :][:, : len(stacked)] @ stacked for j in range(order)]
    columns = np.hstack([R[:, : order * c], *past, R[:, data.inputs], R[:, data.outputs]])
    T = np.asarray(sla.qr(columns, mode="r", check_finite=False)[0])
    q = order * (c + p)
    observer, weights = np.zeros((order + 1, p, c)), np.zeros((order, p, p))
    for direct, k in ((True, q + m), (False, q)):
        outputs = np.flatnonzero(data.feedthrough == direct)
        if not len(outputs):
            continue
        found = solve_upper(T[:k, :k], T[:k, q + m + outputs])
        observer[1:, outputs] = found[: order * c].reshape(order, c, -1).transpose(0, 2, 1)
        weights[:, outputs] = found[order * c : q].reshape(order, p, -1).transpose(0, 2, 1)
        observer[0, outputs, : k - q] = found[q:].T
    return observer, weights
