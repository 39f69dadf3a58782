"""Γ, J and singular values from the blocks of the factor, by projection and SVD."""

from __future__ import annotations

import numpy as np

from ...chunks import Stream
from ...linalg import RANK_TOLERANCE, divide_by_lower, leading_svd, left_whitener
from ...record import Floats
from .layout import Layout


def projected_states(R: Floats, layout: Layout, *, whiten: bool) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from L32, the past's part of the future outputs.

    With `whiten`, L32 is divided by a root of the covariance of the outputs given the future
    inputs, so the singular values are canonical correlations (CVA); without, PO-MOESP.
    """
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    target, root = R[a:b, b:].T, None
    if whiten:
        root, inverse = left_whitener(R[a:, b:].T)
        target = inverse @ target
    U, s, Vt = kept_svd(target, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    state_map, _ = divide_by_lower(size[:, None] * Vt, R[a:b, a:b].T)
    return (U if root is None else root @ U) * size, state_map, s


def oblique_states(R: Floats, layout: Layout) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from the oblique projection L32 L22⁻¹ [L21 L22]."""
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    along, _ = divide_by_lower(R[a:b, b:].T, R[a:b, a:b].T)
    U, s, _ = kept_svd(along @ R[:b, a:b].T, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    return U * size, (U / size).T @ along, s


def output_unit(stream: Stream) -> float:
    """Return the geometric mean of the output scales: the unit of unweighted singular values."""
    return float(np.exp2(np.mean(np.log2(stream.output_scale))))


def kept_svd(matrix: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    """Return the leading singular triplets that stand above rounding, and all values."""
    U, s, Vt = leading_svd(matrix, rank)
    kept = int(np.count_nonzero(s[:rank] > RANK_TOLERANCE * s[0]))
    return U[:, :kept], s, Vt[:kept]
