"""Scores: definitions by hand, initial states against their normal equations, folds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vibrid.errors import DataError, OptionError
from vibrid.record import Floats
from vibrid.scores import (
    carried_state,
    fit_percent,
    folds,
    initial_state,
    relative_error,
    start_samples,
    vaf_percent,
)
from vibrid.statespace import StateSpace

MEASURED = np.array([[0.0, 1.0], [2.0, -1.0], [4.0, 3.0]])
MODELLED = np.array([[0.0, 2.0], [2.0, 0.0], [2.0, 4.0]])
SLOW = 0.9999


def slow_model() -> StateSpace:
    """Return a model of a lightly damped pair and two slow poles that look almost alike."""
    A = np.zeros((4, 4))
    A[:2, :2] = 0.98 * np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    A[2:, 2:] = np.diag([SLOW, 0.9995])
    C = np.array([[1.0, 0.2, 1.0, 1.0], [0.3, -1.0, 0.5, 0.5]])
    return StateSpace(A, np.ones((4, 1)), C, np.ones((2, 1)), 0.1)


def free_responses(model: StateSpace, count: int) -> Floats:
    """Return what the initial state multiplies, one output after the other of each sample."""
    return np.vstack([model.C @ np.linalg.matrix_power(model.A, t) for t in range(count)])


# -- measures


def test_fit_by_hand() -> None:
    """Errors 2 of √8 and √3 of √8: 29.289 % and 38.763 %."""
    expected = 100 * (1 - np.array([2.0, np.sqrt(3)]) / np.sqrt(8))
    np.testing.assert_allclose(fit_percent(MEASURED, MODELLED), expected, rtol=1e-14)


def test_vaf_by_hand() -> None:
    """Variance 8/9 of 8/3 is 66.7 %; a constant error costs no VAF."""
    np.testing.assert_allclose(vaf_percent(MEASURED, MODELLED), [100 * 2 / 3, 100], rtol=1e-14)


def test_relative_error_by_hand() -> None:
    """The largest column sums are 3 of errors and 6 of outputs."""
    assert relative_error(MEASURED, MODELLED) == 3 / 6


@pytest.mark.parametrize("score", [fit_percent, vaf_percent, relative_error])
def test_incomplete_rows_are_left_out(score: Any) -> None:
    """A NaN on either side takes its whole row out."""
    gap = np.full((2, 2), np.nan)
    half = np.array([[np.nan, 7.0]])
    measured, modelled = np.vstack([MEASURED, gap, half]), np.vstack([MODELLED, -gap, half + 1])
    np.testing.assert_array_equal(score(measured, modelled), score(MEASURED, MODELLED))


def test_perfect_mean_and_constant() -> None:
    """100 % for the data, 0 % for their mean, NaN where the data do not move."""
    assert fit_percent(MEASURED, MEASURED).tolist() == [100, 100]
    mean = np.tile(MEASURED.mean(axis=0), (3, 1))
    np.testing.assert_allclose(fit_percent(MEASURED, mean), 0, atol=1e-13)
    still = np.ones((5, 1))
    assert np.isnan(fit_percent(still, still)).all()
    assert np.isnan(vaf_percent(still, 0 * still)).all()
    assert np.isnan(relative_error(0 * still, still))


def test_scores_refuse_what_does_not_fit() -> None:
    """Shapes that differ and fewer than two complete rows are named."""
    with pytest.raises(DataError, match=r"shape \(3, 2\), modelled \(2, 2\)"):
        fit_percent(MEASURED, MODELLED[:2])
    with pytest.raises(DataError, match="at least 2 complete samples; there are 1"):
        vaf_percent(MEASURED[:1], MODELLED[:1])


# -- initial states


@pytest.mark.parametrize("rule", ["map", "least_squares"])
def test_initial_state_is_exact_without_noise(rng: np.random.Generator, rule: Any) -> None:
    """With or without a prior, the true state comes back under a known input."""
    model = slow_model()
    u, x0 = rng.standard_normal((300, 1)), rng.standard_normal(4)
    y = model.simulate(u, x0)
    np.testing.assert_allclose(initial_state(model, u, y, rule), x0, atol=1e-7)
    found = initial_state(model, u, y, rule, np.zeros((2, 2)), np.eye(4))
    np.testing.assert_allclose(found, x0, atol=1e-4)  # the floor of the noise is 1e-6 of y
    assert initial_state(model, u, y, "zero").tolist() == [0, 0, 0, 0]


def test_map_solves_its_normal_equations(rng: np.random.Generator) -> None:
    """(Σ Oᵀ R⁻¹ O + P⁻¹) x = Σ Oᵀ R⁻¹ y over the first max(20, 3 n) samples."""
    model, R = slow_model(), np.array([[2.0, 0.5], [0.5, 1.0]])
    root = rng.standard_normal((4, 4))
    P = root @ root.T + np.eye(4)
    u, y = rng.standard_normal((100, 1)), 10 * rng.standard_normal((100, 2))
    assert start_samples(model.order) == 20
    missing = (y - model.simulate(u))[:20].ravel()
    free, weight = free_responses(model, 20), np.kron(np.eye(20), np.linalg.inv(R))
    expected = np.linalg.solve(free.T @ weight @ free + np.linalg.inv(P), free.T @ weight @ missing)
    found = initial_state(model, u, y, "map", R, P)
    np.testing.assert_allclose(found, expected, rtol=1e-8)
    changed = y.copy()
    changed[20:] = 0
    # the floor of the weights, 1e-12 of the outputs, knows all samples
    np.testing.assert_allclose(initial_state(model, u, changed, "map", R, P), found, rtol=1e-9)


def test_prior_keeps_slow_poles_finite(rng: np.random.Generator) -> None:
    """Two poles that 20 samples cannot tell apart: MAP errs like the prior, the rest explodes."""
    model, prior, R = slow_model(), np.eye(4), np.eye(2)
    errors = {"map": 0.0, "without prior": 0.0}
    for _ in range(40):
        x0 = rng.standard_normal(4)
        y = model.simulate(np.zeros((60, 1)), x0) + rng.standard_normal((60, 2))
        nothing = np.zeros((60, 1))
        errors["map"] += np.sum((initial_state(model, nothing, y, "map", R, prior) - x0) ** 2) / 40
        wild = initial_state(model, nothing, y, "map", R)
        errors["without prior"] += np.sum((wild - x0) ** 2) / 40
    free = free_responses(model, 20)
    expected = np.trace(np.linalg.inv(free.T @ free + np.eye(4)))  # of the posterior
    assert errors["map"] == pytest.approx(expected, rel=0.4)  # 40 draws
    assert errors["without prior"] > 100 * errors["map"]


def test_least_squares_uses_all_samples(rng: np.random.Generator) -> None:
    """Its error sum is the smallest over the whole stretch."""
    model = slow_model()
    u, y = rng.standard_normal((200, 1)), rng.standard_normal((200, 2))
    x0 = initial_state(model, u, y, "least_squares", np.eye(2))
    residual = (y - model.simulate(u, x0)).ravel()
    np.testing.assert_allclose(free_responses(model, 200).T @ residual, 0, atol=1e-6)


def test_states_that_never_move_start_at_zero(rng: np.random.Generator) -> None:
    """A prior of zero holds the state at zero, whatever the data say."""
    model, y = slow_model(), rng.standard_normal((50, 2))
    found = initial_state(model, np.zeros((50, 1)), y, "map", np.eye(2), np.zeros((4, 4)))
    np.testing.assert_allclose(found, 0, atol=1e-100)


def test_unknown_rule_is_refused() -> None:
    """The message lists the rules."""
    with pytest.raises(OptionError, match="initial must be one of map, least_squares, zero"):
        initial_state(slow_model(), np.zeros((30, 1)), np.zeros((30, 2)), "rest")  # type: ignore[arg-type]


# -- folds


@pytest.mark.parametrize(("n", "count"), [(100, 4), (101, 4), (7, 7), (1000, 3)])
def test_folds_cover_everything_once(n: int, count: int) -> None:
    """Folds follow each other without gap or overlap and differ by a sample at most."""
    parts = folds(n, count)
    assert [k for start, stop in parts for k in range(start, stop)] == list(range(n))
    sizes = [stop - start for start, stop in parts]
    assert len(sizes) == count
    assert max(sizes) - min(sizes) <= 1


def test_impossible_folds_are_refused() -> None:
    """More folds than samples, or a single one."""
    with pytest.raises(DataError, match="4 folds need at least 4 samples; there are 3"):
        folds(3)
    with pytest.raises(OptionError, match="count must be at least 2; got 1"):
        folds(100, 1)


def test_carried_state_joins_two_stretches(rng: np.random.Generator) -> None:
    """Simulating a record at once or in two parts with the state carried over is the same."""
    model = StateSpace([[0.9, 0.2], [-0.2, 0.9]], [[1.0], [0.5]], [[1.0, 0.3]], [[0.1]], 0.1)
    u, start = rng.standard_normal((300, 1)), np.array([2.0, -1.0])
    whole = model.simulate(u, start)
    rest = model.simulate(u[130:], carried_state(model, u[:130], start))
    np.testing.assert_allclose(rest, whole[130:], atol=1e-12)
