"""Small dense linear algebra that several methods share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np
import scipy.linalg as sla
from threadpoolctl import ThreadpoolController

from .record import Floats

FULL_SVD_LIMIT = 1500  # smaller side up to which the full SVD is the faster one
OVERSAMPLING = 20
POWER_STEPS = 2
RANK_TOLERANCE = 1e-12  # relative, for factors of the Gram: their noise is about 1e-15


@cache
def _threadpools() -> ThreadpoolController:
    # making a controller costs about a millisecond, entering a limit 0.02 ms
    return ThreadpoolController()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Run small and medium kernels on one BLAS thread: two are slower there."""
    with _threadpools().limit(limits=1, user_api="blas"):
        yield


def leading_svd(matrix: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    """Return U, s, Vᵀ of the `rank` largest singular values, and all of s where it is cheap.

    Full for a smaller side up to 1500, else randomized with two power steps (Halko,
    Martinsson & Tropp 2011), whose leading values are exact to rounding and whose tail is
    approximate; `s` then has `rank` entries only.

    Parameters
    ----------
    matrix : array (rows, columns)
    rank : int
        How many triplets are needed.

    Returns
    -------
    left : array (rows, rank)
    values : array (min(rows, columns),) or (rank,)
    right : array (rank, columns)
    """
    if min(matrix.shape) <= max(FULL_SVD_LIMIT, 2 * rank):
        left, values, right = sla.svd(matrix, full_matrices=False, lapack_driver="gesdd")
        return left[:, :rank], values, right[:rank]
    rng = np.random.default_rng(0)
    sample = matrix @ rng.standard_normal((matrix.shape[1], rank + OVERSAMPLING))
    for _ in range(POWER_STEPS):
        sample = matrix @ (matrix.T @ sla.qr(sample, mode="economic")[0])
    basis = sla.qr(sample, mode="economic")[0]
    inner, values, right = sla.svd(basis.T @ matrix, full_matrices=False)
    return basis @ inner[:, :rank], values[:rank], right[:rank]


def divide_by_lower(matrix: Floats, lower: Floats) -> tuple[Floats, int]:
    """Return matrix · lower⁻¹ and the numerical rank of `lower`.

    A triangular solve where `lower` is well conditioned; otherwise the minimum-norm solution,
    singular values below 1e-12 of the largest dropped.
    """
    n = len(lower)
    if n == 0:
        return np.zeros((len(matrix), 0)), 0
    diagonal = np.abs(np.diag(lower))
    if diagonal.min() > np.sqrt(RANK_TOLERANCE) * diagonal.max():
        solved = sla.solve_triangular(lower, matrix.T, lower=True, trans="T", check_finite=False)
        return np.asarray(solved.T), n
    left, values, right = sla.svd(lower, full_matrices=False)
    rank = int(np.count_nonzero(values > RANK_TOLERANCE * values[0]))
    return (matrix @ right[:rank].T) / values[:rank] @ left[:, :rank].T, rank


def solve_upper(upper: Floats, right_hand_side: Floats) -> Floats:
    """Solve upper · x = right_hand_side in the least-squares sense, of minimum norm if singular."""
    if len(upper) == 0 or right_hand_side.shape[1] == 0:
        return np.zeros((len(upper), right_hand_side.shape[1]))
    diagonal = np.abs(np.diag(upper))
    if diagonal.min() > RANK_TOLERANCE * diagonal.max():
        return np.asarray(sla.solve_triangular(upper, right_hand_side, check_finite=False))
    return np.asarray(sla.lstsq(upper, right_hand_side, cond=RANK_TOLERANCE)[0])


def semidefinite_root(gram: Floats) -> Floats:
    """Return R with RᵀR = gram, directions at rounding level left out (pivoted Cholesky)."""
    size = np.sqrt(np.diag(gram))
    size[size == 0] = 1
    upper, order, rank, _ = sla.lapack.dpstrf(gram / size / size[:, None])
    root = np.zeros((rank, len(gram)))
    root[:, order - 1] = np.triu(upper)[:rank]
    return root * size


def left_whitener(matrix: Floats) -> tuple[Floats, Floats]:
    """Return T and T⁺ with T Tᵀ = matrix · matrixᵀ.

    Triangular where the rows are independent; otherwise from singular vectors, the null
    space dropped.
    """
    rows = len(matrix)
    root = np.asarray(sla.qr(matrix.T, mode="r", check_finite=False)[0])[:rows].T
    diagonal = np.abs(np.diag(root))
    if root.shape == (rows, rows) and diagonal.min() > np.sqrt(RANK_TOLERANCE) * diagonal.max():
        inverse = sla.solve_triangular(root, np.eye(rows), lower=True, check_finite=False)
        return root, np.asarray(inverse)
    left, values, _ = sla.svd(root, full_matrices=False)
    rank = int(np.count_nonzero(values > RANK_TOLERANCE * values[0]))
    return left[:, :rank] * values[:rank], (left[:, :rank] / values[:rank]).T
