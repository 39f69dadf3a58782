"""The real modal form of a transition matrix, in which B and initial states are regressions.

In the basis of real 2 × 2 blocks [σ ω; −ω σ] (and 1 × 1 for real poles), every response
(q − Λ)⁻¹ b u is a combination of the n signals ξ = (q − Λ)⁻¹ e u with e = (1, 0) in each
block, because the matrices that commute with a block are [α β; −β α]: with b = (b₁, b₂),

    c (q − Λ)⁻¹ b u = b₁ (c₁ ξ₁ + c₂ ξ₂) + b₂ (c₂ ξ₁ − c₁ ξ₂).

So n signals an input serve all outputs and all entries of B (numerically n times fewer than
one a state and input).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..record import Floats

CONDITION_LIMIT = 1e12  # of the eigenvectors; beyond it poles coincide to working precision


@dataclass(frozen=True, eq=False)
class ModalBasis:
    """A = V Λ V⁻¹ with real blocks.

    Attributes
    ----------
    vectors : array (n, n)
        V.
    blocks : array (n, n)
        Λ.
    start : array (n,)
        e: 1 at each real pole and at the first state of each pair.
    first, second : arrays of int
        Indices of the pairs' states.
    """

    vectors: Floats
    blocks: Floats
    start: Floats
    first: NDArray[np.int64]
    second: NDArray[np.int64]

    @property
    def partners(self) -> NDArray[np.int64]:
        """The other state of each pair; a real pole's own."""
        other = np.arange(len(self.start))
        other[self.first], other[self.second] = self.second, self.first
        return other

    def coefficients(self, rows: Floats) -> tuple[Floats, Floats]:
        """Return how ξ, and ξ in the order of its partners, combine to what multiplies b.

        Parameters
        ----------
        rows : array (p, n)
            C V.

        Returns
        -------
        own, partner : arrays (p, n)
            c (q − Λ)⁻¹ b u = Σ_i b_i (own_i ξ_i + partner_i ξ_partners(i)).
        """
        own, partner = rows.copy(), np.zeros_like(rows)
        own[:, self.second] = -rows[:, self.first]
        partner[:, self.first] = partner[:, self.second] = rows[:, self.second]
        return own, partner


def modal_basis(A: Floats) -> ModalBasis | None:
    """Return the real modal form of A, or None where its poles coincide."""
    values, vectors = sla.eig(A, check_finite=False)
    keep = values.imag >= 0
    poles, shapes = values[keep], vectors[:, keep]
    n = len(A)
    V, blocks, start = np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    first = []
    k = 0
    for pole, shape in zip(poles, shapes.T, strict=True):
        start[k] = 1
        V[:, k], blocks[k, k] = shape.real, pole.real
        if pole.imag > 0:
            V[:, k + 1] = shape.imag
            blocks[k : k + 2, k : k + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
            first.append(k)
            k += 1
        k += 1
    if k != n or np.linalg.cond(V) > CONDITION_LIMIT:
        return None
    pairs = np.array(first, dtype=np.int64)
    return ModalBasis(V, blocks, start, pairs, pairs + 1)
