"""Separable least squares and sums of decays: plain loops, explicit Jacobians, known answers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from vibrid.errors import DataError, OptionError
from vibrid.record import Floats
from vibrid.statespace import StateSpace
from vibrid.varpro import (
    BlockFilter,
    Blocks,
    Linear,
    Projected,
    SignalSums,
    decays,
    descend,
    removals,
    signals,
    split_poles,
)

FEEDTHROUGH = np.array([True, False, True])
WEIGHTS = np.array([1.0, 2.0, 0.5])
LENGTHS = (230, 140)  # of two segments, each of its own record


def some_system(rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return A, B with a complex pair and three real poles in an arbitrary basis."""
    A = np.zeros((5, 5))
    A[:2, :2] = [[0.8, 0.5], [-0.5, 0.8]]
    A[2:, 2:] = np.diag([0.9, 0.6, -0.3])
    T = rng.standard_normal((5, 5))
    return T @ A @ np.linalg.inv(T), rng.standard_normal((5, 2))


def random_problem(rng: np.random.Generator) -> tuple[Projected, list[Floats]]:
    """Return a place on random data, and the data [u, y] of both segments."""
    A, B = some_system(rng)
    blocks = split_poles(A, B, rng.standard_normal((2, 5)))
    data = [rng.standard_normal((length, 5)) + 1 for length in LENGTHS]
    return summed(blocks, data), data


def summed(blocks: Blocks, data: list[Floats], linear: Linear | None = None) -> Projected:
    """Return the place of blocks on data."""
    states = np.zeros((blocks.n_blocks, 2, 3))
    sums = SignalSums(blocks, linear or Linear(states, np.zeros((2, 3)), np.zeros((2, 3))))
    for k, samples in enumerate(data):
        sums.begin(k, k)
        sums.add(samples)
    return Projected(sums.total(), WEIGHTS, FEEDTHROUGH)


def regressors(blocks: Blocks, data: list[Floats]) -> Floats:
    """Return [X, u, 1] sample by sample, by the plain recursion."""
    A, B, starts = blocks.matrices()
    rows = []
    for k, samples in enumerate(data):
        x = starts[k]
        for z in samples:
            rows.append(np.concatenate([x, z[:2], np.eye(2)[k]]))
            x = A @ x + B @ z[:2]
    return np.array(rows)


def kept_columns(order: int, output: int) -> NDArray[np.int64]:
    """Return the columns that an output may use."""
    return np.delete(np.arange(order + 4), [] if FEEDTHROUGH[output] else [order, order + 1])


def residuals(blocks: Blocks, data: list[Floats]) -> Floats:
    """Return the weighted errors of the best linear part (n_samples, 3)."""
    rows, y = regressors(blocks, data), np.vstack(data)[:, 2:]
    errors = np.empty_like(y)
    for o in range(3):
        Phi = rows[:, kept_columns(blocks.order, o)]
        errors[:, o] = y[:, o] - Phi @ np.linalg.lstsq(Phi, y[:, o], rcond=None)[0]
    return np.asarray(errors * np.sqrt(WEIGHTS))


def used_parameters(blocks: Blocks) -> NDArray[np.bool_]:
    """Return which parameters of a step exist."""
    return np.tile(blocks.used, (1 + 2 + 2, 1, 1)).ravel()


def test_blocks_are_the_same_system(rng: np.random.Generator) -> None:
    """Markov parameters survive, with pairs, real pairs and a single pole."""
    A, B = some_system(rng)
    C = rng.standard_normal((3, 5))
    blocks = split_poles(A, np.hstack([B, np.eye(5)]), np.zeros((0, 5)))
    assert blocks.single.sum() == 1
    assert blocks.order == 5
    own, inputs, _ = blocks.matrices()
    # states and blocks are related by T = inputs of the unit drives
    T = inputs[:, 2:]
    model = StateSpace(own, inputs[:, :2], C @ np.linalg.inv(T), np.zeros((3, 2)), 1.0)
    truth = StateSpace(A, B, C, np.zeros((3, 2)), 1.0)
    np.testing.assert_allclose(model.markov_parameters(20), truth.markov_parameters(20), atol=1e-12)


def test_defective_start_gives_its_poles() -> None:
    """A double pole without a second eigenvector becomes a block with both poles near it."""
    A = np.array([[0.9, 1.0], [0.0, 0.9]])
    blocks = split_poles(A, np.ones((2, 1)), np.zeros((1, 2)))
    np.testing.assert_allclose(blocks.poles, 0.9, atol=1e-3)


