"""SSI: stochastic subspace identification from outputs alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from ..chunks import Stream
from ..errors import DataError, check_choice, check_names
from ..fit import Fit
from ..gram import BlockGram, factorize
from ..linalg import one_blas_thread
from ..record import Floats, Record
from .n4sid import TRANSITIONS
from .preparation import check_order, horizon, prepare
from .subspace import Layout, Subspace, assemble, covariance_states, projected_states, subspace_fit

KINDS = ("covariance", "data", "cva", "stochastic")


@dataclass(frozen=True)
class SSI:
    """Identify modes from outputs alone, under unmeasured broadband excitation.

    Covariance-driven (SSI-cov), data-driven (SSI-data), canonical variates or the stochastic
    algorithm, all with reference channels, after Van Overschee & De Moor (1996) and Peeters &
    De Roeck (1999). Exact for noise-free free decays too.

    Parameters
    ----------
    kind : "covariance", "data", "cva" or "stochastic"
        Block Hankel of output covariances; projection of future on past outputs, as it is or
        in canonical variates (strong and weak modes count alike); or the projection with a
        Kalman gain from covariances that always belong to a process (positive real), so that
        there is a gain wherever the data hold noise.
    block_rows : int, optional
        Future horizon, and past horizon unless `past_rows` says otherwise [samples];
        chosen by prediction error when left out.
    past_rows : int, optional
        Past horizon [samples].
    references : sequence of str, optional
        Names of the outputs that serve as past; all by default.
    transition : "shift", "regression" or "auto"
        A and C from shift invariance (the method's own) or from regression of the states.

    Notes
    -----
    Covariance: H[a, b] = Λ(a+b+1), Λ(l) = Σ y(t+l) y_ref(t)ᵀ, H = U S Vᵀ, Γ = U S^½ and the
    predictor's state x = S^-½ Uᵀ (Y_f / Y_p) Y_p (Han, Bohn & Bauer 2021, section 2). Data:
    the singular values of L21, the past's part of the future, as the MOESP of no inputs.
    Stochastic: algorithm 3 of Van Overschee & De Moor (1996), which is also step (1) of Han,
    Bohn & Bauer (2021): with transition="regression" A and C are its least squares on the
    states; the gain solves (22), (23) for the covariances of the residuals.

    Examples
    --------
    >>> SSI(kind="covariance", block_rows=40).kind
    'covariance'
    """

    kind: str = field(
        default="covariance", metadata={"help": "covariance, data, cva or stochastic"}
    )
    block_rows: int | None = field(
        default=None, metadata={"help": "future horizon in samples; chosen when left out"}
    )
    past_rows: int | None = field(
        default=None, metadata={"help": "past horizon in samples; as block_rows when left out"}
    )
    references: tuple[str, ...] | None = field(
        default=None, metadata={"help": "outputs that serve as past; all when left out"}
    )
    transition: str = field(
        default="shift", metadata={"help": "A from shift, regression, or the better of both (auto)"}
    )

    def __post_init__(self) -> None:
        check_choice("kind", self.kind, KINDS)
        check_choice("transition", self.transition, TRANSITIONS)
        horizon(self.block_rows, self.past_rows)
        if self.references is not None:
            object.__setattr__(self, "references", tuple(self.references))

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
            Inputs present, too few samples, constant or all-NaN channels.
        OptionError
            Unknown references.
        """
        past, future = horizon(self.block_rows, self.past_rows)
        stream, gram = prepare(data, past, future, offset, gram)
        if stream.n_inputs:
            raise DataError(
                f"SSI takes outputs alone; the record has {stream.n_inputs} inputs. Leave them out "
                "(select(inputs=[]), or --inputs '' with --outputs), or use N4SID (--method n4sid)."
            )
        outputs = self._past_channels(stream.records[0])
        layout = Layout(past, future, 0, stream.n_outputs, outputs)
        factor = factorize(gram, stream, layout.rows)
        with one_blas_thread():
            gamma, state_map, values = self._states(factor.triangle, layout, stream, gram)
        unit = stream.output_unit ** {"covariance": 2, "cva": 0}.get(self.kind, 1)
        states = gamma, state_map, values * unit
        positive_real = self.kind == "stochastic"
        return assemble(
            self, stream, gram, layout, factor, states, feedthrough, positive_real=positive_real
        )

    def _states(
        self, R: Floats, layout: Layout, stream: Stream, gram: BlockGram
    ) -> tuple[Floats, Floats, Floats]:
        if self.kind == "covariance":
            return covariance_states(R, layout, stream.output_balance, gram.covariances())
        return projected_states(R, layout, stream.output_balance, whiten=self.kind == "cva")

    def realize(self, decomposition: Subspace, order: int) -> Fit:
        """Return the model of one order; no pass over the data."""
        check_order(order, decomposition.largest_order, decomposition.limit)
        return subspace_fit(self, decomposition, decomposition.realize(order, self.transition))

    def _past_channels(self, record: Record) -> tuple[int, ...]:
        names = record.output_names
        if self.references is None:
            return tuple(range(len(names)))
        check_names("output", self.references, names)
        return tuple(names.index(name) for name in self.references)
