"""The kernel that N4SID and SSI share: from the factor of a Gram to models of every order.

Symbols (Van Overschee & De Moor 1996; Pappalardo et al. 2022, section 3.2): U_f, Y_f future
inputs and outputs, W_p past samples, R upper triangle of the Hankel rows [U_f; W_p; Y_f],
Γ observability matrix, J state map with x(t) = J W_p(t), T triangle of the state regression.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..chunks import Stream
from ..fit import Diagnostics, Finding, Fit
from ..gram import PIVOT_LIMIT, BlockGram, Factor
from ..kalman import DETECTABLE, riccati_gain, spectral_radius
from ..linalg import (
    RANK_TOLERANCE,
    divide_by_lower,
    leading_svd,
    left_whitener,
    one_blas_thread,
    solve_upper,
)
from ..record import Floats
from ..statespace import StateSpace

NOISE_FREE = 1e-8  # innovation over output, rms: below it rounding outweighs the noise


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each Hankel row stands in the factor: [U_f; W_p; Y_f], each ordered by lag."""

    past_rows: int
    future_rows: int
    n_inputs: int
    n_outputs: int
    past_channels: tuple[int, ...]

    @property
    def n_rows(self) -> int:
        return self.past_rows + self.future_rows

    @property
    def n_channels(self) -> int:
        return self.n_inputs + self.n_outputs

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Indices lag · n_channels + channel in factor order."""
        lags = np.arange(self.n_rows)[:, None] * self.n_channels
        past, future = lags[: self.past_rows], lags[self.past_rows :]
        inputs, outputs = np.arange(self.n_inputs), self.n_inputs + np.arange(self.n_outputs)
        return np.concatenate(
            [
                (future + inputs).ravel(),
                (past + np.array(self.past_channels)).ravel(),
                (future + outputs).ravel(),
            ]
        )

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        places = np.full(self.n_rows * self.n_channels, -1)
        places[self.rows] = np.arange(len(self.rows))
        return places.reshape(self.n_rows, self.n_channels)

    @property
    def n_future_inputs(self) -> int:
        return self.future_rows * self.n_inputs

    @property
    def n_past(self) -> int:
        return self.past_rows * len(self.past_channels)

    @property
    def largest_order(self) -> int:
        """Most states that the rows can tell apart; shift invariance needs one row less."""
        return min((self.future_rows - 1) * self.n_outputs, self.n_past)

    def past(self, shift: int = 0) -> NDArray[np.int64]:
        """Return the factor columns of W_p, moved `shift` samples on."""
        lags = np.arange(shift, self.past_rows + shift)
        return np.asarray(self._places[np.ix_(lags, np.array(self.past_channels))].ravel())

    def inputs(self, step: int) -> NDArray[np.int64]:
        """Return the factor columns of u at future step `step`."""
        return self._places[self.past_rows + step, : self.n_inputs]

    def outputs(self, step: int) -> NDArray[np.int64]:
        """Return the factor columns of y at future step `step`."""
        return self._places[self.past_rows + step, self.n_inputs :]


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

    @property
    def radius(self) -> float:
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
        layout = self.layout
        if self.largest_order < layout.largest_order:
            return "the rank of the (nearly noise-free) data"
        return f"{layout.future_rows} future rows of {layout.n_outputs} outputs"

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
        return value + np.log(self.n_columns) * parameters, model.radius < 1

    @cached_property
    def _regression(self) -> Floats:
        """Triangle T of [u(t), x(t), x(t+1), y(t)] for the largest order."""
        R, layout = self.factor.triangle, self.layout
        with one_blas_thread():
            samples = np.hstack(
                [
                    R[:, layout.inputs(0)],
                    R[:, layout.past(0)] @ self.state_map.T,
                    R[:, layout.past(1)] @ self.state_map.T,
                    R[:, layout.outputs(0)],
                ]
            )
            triangle = sla.qr(samples, mode="r", check_finite=False)[0]
        return np.asarray(triangle[: samples.shape[1]])

    @cached_property
    def _nested_shift(self) -> tuple[Floats, Floats]:
        p = self.layout.n_outputs
        Q, upper = sla.qr(self.gamma[:-p], mode="economic", check_finite=False)
        return upper, Q.T @ self.gamma[p:]

    def realize(self, order: int, transition: str = "auto") -> Realization:
        """Return the model of this order; "auto" takes the transition with less error."""
        with one_blas_thread():
            if transition == "regression":
                return self._by_regression(order)
            if transition == "shift":
                return self._by_shift(order)
            return min(
                (self._by_regression(order), self._by_shift(order)),
                key=lambda model: (model.radius >= 1, self._cost(model)),
            )

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
        return self._horizon_cost(model, model.K, self.layout.future_rows - 1)

    def simulation_cost(self, model: Realization) -> float:
        """Return log det of the covariance of the errors when x = J W_p is simulated on.

        The mean over four steps of the horizon, the last one among them.
        """
        last = self.layout.future_rows - 1
        steps = sorted({max(1, last * k // 4) for k in (1, 2, 3, 4)})
        none = np.zeros_like(model.K)
        return float(np.mean([self._horizon_cost(model, none, step) for step in steps]))

    def _horizon_cost(self, model: Realization, gain: Floats, step: int) -> float:
        error = self.factor.triangle @ self._error_map(model, gain, step)
        if not np.isfinite(error).all():
            return np.inf
        spread = self.factor.triangle[:, self.layout.outputs(step)]
        floor = NOISE_FREE**2 * np.diag((spread**2).sum(axis=0))
        return float(np.linalg.slogdet((error.T @ error + floor) / self.n_columns)[1])

    def _error_map(self, model: Realization, gain: Floats, step: int) -> Floats:
        """Return e(step) = y − ŷ as a combination of Hankel rows, (n_rows · c, p).

        ŷ(k) = C Ã^k J W_p + Σ_j C Ã^(k−1−j) [B̃ u(j) + K y(j)] + D u(k), Ã = A − K C.
        """
        layout = self.layout
        A, B = model.A - gain @ model.C, model.B - gain @ model.D
        errors = np.zeros((len(self.factor.triangle), layout.n_outputs))
        row = model.C
        with np.errstate(over="ignore", invalid="ignore"):
            for back in range(step):
                errors[layout.inputs(step - 1 - back)] = -(row @ B).T
                errors[layout.outputs(step - 1 - back)] = -(row @ gain).T
                row = row @ A
            errors[layout.past()] = -(row @ self.state_map[: len(A)]).T
        errors[layout.inputs(step)] = -model.D.T
        errors[layout.outputs(step)] = np.eye(layout.n_outputs)
        return errors

    # -- the two transitions

    def _split(self, order: int) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the columns u, x, x⁺, y of T for this order."""
        T, m, largest = self._regression, self.layout.n_inputs, self.largest_order
        return (
            T[:, :m],
            T[:, m : m + order],
            T[:, m + largest : m + largest + order],
            T[:, m + 2 * largest :],
        )

    def _by_regression(self, order: int) -> Realization:
        u, x, after, y = self._split(order)
        q = self.layout.n_inputs + order
        regressors = self._regression[:q, :q]
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
        upper, down = self._nested_shift
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


