"""OKID: observer/Kalman filter identification, realized by ERA or ERA/DC."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from ...chunks import Stream, open_stream
from ...errors import DataError, OptionError, check_choice, check_whole
from ...fit import Diagnostics, Finding, Fit, feedthrough_mask
from ...gram import BlockGram, reduce
from ...kalman import spectral_radius
from ...linalg import one_blas_thread
from ...markov import joint_markov
from ...record import Record
from ..era import ERA, ERADC, HankelModels
from ..n4sid import COMPLETIONS
from ..preparation import check_order
from ..result import Realization, as_fit, factor_findings, gain_findings
from .causal import EXPLODED, Responses, causal_responses, growth
from .choice import (
    BEYOND,
    EXACT_MARGIN,
    akaike_order,
    check_observer_order,
    choose_observer_order,
    n_rows,
)
from .decomposition import ObserverModels, gain_rows
from .regression import Regression, regress
from .whitening import whitened_responses

REALIZATIONS: dict[str, Any] = {"era": ERA, "eradc": ERADC}
HANKELS = ("system", "combined")
SHORTEST_HANKEL = 60  # block rows and columns
ORDERS_IN_HANKEL = 3
SHORT_OBSERVER = 0.75  # of the order may be what the information criterion asks for
MOST_ROWS, MOST_COLUMNS = 3000, 1000  # elements a side: beyond them the factorization is slow
MOST_STACKED, FEWEST_ROWS = 600, 10  # elements of correlations, stacked by shifts; block rows


@dataclass(frozen=True)
class OKID:
    """Identify through an observer: short, even where the structure rings for long.

    Observer/Kalman filter identification (Juang, Phan, Horta & Longman 1993; Pappalardo et
    al. 2022, section 2.3 to 3.1): least squares of the outputs on past inputs and outputs
    gives the Markov parameters of an observer, a recursion those of the system, at any
    number of lags, and ERA or ERA/DC a model of them.

    Parameters
    ----------
    observer_order : int, optional
        Past samples in the regression; chosen long enough for damping when left out. The
        observer must have forgotten what is older; noise-free, observer_order · n_outputs
        ≥ order is enough.
    realization : ERA, ERADC, "era" or "eradc"
        With its own options; block rows and columns left out are chosen.
    hankel : "system" or "combined"
        Hankel matrix of the system Markov parameters alone, or of [Y, Y°] with those of the
        observer gain. The combined one is exact only where observer_order · n_outputs is the
        order: an observer of more past samples has more states than the system.
    whitening : int
        Iterations of extended least squares with lagged residuals, which let a short
        observer do for light damping. Needs no further pass over the data: residuals are
        combinations of past samples, so the Gram gets (whitening + 1) · observer_order + 1
        block rows instead of observer_order + 1.
    completion : "auto", "simulation", "prediction" or "regression"
        How B, D and the initial states of the chosen order are found; as for N4SID.

    Notes
    -----
    y(t) = D u(t) + Σ_{k=1}^{P} h̄_k z(t−k) over the t that have P samples before them, so any
    initial state is exact; h̄_k = [C Ā^(k−1) (B + L D), −C Ā^(k−1) L], Ā = A + L C, and the
    Kalman gain is K = −L. L solves O L = [Y°_1; Y°_2; …] with the observability matrix O.
    The Gram of [z(t−1), …, z(t−P), z(t)] is factored once: every smaller order is nested in
    it. Noise-free regressors are dependent; then the solution of minimum norm is taken.

    Where noisy data make the responses explode, because the outputs lead the inputs by a part of
    a sample, their part at negative lags is split off by a Laurent series and reported.

    Examples
    --------
    >>> OKID(observer_order=20, realization=ERADC(lag=3)).realization.lag
    3
    """

    observer_order: int | None = field(
        default=None, metadata={"help": "past samples in the regression; chosen when left out"}
    )
    realization: Any = field(default="era", metadata={"type": str, "help": "era or eradc"})
    hankel: str = field(
        default="system", metadata={"help": "system, or combined with the observer gain's"}
    )
    whitening: int = field(
        default=0, metadata={"help": "iterations of residual whitening; lets a short observer do"}
    )
    completion: str = field(
        default="auto",
        metadata={"help": "B, D, x0 by simulation, prediction, regression, or auto"},
    )

    def __post_init__(self) -> None:
        if self.observer_order is not None:
            check_whole("observer_order", self.observer_order, 1)
        if isinstance(self.realization, str):
            check_choice("realization", self.realization, tuple(REALIZATIONS))
            object.__setattr__(self, "realization", REALIZATIONS[self.realization]())
        if not isinstance(self.realization, ERA | ERADC):
            raise OptionError(
                f"realization must be ERA(…), ERADC(…), 'era' or 'eradc'; got {self.realization!r}."
            )
        for name, unset in (("responses", "auto"), ("references", None)):
            if getattr(self.realization, name) != unset:
                raise OptionError(
                    f"{name}={getattr(self.realization, name)!r} says how ERA takes a record; "
                    f"inside OKID it has the observer's responses. Leave {name} out."
                )
        check_choice("hankel", self.hankel, HANKELS)
        check_whole("whitening", self.whitening, 0)
        check_choice("completion", self.completion, COMPLETIONS)

    def decompose(
        self,
        data: Record | Sequence[Record] | Stream,
        *,
        offset: str = "estimate",
        feedthrough: bool | Sequence[bool] | None = None,
        gram: BlockGram | None = None,
    ) -> ObserverModels:
        """Reduce and factor the data, choose what was left open, realize all orders.

        A stream brings its own `offset` rule; `gram` is a Gram of at least as many block rows
        from the same stream, which saves the reduction.

        Raises
        ------
        DataError
            No inputs, too few samples, constant or all-NaN channels; responses that explode.
        """
        stream = data if isinstance(data, Stream) else open_stream(data, offset)
        if stream.n_inputs == 0:
            raise DataError(
                "OKID needs inputs; the record has none. Name them (select(), or --inputs), or "
                "use SSI (--method ssi), or ERA for free decays (--method era)."
            )
        mask = feedthrough_mask(feedthrough, stream.records[0].output_channels)
        method, reasons = self._with_observer_order(stream, mask)
        assert method.observer_order is not None
        rows = n_rows(method.observer_order, method.whitening)
        gram = reduce(stream, rows) if gram is None else gram.shorten(rows)
        with one_blas_thread():
            return method._realized(stream, gram, regress(stream, gram, rows - 1, mask), reasons)

    def _with_observer_order(self, stream: Stream, mask: Any) -> tuple[OKID, tuple[str, ...]]:
        if self.observer_order is not None:
            check_observer_order(stream, self.observer_order, self.whitening)
            return self, ()
        check_observer_order(stream, 1, self.whitening)
        order, why = choose_observer_order(
            stream, mask, self.whitening, 0 if self.hankel == "combined" else EXACT_MARGIN
        )
        return replace(self, observer_order=order), (f"observer_order={order}: {why}",)

    def _realized(
        self, stream: Stream, gram: BlockGram, data: Regression, reasons: tuple[str, ...]
    ) -> ObserverModels:
        """Return the models of all orders from the regression."""
        assert self.observer_order is not None
        m, p = data.n_inputs, data.n_outputs
        sizes = hankel_sizes(self, p, m if self.hankel == "system" else m + p)
        n_lags = self.realization.highest_lag(*sizes) + 1
        responses = self._responses(data, n_lags)
        joint = responses.joint
        markov = joint[:, :, :m] if self.hankel == "system" else joint
        sized = replace(self.realization, rows=sizes[0], columns=sizes[1])
        kernel = sized.factor(markov)
        findings = list(responses.findings)
        if not reasons:
            findings += _short_observer(self, data)
        if self.hankel == "combined" and data.is_exact(self.observer_order):
            findings += _observer_states(kernel, sized.factor(joint[:, :, :m]))
        return ObserverModels(
            method=replace(self, realization=sized),
            stream=stream,
            gram=gram,
            regression=data,
            direct=joint[0, :, :m] * data.feedthrough[:, None],
            gains=gain_rows(joint, sizes[0], m),
            kernel=kernel,
            reasons=reasons,
            remarks=tuple(findings),
        )

    def _responses(self, data: Regression, n_lags: int) -> Responses:
        """Return [Y_k, Y°_k] of so many lags from the observer's Markov parameters."""
        assert self.observer_order is not None
        if self.whitening and not data.is_exact(self.observer_order):
            return whitened_responses(data, self.observer_order, self.whitening, n_lags)
        observer = data.observer(self.observer_order)
        if data.is_exact(self.observer_order):
            return Responses(joint_markov(observer, n_lags))
        found = causal_responses(observer, n_lags)
        if found is None:
            raise DataError(
                f"With observer_order={self.observer_order} the responses grow "
                f"{growth(joint_markov(observer, n_lags)):.1g}-fold over {n_lags} samples (limit "
                f"{EXPLODED:g}): these inputs do not drive these outputs as a stable structure "
                "would be driven. Use N4SID (--method n4sid), fewer channels, or another "
                "observer_order."
            )
        return found

    def realize(self, decomposition: ObserverModels, order: int) -> Fit:
        """Return the model of one order; no pass over the data."""
        check_order(order, decomposition.largest_order, decomposition.limit)
        found = decomposition.realize(order)
        return as_fit(
            decomposition.method,
            decomposition.stream,
            found,
            singular_values=decomposition.singular_values,
            feedthrough=decomposition.feedthrough,
            diagnostics=_diagnostics(decomposition, found),
            gram=decomposition.gram,
        )


