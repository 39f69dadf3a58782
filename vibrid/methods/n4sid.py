"""N4SID family: subspace identification of systems with measured inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ..chunks import Stream
from ..errors import DataError, check_choice
from ..fit import Fit
from ..gram import BlockGram, factorize
from ..linalg import one_blas_thread
from ..record import Floats, Record
from .preparation import check_order, horizon, prepare
from .subspace import (
    Layout,
    Subspace,
    assemble,
    oblique_states,
    projected_states,
    subspace_fit,
    whitened_by_regression,
)

WEIGHTINGS = ("cva", "moesp", "n4sid", "ssarx", "auto")
COMPARED = ("cva", "moesp")  # what an automatic choice tries
TRANSITIONS = ("auto", "regression", "shift")
COMPLETIONS = ("auto", "simulation", "prediction", "regression")


@dataclass(frozen=True)
class N4SID:
    """Identify a state-space model from inputs and outputs by subspace projection.

    The common frame of Van Overschee & De Moor (1996): the future outputs are projected on
    the past along the future inputs, a weighted singular value decomposition gives the
    states, and everything comes from the triangular factor of one Gram matrix.

    Parameters
    ----------
    weighting : "auto", "cva", "moesp", "n4sid" or "ssarx"
        Canonical variates (Larimore 1990), PO-MOESP (Verhaegen 1994), none, or a regression
        on the past first (SSARX, Jansson 2003), which feedback does not bias. "auto" is
        "cva", except where `identify` chooses the horizon: there the better simulation of
        "cva" and "moesp".
    block_rows : int, optional
        Future horizon, and past horizon unless `past_rows` says otherwise [samples]. Left
        out, `identify` tries 10, 20, 40 and 80, as far as the record allows: those that
        simulate within 2 % of the best error, and of these the shortest whose prediction
        error is within 2 % of the best.
    past_rows : int, optional
        Past horizon [samples].
    transition : "auto", "regression" or "shift"
        A and C from regression of the states or from shift invariance of the observability
        matrix; "auto" takes the one that predicts better over the horizon.
    completion : "auto", "simulation", "prediction" or "regression"
        How B, D and the initial states of the chosen order are found: least squares on the
        simulation (best without process noise), on the prediction, or none beyond the
        state regression.

    Notes
    -----
    With the LQ blocks of [U_f; W_p; Y_f] (Pappalardo et al. 2022, eq. 66-83;
    their W₂ = Π is singular, so the states come from Γ and never from its inverse):
    MOESP X = L32; N4SID X = L32 L22⁻¹ [L21 L22]; CVA X = T⁻¹ L32 with
    T Tᵀ = L32 L32ᵀ + L33 L33ᵀ. Then X = U S Vᵀ, Γ = T U S^½ and x(t) = J W_p(t). SSARX takes
    the future samples' own part off Y_f by a regression of order `past_rows` instead of
    projecting U_f out; without noise, where that regression is not unique, it is CVA.
    Shift invariance is biased in closed loop, regression where the horizon is short.

    Examples
    --------
    >>> N4SID(weighting="moesp", block_rows=15).block_rows
    15
    """

    weighting: str = field(default="auto", metadata={"help": "auto, cva, moesp, n4sid or ssarx"})
    block_rows: int | None = field(
        default=None, metadata={"help": "future horizon in samples; chosen when left out"}
    )
    past_rows: int | None = field(
        default=None, metadata={"help": "past horizon in samples; as block_rows when left out"}
    )
    transition: str = field(
        default="auto", metadata={"help": "A from regression, shift, or the better of both (auto)"}
    )
    completion: str = field(
        default="auto",
        metadata={"help": "B, D, x0 by simulation, prediction, regression, or auto"},
    )

    def __post_init__(self) -> None:
        check_choice("weighting", self.weighting, WEIGHTINGS)
        check_choice("transition", self.transition, TRANSITIONS)
        check_choice("completion", self.completion, COMPLETIONS)
        horizon(self.block_rows, self.past_rows)

    @one_blas_thread()
    def decompose(
        self,
        data: Record | Sequence[Record] | Stream,
        *,
        offset: str = "estimate",
        feedthrough: bool | Sequence[bool] | None = None,
        gram: BlockGram | None = None,
    ) -> Subspace:
        """Reduce and factor the data once, for models of every order.

        A stream brings its own `offset` rule; `gram` is a Gram of at least as many block rows
        from the same stream, which saves the reduction.

        Raises
        ------
        DataError
            No inputs, too few samples, constant or all-NaN channels.
        """
        if self.weighting == "auto":
            option = replace(self, weighting=COMPARED[0])
            return option.decompose(data, offset=offset, feedthrough=feedthrough, gram=gram)
        past, future = horizon(self.block_rows, self.past_rows)
        stream, gram = prepare(data, past, future, offset, gram)
        m, p = stream.n_inputs, stream.n_outputs
        if m == 0:
            raise DataError(
                "N4SID needs inputs; the record has none. Name them (select(), or --inputs), or "
                "use SSI (--method ssi)."
            )
        layout = Layout(past, future, m, p, tuple(range(m + p)))
        factor = factorize(gram, stream, layout.rows)
        states = self._states(factor.triangle, layout, stream)
        return assemble(self, stream, gram, layout, factor, states, feedthrough)

    def _states(self, R: Floats, layout: Layout, stream: Stream) -> tuple[Floats, Floats, Floats]:
        """Return Γ, J and singular values.

        Canonical correlations of "cva" and "ssarx", else in the geometric mean of the outputs'
        units.
        """
        found = whitened_by_regression(R, layout) if self.weighting == "ssarx" else None
        if found is not None:
            return found
        balance, whiten = stream.output_balance, self.weighting in ("cva", "ssarx")
        if self.weighting == "n4sid":
            gamma, state_map, values = oblique_states(R, layout, balance)
        else:
            gamma, state_map, values = projected_states(R, layout, balance, whiten=whiten)
        return gamma, state_map, values if whiten else values * stream.output_unit

    @one_blas_thread()
    def realize(self, decomposition: Subspace, order: int) -> Fit:
        """Return the model of one order; no pass over the data."""
        check_order(order, decomposition.largest_order, decomposition.limit)
        used = replace(self, weighting=decomposition.method.weighting)
        return subspace_fit(used, decomposition, decomposition.realize(order, self.transition))

    @one_blas_thread()
    def alternatives(self, decomposition: Subspace) -> list[Subspace]:
        """Return the decompositions that an automatic choice compares, all of one factor.

        `decomposition` is this method's own, and the first of them.
        """
        if self.weighting != "auto":
            return [decomposition]
        options = [replace(self, weighting=name) for name in COMPARED[1:]]
        return [decomposition, *(self._weighted(decomposition, option) for option in options)]

    @staticmethod
    def _weighted(known: Subspace, option: N4SID) -> Subspace:
        found = option._states(known.factor.triangle, known.layout, known.stream)
        gamma, state_map, values = found
        return replace(
            known, method=option, gamma=gamma, state_map=state_map, singular_values=values
        )
