"""ERA of output correlations under ambient excitation (NExT)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...chunks import Stream
from ...errors import OptionError, check_names
from ...fit import Diagnostics, Finding, Fit, feedthrough_mask
from ...gram import BlockGram, reduce
from ...kalman import STABLE_TO, innovation_form
from ...linalg import one_blas_thread
from ...record import Floats, Record
from ...statespace import StateSpace
from ..preparation import check_length
from ..result import Realization, as_fit, gain_findings
from .evidence import Evidence, information
from .responses import Mask

TALL = 600  # elements of a block column
MOST_ROWS = 40  # damping of modes from 1/30 to a third of Nyquist gains nothing from more
FEWEST_ROWS = 10
SHARE = 10  # samples a lag: correlations of longer lags are mostly noise


@dataclass(frozen=True, eq=False)
class CorrelationModels(Evidence):
    """Models of output correlations Λ(l) = C A^(l−1) G, l ≥ 1.

    Attributes
    ----------
    covariances : array (n_lags, p, p)
        Λ(l) = E y(t+l) y(t)ᵀ, scaled.
    references : array of int
    """

    stream: Stream
    gram: BlockGram
    covariances: Floats
    references: NDArray[np.int64]

    @property
    def n_columns(self) -> int:
        return self.gram.projected_columns

    def factors(self, order: int) -> tuple[Floats, Floats | None]:
        """Return observability (rows · p, n) and controllability (n, columns, references)."""
        reach = self.kernel.controllability(order)
        return self.kernel.observability(order), reach.reshape(order, -1, len(self.references))

    @property
    def criterion_decides(self) -> bool:
        """Excitation may be coloured: then the criterion falls for ever."""
        return False

    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the Bayesian information criterion of this order, and whether it is stable.

        One-step prediction cost plus ln(columns) a parameter; n states have 2 n p of them.
        """
        model = self.realize(order)
        if model.radius > STABLE_TO or not np.isfinite(model.innovation).all():
            return np.inf, model.radius <= STABLE_TO
        spread = float(np.linalg.slogdet(model.innovation)[1])
        return information(spread, self.n_columns, 2 * order * self.stream.n_outputs), True

    @cached_property
    def _joint(self) -> Floats:
        """Covariance of [y(t); y(t−1); …] over all lags known."""
        L, p, _ = self.covariances.shape
        lags = np.concatenate([self.covariances[:0:-1].transpose(0, 2, 1), self.covariances])
        step = np.arange(L)
        blocks = lags[L - 1 + step[None, :] - step[:, None]]  # E y(t−j) y(t−k)ᵀ = Λ(k−j)
        return np.asarray(blocks.transpose(0, 2, 1, 3).reshape(L * p, L * p))

    def _prediction_error(self, A: Floats, C: Floats, K: Floats) -> Floats:
        """Return the covariance of y(t) less its prediction from all lags known."""
        p, lags = len(C), len(self.covariances)
        predictor = StateSpace(A - K @ C, K, C, np.zeros((p, p)), 1.0)
        weights = np.hstack(list(-predictor.markov_parameters(lags)))
        weights[:, :p] = np.eye(p)
        return np.asarray(weights @ self._joint @ weights.T)

    def realize(self, order: int) -> Realization:
        """Return the model of this order in the stream's scaled units."""
        return self._with_raise(order)[0]

    def _with_raise(self, order: int) -> tuple[Realization, float]:
        """Return the model, and the white noise that its gain needed."""
        if order not in self._made:
            with one_blas_thread():
                self._made[order] = self._realized(order)
        return self._made[order]

    @cached_property
    def _made(self) -> dict[int, tuple[Realization, float]]:
        # scanning orders and then realizing one asks for the same models again
        return {}

    def _realized(self, order: int) -> tuple[Realization, float]:
        A, G, C = self.kernel.triplet(order)
        p = self.stream.n_outputs
        if len(self.references) < p:
            # all outputs' covariances with the next state: Λ(1), Λ(2), … = O G
            stacked = self.covariances[1 : self.method.rows + 1].reshape(-1, p)
            G = sla.lstsq(self.kernel.observability(order), stacked, cond=1e-12)[0]
        found = innovation_form(A, C, G, self.covariances[0])
        none = np.zeros((order, p)), None, np.eye(order), 0.0
        K, _, states, raised = found or none
        # of the data, not what the realized covariances promise
        innovation = self._prediction_error(A, C, K)
        gain = "Riccati" if found else "none: the model is unstable or hardly stable"
        model = Realization(
            A,
            np.zeros((order, 0)),
            C,
            np.zeros((p, 0)),
            type(self.method).__name__,
            K,
            innovation,
            states,
            gain,
        )
        return model, raised

    def fit(self, order: int, method: Any) -> Fit:
        """Return the model of one order with its Kalman gain."""
        found, raised = self._with_raise(order)
        figures = {
            **self.figures(order, found.A),
            "responses": "correlations",
            "gain": found.gain,
            "white_noise_added": raised,
        }
        findings = [*self.remarks, *gain_findings(found), *_raised_findings(raised)]
        return as_fit(
            method,
            self.stream,
            found,
            singular_values=self.singular_values,
            feedthrough=self.feedthrough,
            diagnostics=Diagnostics(figures, tuple(findings)),
            gram=self.gram,
        )


