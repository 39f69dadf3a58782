"""ERA of measured responses: impulse, frequency, and finite impulse responses of a record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from ...chunks import Stream
from ...fit import Diagnostics, Finding, Fit, feedthrough_mask
from ...gram import BlockGram
from ...kalman import STABLE_TO, spectral_radius
from ...record import Floats, FrequencyResponses, ImpulseResponses
from ...statespace import StateSpace
from ..result import Realization, as_fit, gain_findings
from .evidence import NO_GAIN, NOISE_FREE, Evidence, information
from .hankel import balancing_weights
from .sizes import lasting_lags

Mask = bool | Sequence[bool] | None
TRUSTED_SHARE = 0.5  # of a period of inverted frequency responses: the rest holds negative times


@dataclass(frozen=True, eq=False)
class ResponseModels(Evidence):
    """Models of pulse responses.

    Attributes
    ----------
    responses : ImpulseResponses
    period : int or None
        Of responses that came from frequency responses: samples they are wrapped around.
    known : dict
        Figures of how the responses were made.
    """

    responses: ImpulseResponses
    period: int | None
    known: dict[str, Any]

    @property
    def rank_limited(self) -> bool:
        """Whether singular values beyond the largest order are nothing but rounding.

        The ringing of a cut band fades into rounding too: its poles are no system's, and some
        of them are unstable.
        """
        if self.period is None or not self.kernel.is_cut:
            return self.kernel.rank_limited
        return spectral_radius(self._model(self.largest_order).A) <= STABLE_TO

    @property
    def criterion_decides(self) -> bool:
        """Whether errors are white: where nothing but ringing is left they are not."""
        return self.period is None or not self.kernel.is_cut

    @property
    def n_columns(self) -> int:
        """Response samples of each output, lag 0 left out."""
        return (len(self.responses.values) - 1) * self.kernel.n_inputs

    def factors(self, order: int) -> tuple[Floats, Floats | None]:
        """Return observability (rows · p, n) and controllability (n, columns · m) matrices."""
        return self.kernel.observability(order), self.kernel.controllability(order)

    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the Bayesian information criterion of this order, and whether it is stable.

        Of the error of every response at every lag, white within an output; n (p + m)
        parameters.
        """
        model = self._model(order)
        radius = spectral_radius(model.A)
        errors = self._errors(order)
        if not np.isfinite(errors).all():
            return np.inf, False
        spread = float(np.log(errors + NOISE_FREE**2).sum())
        parameters = order * (self.kernel.n_outputs + self.kernel.n_inputs)
        return information(spread, self.n_columns, parameters), radius <= STABLE_TO

    def _model(self, order: int) -> StateSpace:
        if order not in self._made:
            A, B, C = self.kernel.triplet(order)
            D = self.responses.values[0] * self.feedthrough[:, None]
            self._made[order] = StateSpace(A, B, C, D, self.responses.dt)
        return self._made[order]

    @cached_property
    def _made(self) -> dict[int, StateSpace]:
        # scanning orders and then realizing one asks for the same models again
        return {}

    def _errors(self, order: int) -> Floats:
        """Return measured less modelled over measured responses, squared, output by output."""
        unit = _units(self.responses.values[1:])[:, None]
        with np.errstate(over="ignore", invalid="ignore"):  # of an unstable model
            modelled = self._model(order).markov_parameters(len(self.responses.values))
            left = np.square((self.responses.values - modelled)[1:] / unit).sum(axis=(0, 2))
        sizes = np.square(self.responses.values[1:] / unit).sum(axis=(0, 2))
        return np.asarray(left / np.where(sizes > 0, sizes, 1))

    def fit(self, order: int, method: Any) -> Fit:
        """Return the model of one order with its figures."""
        model = self._model(order)
        # balanced outputs weigh alike, silent ones nothing
        silent = ~self.responses.values[1:].any(axis=(0, 2))
        figures = {
            **self.figures(order, model.A),
            **self.known,
            "reconstruction_error": float(np.sqrt(self._errors(order)[~silent].mean())),
        }
        if self.stream is not None:
            return self._record_fit(model, method, figures)
        if self.period is not None:
            model, figures["wrap_undone"] = _unwrapped(model, self.period)
        return self._response_fit(model, method, figures)

    def _response_fit(self, model: StateSpace, method: Any, figures: dict[str, Any]) -> Fit:
        n, p = model.order, model.n_outputs
        finding = Finding("no-gain", "note", "The Kalman gain is zero (responses hold no noise).")
        return Fit(
            model=model,
            kalman_gain=np.zeros((n, p)),
            innovation_covariance=np.zeros((0, 0)),
            initial_states=np.zeros((0, n)),
            segments=(),
            input_offset=np.zeros(model.n_inputs),
            output_offset=np.zeros(p),
            feedthrough=self.feedthrough,
            method=method,
            order=n,
            singular_values=self.singular_values,
            state_covariance=np.zeros((0, 0)),
            parameter_covariance=None,
            diagnostics=Diagnostics(figures, (*self.remarks, finding)),
            gram=None,
            input_channels=self.responses.input_channels,
            output_channels=self.responses.output_channels,
        )

    def _record_fit(self, model: StateSpace, method: Any, figures: dict[str, Any]) -> Fit:
        """Return the model of a record; its errors and states are left to completion."""
        assert self.stream is not None
        u, y = self.stream.input_scale, self.stream.output_scale
        n, p = model.order, model.n_outputs
        found = Realization(
            model.A,
            model.B * u,
            model.C / y[:, None],
            model.D * u / y[:, None],
            "FIR",
            np.zeros((n, p)),
            np.diag((self.stream.output_deviation / y) ** 2),
            _white_state_covariance(self.kernel.controllability(n), u),
            NO_GAIN.format("responses"),
        )
        return as_fit(
            method,
            self.stream,
            found,
            singular_values=self.singular_values,
            feedthrough=self.feedthrough,
            diagnostics=Diagnostics(figures, (*self.remarks, *gain_findings(found))),
            gram=self.gram,
        )


