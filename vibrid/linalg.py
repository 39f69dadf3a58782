"""Small dense linear algebra that several methods share."""

from __future__ import annotations

from contextlib import ContextDecorator
from functools import cache
from threading import Lock

import numpy as np
import scipy.linalg as sla
from threadpoolctl import LibController, ThreadpoolController

from .record import Floats

FULL_SVD_LIMIT = 1500  # smaller side up to which the full SVD is the faster one
GRAM_SVD_LIMIT = 1e-12  # of the largest eigenvalue of a Gram: its square root is good to 1e-3
OVERSAMPLING = 20
POWER_STEPS = 2
QR_ROOM = 64  # columns that LAPACK may take together
RANK_TOLERANCE = 1e-12  # relative, for factors of the Gram: their noise is about 1e-15


class _OneThread(ContextDecorator):
    """One BLAS thread while anyone wants it: the first sets the limit, the last lifts it."""

    def __init__(self) -> None:
        self._lock, self._users = Lock(), 0
        self._lifted: list[tuple[LibController, int]] = []

    def __enter__(self) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:
                found = [(pool, pool.num_threads) for pool in _blas()]
                for pool, count in found:
                    if count != 1:
                        pool.set_num_threads(1)
                # where another thread of the caller's holds a limit of its own, that stays
                self._lifted = [each for each in found if each[1] != each[0].num_threads]

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0:
                for pool, count in self._lifted:
                    _release(pool)  # the last to leave need not be who came first
                    pool.set_num_threads(count)
                    _release(pool)


def _release(pool: LibController) -> None:
    """Let any thread set the count: threadpoolctl ≥ 3.8 lets the first that did alone."""
    if hasattr(pool, "clear_controlling_thread"):
        pool.clear_controlling_thread(force=True)


@cache
def _blas() -> tuple[LibController, ...]:
    # looking for the libraries costs about a millisecond
    return tuple(ThreadpoolController().select(user_api="blas").lib_controllers)


_ONE_THREAD = _OneThread()


def one_blas_thread() -> _OneThread:
    """Run small and medium kernels on one BLAS thread: two are slower there.

    Used by ``with`` or as a decorator; may be entered again inside itself.
    """
    return _ONE_THREAD


def triangle(matrix: Floats) -> Floats:
    """Return the upper triangle R of the QR factorization, (min(rows, columns), columns)."""
    if not matrix.size:
        return np.zeros((min(matrix.shape), matrix.shape[1]))
    room = QR_ROOM * matrix.shape[1]
    return np.triu(sla.lapack.dgeqrf(matrix, lwork=max(1, room))[0][: min(matrix.shape)])


def leading_svd(matrix: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    """Return U, s, Vᵀ of the `rank` largest singular values, and all of s where it is cheap.

    For a smaller side up to 1500 from the Gram of that side where the values asked for stay
    above 1e-6 of the largest, which takes half the time: value k then has a relative error of
    about 1e-15 (σ₁/σ_k)². Below, by the full decomposition. Larger ones are sketched, with two
    power steps (Halko, Martinsson & Tropp 2011): leading values are exact to rounding, the tail
    is approximate, and `s` has `rank` entries only.

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
        if matrix.shape[0] > matrix.shape[1]:
            right, values, left = leading_svd(matrix.T, rank)
            return left.T, values, right.T
        return _by_gram(matrix, rank) or _full_svd(matrix, rank)
    rng = np.random.default_rng(0)
    sample = matrix @ rng.standard_normal((matrix.shape[1], rank + OVERSAMPLING))
    for _ in range(POWER_STEPS):
        sample = matrix @ (matrix.T @ sla.qr(sample, mode="economic")[0])
    basis = sla.qr(sample, mode="economic")[0]
    inner, values, right = sla.svd(basis.T @ matrix, full_matrices=False)
    return basis @ inner[:, :rank], values[:rank], right[:rank]


def _by_gram(wide: Floats, rank: int) -> tuple[Floats, Floats, Floats] | None:
    """Return triplets from the eigenvectors of wide · wideᵀ, or None where that is too coarse."""
    squares, vectors = np.linalg.eigh(wide @ wide.T)
    squares, left = squares[::-1], vectors[:, : -rank - 1 : -1]
    if not squares[:rank].min(initial=np.inf) > GRAM_SVD_LIMIT * squares.max(initial=0):
        return None
    values = np.sqrt(np.maximum(squares, 0))
    return left, values, (left / values[:rank]).T @ wide


def _full_svd(wide: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    right, values, left = np.linalg.svd(wide.T, full_matrices=False)  # tall is faster
    return left.T[:, :rank], values, right.T[:rank]


def divide_by_lower(matrix: Floats, lower: Floats) -> tuple[Floats, int]:
    """Return matrix · lower⁻¹ and the numerical rank of `lower`.

    A triangular solve where `lower` is well conditioned; otherwise the minimum-norm solution,
    singular values below 1e-12 of the largest dropped.
    """
    n = len(lower)
    if n == 0:
        return np.zeros((len(matrix), 0)), 0
    diagonal = np.abs(lower.diagonal())
    if diagonal.min() > np.sqrt(RANK_TOLERANCE) * diagonal.max():
        return np.asarray(sla.lapack.dtrtrs(lower, matrix.T, lower=1, trans=1)[0].T), n
    left, values, right = sla.svd(lower, full_matrices=False)
    rank = int(np.count_nonzero(values > RANK_TOLERANCE * values[0]))
    return (matrix @ right[:rank].T) / values[:rank] @ left[:, :rank].T, rank


def solve_upper(upper: Floats, right_hand_side: Floats) -> Floats:
    """Solve upper · x = right_hand_side in the least-squares sense, of minimum norm if singular."""
    if len(upper) == 0 or right_hand_side.shape[1] == 0:
        return np.zeros((len(upper), right_hand_side.shape[1]))
    diagonal = np.abs(upper.diagonal())
    if diagonal.min() > RANK_TOLERANCE * diagonal.max():
        return np.asarray(sla.lapack.dtrtrs(upper, right_hand_side)[0])
    return np.asarray(sla.lstsq(upper, right_hand_side, cond=RANK_TOLERANCE)[0])


def semidefinite_root(gram: Floats) -> Floats:
    """Return R with RᵀR = gram, directions at rounding level left out (pivoted Cholesky)."""
    size = np.sqrt(gram.diagonal())
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
    root = triangle(matrix.T).T
    diagonal = np.abs(root.diagonal())
    if root.shape == (rows, rows) and diagonal.min() > np.sqrt(RANK_TOLERANCE) * diagonal.max():
        return root, np.asarray(sla.lapack.dtrtri(root, lower=1)[0])
    left, values, _ = sla.svd(root, full_matrices=False)
    rank = int(np.count_nonzero(values > RANK_TOLERANCE * values[0]))
    return left[:, :rank] * values[:rank], (left[:, :rank] / values[:rank]).T