def projected_states(R: Floats, layout: Layout, *, whiten: bool) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from L32, the past's part of the future outputs.

    With `whiten`, L32 is divided by a root of the covariance of the outputs given the future
    inputs, so the singular values are canonical correlations (CVA); without, PO-MOESP.
    """
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    target, root = R[a:b, b:].T, None
    if whiten:
        root, inverse = left_whitener(R[a:, b:].T)
        target = inverse @ target
    U, s, Vt = kept_svd(target, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    state_map, _ = divide_by_lower(size[:, None] * Vt, R[a:b, a:b].T)
    return (U if root is None else root @ U) * size, state_map, s


def oblique_states(R: Floats, layout: Layout) -> tuple[Floats, Floats, Floats]:
    """Return Γ, J and singular values from the oblique projection L32 L22⁻¹ [L21 L22]."""
    a, b = layout.n_future_inputs, layout.n_future_inputs + layout.n_past
    along, _ = divide_by_lower(R[a:b, b:].T, R[a:b, a:b].T)
    U, s, _ = kept_svd(along @ R[:b, a:b].T, layout.largest_order)
    size = s[: U.shape[1]] ** 0.5
    return U * size, (U / size).T @ along, s


def output_unit(stream: Stream) -> float:
    """Return the geometric mean of the output scales: the unit of unweighted singular values."""
    return float(np.exp2(np.mean(np.log2(stream.output_scale))))


def kept_svd(matrix: Floats, rank: int) -> tuple[Floats, Floats, Floats]:
    """Return the leading singular triplets that stand above rounding, and all values."""
    U, s, Vt = leading_svd(matrix, rank)
    kept = int(np.count_nonzero(s[:rank] > RANK_TOLERANCE * s[0]))
    return U[:, :kept], s, Vt[:kept]


def as_fit(method: object, subspace: Subspace, found: Realization) -> Fit:
    """Return the realization in the units of the data."""
    stream = subspace.stream
    u, y = stream.input_scale, stream.output_scale
    m = stream.n_inputs
    channels = stream.records[0]
    return Fit(
        model=StateSpace(
            found.A,
            found.B / u,
            y[:, None] * found.C,
            y[:, None] * found.D / u,
            channels.dt,
        ),
        kalman_gain=found.K / y,
        innovation_covariance=found.innovation * np.outer(y, y),
        initial_states=np.full((len(stream.segments), len(found.A)), np.nan),
        segments=stream.segments,
        input_offset=stream.centre[:m],
        output_offset=stream.centre[m:],
        method=method,
        order=len(found.A),
        singular_values=subspace.singular_values,
        state_covariance=found.state_covariance,
        parameter_covariance=None,
        diagnostics=_diagnostics(subspace, found),
        gram=subspace.gram,
        input_channels=channels.input_channels,
        output_channels=channels.output_channels,
    )


def _diagnostics(subspace: Subspace, found: Realization) -> Diagnostics:
    layout, factor = subspace.layout, subspace.factor
    memory = spectral_radius(found.A - found.K @ found.C) ** layout.past_rows
    findings = []
    if factor.path == "qr":
        findings.append(
            Finding(
                "qr-path",
                "note",
                f"The Gram matrix is nearly singular (squared pivot {factor.smallest_pivot:.1g}, "
                f"limit {PIVOT_LIMIT:g}): the data were factored by QR in a second pass.",
            )
        )
    if found.gain.startswith("none"):
        findings.append(Finding("no-gain", "note", f"The Kalman gain is zero ({found.gain[6:]})."))
    figures = {
        "past_rows": layout.past_rows,
        "future_rows": layout.future_rows,
        "columns": subspace.n_columns,
        "factorization": factor.path,
        "smallest_pivot": factor.smallest_pivot,
        "transition": found.transition,
        "gain": found.gain,
        "spectral_radius": found.radius,
        "predictor_memory": memory,
        "prediction_cost": subspace.prediction_cost(found),
    }
    return Diagnostics(figures, tuple(findings))