def hankel_sizes(method: OKID, p: int, m: int) -> tuple[int, int]:
    """Return block rows and columns of the Hankel matrix, those left out chosen.

    Three times the observer order: shorter ones lose damping ratios of a few per mille to the
    noise, longer ones gain nothing. Of correlations, which already average over the columns and
    reach further by their shifts, 20 rows of 3 outputs give the damping of 75.
    """
    assert method.observer_order is not None
    enough = max(SHORTEST_HANKEL, ORDERS_IN_HANKEL * method.observer_order)
    stacked = method.realization.stacked
    most = max(FEWEST_ROWS, MOST_STACKED // (p * stacked)) if stacked else MOST_ROWS // p
    rows = method.realization.rows or max(2, min(enough, most))
    columns = method.realization.columns or max(2, min(enough, MOST_COLUMNS // m))
    return rows, columns


def _diagnostics(models: ObserverModels, found: Realization) -> Diagnostics:
    method, factor = models.method, models.regression.factor
    closed = found.A - found.K @ found.C
    memory = spectral_radius(closed) ** models.regression.largest_order
    figures = {
        "observer_order": method.observer_order,
        "hankel_rows": method.realization.rows,
        "hankel_columns": method.realization.columns,
        "columns": models.n_columns,
        "factorization": factor.path,
        "smallest_pivot": factor.smallest_pivot,
        "transition": found.transition,
        "gain": found.gain,
        "spectral_radius": found.radius,
        "predictor_memory": memory,
        "prediction_cost": models.prediction_cost(found),
    }
    findings = [
        *factor_findings(factor),
        *gain_findings(found),
        *_combined_findings(models, len(found.A)),
    ]
    return Diagnostics(figures, tuple(findings))


def _short_observer(method: OKID, data: Regression) -> tuple[Finding, ...]:
    """Say when Akaike's criterion asks for (nearly) all past samples of the order asked for."""
    wanted = akaike_order(data)
    if method.whitening or data.is_exact(data.largest_order):
        return ()
    if wanted <= SHORT_OBSERVER * data.largest_order:
        return ()
    return (
        Finding(
            "short-observer",
            "doubt",
            f"The information criterion (AIC) asks for {wanted} past samples out of "
            f"observer_order={data.largest_order}; where noise is white, damping comes out too "
            f"high with fewer than {BEYOND} times as many.",
            f"Try observer_order={BEYOND * wanted}, whitening=5, or leave it out.",
        ),
    )


def _observer_states(combined: HankelModels, system: HankelModels) -> tuple[Finding, ...]:
    """Say when a combined Hankel matrix of noise-free data has more states than the system."""
    if not system.rank_limited or system.largest_order >= combined.largest_order:
        return ()
    return (
        Finding(
            "combined-hankel",
            "doubt",
            f"The combined Hankel matrix has {combined.largest_order} states; the inputs reach "
            f"{system.largest_order}. The rest belongs to the observer, whose past samples times "
            "outputs are more than the order.",
            'Use hankel="system" (--hankel system).',
        ),
    )


def _combined_findings(models: ObserverModels, order: int) -> list[Finding]:
    method = models.method
    states = method.observer_order * models.stream.n_outputs
    if method.hankel != "combined" or states == order:
        return []
    return [
        Finding(
            "combined-hankel",
            "doubt",
            f"The combined Hankel matrix is exact only where observer_order times outputs is the "
            f"order; here {method.observer_order} × {models.stream.n_outputs} = {states} and the "
            f"order is {order}.",
            'Use hankel="system" (--hankel system).',
        )
    ]