def _units(values: Floats) -> Floats:
    """Return the largest magnitude of each output, 1 of a silent one: squares stay in range."""
    largest = np.abs(values).max(axis=(0, 2))
    return np.asarray(np.where(largest > 0, largest, 1.0))


def _white_state_covariance(reach: Floats, input_scale: Floats) -> Floats:
    """Return the covariance of states that white inputs of the scale's size drive."""
    scaled = reach * np.resize(input_scale, reach.shape[1])
    return scaled @ scaled.T


def _unwrapped(model: StateSpace, period: int) -> tuple[StateSpace, bool]:
    """Return the model without circular wrap; as it is where a pole does not decay."""
    from ...spectra.inversion import undo_wrap

    if np.abs(model.poles).max() > 1:
        return model, False
    return undo_wrap(model, period), True


def from_impulse_responses(
    method: Any,
    responses: ImpulseResponses,
    feedthrough: Mask,
    *,
    highest: int | None = None,
    stream: Stream | None = None,
    gram: BlockGram | None = None,
    period: int | None = None,
    reasons: tuple[str, ...] = (),
    findings: tuple[Finding, ...] = (),
    known: dict[str, Any] | None = None,
) -> ResponseModels:
    """Factor the Hankel matrix of responses; up to lag `highest` where sizes are left out."""
    n_lags, p, m = responses.values.shape
    if method.rows is not None and method.columns is not None:
        rows, columns = method.sizes(n_lags - 1, p, m)
    else:
        within = responses.values[: None if highest is None else highest + 1]
        lasting = lasting_lags(_energy(within))
        needed = method.highest_lag(method.rows or 1, method.columns or 1)
        usable = min(n_lags - 1, max(lasting + method.reach, needed))
        rows, columns = method.sizes(usable, p, m)
        reasons = (*reasons, _size_reason(method, rows, columns, lasting))
    used = replace(method, rows=rows, columns=columns)
    return ResponseModels(
        method=used,
        kernel=used.factor(responses.values),
        feedthrough=feedthrough_mask(feedthrough, responses.output_channels),
        stream=stream,
        gram=gram,
        reasons=reasons,
        remarks=findings,
        responses=responses,
        period=period,
        known=known or {},
    )


def _energy(values: Floats) -> Floats:
    """Return the energy of balanced responses at each lag."""
    outputs, inputs = balancing_weights(values[1:])
    return np.asarray(np.square(values * outputs[:, None] * inputs).sum(axis=(1, 2)))


def _size_reason(method: Any, rows: int, columns: int, lasting: int) -> str:
    chosen = [
        f"{name}={value}"
        for name, value in (("rows", rows), ("columns", columns))
        if getattr(method, name) is None
    ]
    return (
        f"{' and '.join(chosen)} reach to lag {method.highest_lag(rows, columns)}; the first "
        f"{lasting} lags hold what stands out of the noise"
    )


def from_frequency_responses(
    method: Any, responses: FrequencyResponses, feedthrough: Mask
) -> ResponseModels:
    """Invert frequency responses and factor the Hankel matrix of the result."""
    from ...spectra.inversion import invert

    inversion = invert(responses)
    period = len(inversion.responses.values)
    return from_impulse_responses(
        method,
        inversion.responses,
        feedthrough,
        highest=max(2, int(TRUSTED_SHARE * period)),
        period=period,
        findings=tuple(Finding(*remark) for remark in inversion.findings),
        known=dict(inversion.figures),
    )
