"""Small linear algebra against matrices whose answers are known."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Thread

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_info, threadpool_limits

from vibrid import linalg
from vibrid.linalg import (
    divide_by_lower,
    leading_svd,
    left_whitener,
    one_blas_thread,
    semidefinite_root,
    solve_upper,
)
from vibrid.record import Floats


def orthonormal(rng: np.random.Generator, rows: int, columns: int) -> Floats:
    """Return orthonormal columns."""
    return np.asarray(np.linalg.qr(rng.standard_normal((rows, columns)))[0])


def test_full_svd(rng: np.random.Generator) -> None:
    """Below the limit all singular values come back, with the leading vectors."""
    matrix = rng.standard_normal((30, 20))
    left, values, right = leading_svd(matrix, 20)
    np.testing.assert_allclose(left * values @ right, matrix, atol=1e-13)
    left, values, right = leading_svd(matrix, 3)
    assert (left.shape, values.shape, right.shape) == ((30, 3), (20,), (3, 20))


@pytest.mark.parametrize("shape", [(60, 40), (40, 60), (50, 50)])
def test_svd_by_the_gram(rng: np.random.Generator, shape: tuple[int, int]) -> None:
    """Value k has a relative error of 1e-15 (σ₁/σ_k)²; vectors are singular vectors as well."""
    known = np.geomspace(3.0, 3e-5, min(shape))
    matrix = (
        orthonormal(rng, shape[0], len(known)) * known @ orthonormal(rng, shape[1], len(known)).T
    )
    left, values, right = leading_svd(matrix, len(known))
    assert (np.abs(values / known - 1) <= 1e-14 * (known[0] / known) ** 2).all()
    np.testing.assert_allclose(left * values @ right, matrix, atol=1e-14)
    np.testing.assert_allclose(matrix @ right[:20].T, left[:, :20] * values[:20], atol=1e-14)
    np.testing.assert_allclose(left[:, :20].T @ left[:, :20], np.eye(20), atol=1e-10)
    np.testing.assert_allclose(right[:20] @ right[:20].T, np.eye(20), atol=1e-10)


def test_svd_of_a_spectrum_too_wide_for_its_gram(rng: np.random.Generator) -> None:
    """Values asked for below 1e-6 of the largest come from the full decomposition."""
    known = np.geomspace(1.0, 1e-12, 13)
    matrix = orthonormal(rng, 30, 13) * known @ orthonormal(rng, 20, 13).T
    _, values, _ = leading_svd(matrix, 13)
    np.testing.assert_allclose(values[:13], known, atol=1e-15)
    assert (values[13:] < 1e-15).all()
    # fewer asked for, which the Gram tells
    np.testing.assert_allclose(leading_svd(matrix, 4)[1][:4], known[:4], rtol=1e-9)


def test_svd_of_nothing() -> None:
    """No rows, or zeros, are no error: there is no value, or zeros."""
    assert leading_svd(np.zeros((0, 5)), 3)[1].shape == (0,)
    np.testing.assert_array_equal(leading_svd(np.zeros((3, 5)), 2)[1], np.zeros(3))


def test_randomized_svd_of_a_large_matrix(rng: np.random.Generator) -> None:
    """Above 1500 rows the leading triplets equal the known ones to rounding."""
    size, rank = linalg.FULL_SVD_LIMIT + 20, 6
    known = np.concatenate([[10.0, 7.0, 5.0, 3.0, 2.0, 1.0], np.geomspace(1e-3, 1e-9, 40)])
    U, V = orthonormal(rng, size, len(known)), orthonormal(rng, size + 3, len(known))
    left, values, right = leading_svd(U * known @ V.T, rank)
    assert values.shape == (rank,)  # no tail: the randomized path was taken
    np.testing.assert_allclose(values, known[:rank], rtol=1e-12)
    np.testing.assert_allclose(left * values @ right, U[:, :6] * known[:6] @ V[:, :6].T, atol=1e-10)


def test_randomized_and_full_agree(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On noisy data with a gap, both paths span the same space to 1e-6."""
    signal = orthonormal(rng, 300, 4) * [9.0, 8, 7, 6] @ orthonormal(rng, 200, 4).T
    matrix = signal + 1e-3 * rng.standard_normal((300, 200))
    left, values, _ = leading_svd(matrix, 4)
    monkeypatch.setattr(linalg, "FULL_SVD_LIMIT", 10)
    quick, quick_values, _ = leading_svd(matrix, 4)
    np.testing.assert_allclose(quick_values, values[:4], rtol=1e-10)
    np.testing.assert_allclose(np.abs(quick.T @ left), np.eye(4), atol=1e-6)


def test_divide_by_a_regular_lower_matrix(rng: np.random.Generator) -> None:
    """matrix · lower⁻¹, of full rank."""
    lower = np.tril(rng.standard_normal((6, 6))) + 5 * np.eye(6)
    solution = rng.standard_normal((4, 6))
    quotient, rank = divide_by_lower(solution @ lower, lower)
    assert rank == 6
    np.testing.assert_allclose(quotient, solution, atol=1e-13)


