"""Subspace: models of every order from Γ, J and the factor, ranked by the Gram alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...chunks import Stream
from ...fit import feedthrough_mask
from ...gram import BlockGram, Factor
from ...kalman import DETECTABLE, STABLE_TO, riccati_gain, spectral_radius
from ...linalg import one_blas_thread, solve_upper
from ...record import Floats
from .layout import Layout

USUAL_ORDERS = 64  # states prepared together; larger orders prepare all there are
NOISE_FREE = 1e-8  # innovation over output, rms: below it rounding outweighs the noise


@dataclass(frozen=True, eq=False)
class Realization:
    """An innovations model in scaled units, and how it was found."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    K: Floats
    innovation: Floats
    state_covariance: Floats
    transition: str
    gain: str

    @cached_property
    def radius(self) -> float:
        """Spectral radius of A."""
        return spectral_radius(self.A)


@dataclass(frozen=True, eq=False)
class Subspace:
    """Γ and J of the largest order, with all that smaller orders need.

    Attributes
    ----------
    gamma : array (future_rows · n_outputs, largest_order)
        Columns nest: order n takes the first n.
    state_map : array (largest_order, n_past)
        Rows nest.
    singular_values : array
    """

    layout: Layout
    factor: Factor
    stream: Stream
    gram: BlockGram
    gamma: Floats
    state_map: Floats
    singular_values: Floats
    feedthrough: NDArray[np.bool_]
    transition: str

    @property
    def largest_order(self) -> int:
        return int(self.gamma.shape[1])

    @property
    def limit(self) -> str:
        """What the largest order follows from, in words."""
        if self.rank_limited:
            return "the rank of the (nearly noise-free) data"
        outputs = f"{self.layout.n_outputs} output{'s' if self.layout.n_outputs > 1 else ''}"
        return f"{self.layout.future_rows} future rows of {outputs}"

    @property
    def rank_limited(self) -> bool:
        """Whether singular values beyond the largest order are nothing but rounding."""
        return self.largest_order < self.layout.largest_order

    @property
    def n_columns(self) -> int:
        return self.gram.projected_columns

    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the Bayesian information criterion of this order, and whether it is stable.

        Prediction cost over the horizon plus ln(columns) a parameter; an innovations model
        of n states has n (2 p + m) of them beside D and the covariance.
        """
        model = self.realize(order, self.transition)
        layout = self.layout
        parameters = order * (2 * layout.n_outputs + layout.n_inputs)
        value = self.n_columns * self.prediction_cost(model)
        return value + np.log(self.n_columns) * parameters, model.radius <= STABLE_TO

    def _width(self, order: int) -> int:
        """Return how many states are prepared at once for this order: few serve most orders."""
        return self.largest_order if order > USUAL_ORDERS else min(USUAL_ORDERS, self.largest_order)

    def _regression(self, width: int) -> Floats:
        """Return the triangle T of [u(t), x(t), x(t+1), y(t)] for orders up to `width`."""
        if width not in self._regressions:
            R, layout, J = self.factor.triangle, self.layout, self.state_map[:width].T
            samples = np.hstack(
                [
                    R[:, layout.inputs(0)],
                    R[:, layout.past(0)] @ J,
                    R[:, layout.past(1)] @ J,
                    R[:, layout.outputs(0)],
                ]
            )
            triangle = np.asarray(sla.qr(samples, mode="r", check_finite=False)[0])
            self._regressions[width] = triangle[: samples.shape[1]]
        return self._regressions[width]

    def _nested_shift(self, width: int) -> tuple[Floats, Floats]:
        """Return R and Qᵀ Γ_down of the QR of Γ_up, for orders up to `width`."""
        if width not in self._shifts:
            p = self.layout.n_outputs
            # rows weigh by the outputs' deviations, so that units do not
            weights = np.tile(self.stream.output_balance, self.layout.future_rows)[:, None]
            gamma = weights * self.gamma[:, :width]
            Q, upper = sla.qr(gamma[:-p], mode="economic", check_finite=False)
            self._shifts[width] = upper, Q.T @ gamma[p:]
        return self._shifts[width]

    @cached_property
    def _regressions(self) -> dict[int, Floats]:
        return {}

    @cached_property
    def _shifts(self) -> dict[int, tuple[Floats, Floats]]:
        return {}

    def realize(self, order: int, transition: str = "auto") -> Realization:
        """Return the model of this order; "auto" takes the transition with less error."""
        key = (order, transition)
        if key not in self._made:
            with one_blas_thread():
                self._made[key] = self._realized(order, transition)
        return self._made[key]

    def _realized(self, order: int, transition: str) -> Realization:
        if transition == "regression":
            return self._by_regression(order)
        if transition == "shift":
            return self._by_shift(order)
        return min(
            (self.realize(order, "regression"), self.realize(order, "shift")),
            key=lambda model: (model.radius > STABLE_TO, self._cost(model)),
        )

    @cached_property
    def _made(self) -> dict[tuple[int, str], Realization]:
        # scanning orders and then realizing one asks for the same models again
        return {}

    def _cost(self, model: Realization) -> float:
        """Return what models are ranked by: simulation with inputs, prediction without."""
        if self.layout.n_inputs:
            return self.simulation_cost(model)
        return self.prediction_cost(model)

    def prediction_cost(self, model: Realization) -> float:
        """Return log det of the covariance of the one-step errors at the horizon's end.

        The predictor starts from x = J W_p and runs with its own gain through the future
        rows, so a transition that is wrong, or a state that remembers too little, shows.
        """
        return self._horizon_cost(model, model.K, [self.layout.future_rows - 1])

    def simulation_cost(self, model: Realization) -> float:
        """Return log det of the covariance of the errors when x = J W_p is simulated on.

        The mean over four steps of the horizon, the last one among them.
        """
        last = self.layout.future_rows - 1
        steps = sorted({max(1, last * k // 4) for k in (1, 2, 3, 4)})
        return self._horizon_cost(model, np.zeros_like(model.K), steps)

    def _horizon_cost(self, model: Realization, gain: Floats, steps: Sequence[int]) -> float:
        """Return the mean over the steps of log det of the covariance of y − ŷ."""
        R, p = self.factor.triangle, self.layout.n_outputs
        responses = _responses(model, gain, max(steps))
        # one product for all steps: reading R is what it costs
        maps = [self._error_map(model, responses, step) for step in steps]
        errors = R @ np.hstack(maps)
        if not np.isfinite(errors).all():
            return np.inf
        total = 0.0
        for k, step in enumerate(steps):
            error = errors[:, k * p : (k + 1) * p]
            floor = NOISE_FREE**2 * np.diag((R[:, self.layout.outputs(step)] ** 2).sum(axis=0))
            total += np.linalg.slogdet((error.T @ error + floor) / self.n_columns)[1]
        return total / len(steps)

    def _error_map(
        self, model: Realization, responses: tuple[Floats, Floats, Floats], step: int
    ) -> Floats:
        """Return y − ŷ at a step as a combination of Hankel rows, (n_rows · c, p).

        ŷ(k) = C Ã^k J W_p + Σ_j C Ã^(k−1−j) [B̃ u(j) + K y(j)] + D u(k).
        """
        layout, (free, driven, corrected) = self.layout, responses
        m, p = layout.n_inputs, layout.n_outputs
        first_output = len(self.factor.triangle) - layout.future_rows * p
        errors = np.zeros((len(self.factor.triangle), p))
        past = driven[:step][::-1].transpose(0, 2, 1)
        errors[: step * m] = -past.reshape(step * m, p)
        past = corrected[:step][::-1].transpose(0, 2, 1)
        errors[first_output : first_output + step * p] = -past.reshape(step * p, p)
        errors[layout.past()] = -(free[step] @ self.state_map[: len(model.A)]).T
        errors[layout.inputs(step)] = -model.D.T
        errors[layout.outputs(step)] = np.eye(p)
        return errors

    # -- the two transitions

    def _split(self, order: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the columns u, x, x⁺, y of T for this order."""
        m, width = self.layout.n_inputs, self._width(order)
        T = self._regression(width)
        return (
            T[:, :m],
            T[:, m : m + order],
            T[:, m + width : m + width + order],
            T[:, m + 2 * width :],
        )

    def _by_regression(self, order: int) -> Realization:
        u, x, after, y = self._split(order)
        q = self.layout.n_inputs + order
        regressors = self._regression(self._width(order))[:q, :q]
        AB = solve_upper(regressors, after[:q]).T
        CD = solve_upper(regressors, y[:q]).T
        m = self.layout.n_inputs
        A, B, C, D = AB[:, m:], AB[:, :m], CD[:, m:].copy(), CD[:, :m].copy()
        still = ~self.feedthrough
        if still.any() and m:
            C[still] = np.linalg.lstsq(x, y[:, still], rcond=None)[0].T
            D[still] = 0
        return self._with_gain(
            A, B, C, D, after - x @ A.T - u @ B.T, y - x @ C.T - u @ D.T, x, "regression"
        )

    def _by_shift(self, order: int) -> Realization:
        u, x, after, y = self._split(order)
        m = self.layout.n_inputs
        upper, down = self._nested_shift(self._width(order))
        A = solve_upper(upper[:order, :order], down[:order, :order])
        C = self.gamma[: self.layout.n_outputs, :order]
        rest, out = after - x @ A.T, y - x @ C.T
        B = solve_upper(u[:m], rest[:m]).T
        D = solve_upper(u[:m], out[:m]).T * self.feedthrough[:, None]
        return self._with_gain(A, B, C, D, rest - u @ B.T, out - u @ D.T, x, "shift")

    def _with_gain(
        self,
        A: Floats,
        B: Floats,
        C: Floats,
        D: Floats,
        state_error: Floats,
        output_error: Floats,
        x: Floats,
        transition: str,
    ) -> Realization:
        """Regress the state errors on the innovations; Riccati where that does not predict."""
        samples = self.n_columns
        innovation = output_error.T @ output_error / samples
        K, gain = np.zeros((len(A), len(C))), "none: no noise to learn it from"
        _, _, _, y = self._split(len(A))
        if (np.diag(innovation) > NOISE_FREE**2 * (y**2).sum(axis=0) / samples).any():
            K = sla.lstsq(output_error, state_error, cond=1e-10, check_finite=False)[0].T
            gain = "regression"
            if spectral_radius(A - K @ C) >= DETECTABLE:
                found = riccati_gain(
                    A,
                    C,
                    state_error.T @ state_error / samples,
                    innovation,
                    state_error.T @ output_error / samples,
                )
                gain = "Riccati" if found else "none: no stable predictor"
                K, innovation = found or (np.zeros_like(K), innovation)
        return Realization(A, B, C, D, K, innovation, x.T @ x / samples, transition, gain)


def assemble(
    stream: Stream,
    gram: BlockGram,
    layout: Layout,
    factor: Factor,
    states: tuple[Floats, Floats, Floats],
    feedthrough: bool | Sequence[bool] | None,
    transition: str,
) -> Subspace:
    """Return the decomposition of Γ, J and singular values found from the factor."""
    return Subspace(
        layout=layout,
        factor=factor,
        stream=stream,
        gram=gram,
        gamma=states[0],
        state_map=states[1],
        singular_values=states[2],
        feedthrough=feedthrough_mask(feedthrough, stream.records[0].output_channels),
        transition=transition,
    )


def _responses(model: Realization, gain: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    """Return C Ã^k, C Ã^k B̃ and C Ã^k K for k ≤ count; Ã = A − K C, B̃ = B − K D."""
    A, B = model.A - gain @ model.C, model.B - gain @ model.D
    free = np.empty((count + 1, *model.C.shape))
    free[0] = model.C
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable model; seen by the caller
        for k in range(count):
            free[k + 1] = free[k] @ A
        return free, free @ B, free @ gain