def test_a_step_does_what_it_says(rng: np.random.Generator) -> None:
    """The new A is that of the stepped companion block in other coordinates."""
    blocks = replace(split_poles(*some_system(rng), np.zeros((2, 5))), slowest=10.0)
    step = 0.05 * rng.standard_normal((5, blocks.n_blocks, 2))
    moved, T = blocks.moved(step)
    r, s, b = blocks.centre, blocks.spread, blocks.shape
    for k in np.flatnonzero(~blocks.single):
        stepped = np.array(
            [[r[k] - s[k] * step[0, k, 0], s[k]], [-s[k] * (b[k] + step[0, k, 1]), r[k]]]
        )
        own = T[k] @ stepped @ np.linalg.inv(T[k])
        np.testing.assert_allclose(moved.transition[k], own, atol=1e-13)
        inputs = (blocks.inputs + step[1:3])[:, k] @ T[k].T
        np.testing.assert_allclose(moved.inputs[:, k], inputs, atol=1e-13)


def test_poles_stay_inside_their_bounds(rng: np.random.Generator) -> None:
    """Whatever the step, pairs stay in the unit circle and real poles below their bound."""
    A, B = some_system(rng)
    blocks = split_poles(A, B, np.zeros((2, 5)), slowest=0.95)
    for _ in range(20):
        moved, _ = blocks.moved(10 * rng.standard_normal((5, blocks.n_blocks, 2)))
        size = np.abs(moved.poles)
        assert size.max() < 1
        assert size[moved.poles.imag == 0].max(initial=0) <= 0.95 + 1e-12


def test_unstable_starts_are_reflected() -> None:
    """A pole outside the circle comes back with its frequency and inverse magnitude."""
    pair = 1.02 * np.array([[np.cos(1), np.sin(1)], [-np.sin(1), np.cos(1)]])
    A = np.block([[pair, np.zeros((2, 1))], [np.zeros((1, 2)), np.full((1, 1), 1.25)]])
    poles = split_poles(A, np.ones((3, 1)), np.zeros((1, 3))).poles
    np.testing.assert_allclose(np.sort(np.abs(poles)), [0.8, 1 / 1.02, 1 / 1.02], rtol=1e-12)
    np.testing.assert_allclose(np.abs(np.angle(poles)).max(), 1, rtol=1e-12)


def test_filter_equals_the_loop(rng: np.random.Generator) -> None:
    """Stretches give the plain recursion, for two drives with carried states."""
    A = rng.standard_normal((3, 2, 2)) / 2
    drives, states = rng.standard_normal((2, 1, 160)), rng.standard_normal((2, 3, 2))
    found = np.empty((2, 3, 2, 160))
    last = BlockFilter(A).run(drives, states, found)
    x = states
    for t in range(160):
        np.testing.assert_allclose(found[..., t], x, rtol=1e-10, atol=1e-10)
        x = np.einsum("bij,dbj->dbi", A, x) + np.array([0, 1]) * drives[:, :, t, None]
    np.testing.assert_allclose(last, x, rtol=1e-10)


def test_cost_and_errors_equal_explicit_least_squares(rng: np.random.Generator) -> None:
    """Two records with offsets and starts of their own, one output without D."""
    place, data = random_problem(rng)
    errors = residuals(place.blocks, data)
    assert place.cost == pytest.approx((errors**2).sum(), rel=1e-12)
    root = np.sqrt(WEIGHTS)
    np.testing.assert_allclose(place.errors * np.outer(root, root), errors.T @ errors, atol=1e-10)
    assert not place.linear.direct[:, 1].any()


def test_sums_of_errors_are_those_of_outputs(rng: np.random.Generator) -> None:
    """A guess of the linear part changes the sums, not the answer."""
    place, data = random_problem(rng)
    again = summed(place.blocks, data, place.linear)
    assert again.cost == pytest.approx(place.cost, rel=1e-12)
    used = place.blocks.used
    np.testing.assert_allclose(again.linear.states[used], place.linear.states[used], atol=1e-10)
    np.testing.assert_allclose(again.gradient, place.gradient, atol=1e-9)


