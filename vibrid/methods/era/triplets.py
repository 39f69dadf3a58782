"""Leading singular triplets of a Hankel matrix, in a fraction of the time of its SVD."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ...errors import DataError
from ...linalg import FULL_SVD_LIMIT, OVERSAMPLING, RANK_TOLERANCE, leading_svd
from ...record import Floats

SMALL = 200  # smaller side up to which the SVD costs nothing that matters
GRAM_FLOOR = 1e-9  # eigenvalues of a Gram below this share of the largest are loose


@dataclass(frozen=True, eq=False)
class Triplets:
    """U (rows, kept), all singular values that are known, Vᵀ (kept, columns).

    `asked` counts the triplets that were looked for; fewer are kept where the rest is
    rounding.
    """

    left: Floats
    values: Floats
    right: Floats
    asked: int

    @property
    def kept(self) -> int:
        return int(self.left.shape[1])


def leading_triplets(matrix: Any, rank: int) -> Triplets:
    """Return the `rank` leading triplets of an array or linear operator, rounding left out.

    The eigenvectors of the Gram of the smaller side span the leading subspace, a singular
    value decomposition of the matrix on that subspace gives the triplets. The outside of the
    span is missed by about 2e-16 σ₁² / σ², which is nothing for noisy data; where the
    spectrum falls further, a step of orthogonal iteration (Halko, Martinsson & Tropp 2011)
    brings it to 2e-16 σ₁, that of the full decomposition. Large matrices are sketched.

    Raises
    ------
    DataError
        The matrix is zero.
    """
    rank = min(rank, *matrix.shape)
    smaller = min(matrix.shape)
    if not isinstance(matrix, np.ndarray) and smaller <= max(FULL_SVD_LIMIT, 2 * rank):
        matrix = matrix @ np.eye(matrix.shape[1])
    if smaller > FULL_SVD_LIMIT or smaller <= max(SMALL, 2 * rank):
        left, values, right = leading_svd(matrix, rank)
    elif matrix.shape[0] < matrix.shape[1]:
        right, values, left = (each.T for each in _by_gram(matrix.T, rank))
    else:
        left, values, right = _by_gram(matrix, rank)
    if len(values) == 0 or values[0] == 0:
        raise DataError(
            "The responses are zero at every lag beyond the first: there is no state to find. "
            "Check the channels."
        )
    kept = int(np.count_nonzero(values[:rank] > RANK_TOLERANCE * values[0]))
    return Triplets(left[:, :kept], values, right[:kept], rank)


def _by_gram(matrix: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    """Return the leading triplets, and all values, of a matrix with fewer columns than rows."""
    squares, vectors = sla.eigh(matrix.T @ matrix, driver="evd", check_finite=False)
    squares, vectors = squares[::-1], vectors[:, ::-1]
    told = int(np.count_nonzero(squares > GRAM_FLOOR * squares[0]))
    if told >= rank:
        left, leading, right = _on_basis(matrix, vectors[:, :rank])
    else:
        # few vectors beyond those that the Gram tells do where the rank ends among them
        for width in (told + OVERSAMPLING, rank + OVERSAMPLING):
            sample = _orthonormal(matrix @ vectors[:, :width])
            left, leading, right = _on_basis(matrix, _orthonormal(matrix.T @ sample))
            if leading[-1] < RANK_TOLERANCE * leading[0]:
                break
    # below the Gram's floor its values are rounding: they cannot exceed what leads them
    tail = np.sqrt(np.maximum(squares[len(leading) :], 0))
    values = np.concatenate([leading, np.minimum(tail, leading[-1])])
    return left[:, :rank], values, right[:rank]


def _on_basis(matrix: Floats, basis: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the singular triplets of the matrix on the span of orthonormal columns."""
    left, values, inner = sla.svd(matrix @ basis, full_matrices=False, check_finite=False)
    return left, values, inner @ basis.T


def _orthonormal(matrix: Floats) -> Floats:
    return np.asarray(sla.qr(matrix, mode="economic", overwrite_a=True, check_finite=False)[0])
