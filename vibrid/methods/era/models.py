"""HankelModels: realizations of every order from one factored Hankel matrix."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.linalg as sla

from ...errors import OptionError
from ...linalg import one_blas_thread, solve_upper
from ...record import Floats
from .triplets import Triplets, leading_triplets

USUAL_ORDERS = 64  # states prepared together; larger orders prepare all there are
GAP = 1e-2  # the first value of rounding over the last of the data, where they have a rank


@dataclass(frozen=True, eq=False)
class HankelModels:
    """Hold H(0) = U Σ Vᵀ and H(1), and with them the models of all orders.

    Attributes
    ----------
    first, second : arrays or linear operators (≥ rows · p, columns)
        H(0) and H(1), or their block correlations; balanced.
    rows : int
        Block rows of the observability matrix.
    output_weights, input_weights : array (p,), (m,)
        What the balanced responses were multiplied by.
    energy : float
        Squared Frobenius norm of `first`.
    leading : Triplets
    markov : array (rows · p, columns · m) or None
        H(0) itself where `first` holds correlations: the inputs come from it.

    Notes
    -----
    A = Σ^-½ Uᵀ H(1) V Σ^-½, C the first block row of O = U Σ^½, B the first block column of
    R = Σ^½ Vᵀ (Juang & Pappa 1985); with correlations R = O⁺ H(0) (Juang, Cooper & Wright
    1988). The model of order n is the leading part of that of order n + 1.
    """

    first: Any
    second: Any
    rows: int
    output_weights: Floats
    input_weights: Floats
    energy: float
    leading: Triplets
    markov: Floats | None = None

    @property
    def n_outputs(self) -> int:
        return len(self.output_weights)

    @property
    def n_inputs(self) -> int:
        return len(self.input_weights)

    @property
    def singular_values(self) -> Floats:
        """Of the balanced Hankel matrix; those beyond the prepared ones where they are cheap."""
        return self.leading.values

    @property
    def singular_values_kept(self) -> int:
        """How many states are prepared; larger orders cost a full decomposition."""
        return self.leading.kept

    @property
    def largest_order(self) -> int:
        if self.is_cut:
            return self.leading.kept
        # correlations stack more rows, but O needs its own for the inputs
        return int(min(self.rows * self.n_outputs, self._width))

    @property
    def _width(self) -> int:
        """Columns that states can be told from; stacking correlations makes no more of them."""
        return int(self.first.shape[1] if self.markov is None else self.markov.shape[1])

    @property
    def rank_limited(self) -> bool:
        """Whether the data end at a rank: a gap, and nothing but rounding beyond it.

        Values that fade into rounding, as those of smooth data do, show no rank.
        """
        kept, values = self.leading.kept, self.leading.values
        return self.is_cut and (kept == len(values) or bool(values[kept] <= GAP * values[kept - 1]))

    @property
    def is_cut(self) -> bool:
        """Whether states were left out because their singular values are rounding."""
        return self.leading.kept < self.leading.asked

    @property
    def limit(self) -> str:
        """What the largest order follows from, in words."""
        if self.rank_limited:
            return "the rank of the (nearly noise-free) data"
        if self.is_cut:
            return "the singular values above rounding"
        if self.rows * self.n_outputs <= self._width:
            outputs = f"{self.n_outputs} output{'s' if self.n_outputs > 1 else ''}"
            return f"rows={self.rows} with {outputs}"
        return f"the {self._width} columns of the Hankel matrix"

    def tail(self, order: int) -> float:
        """Return the share of the matrix's energy that this order leaves out."""
        left_out = 1 - np.sum(self.leading.values[:order] ** 2) / self.energy
        return float(max(0.0, left_out))

    def triplet(self, order: int) -> tuple[Floats, Floats, Floats]:
        """Return A (n, n), B (n, m), C (p, n) of this order; no further decomposition."""
        found = self._prepared(order)
        scale = found.values[:order] ** -0.5
        A = scale[:, None] * self._shifted(order)[:order, :order] * scale
        B = self._reach(order, self.n_inputs)
        return A, B, self.observability(order)[: self.n_outputs].copy()

    def observability(self, order: int) -> Floats:
        """Return O (rows · p, n): its first block row is C, the next about C A, and so on."""
        found = self._prepared(order)
        weights = np.tile(self.output_weights, self.rows)[:, None]
        return np.asarray(self._balanced(found)[:, :order] / weights)

    def controllability(self, order: int) -> Floats:
        """Return R (n, columns · m): its first block column is B, the next about A B."""
        return self._reach(order, self._width)

    def _reach(self, order: int, width: int) -> Floats:
        """Return the first columns of R."""
        found = self._prepared(order)
        weights = np.resize(self.input_weights, width)
        if self.markov is None:
            return (
                np.asarray(found.values[:order, None] ** 0.5 * found.right[:order, :width])
                / weights
            )
        Q, upper = self._observed(found.kept)
        return solve_upper(upper[:order, :order], Q[:, :order].T @ self.markov[:, :width]) / weights

    def _balanced(self, found: Triplets) -> Floats:
        height = self.rows * self.n_outputs
        return found.left[:height] * found.values[: found.kept] ** 0.5

    def _observed(self, kept: int) -> tuple[Floats, Floats]:
        """Return the QR of O in balanced units: nested, as O is."""
        if kept not in self._factors:
            found = self._prepared(kept)
            self._factors[kept] = sla.qr(self._balanced(found), mode="economic")
        return self._factors[kept]

    def _shifted(self, order: int) -> Floats:
        """Return Uᵀ H(1) V, of which every order takes the leading part."""
        found = self._prepared(order)
        if found.kept not in self._transitions:
            with one_blas_thread():
                self._transitions[found.kept] = found.left.T @ (self.second @ found.right.T)
        return self._transitions[found.kept]

    def _prepared(self, order: int) -> Triplets:
        if order <= self.leading.kept:
            return self.leading
        if order > self.largest_order or order > self._all.kept:
            most = min(self.largest_order, self.leading.kept if self.is_cut else self._all.kept)
            raise OptionError(
                f"order={order} is more than {self.limit} allow: at most {most}. "
                "Use a lower order, or a larger Hankel matrix where the data hold more."
            )
        return self._all

    @cached_property
    def _all(self) -> Triplets:
        with one_blas_thread():
            return leading_triplets(self.first, min(self.first.shape))

    @cached_property
    def _factors(self) -> dict[int, tuple[Floats, Floats]]:
        return {}

    @cached_property
    def _transitions(self) -> dict[int, Floats]:
        return {}
