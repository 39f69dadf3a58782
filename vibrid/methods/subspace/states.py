"""Γ, J and singular values from the blocks of the factor, by projection and SVD."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...errors import DataError
from ...linalg import (
    RANK_TOLERANCE,
    divide_by_lower,
    leading_svd,
    left_whitener,
    solve_upper,
    triangle,
)
from ...record import Floats
from .layout import Layout

NOISE_FREE = 1e-8  # innovation over output, rms: below it rounding outweighs the noise


def projected_states(
    R: Floats, layout: Layout, balance: Floats, *, whiten: bool
) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from L32, the past's part of the future outputs.

    With `whiten`, L32 is divided by a root of the covariance of the outputs given the future
    inputs, so the singular values are canonical correlations (CVA); without, PO-MOESP.
    `balance` (n_outputs,) weighs the outputs, so that their units do not.
    """
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    if whiten:
        root, correlations = _whitened(R[a:, b:], b - a)
        U, s, Vt = kept_svd(correlations, layout.largest_order)
        gamma = root @ U
    else:
        weights = np.tile(balance, layout.future_rows)[:, None]
        U, s, Vt = kept_svd(weights * R[a:b, b:].T, layout.largest_order)
        gamma = U / weights
    size = s[: U.shape[1]] ** 0.5
    state_map, _ = divide_by_lower(size[:, None] * Vt, R[a:b, a:b].T)
    return gamma * size, state_map, s


def _whitened(outputs: Floats, n_past: int) -> tuple[Floats, Floats]:
    """Return T with T Tᵀ = outputsᵀ · outputs and T⁺ times its first `n_past` rows, transposed.

    These are rows of an orthogonal factor (Björck & Golub 1973), exact to rounding even where
    T is nearly singular; an inverse of T would mix correlations that are nearly one.
    """
    Q, upper = sla.qr(outputs, mode="economic", check_finite=False)
    diagonal = np.abs(upper.diagonal())
    if len(upper) == len(upper.T) and diagonal.min() > RANK_TOLERANCE * diagonal.max():
        return upper.T, Q[:n_past].T
    root, inverse = left_whitener(outputs.T)
    return root, inverse @ outputs[:n_past].T


