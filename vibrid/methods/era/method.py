"""ERA and ERA/DC: realization of pulse responses, free decays and correlations."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...errors import OptionError, check_choice, check_whole
from ...fit import Fit
from ...gram import BlockGram
from ...linalg import one_blas_thread
from ...record import Floats
from ..preparation import check_order
from .data import RESPONSES, Data, decomposed
from .evidence import Evidence
from .hankel import balancing_weights, block_rows, hankel_pair, squared_norm
from .models import USUAL_ORDERS, HankelModels
from .responses import Mask
from .sizes import chosen_sizes
from .triplets import leading_triplets

Weights = tuple[Floats, Floats]

ROWS = "block rows of the Hankel matrix; chosen when left out"
COLUMNS = "block columns of the Hankel matrix; chosen when left out"
KINDS = "what a record is taken for: decay, correlations, fir (with inputs) or auto"
REFERENCES = "outputs that correlations refer to; all when left out"


class _Realization:
    """What ERA and ERA/DC do alike; `reach` counts the lags beyond rows and columns."""

    rows: int | None
    columns: int | None
    responses: str
    references: tuple[str, ...] | None

    def __post_init__(self) -> None:
        for name in ("rows", "columns"):
            if getattr(self, name) is not None:
                check_whole(name, getattr(self, name), 1)
        check_choice("responses", self.responses, RESPONSES)
        if isinstance(self.references, str):
            object.__setattr__(self, "references", (self.references,))
        elif self.references is not None:
            object.__setattr__(self, "references", tuple(self.references))
        if self.references is not None and self.responses not in ("auto", "correlations"):
            raise OptionError(
                f"references={self.references} belong to correlations; with responses="
                f'"{self.responses}" there are none. Leave them out, or use '
                'responses="correlations".'
            )

    @property
    def reach(self) -> int:
        return 0

    @property
    def stacked(self) -> int:
        """How many correlations stand on each other; 0 without any."""
        return 0

    def highest_lag(self, rows: int, columns: int) -> int:
        """Return the highest lag of the Markov parameters that this size uses."""
        return rows + columns + self.reach

    def sizes(self, highest: int, n_outputs: int, n_inputs: int) -> tuple[int, int]:
        """Return block rows and columns for responses that reach to lag `highest`."""
        return self._sized(self.rows, self.columns, highest, n_outputs, n_inputs)

    def _sized(
        self, rows: int | None, columns: int | None, highest: int, p: int, m: int
    ) -> tuple[int, int]:
        return chosen_sizes(rows, columns, highest, p, m, self.reach, self.stacked)

    def factor(
        self,
        markov: Floats,
        rows: int | None = None,
        columns: int | None = None,
        weights: Weights | None = None,
    ) -> HankelModels:
        """Factor the Hankel matrix of Markov parameters, for models of every order.

        Parameters
        ----------
        markov : array (n_lags, n_outputs, n_inputs)
            `markov[0]` = D, which takes no part, `markov[k]` = C A^(k−1) B.
        rows, columns : int, optional
            The method's own by default, or chosen from the number of lags.
        weights : (array (n_outputs,), array (n_inputs,)), optional
            What outputs and inputs are multiplied by; by default so that units do not matter.

        Returns
        -------
        HankelModels
            In the units of `markov`.

        Raises
        ------
        DataError
            Fewer lags than `highest_lag(rows, columns)`, or responses that are zero.
        """
        if markov.ndim != 3:
            raise OptionError(
                "Markov parameters must be (n_lags, n_outputs, n_inputs); got shape "
                f"{markov.shape}."
            )
        n_lags, p, m = markov.shape
        rows, columns = self._sized(rows or self.rows, columns or self.columns, n_lags - 1, p, m)
        outputs, inputs = balancing_weights(markov[1:]) if weights is None else weights
        balanced = markov * outputs[:, None] * inputs
        blocks = block_rows(balanced, rows + self.reach + 1, columns)
        return self.factor_rows(blocks, (outputs, inputs))

    def factor_rows(self, blocks: Floats, weights: Weights) -> HankelModels:
        """Factor balanced block rows (rows + reach + 1, n_outputs, width), however made."""
        raise NotImplementedError

    def decompose(
        self,
        data: Data,
        *,
        offset: str = "estimate",
        feedthrough: Mask = None,
        gram: BlockGram | None = None,
    ) -> Evidence:
        """Factor the Hankel matrix of the responses once, for models of every order.

        Parameters
        ----------
        data : ImpulseResponses, FrequencyResponses, Record, sequence of Record, or Stream
        offset : "estimate", "mean" or "none"
            Of records; a stream brings its own.
        feedthrough : bool or one for each output, optional
            Whether D is estimated; None: not for displacements and velocities.
        gram : BlockGram, optional
            Of at least as many block rows from the same stream, which saves the reduction.

        Raises
        ------
        DataError
            Too few lags or samples, no response at all, constant or all-NaN channels.
        OptionError
            Unknown references, or a kind of responses that the data cannot be.
        """
        return decomposed(self, data, offset, feedthrough, gram)

    def realize(self, decomposition: Evidence, order: int) -> Fit:
        """Return the model of one order; no pass over the data."""
        check_order(order, decomposition.largest_order, decomposition.limit)
        return decomposition.fit(order, self)


@dataclass(frozen=True)
class ERA(_Realization):
    """Realize a model from pulse responses: the eigensystem realization algorithm.

    A and C from the singular value decomposition of the block Hankel matrix of the responses,
    B from its first columns (Juang & Pappa 1985). The responses may be measured
    (ImpulseResponses, FrequencyResponses), the samples of free decays, or estimated from a
    record: finite impulse responses where there are inputs, correlations of ambient vibration
    where there are none (NExT; James, Carne & Lauffer 1995).

    Parameters
    ----------
    rows, columns : int, optional
        Block rows and columns of the Hankel matrix; `decompose` chooses and says why. Of
        decays all columns are used unless `columns` limits them to the first samples.
    responses : "auto", "decay", "correlations" or "fir"
        What a record is taken for. "auto": with inputs "fir"; without, a decay where its last
        quarter has less than a quarter of the energy of its first, or where the data have a
        rank, as noise-free free motion has; otherwise correlations.
    references : sequence of str, optional
        Names of the outputs that correlations refer to; all by default.

    Notes
    -----
    H(0) = U Σ Vᵀ, A = Σ^-½ Uᵀ H(1) V Σ^-½, C and B the first blocks of U Σ^½ and Σ^½ Vᵀ, D the
    response at lag 0 (realization chapter, eq. 1.37-1.39; for decays 1.67-1.71). H(1) reaches
    to lag rows + columns. Outputs and inputs are weighed so that units do not matter. The
    leading singular triplets come from the Gram of the smaller side, refined so that they are
    those of the full decomposition to rounding.

    References
    ----------
    Juang & Pappa (1985), J. Guid. Control Dyn. 8(5), doi:10.2514/3.20031.

    Examples
    --------
    >>> from vibrid.record import ImpulseResponses
    >>> pulse = ImpulseResponses(0.5 ** np.arange(8.0)[:, None, None], dt=0.1)
    >>> method = ERA(rows=3, columns=3)
    >>> method.realize(method.decompose(pulse), 1).model.A.round(12)
    array([[0.5]])
    """

    rows: int | None = field(default=None, metadata={"help": ROWS})
    columns: int | None = field(default=None, metadata={"help": COLUMNS})
    responses: str = field(default="auto", metadata={"help": KINDS})
    references: tuple[str, ...] | None = field(default=None, metadata={"help": REFERENCES})

    def factor_rows(self, blocks: Floats, weights: Weights) -> HankelModels:
        """Factor balanced block rows (rows + 1, n_outputs, width), however made."""
        with one_blas_thread():
            first, second = hankel_pair(blocks)
            return HankelModels(
                first,
                second,
                len(blocks) - 1,
                *weights,
                squared_norm(blocks[:-1]),
                leading_triplets(first, USUAL_ORDERS),
            )


@dataclass(frozen=True)
class ERADC(_Realization):
    """Realize a model from correlations of pulse responses: ERA with data correlations.

    Juang, Cooper & Wright (1988). The block Hankel of R(k) = H(k) H(0)ᵀ averages over the
    columns before the singular value decomposition.

    Parameters
    ----------
    rows, columns, responses, references
        As of `ERA`.
    lag : int
        τ, samples between neighbouring correlations.
    row_shifts, column_shifts : int
        ξ and ζ: how many further rows and columns of correlations.

    Notes
    -----
    𝓗(0) = U Σ Vᵀ, A = Σ^-½ Uᵀ 𝓗(1) V Σ^-½, O the first rows · n_outputs rows of U Σ^½ and C its
    first block; B the first block column of O⁺ H(0) with the Hankel matrix of the responses
    themselves: eq. 1.84 and 1.85b of the realization chapter, which print 𝓗(0) in its place,
    so corrected. The responses must reach to lag rows + columns + (ξ + ζ) τ.

    R(0) keeps the noise's own correlation, so nothing is gained by small shifts: τ = ξ = ζ = 1
    is ERA of the same size. Measured on a two-mass chain, 300 lags, noise of 30 % of the
    responses' rms, median pole errors: where the noise is correlated (first order, .9 from
    lag to lag), τ = 10 and ξ = ζ = 3 have .0015 and .0005 against .0035 and .0016 of ERA of
    the same 30 rows and 200 columns, and .0017 and .0006 of ERA of all lags; where it is
    white, ERA of all lags is as good or better (.0009 and .0009 against .0010 and .0010), and
    much better for weak modes, whose singular values correlations square: of ten modes in white
    noise of 5 %, with 100 × 100 blocks, the worst pole is off by .0002 against .004.

    References
    ----------
    Juang, Cooper & Wright (1988), Control-Theory and Advanced Technology 4(1).
    """

    rows: int | None = field(default=None, metadata={"help": ROWS})
    columns: int | None = field(default=None, metadata={"help": COLUMNS})
    lag: int = field(default=5, metadata={"help": "samples between the correlations (tau)"})
    row_shifts: int = field(default=2, metadata={"help": "further rows of correlations (xi)"})
    column_shifts: int = field(
        default=2, metadata={"help": "further columns of correlations (zeta)"}
    )
    responses: str = field(default="auto", metadata={"help": KINDS})
    references: tuple[str, ...] | None = field(default=None, metadata={"help": REFERENCES})

    def __post_init__(self) -> None:
        super().__post_init__()
        check_whole("lag", self.lag, 1)
        check_whole("row_shifts", self.row_shifts, 0)
        check_whole("column_shifts", self.column_shifts, 0)

    @property
    def reach(self) -> int:
        """Lags that the shifts add: (ξ + ζ) τ."""
        return (self.row_shifts + self.column_shifts) * self.lag

    @property
    def stacked(self) -> int:
        return 1 + max(self.row_shifts, self.column_shifts)

    def factor_rows(self, blocks: Floats, weights: Weights) -> HankelModels:
        """Factor correlations of balanced block rows (rows + reach + 1, n_outputs, width)."""
        count, p, _ = blocks.shape
        rows = count - self.reach - 1
        with one_blas_thread():
            matrix = blocks.reshape(count * p, -1)
            markov = matrix[: rows * p]
            # R(k) = H(k) H(0)ᵀ stands at block row k of one product
            products = matrix @ markov.T
            first, second = (self._block_hankel(products[k * p :], rows, p) for k in (0, 1))
            return HankelModels(
                first,
                second,
                rows,
                *weights,
                float(np.square(first).sum()),
                # stacked correlations have no more rank than the responses they are made of
                leading_triplets(first, min(USUAL_ORDERS, *markov.shape)),
                markov,
            )

    def _block_hankel(self, products: Floats, rows: int, p: int) -> Floats:
        """Return the block Hankel of the correlations R(k + (i + j) τ)."""
        step, height = self.lag * p, rows * p
        return np.block(
            [
                [products[(i + j) * step :][:height] for j in range(self.column_shifts + 1)]
                for i in range(self.row_shifts + 1)
            ]
        )
