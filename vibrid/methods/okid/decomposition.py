"""ObserverModels: state-space models of every order from observer Markov parameters."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...chunks import Stream
from ...fit import Finding
from ...gram import BlockGram
from ...kalman import DETECTABLE, STABLE_TO, riccati_gain, spectral_radius
from ...linalg import RANK_TOLERANCE, solve_upper
from ...record import Floats
from ...statespace import free_responses
from ..excitation_checks import data_findings
from ..result import NO_NOISE, Matrices, Realization, Remembering
from .regression import NOISE_FREE, Regression


@dataclass(frozen=True, eq=False)
class ObserverModels(Remembering):
    """The realized Hankel matrix of the Markov parameters, with all that a model needs.

    Attributes
    ----------
    method : OKID, with every option as used
    regression : Regression
        Its past reaches as far back as states are reconstructed from.
    gains : array (rows · p, p)
        Observer-gain Markov parameters Y°_1, …, Y°_rows under each other; L = −K.
    kernel : the factored Hankel matrix of the realization
    """

    method: Any
    stream: Stream
    gram: BlockGram
    regression: Regression
    direct: Floats
    gains: Floats
    kernel: Any
    reasons: tuple[str, ...]
    remarks: tuple[Finding, ...] = ()

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What the data lack, and what was remarked on the way."""
        return (*data_findings(self.stream, self.gram), *self.remarks)

    @property
    def criterion_decides(self) -> bool:
        """There are always inputs."""
        return True

    @property
    def largest_order(self) -> int:
        return int(self.kernel.largest_order)

    @property
    def rank_limited(self) -> bool:
        """Whether singular values beyond the largest order are nothing but rounding.

        Of noisy data they are too, but only because an observer of P past samples makes a
        system of P · n_outputs states.
        """
        return self.is_exact and bool(self.kernel.rank_limited)

    @property
    def limit(self) -> str:
        """What the largest order follows from, in words."""
        if self.kernel.rank_limited and not self.is_exact:
            outputs = f"{self.stream.n_outputs} output{'s' if self.stream.n_outputs > 1 else ''}"
            return f"observer_order={self.method.observer_order} with {outputs}"
        return str(self.kernel.limit)

    @property
    def singular_values(self) -> Floats:
        """Of the balanced Hankel matrix of Markov parameters."""
        return np.asarray(self.kernel.singular_values)

    @property
    def n_columns(self) -> int:
        return self.regression.n_columns

    @property
    def feedthrough(self) -> NDArray[np.bool_]:
        return self.regression.feedthrough

    def factors(self, order: int) -> tuple[Floats, Floats]:
        """Return observability (rows · p, n) and controllability (n, columns · m) matrices."""
        m = self.stream.n_inputs
        reach = self.kernel.controllability(order)
        # of a combined Hankel matrix, only the columns that inputs lead through
        blocks = reach.reshape(order, -1, self.kernel.n_inputs)[:, :, :m]
        return self.kernel.observability(order), blocks.reshape(order, -1)

    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the Bayesian information criterion of this order, and whether it is stable.

        One-step prediction cost plus ln(columns) a parameter; an innovations model of n
        states has n (2 p + m) of them beside D and the covariance.
        """
        model = self.realize(order)
        parameters = order * (2 * self.stream.n_outputs + self.stream.n_inputs)
        value = self.n_columns * self.prediction_cost(model)
        penalty = np.log(self.n_columns) * parameters
        return float(value + penalty), model.radius <= STABLE_TO

    def prediction_cost(self, model: Realization) -> float:
        """Return log det of the covariance of the model's one-step errors."""
        if not np.isfinite(model.innovation).all():
            return np.inf
        floor = NOISE_FREE**2 * np.diag(self.regression.output_sizes)
        return float(np.linalg.slogdet(model.innovation + floor)[1])

    def _realized(self, order: int) -> Realization:
        A, B, C = self.kernel.triplet(order)
        B, L, D = *np.split(B, [self.stream.n_inputs], axis=1), self.direct
        found = self._model((A, B, C, D), *self._gain(A, C, L))
        if self.is_exact:
            return found
        still = self._model((A, B, C, D), np.zeros((order, len(C))), "none: no stable predictor")
        if found.K.any() and self.prediction_cost(found) <= self.prediction_cost(still):
            return found
        # the observer's poles are too many for this order, or its noise is not of the model's
        gained = self._gain_from_residuals((A, B, C, D))
        if gained is None:
            return found
        other = self._model((A, B, C, D), gained, "Riccati of residuals")
        return min(found, other, key=self.prediction_cost)

    def _model(self, matrices: Matrices, K: Floats, gain: str) -> Realization:
        x, errors = self._states_and_errors(matrices, K)
        N = self.n_columns
        innovation, states = errors.T @ errors / N, x.T @ x / N
        return Realization(*matrices, self._transition, K, innovation, states, gain)

    @property
    def _transition(self) -> str:
        return type(self.method.realization).__name__

    # -- the gain

    @cached_property
    def is_exact(self) -> bool:
        """Whether the data hold no noise that a gain could be learnt from."""
        return self.regression.is_exact(self.regression.largest_order)

    def _observability(self, order: int) -> tuple[Floats, Floats]:
        """Return R and Qᵀ Y° of the QR of the observability matrix: orders nest."""
        width = max(order, self.kernel.leading.kept)
        if width not in self._projected:
            rows = self.kernel.observability(width)
            weights = np.resize(self.stream.output_balance, len(rows))[:, None]
            Q, upper = sla.qr(weights * rows, mode="economic", check_finite=False)
            self._projected[width] = upper, Q.T @ (weights * self.gains)
        return self._projected[width]

    @cached_property
    def _projected(self) -> dict[int, tuple[Floats, Floats]]:
        return {}

    def _gain(self, A: Floats, C: Floats, L: Floats) -> tuple[Floats, str]:
        """Return K = −L, and how it was found.

        From the combined Hankel matrix L came with B; else by least squares from
        O L = [Y°_1; Y°_2; …].
        """
        order, found_with_B = len(A), L.shape[1] > 0
        none = np.zeros((order, len(C)))
        if self.is_exact:
            return none, NO_NOISE
        if not found_with_B:
            upper, projected = self._observability(order)
            L = solve_upper(upper[:order, :order], projected[:order])
        K = -L
        if spectral_radius(A - K @ C) < DETECTABLE:
            return K, "combined Hankel" if found_with_B else "least squares"
        S = self.regression.innovation(self.regression.largest_order)
        # the same spectrum with the zeros of the predictor reflected into the circle
        found = riccati_gain(A, C, K @ S @ K.T, S, K @ S)
        return (found[0], "Riccati") if found else (none, "none: no stable predictor")

    def _gain_from_residuals(self, matrices: Matrices) -> Floats | None:
        """Return the gain for the noise that states rebuilt without a gain leave, or None.

        x̂(t) of the P − 1 samples before t and x̂(t−1) of those before t − 1 give the residuals of
        x(t) = A x(t−1) + B u(t−1) + w and y(t−1) = C x(t−1) + D u(t−1) + v.
        """
        data, (A, B, C, D) = self.regression, matrices
        order, c = len(A), data.n_channels
        if data.largest_order < 2:
            return None
        past = data.triangle[:, data.past]
        rebuilt = self._state_map(matrices, np.zeros((order, len(C))), data.largest_order - 1).T
        if not np.isfinite(rebuilt).all():
            return None
        later, before, u = past[:, :-c] @ rebuilt, past[:, c:] @ rebuilt, past[:, : data.n_inputs]
        w = later - before @ A.T - u @ B.T
        v = past[:, data.n_inputs : c] - before @ C.T - u @ D.T
        N = self.n_columns
        found = riccati_gain(A, C, w.T @ w / N, v.T @ v / N, w.T @ v / N)
        return found[0] if found else None

    # -- states from the past samples

    def _state_map(self, matrices: Matrices, K: Floats, n_lags: int) -> Floats:
        noise = np.diag(self.regression.innovation(self.regression.largest_order))
        weights = 1 / np.sqrt(noise + NOISE_FREE**2 * self.regression.output_sizes)
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable model
            return state_map(matrices, K, n_lags, weights)

    def _states_and_errors(self, matrices: Matrices, K: Floats) -> tuple[Floats, Floats]:
        """Return factors of x̂(t) and of y(t) − C x̂(t) − D u(t) over the triangle's rows."""
        data, (_, _, C, D) = self.regression, matrices
        R = data.triangle
        with np.errstate(over="ignore", invalid="ignore"):
            x = R[:, data.past] @ self._state_map(matrices, K, data.largest_order).T
            return x, R[:, data.outputs] - x @ C.T - R[:, data.inputs] @ D.T