def test_divide_by_a_singular_lower_matrix(rng: np.random.Generator) -> None:
    """The pseudo-inverse serves where the factor has lost rank, and the rank is told."""
    tall = rng.standard_normal((6, 4))
    lower = np.linalg.qr((tall @ tall.T).T, mode="r").T
    matrix = rng.standard_normal((5, 6)) @ lower
    quotient, rank = divide_by_lower(matrix, lower)
    assert rank == 4
    np.testing.assert_allclose(quotient, matrix @ np.linalg.pinv(lower, rcond=1e-12), atol=1e-10)
    np.testing.assert_allclose(quotient @ lower, matrix, atol=1e-11)


def test_divide_by_nothing() -> None:
    """A zero matrix has rank 0 and gives zeros; so does an empty one."""
    quotient, rank = divide_by_lower(np.ones((2, 3)), np.zeros((3, 3)))
    assert rank == 0
    np.testing.assert_array_equal(quotient, np.zeros((2, 3)))
    assert divide_by_lower(np.ones((2, 0)), np.zeros((0, 0)))[0].shape == (2, 0)


def test_solve_upper(rng: np.random.Generator) -> None:
    """Exact where regular; least squares of minimum norm where singular; empty where empty."""
    upper = np.triu(rng.standard_normal((5, 5))) + 4 * np.eye(5)
    x = rng.standard_normal((5, 2))
    np.testing.assert_allclose(solve_upper(upper, upper @ x), x, atol=1e-13)
    upper[3:, 3:] = [[0.0, 1.0], [0.0, 0.0]]
    right = rng.standard_normal((5, 2))
    shortest = np.linalg.pinv(upper) @ right
    np.testing.assert_allclose(solve_upper(upper, right), shortest, atol=1e-12)
    assert solve_upper(np.zeros((0, 0)), np.zeros((0, 2))).shape == (0, 2)


def test_left_whitener(rng: np.random.Generator) -> None:
    """T Tᵀ is the matrix's square, T⁺ its left inverse, and the null space is dropped."""
    matrix = rng.standard_normal((6, 3)) @ rng.standard_normal((3, 50))
    root, inverse = left_whitener(matrix)
    assert root.shape == (6, 3)
    np.testing.assert_allclose(root @ root.T, matrix @ matrix.T, atol=1e-12 * 1e3)
    np.testing.assert_allclose(inverse @ root, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.svd(inverse @ matrix, compute_uv=False), 1, atol=1e-12)


def blas_threads() -> list[int]:
    return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]


@contextmanager
def two_blas_threads() -> Iterator[None]:
    """Two threads a BLAS, which any thread may change: the tests' own limit is set aside."""
    with threadpool_limits(2, user_api="blas"):
        for pool in ThreadpoolController().select(user_api="blas").lib_controllers:
            if hasattr(pool, "clear_controlling_thread"):
                pool.clear_controlling_thread()
        yield


def test_one_blas_thread_is_limited_and_given_back() -> None:
    """Inside, every BLAS runs on one thread; outside as before, also after an error."""
    with two_blas_threads():
        before = blas_threads()
        with pytest.raises(RuntimeError, match="stop"), one_blas_thread():
            assert set(blas_threads()) == {1}
            raise RuntimeError("stop")
        assert blas_threads() == before
        with one_blas_thread():
            with one_blas_thread():
                pass
            assert set(blas_threads()) == {1}
        assert blas_threads() == before


def test_one_blas_thread_of_several_threads() -> None:
    """The last to leave gives the count back, also where another came first and still runs."""
    entered, leave, left, end = Event(), Event(), Event(), Event()

    def first() -> None:
        with one_blas_thread():
            entered.set()
            leave.wait(10)
        left.set()
        end.wait(10)

    with two_blas_threads():
        before = blas_threads()
        other = Thread(target=first)
        other.start()
        entered.wait(10)
        with one_blas_thread():
            leave.set()
            left.wait(10)
            assert set(blas_threads()) == {1}
        assert blas_threads() == before
        with one_blas_thread():
            assert set(blas_threads()) == {1}
        end.set()
        other.join()
        assert blas_threads() == before


def test_root_of_a_semidefinite_matrix(rng: np.random.Generator) -> None:
    """Dependent and zero columns, and sizes far apart, change nothing: RᵀR is the matrix."""
    tall = rng.standard_normal((40, 5)) @ rng.standard_normal((5, 8)) * 10.0 ** np.arange(-4, 4)
    tall[:, 2] = 0
    gram = tall.T @ tall
    root = semidefinite_root(gram)
    size = np.sqrt(np.diag(gram))
    assert len(root) == 5
    np.testing.assert_array_less(
        np.abs(root.T @ root - gram), 1e-13 * np.outer(size, size) + 1e-300
    )