def _raised_findings(raised: float) -> list[Finding]:
    if not raised:
        return []
    return [
        Finding(
            "not-positive-real",
            "note",
            f"The realized correlations are those of no process; {100 * raised:.2g} % of the "
            "outputs' variance was added as white noise to find a Kalman gain.",
            "Poles and shapes do not depend on it; a longer record or another order needs less.",
        )
    ]


def from_correlations(
    method: Any, stream: Stream, feedthrough: Mask, gram: BlockGram | None, reason: str
) -> CorrelationModels:
    """Factor the block Hankel matrix of output covariances, from lag 1 on."""
    references = _references(method, stream.records[0])
    rows = method.rows or _chosen_rows(stream, method)
    columns = method.columns or rows
    highest = method.highest_lag(rows, columns)
    _check_length(stream, method, rows, columns)
    gram = reduce(stream, highest + 1) if gram is None else gram.shorten(highest + 1)
    # the transpose of a lagged sum is Λ(l) = E y(t+l) y(t)ᵀ
    covariances = gram.covariances().transpose(0, 2, 1) / gram.projected_columns
    balance = stream.output_balance
    option = replace(method, rows=rows, columns=columns, responses="correlations")
    chosen = (
        ()
        if method.rows and method.columns
        else (f"rows={rows} and columns={columns} use correlations up to lag {highest}",)
    )
    return CorrelationModels(
        method=option,
        kernel=option.factor(covariances[:, :, references], weights=(balance, balance[references])),
        feedthrough=feedthrough_mask(feedthrough, stream.records[0].output_channels),
        stream=stream,
        gram=gram,
        reasons=(reason, *chosen),
        remarks=(),
        covariances=covariances,
        references=references,
    )


def _check_length(stream: Stream, method: Any, rows: int, columns: int) -> None:
    """Refuse more lags than the samples bear, in words of the Hankel matrix."""
    p, extra = stream.n_outputs, method.reach
    longest = max(segment.length for segment in stream.segments)
    most = (longest + 1) // (p + 1) - 1 - extra
    shifts = f" with {extra} lags of shifts" if extra else ""
    cure = f"Use rows and columns of at most {most} together, or a longer record."
    if most < 2:
        least = (3 + extra) * (p + 1) - 1
        cure = f"Record at least {least} samples in one piece; better more."
    check_length(
        stream,
        method.highest_lag(rows, columns) + 1,
        f"rows={rows} and columns={columns}{shifts}",
        cure,
    )


def _references(method: Any, record: Record) -> NDArray[np.int64]:
    names = record.output_names
    if method.references is None:
        return np.arange(len(names))
    check_names("output", method.references, names)
    if not method.references or len(set(method.references)) < len(method.references):
        listed = ", ".join(method.references)
        raise OptionError(f"Name each reference once, at least one; got {listed!r}.")
    return np.array([names.index(name) for name in method.references])


def _chosen_rows(stream: Stream, method: Any) -> int:
    """Return block rows: long enough for damping, within the samples there are."""
    p = stream.n_outputs
    longest = max(segment.length for segment in stream.segments)
    wanted = min(MOST_ROWS, max(FEWEST_ROWS, TALL // (p * max(1, method.stacked))))
    lags = min(longest // (p + 1), max(longest // SHARE, 2 * FEWEST_ROWS)) - method.reach
    return int(max(2, min(wanted, (lags - 1) // 2)))