def oblique_states(R: Floats, layout: Layout, balance: Floats) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from the oblique projection L32 L22⁻¹ [L21 L22]."""
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    weights = np.tile(balance, layout.future_rows)[:, None]
    along, _ = divide_by_lower(weights * R[a:b, b:].T, R[a:b, a:b].T)
    U, s, _ = kept_svd(along @ R[:b, a:b].T, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    return U * size / weights, (U / size).T @ along, s


def whitened_by_regression(R: Floats, layout: Layout) -> tuple[Floats, Floats, Floats] | None:
    """Return Γ, J and singular values by SSARX (Jansson 2003), or None where noise is missing.

    A regression of y(t) on its direct input and the whole past gives D and the predictor's
    Markov parameters M_l = [C Ã^(l−1) B̃, C Ã^(l−1) K]. What they say of the future samples'
    own part is taken off the future outputs,

        ỹ(k) = y(k) − D u(k) − Σ_{l ≤ k} M_l z(k−l) = C Ã^k x(0) + e(k),

    and canonical correlations of ỹ with the past give J. No future input is projected out,
    so feedback does no harm. ỹ sees Γ̃ of Ã; Γ of A follows from Γ̃ = (I − T_y) Γ.

    Without noise the predictor is not unique: then there is nothing to take off, and the
    caller has to use another weighting.
    """
    past, now = layout.past, layout.inputs(0)
    direct, lagged = _predictor_markov(R, layout, past, now)
    error = R[:, layout.outputs(0)] - R[:, now] @ direct - R[:, past] @ lagged
    size = np.linalg.norm(R[:, layout.outputs(0)], axis=0)
    if (np.linalg.norm(error, axis=0) <= NOISE_FREE * size).any():
        return None
    toeplitz = _future_part(layout, direct, lagged)
    T, b = triangle(np.hstack([R[:, past], R @ toeplitz])), len(past)
    root, inverse = left_whitener(T[:, b:].T)
    U, s, Vt = kept_svd(inverse @ T[:b, b:].T, layout.largest_order)
    scale = s[: U.shape[1]] ** 0.5
    state_map, _ = divide_by_lower(scale[:, None] * Vt, T[:b, :b].T)
    # the outputs' rows of the map are (I − T_y)ᵀ, unit upper triangular
    outputs = toeplitz[len(R) - layout.future_rows * layout.n_outputs :]
    gamma = sla.solve_triangular(outputs.T, root @ U, lower=True, check_finite=False)
    return np.asarray(gamma) * scale, state_map, s


def _predictor_markov(
    R: Floats, layout: Layout, past: NDArray[np.int64], now: NDArray[np.int64]
) -> tuple[Floats, Floats]:
    """Return Dᵀ (m, p) and the coefficients of W_p (n_past, p) of the regression of y(t)."""
    columns = np.concatenate([past, now, layout.outputs(0)])
    T, q = triangle(R[:, columns]), len(past) + len(now)
    found = solve_upper(T[:q, :q], T[:q, q : len(columns)])
    return found[len(past) :], found[: len(past)]


def _future_part(layout: Layout, direct: Floats, lagged: Floats) -> Floats:
    """Return ỹ(0), ỹ(1), … as combinations of Hankel rows (n_rows · c, future_rows · p)."""
    p, c = layout.n_outputs, layout.n_channels
    toeplitz = np.zeros((len(layout.rows), layout.future_rows * p))
    for k in range(layout.future_rows):
        columns = slice(k * p, (k + 1) * p)
        toeplitz[layout.outputs(k), columns] = np.eye(p)
        toeplitz[layout.inputs(k), columns] = -direct
        for lag in range(1, min(k, layout.past_rows) + 1):
            # the youngest past sample comes last
            first = (layout.past_rows - lag) * c
            markov = lagged[first : first + c]
            toeplitz[layout.inputs(k - lag), columns] = -markov[: c - p]
            toeplitz[layout.outputs(k - lag), columns] = -markov[c - p :]
    return toeplitz


def covariance_states(
    R: Floats, layout: Layout, balance: Floats, lagged: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from the block Hankel of output covariances.

    `lagged` (n_rows, c, c) holds Σ z(t) z(t+l)ᵀ of outputs alone.
    """
    past, b = np.array(layout.past_channels), layout.n_past
    steps = np.arange(layout.future_rows)[:, None] + np.arange(layout.past_rows) + 1
    # the transpose of a lagged sum is Λ(l) = Σ y(t+l) y(t)ᵀ; the youngest past sample leads
    balanced = lagged * balance[:, None] * balance
    blocks = balanced.transpose(0, 2, 1)[:, :, past][steps]
    hankel = blocks.transpose(0, 2, 1, 3).reshape(
        layout.future_rows * layout.n_outputs, layout.past_rows * len(past)
    )
    U, s, _ = kept_svd(hankel, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    weights = np.tile(balance, layout.future_rows)[:, None]
    predictor, _ = divide_by_lower(weights * R[:b, b:].T, R[:b, :b].T)
    return U * size / weights, (U / size).T @ predictor, s


def kept_svd(matrix: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    """Return the leading singular triplets that stand above rounding, and all values.

    Raises
    ------
    DataError
        The matrix is zero: the past says nothing of the future.
    """
    U, s, Vt = leading_svd(matrix, rank)
    if len(s) == 0 or s[0] == 0:
        raise DataError(
            "The past of these outputs says nothing of their future: there is no state to find. "
            "Use a longer record, or check the channels."
        )
    kept = int(np.count_nonzero(s[:rank] > RANK_TOLERANCE * s[0]))
    return U[:, :kept], s, Vt[:kept]
