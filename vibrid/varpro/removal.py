"""Which blocks a model needs least."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..record import Floats
from .projection import Projected


def removals(
    projected: Projected, first: NDArray[np.bool_] | None = None
) -> list[tuple[NDArray[np.bool_], float]]:
    """Return which blocks are left, and the cost, as the least needed go one by one.

    Without a block the cost rises by Σ_o w_o c_oᵀ ([(ΦᵀΦ)⁻¹]_bb)⁻¹ c_o, everything linear
    fitted anew; B and initial states of the others stay. From all blocks down to one.

    Parameters
    ----------
    projected : Projected
    first : array of bool (n_blocks,), optional
        Blocks that go before all others.
    """
    blocks = projected.blocks
    rows = [slice(2 * b + int(alone), 2 * b + 2) for b, alone in enumerate(blocks.single)]
    answers = projected.linear.stacked() * np.sqrt(projected.weights)
    parts = [
        (root @ root.T, answers[np.ix_(projected.rows_of(outputs), outputs)])
        for outputs, root, _ in projected.groups
    ]
    left, cost = np.ones(blocks.n_blocks, dtype=bool), projected.cost
    early = np.zeros_like(left) if first is None else first
    found = [(left.copy(), cost)]
    while left.sum() > 1:
        open_ones = left & early if (left & early).any() else left
        rises = {
            int(b): sum(_rise(inverse, rows[b], C) for inverse, C in parts)
            for b in np.flatnonzero(open_ones)
        }
        least = min(rises, key=lambda b: rises[b])
        parts = [_without(inverse, C, rows[least]) for inverse, C in parts]
        left[least] = False
        cost += rises[least]
        found.append((left.copy(), cost))
    return found


def _rise(inverse: Floats, rows: slice, C: Floats) -> float:
    """Return how the squares rise when the coefficients in some rows are set to zero."""
    c = C[rows]
    return float(np.sum(c * np.linalg.lstsq(inverse[rows, rows], c, rcond=None)[0]))


def _without(inverse: Floats, C: Floats, rows: slice) -> tuple[Floats, Floats]:
    """Return (ΦᵀΦ)⁻¹ and coefficients after some columns of Φ were taken out."""
    both = np.hstack([inverse, C])
    both -= inverse[:, rows] @ np.linalg.lstsq(inverse[rows, rows], both[rows], rcond=None)[0]
    both[rows] = 0
    both[:, rows] = 0
    return both[:, : len(inverse)], both[:, len(inverse) :]
