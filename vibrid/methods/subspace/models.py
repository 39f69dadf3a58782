"""Subspace: models of every order from Γ, J and the factor, ranked by the Gram alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...chunks import Stream
from ...fit import Finding, feedthrough_mask
from ...gram import BlockGram, Factor
from ...kalman import (
    DETECTABLE,
    STABLE_TO,
    innovation_form,
    riccati_gain,
    spectral_radius,
)
from ...linalg import one_blas_thread, solve_upper, triangle
from ...record import Floats
from ..excitation_checks import data_findings
from ..result import NO_NOISE, Draft, Matrices, Realization
from .costs import FreeRun, free_run, prediction_cost
from .feedback import Feedback, feedback_of
from .layout import Layout
from .states import NOISE_FREE

Model = TypeVar("Model", bound=Draft)
PREPARED = (8, 16, 64)  # states prepared together; larger orders prepare all there are


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
    positive_real : bool
        Whether the Kalman gain follows from covariances that belong to a process, by the
        Riccati equation, instead of from a regression on the innovations.
    """

    method: Any
    layout: Layout
    factor: Factor
    stream: Stream
    gram: BlockGram
    gamma: Floats
    state_map: Floats
    singular_values: Floats
    feedthrough: NDArray[np.bool_]
    positive_real: bool = False

    @property
    def reasons(self) -> tuple[str, ...]:
        """Sentences on sizes chosen: none, the horizon is given."""
        return ()

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What the data lack, and whether the inputs follow the outputs."""
        feedback = self.feedback.findings() if self.feedback else []
        return (*data_findings(self.stream, self.gram), *feedback)

    @cached_property
    def feedback(self) -> Feedback | None:
        """Test for feedback from the outputs to the inputs; None without inputs or noise."""
        with one_blas_thread():
            return feedback_of(self.factor.triangle, self.layout, self.n_columns)

    @property
    def criterion_decides(self) -> bool:
        """Without inputs coloured excitation lets the criterion fall for ever."""
        return self.layout.n_inputs > 0

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

        Prediction cost plus ln(columns) a parameter; an innovations model of n states has
        n (2 p + m) of them beside D and the covariance. With inputs, the cost is that of the
        state regression, which does not hang on what a coloured input leaves of B and K;
        without, of the model over the horizon.
        """
        model = self.realize(order, self.method.transition)
        layout = self.layout
        parameters = order * (2 * layout.n_outputs + layout.n_inputs)
        cost = self.regression_cost(order) if layout.n_inputs else self.prediction_cost(model)
        value = self.n_columns * cost
        return value + np.log(self.n_columns) * parameters, model.radius <= STABLE_TO

    def regression_cost(self, order: int) -> float:
        """Return log det of the covariance of y(t) less its regression on x(t) and u(t)."""
        _, _, _, y = self._split(order)
        error = y[self.layout.n_inputs + order :]
        floor = NOISE_FREE**2 * np.diag((y**2).sum(axis=0))
        return float(np.linalg.slogdet((error.T @ error + floor) / self.n_columns)[1])

    def factors(self, order: int) -> tuple[Floats, Floats | None]:
        """Return Γ of this order in the coordinates of its model, and that there is no Δ.

        Outputs in units of their own deviation, so that their units do not weigh.
        """
        weights = np.tile(self.stream.output_balance, self.layout.future_rows)[:, None]
        return weights * self.gamma[:, :order], None

    def _width(self, order: int) -> int:
        """Return how many states are prepared at once for this order: few serve most orders."""
        wide = next((width for width in PREPARED if order <= width), self.largest_order)
        return min(wide, self.largest_order)

    def _regression(self, width: int) -> Floats:
        """Return the triangle T of [u(t), x(t), x(t+1), y(t)] for orders up to `width`."""
        if width not in self._regressions:
            R, layout, J = self.factor.triangle, self.layout, self.state_map[:width].T
            samples = np.hstack(
                [
                    R[:, layout.inputs(0)],
                    R[:, layout.past] @ J,
                    R[:, layout.next_past] @ J,
                    R[:, layout.outputs(0)],
                ]
            )
            self._regressions[width] = triangle(samples)
        return self._regressions[width]

    def _nested_shift(self, width: int) -> tuple[Floats, Floats]:
        """Return R and Qᵀ Γ_down of the QR of Γ_up, for orders up to `width`."""
        if width not in self._shifts:
            p = self.layout.n_outputs
            # rows weigh by the outputs' deviations, so that units do not
            weights = np.tile(self.stream.output_balance, self.layout.future_rows)[:, None]
            gamma = weights * self.gamma[:, :width]
            both = triangle(np.hstack([gamma[:-p], gamma[p:]]))[:width]
            self._shifts[width] = both[:, :width], both[:, width:]
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
        if transition != "auto":
            return self._completed(self._draft(order, transition))
        if not self.layout.n_inputs:
            models = [self.realize(order, name) for name in ("regression", "shift")]
            return _first_stable(sorted(models, key=self.prediction_cost))
        # a free response needs no gain, which is what costs most of small models
        drafts = [self._draft(order, name) for name in ("regression", "shift")]
        return self.realize(order, _first_stable(sorted(drafts, key=self.free_cost)).transition)

    @cached_property
    def _made(self) -> dict[tuple[int, str], Realization]:
        # scanning orders and then realizing one asks for the same models again
        return {}

    def prediction_cost(self, model: Realization) -> float:
        """Return log det of the covariance of the one-step errors at the horizon's end.

        The predictor starts from x = J W_p and runs with its own gain through the future
        rows, so a transition that is wrong, or a state that remembers too little, shows.
        """
        return prediction_cost(
            self.factor.triangle, self.layout, self.state_map, model, self.n_columns
        )

    def free_cost(self, model: Draft) -> float:
        """Return log det of the covariance of what the free response of x = J W_p misses.

        Of outputs and states less what the future inputs explain of them; the mean over four
        steps of the horizon, the last one among them.
        """
        width = self._width(len(model.A))
        if width not in self._free_runs:
            self._free_runs[width] = free_run(
                self.factor.triangle, self.layout, self.state_map[:width]
            )
        return self._free_runs[width].cost(model.A, model.C, self.n_columns)

    @cached_property
    def _free_runs(self) -> dict[int, FreeRun]:
        return {}

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

    def _draft(self, order: int, transition: str) -> Draft:
        """Return the model of a transition without its gain."""
        key = (order, transition)
        if key not in self._drafts:
            by = self._by_regression if transition == "regression" else self._by_shift
            self._drafts[key] = Draft(*by(order), transition)
        return self._drafts[key]

    @cached_property
    def _drafts(self) -> dict[tuple[int, str], Draft]:
        return {}

    def _by_regression(self, order: int) -> Matrices:
        u, x, after, y = self._split(order)
        m, still = u.shape[1], ~self.feedthrough
        if m == 0 or not still.any():
            columns, q = np.hstack([u, x, after, y]), m + order
        else:
            found, *_ = np.linalg.lstsq(x, y[:, still], rcond=None)
            C_still = np.asarray(found.T, dtype=np.float64)
            known = np.hstack([u, x, self._fed_back(order, still, C_still)])
            columns, q = triangle(np.hstack([known, after, y])), known.shape[1]
        found = solve_upper(columns[:q, :q], columns[:q, q:]).T
        own = slice(m, m + order)
        A, B, C, D = found[:order, own], found[:order, :m], found[order:, own], found[order:, :m]
        if m and still.any():
            C[still], D[still] = C_still, 0
        return A, B, C, D

    def _fed_back(self, order: int, still: NDArray[np.bool_], C_still: Floats) -> Floats:
        """Return the innovations of outputs without D that u(t) may know, where feedback is seen.

        A controller that answers within the sample carries them into u(t), so that they have to
        take part in the regression; but not where they are no more than rounding.
        """
        _, x, _, y = self._split(order)
        errors = y[:, still] - x @ C_still.T
        if not (self.feedback and self.feedback.suspected):
            return errors[:, :0]
        left = np.linalg.norm(y[self.layout.n_inputs + order :, still], axis=0)
        return errors[:, left > NOISE_FREE * np.linalg.norm(y[:, still], axis=0)]

    def _by_shift(self, order: int) -> Matrices:
        u, x, after, y = self._split(order)
        m = self.layout.n_inputs
        upper, down = self._nested_shift(self._width(order))
        A = solve_upper(upper[:order, :order], down[:order, :order])
        C = self.gamma[: self.layout.n_outputs, :order]
        left = np.hstack([after - x @ A.T, y - x @ C.T])[:m]
        found = solve_upper(u[:m], left).T
        return A, found[:order], C, found[order:] * self.feedthrough[:, None]

    def _completed(self, draft: Draft) -> Realization:
        """Find the gain: by regression on the innovations where that predicts, else Riccati."""
        A, B, C, D, samples = draft.A, draft.B, draft.C, draft.D, self.n_columns
        u, x, after, y = self._split(len(A))
        state_error, output_error = after - x @ A.T - u @ B.T, y - x @ C.T - u @ D.T
        still = Realization(
            *(A, B, C, D, draft.transition),
            K=np.zeros((len(A), len(C))),
            innovation=output_error.T @ output_error / samples,
            state_covariance=x.T @ x / samples,
            gain=NO_NOISE,
        )
        size = (y**2).sum(axis=0) / samples
        if not (still.innovation.diagonal() > NOISE_FREE**2 * size).any():
            return still
        found, *_ = np.linalg.lstsq(output_error, state_error, rcond=1e-10)
        regressed = replace(still, K=np.asarray(found.T, dtype=np.float64), gain="regression")
        if not self.positive_real and regressed.predictor_radius < DETECTABLE:
            return regressed
        solved = _gain_of_residuals(A, C, state_error, output_error, samples)
        if solved is None:
            return replace(still, gain="none: no stable predictor")
        return replace(still, K=solved[0], innovation=solved[1], gain="Riccati")


