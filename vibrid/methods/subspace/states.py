"""Γ, J and singular values from the blocks of the factor, by projection and SVD."""

from __future__ import annotations

import numpy as np

from ...errors import DataError
from ...linalg import RANK_TOLERANCE, divide_by_lower, leading_svd, left_whitener
from ...record import Floats
from .layout import Layout


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
        root, inverse = left_whitener(R[a:, b:].T)
        U, s, Vt = kept_svd(inverse @ R[a:b, b:].T, layout.largest_order)
        gamma = root @ U
    else:
        weights = np.tile(balance, layout.future_rows)[:, None]
        U, s, Vt = kept_svd(weights * R[a:b, b:].T, layout.largest_order)
        gamma = U / weights
    size = s[: U.shape[1]] ** 0.5
    state_map, _ = divide_by_lower(size[:, None] * Vt, R[a:b, a:b].T)
    return gamma * size, state_map, s


def oblique_states(R: Floats, layout: Layout, balance: Floats) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from the oblique projection L32 L22⁻¹ [L21 L22]."""
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    weights = np.tile(balance, layout.future_rows)[:, None]
    along, _ = divide_by_lower(weights * R[a:b, b:].T, R[a:b, a:b].T)
    U, s, _ = kept_svd(along @ R[:b, a:b].T, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    return U * size / weights, (U / size).T @ along, s


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