def state_map(model: Matrices, K: Floats, n_lags: int, weights: Floats) -> Floats:
    """Return x̂(t) as a combination of z(t−1), …, z(t−n_lags): (n, n_lags · c).

    The predictor x⁺ = Ã x + [B − K D, K] z runs over these samples from the start that
    predicts their outputs best, errors weighed by `weights` (n_outputs,). So nothing depends
    on how fast the predictor forgets; without noise it is exact, even with K = 0.
    """
    A, B, C, D = model
    n, p = len(A), len(C)
    driven, direct = np.hstack([B - K @ D, K]), np.hstack([-D, np.eye(p)])
    closed = A - K @ C
    free = free_responses(closed, np.eye(n), n_lags + 1)
    if not np.isfinite(free).all():
        return np.full((n, n_lags * driven.shape[1]), np.nan)
    seen = ((weights[:, None] * C) @ free[:-1]).reshape(n_lags * p, n)
    back = free[-1] @ np.linalg.pinv(seen, rcond=RANK_TOLERANCE)
    back = back.reshape(n, n_lags, p) * weights
    blocks = np.empty((n, n_lags, driven.shape[1]))
    reach = np.eye(n)
    for k in range(n_lags):
        youngest = back[:, n_lags - 1 - k]
        blocks[:, k] = reach @ driven + youngest @ direct
        reach = reach @ closed - youngest @ C
    return blocks.reshape(n, -1)


def gain_rows(joint: Floats, rows: int, n_inputs: int) -> Floats:
    """Return Y°_1, …, Y°_rows of joint Markov parameters under each other (rows · p, p)."""
    gains = joint[1 : rows + 1, :, n_inputs:]
    return gains.reshape(-1, gains.shape[2])