def _first_stable(models: Sequence[Model]) -> Model:
    return next((model for model in models if model.radius <= STABLE_TO), models[0])


def assemble(
    method: Any,
    stream: Stream,
    gram: BlockGram,
    layout: Layout,
    factor: Factor,
    states: tuple[Floats, Floats, Floats],
    feedthrough: bool | Sequence[bool] | None,
    *,
    positive_real: bool = False,
) -> Subspace:
    """Return the decomposition of Γ, J and singular values found from the factor."""
    return Subspace(
        method=method,
        layout=layout,
        factor=factor,
        stream=stream,
        gram=gram,
        gamma=states[0],
        state_map=states[1],
        singular_values=states[2],
        feedthrough=feedthrough_mask(feedthrough, stream.records[0].output_channels),
        positive_real=positive_real,
    )


def _gain_of_residuals(
    A: Floats, C: Floats, state_error: Floats, output_error: Floats, samples: int
) -> tuple[Floats, Floats] | None:
    """Return gain and innovation covariance of the process that the residuals define.

    Their covariance [Q S; Sᵀ R] is never negative, so with Σ = A Σ Aᵀ + Q, G = A Σ Cᵀ + S and
    Λ(0) = C Σ Cᵀ + R the covariances C A^(l−1) G are those of a process: a positive real
    sequence, whose Riccati equation has a solution (Van Overschee & De Moor 1996, stochastic
    algorithm 3; Han, Bohn & Bauer 2021, eq. 22, 23).
    """
    Q = state_error.T @ state_error / samples
    R = output_error.T @ output_error / samples
    S = state_error.T @ output_error / samples
    found = riccati_gain(A, C, Q, R, S)
    if found is not None or spectral_radius(A) >= DETECTABLE:
        return found
    covariance = sla.solve_discrete_lyapunov(A, Q)
    G, L0 = A @ covariance @ C.T + S, C @ covariance @ C.T + R
    form = innovation_form(A, C, G, L0) if np.diag(L0).all() else None
    return None if form is None else (form[0], form[1])