def test_chunks_do_not_matter(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of one stretch, decays carried on and left out where vanished, give the same."""
    place, data = random_problem(rng)
    monkeypatch.setattr(signals, "CHUNK_ELEMENTS", 1)
    np.testing.assert_allclose(
        summed(place.blocks, data).sums.gram, place.sums.gram, rtol=1e-9, atol=1e-10
    )


def test_gradient_is_the_slope_of_the_cost(rng: np.random.Generator) -> None:
    """Central differences of explicit least squares, every parameter."""
    place, data = random_problem(rng)
    blocks, step = place.blocks, 1e-6
    for k in np.flatnonzero(used_parameters(blocks)):
        unit = np.zeros(len(place.gradient))
        unit[k] = step
        costs = [
            (residuals(blocks.moved((s * unit).reshape(5, -1, 2))[0], data) ** 2).sum()
            for s in (-1, 1)
        ]
        assert place.gradient[k] == pytest.approx((costs[1] - costs[0]) / (4 * step), abs=1e-5)


def test_information_is_that_of_kaufmans_jacobian(rng: np.random.Generator) -> None:
    """JᵀJ with J = −P ∂X C, the derivative of the regressors by central differences."""
    place, data = random_problem(rng)
    blocks, step = place.blocks, 1e-5
    rows = regressors(blocks, data)
    C = place.linear.states[blocks.used].T * np.sqrt(WEIGHTS)[:, None]
    columns = []
    for k in np.flatnonzero(used_parameters(blocks)):
        unit = np.zeros(len(place.gradient))
        unit[k] = step
        parts = []
        for sign in (-1, 1):
            moved, T = blocks.moved((sign * unit).reshape(5, -1, 2))
            own = np.zeros((blocks.n_blocks, 2, blocks.n_blocks, 2))
            own[np.arange(blocks.n_blocks), :, np.arange(blocks.n_blocks), :] = T
            used = blocks.used.ravel()
            back = np.linalg.inv(own.reshape(len(used), -1)[np.ix_(used, used)])
            parts.append(regressors(moved, data)[:, :5] @ back.T)
        slope = (parts[1] - parts[0]) / (2 * step)
        column = slope @ C.T
        for o in range(3):
            Phi = rows[:, kept_columns(5, o)]
            column[:, o] -= Phi @ np.linalg.lstsq(Phi, column[:, o], rcond=None)[0]
        columns.append(column.ravel())
    J = np.array(columns)
    used = used_parameters(blocks)
    np.testing.assert_allclose(
        place.information[np.ix_(used, used)], J @ J.T, atol=1e-6 * np.abs(J @ J.T).max()
    )


def test_neutral_steps_change_nothing(rng: np.random.Generator) -> None:
    """Along each the gradient and the information vanish: two of a block, one of a single."""
    place, _ = random_problem(rng)
    size = np.sqrt(np.maximum(np.diag(place.information), 1e-300))
    unit = place.information / size / size[:, None]
    directions = place.neutral * size[:, None]
    length = np.linalg.norm(directions, axis=0)
    assert (length > 0).sum() == place.blocks.order
    directions = directions[:, length > 0] / length[length > 0]
    np.testing.assert_allclose(unit @ directions, 0, atol=1e-10)
    np.testing.assert_allclose((place.gradient / size) @ directions, 0, atol=1e-10)


def test_removal_costs_what_a_fit_without_the_block_costs(rng: np.random.Generator) -> None:
    """The formula equals least squares on the columns left, at every step."""
    place, data = random_problem(rng)
    found = removals(place)
    assert [left.sum() for left, _ in found] == [3, 2, 1]
    for left, cost in found[1:]:
        without = (residuals(place.blocks.select(left), data) ** 2).sum()
        assert cost == pytest.approx(without, rel=1e-10)
        some = replace(place, sums=place.sums.select(left))
        assert some.cost == pytest.approx(without, rel=1e-10)
    last = removals(place, np.array([True, False, False]))
    assert not last[1][0][0]


@dataclass(frozen=True)
class Valley:
    """Rosenbrock's valley with a bound on its first parameter, and one that does nothing."""

    at: tuple[float, float, float]
    bound: float = np.inf

    @property
    def _errors(self) -> Floats:
        x, y, _ = self.at
        return np.array([10 * (y - x**2), 1 - x])

    @property
    def _jacobian(self) -> Floats:
        return np.array([[-20 * self.at[0], 10, 0], [-1, 0, 0]])

    @property
    def cost(self) -> float:
        return float(self._errors @ self._errors)

    @property
    def gradient(self) -> Floats:
        return np.asarray(self._jacobian.T @ self._errors)

    @property
    def information(self) -> Floats:
        return np.asarray(self._jacobian.T @ self._jacobian)

    @property
    def neutral(self) -> Floats:
        return np.array([[0.0], [0.0], [1.0]])

    def moved(self, step: Floats) -> Valley:
        x, y, z = np.array(self.at) + step
        return Valley((min(x, self.bound), y, z), self.bound)

    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        return np.array([self.at[0] >= self.bound and step[0] > 0, False, False])


def test_descent_finds_the_bottom() -> None:
    """The classic start reaches (1, 1); the parameter without effect does not move."""
    found = descend(Valley((-1.2, 1.0, 7.0)), tolerance=1e-14)
    assert found.converged
    assert found.point.at == pytest.approx((1, 1, 7), abs=1e-8)


def test_descent_goes_along_a_bound() -> None:
    """With x ≤ 0.5 the least cost is at (0.5, 0.25)."""
    found = descend(Valley((-1.2, 1.0, 0.0), 0.5), tolerance=1e-12)
    assert found.converged
    assert found.point.at[:2] == pytest.approx((0.5, 0.25), abs=1e-6)
    assert found.point.cost < found.start_cost


# -- sums of decays


def some_decays(rng: np.random.Generator, noise: float) -> tuple[list[Floats], Floats]:
    """Return three records of a sine, two decays and an exponential, and the poles."""
    poles = np.array([0.97, np.exp(0.2j), 0.995 * np.exp(0.35j), 0.98 * np.exp(0.9j)])
    shapes = rng.standard_normal((2, 4)) + 1j * rng.standard_normal((2, 4))
    records = []
    for length in (600, 500, 400):
        amplitude = rng.standard_normal(4) + 1j * rng.standard_normal(4)
        residues = shapes * amplitude
        residues[:, 0] = (shapes[:, 0].real) * amplitude[0].real
        y = ((poles ** np.arange(length)[:, None]) @ residues.T).real + rng.standard_normal(2)
        records.append(y + noise * rng.standard_normal(y.shape))
    return records, poles


def test_decays_share_their_poles(rng: np.random.Generator) -> None:
    """Exact sums are found from poles off by a little; the sine stays on the circle."""
    records, poles = some_decays(rng, 0.0)
    start = poles * np.array([0.99, np.exp(0.003j), 0.999 * np.exp(0.005j), 0.99])
    found = decays(records, start, undamped=[False, True, False, False])
    assert found.converged
    np.testing.assert_allclose(found.poles, poles, atol=1e-12)
    assert abs(abs(found.poles[1]) - 1) < 1e-15
    for k, record in enumerate(records):
        np.testing.assert_allclose(found.modelled(len(record), k), record, atol=1e-9)


def test_deviations_of_decays_are_their_spread(rng: np.random.Generator) -> None:
    """Over 40 noisy copies errors have the deviations reported."""
    clean, poles = some_decays(rng, 0.0)
    held, scores = [False, True, False, False], []
    for _ in range(40):
        noisy = [record + 0.05 * rng.standard_normal(record.shape) for record in clean]
        found = decays(noisy, poles, undamped=held)
        rates, truth = np.log(found.poles[1:]), np.log(poles[1:])
        frequencies = (np.abs(rates) - np.abs(truth)) / (2 * np.pi) / found.frequencies_std
        damping = (rates.real / np.abs(rates) - truth.real / np.abs(truth))[1:]
        scores.append([*frequencies, *(damping / found.damping_std[1:])])
        assert found.damping_std[0] < 1e-12
    rms = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (np.abs(rms - 1) < 0.35).all()  # known to 11 % from 40 copies


@pytest.mark.parametrize(
    ("records", "poles", "undamped", "message"),
    [
        ([np.zeros((9, 1))], [], None, "finite numbers"),
        ([np.zeros((9, 1))], [0.9, 0.9], None, "coincide"),
        ([np.zeros((9, 1))], [-1 + 2000j], None, "near the unit circle"),
        ([np.zeros((9, 1))], [0.9], [True], "False for real ones"),
        ([np.zeros((9, 1)), np.zeros((9, 2))], [0.9], None, "must have the same"),
        ([np.full((9, 1), np.nan)], [0.9], None, "NaN"),
        ([np.zeros((3, 1))], [0.9j], None, "longer record"),
    ],
)
def test_wrong_decays_are_refused(
    records: list[Floats], poles: list[complex], undamped: list[bool] | None, message: str
) -> None:
    """The message names what is wrong."""
    with pytest.raises((OptionError, DataError), match=message):
        decays(records, poles, undamped=undamped)
