"""Hankel matrices of ERA and ERA/DC against naive loops; channel weights; large matrices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from era_cases import DT, METHODS, assert_same_modes, fitted, naive_era, pulses, structure
from numpy.lib.array_utils import byte_bounds

from vibrid.linalg import FULL_SVD_LIMIT
from vibrid.methods.era import ERA, ERADC
from vibrid.methods.era.hankel import balancing_weights, block_rows
from vibrid.methods.era.triplets import leading_triplets
from vibrid.record import Floats, ImpulseResponses
from vibrid.statespace import StateSpace

# -- against explicit matrices


def naive_eradc(
    h: Floats, rows: int, columns: int, lag: int, xi: int, zeta: int, order: int
) -> tuple[Floats, ...]:
    """Realize by the equations of the chapter, R_q = O_p⁺ H(0)."""

    def hankel(k: int) -> Floats:
        return np.block([[h[1 + k + i + j] for j in range(columns)] for i in range(rows)])

    def correlations(k: int) -> Floats:
        grid = [[k + (i + j) * lag for j in range(zeta + 1)] for i in range(xi + 1)]
        return np.block([[hankel(each) @ hankel(0).T for each in row] for row in grid])

    U, s, Vt = np.linalg.svd(correlations(0))
    U, root, V = U[:, :order], np.sqrt(s[:order]), Vt[:order].T
    A = np.diag(1 / root) @ U.T @ correlations(1) @ V @ np.diag(1 / root)
    observed = (U @ np.diag(root))[: rows * h.shape[1]]
    B = (np.linalg.pinv(observed) @ hankel(0))[:, : h.shape[2]]
    return A, B, observed[: h.shape[1]]


@pytest.mark.parametrize("order", [4, 6, 9])
def test_equal_to_a_naive_realization(order: int, rng: np.random.Generator) -> None:
    """With noise and equal weights, the Markov parameters are those of explicit matrices."""
    h = pulses(structure(3), 60).values
    h = h + 0.1 * h.std() * rng.standard_normal(h.shape)
    ones = np.ones(3), np.ones(3)
    D = h[0]
    kernels = [
        (ERA().factor(h, 12, 20, ones), naive_era(h, 12, 20, order)),
        (
            ERADC(lag=2, row_shifts=1, column_shifts=2).factor(h, 12, 20, ones),
            naive_eradc(h, 12, 20, 2, 1, 2, order),
        ),
    ]
    for kernel, (A, B, C) in kernels:
        found = StateSpace(*kernel.triplet(order), D, DT).markov_parameters(30)
        expected = StateSpace(A, B, C, D, DT).markov_parameters(30)
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(h).max())


def test_block_rows_are_a_view() -> None:
    """The Hankel matrix of many lags takes no more memory than the lags."""
    markov = np.arange(24.0).reshape(6, 2, 2)
    blocks = block_rows(markov, 3, 3)
    explicit = np.block([[markov[1 + i + j] for j in range(3)] for i in range(3)])
    np.testing.assert_array_equal(blocks.reshape(6, 6), explicit)
    low, high = byte_bounds(np.asarray(block_rows(np.zeros((2001, 2, 2)), 1000, 1000)))
    assert high - low < 2001 * 4 * 8


@pytest.mark.parametrize("method", [METHODS[1], METHODS[4]], ids=str)
def test_first_blocks_of_the_factors_are_the_model(method: Any, rng: np.random.Generator) -> None:
    """C leads the observability, B the controllability matrix; without noise powers follow."""
    exact = pulses(structure(2))
    noisy = ImpulseResponses(exact.values + 0.1 * rng.standard_normal(exact.values.shape), dt=DT)
    for data, order in ((exact, 4), (noisy, 5)):
        decomposition = method.decompose(data)
        model = method.realize(decomposition, order).model
        observed, reached = decomposition.factors(order)
        np.testing.assert_allclose(observed[:2], model.C, atol=1e-12)
        np.testing.assert_allclose(reached[:, :2], model.B, atol=1e-10 * np.abs(model.B).max())
        if data is exact:
            np.testing.assert_allclose(
                observed, model.observability_matrix(method.rows), atol=1e-10
            )
            np.testing.assert_allclose(
                reached, model.controllability_matrix(method.columns), atol=1e-10
            )


# -- weights of channels


@pytest.mark.parametrize("shape", [(3, 2), (90, 1), (1, 4)])
def test_balancing_weights_level_every_channel(
    shape: tuple[int, int], rng: np.random.Generator
) -> None:
    """Afterwards all outputs have one mean square, and all inputs."""
    units = np.logspace(-6, 3, shape[0])[:, None] * np.logspace(4, 0, shape[1])
    markov = rng.standard_normal((50, *shape)) * units
    outputs, inputs = balancing_weights(markov)
    energy = np.square(markov * outputs[:, None] * inputs).sum(axis=0)
    np.testing.assert_allclose(energy.sum(axis=1), energy.sum() / shape[0])
    np.testing.assert_allclose(energy.sum(axis=0), energy.sum() / shape[1])


def test_a_silent_channel_keeps_its_weight() -> None:
    """A force that moves nothing, or a dead sensor, disturbs no other weight."""
    markov = np.ones((5, 3, 2))
    markov[:, 1] = 0
    outputs, inputs = balancing_weights(markov)
    assert np.isfinite(outputs).all()
    assert outputs[0] == pytest.approx(outputs[2])
    assert inputs[0] == pytest.approx(inputs[1])


# -- large matrices


def decaying(shape: tuple[int, int], values: Floats, rng: np.random.Generator) -> Floats:
    left = np.linalg.qr(rng.standard_normal((shape[0], len(values))))[0]
    right = np.linalg.qr(rng.standard_normal((shape[1], len(values))))[0]
    return left * values @ right.T


@pytest.mark.parametrize("kind", ["noise", "fast", "rank"])
@pytest.mark.parametrize("shape", [(700, 300), (260, 900)])
def test_leading_triplets_are_those_of_the_full_decomposition(
    shape: tuple[int, int], kind: str, rng: np.random.Generator
) -> None:
    """The truncated matrix is as near as the best of its rank, to rounding of the largest."""
    values = np.logspace(0, -11, 30) if kind == "rank" else np.logspace(0, -14, 250)
    matrix = decaying(shape, values, rng)
    if kind == "noise":
        matrix += 1e-4 * rng.standard_normal(shape)
    found = leading_triplets(matrix, 40)
    s = np.linalg.svd(matrix, compute_uv=False)
    assert found.kept == (30 if kind == "rank" else 40)
    np.testing.assert_allclose(found.values[: found.kept], s[: found.kept], atol=2e-15)
    left_out = matrix - found.left * found.values[: found.kept] @ found.right
    assert np.linalg.norm(left_out, 2) < s[found.kept] + 1e-14
    identity = np.eye(found.kept)
    np.testing.assert_allclose(found.left.T @ found.left, identity, atol=1e-12)
    np.testing.assert_allclose(found.right @ found.right.T, identity, atol=1e-12)


def test_large_hankel_matrices_are_never_laid_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sketched through views, a large matrix gives the same exact model."""
    monkeypatch.setattr("vibrid.methods.era.hankel.LARGEST_COPY", 10_000)
    monkeypatch.setattr("vibrid.methods.era.triplets.FULL_SVD_LIMIT", 100)
    monkeypatch.setattr("vibrid.linalg.FULL_SVD_LIMIT", 100)
    assert FULL_SVD_LIMIT > 100
    frame = structure(2)
    fit = fitted(ERA(rows=150, columns=140), pulses(frame, 300), 4)
    assert_same_modes(fit, frame)
