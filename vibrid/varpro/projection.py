"""Eliminate what is linear: cost, gradient and information of the poles from sums of products.

Outputs are y = X Cᵀ + u Dᵀ + 1 dᵀ + e, where the states X follow from the blocks. With
Φ = [X, u, 1] and P the projection off Φ, the residual of output o is P y_o and its derivative
by a parameter is −P ∂X c_o (Kaufman 1975; the term left out vanishes with the residual). Every
∂X is a combination of few signals F, so the information needs Fᵀ P F only:

    H_ij = Σ_o w_o (M_iᵀ c_o)ᵀ [Fᵀ P F]_ij (M_jᵀ c_o).

Signals, for every block: W, the block's filter driven by its own first state; its response to
every input; its free decay in every segment. A change of the driven entry e = (0, 1) of B or
of an initial state has the signal itself as derivative, one of the other entry J times it,
J = (A − r) / s; changes of the pole coefficients have −s J W and −s W.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..record import Floats
from .blocks import Blocks

DEPENDENT = 1e-12  # relative eigenvalue of [X, u, 1]'s products: below it a direction is unused


@dataclass(frozen=True, eq=False)
class Linear:
    """What is linear in a model: C in the blocks' states, D, and a constant for each record.

    Attributes
    ----------
    states : array (n_blocks, 2, p)
    direct : array (m, p)
    constants : array (n_records or 0, p)
    """

    states: Floats
    direct: Floats
    constants: Floats

    def stacked(self) -> Floats:
        """Return all of them (2 n_blocks + m + n_records, p)."""
        p = self.direct.shape[1]
        return np.concatenate([self.states.reshape(-1, p), self.direct, self.constants])

    def restacked(self, rows: Floats) -> Linear:
        """Return the same parts with other values."""
        k, m = self.states.shape[0] * 2, len(self.direct)
        return Linear(rows[:k].reshape(self.states.shape), rows[k : k + m], rows[k + m :])


@dataclass(frozen=True, eq=False)
class Sums:
    """Products of the signals with each other and with the errors, over all data.

    Attributes
    ----------
    gram : array (q, q)
        Of [W, responses, decays; u; 1 of each record; e].
    blocks : Blocks
    linear : Linear
        The model whose errors e are.
    """

    gram: Floats
    blocks: Blocks
    linear: Linear

    @property
    def n_signals(self) -> int:
        return 2 * self.blocks.n_blocks * (1 + len(self.blocks.inputs) + len(self.blocks.starts))

    def select(self, kept: NDArray[np.bool_]) -> Sums:
        """Return the sums of some of the blocks; the errors stay those of the same outputs."""
        families = self.n_signals // (2 * self.blocks.n_blocks)
        rest = np.ones(len(self.gram) - self.n_signals, dtype=bool)
        columns = np.concatenate([np.tile(np.repeat(kept, 2), families), rest])
        linear = replace(self.linear, states=self.linear.states[kept])
        return Sums(self.gram[np.ix_(columns, columns)], self.blocks.select(kept), linear)


@dataclass(frozen=True, eq=False)
class Projected:
    """The model whose linear part fits best, and how its cost depends on the blocks.

    Attributes
    ----------
    sums : Sums
    weights : array (p,)
        Of the outputs' squared errors.
    feedthrough : array of bool (p,)
        Which outputs have D.
    indirect : int
        Number of last inputs that reach the outputs through the states only.
    """

    sums: Sums
    weights: Floats
    feedthrough: NDArray[np.bool_]
    indirect: int = 0

    @property
    def blocks(self) -> Blocks:
        return self.sums.blocks

    @cached_property
    def mixing(self) -> Floats:
        """What makes states of responses and decays (m + n_segments, n_blocks, 2, 2)."""
        return mixing(self.blocks)

    @cached_property
    def _regressors(self) -> Floats:
        """Combinations of all signals that are [X, u, 1] (q − p, 2 n_blocks + m + n_records)."""
        k, one = self.blocks.n_blocks, self.sums.n_signals
        rest = len(self.sums.gram) - one - len(self.weights)
        into = np.zeros((one // (2 * k), k, 2, k, 2))
        each = np.arange(k)
        into[1:, each, :, each, :] = self.mixing.transpose(1, 0, 3, 2)
        result = np.zeros((one + rest, 2 * k + rest))
        result[:one, : 2 * k] = into.reshape(one, 2 * k)
        result[one:, 2 * k :] = np.eye(rest)
        return result

    @cached_property
    def groups(self) -> list[tuple[NDArray[np.bool_], Floats, Floats]]:
        """Return for outputs with and without D: which, root of (ΦᵀΦ)⁻¹, and Φ's products."""
        p, found = len(self.weights), []
        for direct in (True, False):
            outputs = self.feedthrough == direct
            if not outputs.any():
                continue
            columns = self._regressors[:, self.rows_of(outputs)]
            products = columns.T @ self.sums.gram[: len(columns)]
            root = _inverse_root(products[:, :-p] @ columns)
            found.append((outputs, root, root.T @ products))
        return found

    @cached_property
    def errors(self) -> Floats:
        """Σ e eᵀ of the fitted model (p, p)."""
        p = len(self.weights)
        groups = [(outputs, known[:, -p:].T @ known[:, -p:]) for outputs, _, known in self.groups]
        explained = groups[0][1]
        for outputs, part in groups[1:]:  # what the wider Φ leaves is orthogonal to the narrower
            explained[np.ix_(outputs, outputs)] = part[np.ix_(outputs, outputs)]
        return np.asarray(self.sums.gram[-p:, -p:] - explained)

    @cached_property
    def cost(self) -> float:
        return float(self.weights @ np.diag(self.errors))

    @property
    def weighing(self) -> Floats:
        """W of the weighted squares eᵀ W e (p, p); across outputs only where all have one Φ."""
        return np.diag(self.weights)

    @cached_property
    def linear(self) -> Linear:
        """The linear part that fits best."""
        p = len(self.weights)
        return self._added(self.sums.linear, [known[:, -p:] for _, _, known in self.groups])

    @property
    def state_squares(self) -> Floats:
        """Σ x xᵀ of the existing states (n, n)."""
        used = self.blocks.used.ravel()
        columns = self._regressors[:, : len(used)][:, used]
        return np.asarray(columns.T @ self.sums.gram[: len(columns), : len(columns)] @ columns)

    @property
    def state_sums(self) -> Floats:
        """Σ x of every record (n_records, n)."""
        used, p = self.blocks.used.ravel(), len(self.weights)
        columns = self._regressors[:, : len(used)][:, used]
        records = slice(-p - len(self.sums.linear.constants), -p)
        return np.asarray(self.sums.gram[records, : len(columns)] @ columns)

    def _added(self, base: Linear, changes: list[Floats]) -> Linear:
        """Return a linear part changed by root · change for each group's outputs."""
        rows = base.stacked().copy()
        for (outputs, root, _), change in zip(self.groups, changes, strict=True):
            rows[np.ix_(self.rows_of(outputs), outputs)] += (root @ change)[:, outputs]
        return base.restacked(rows)

    def rows_of(self, outputs: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which rows of a stacked linear part a group of outputs has."""
        k, m = 2 * self.blocks.n_blocks, len(self.blocks.inputs)
        kept = np.ones(self._regressors.shape[1], dtype=bool)
        kept[k : k + m] = self.feedthrough[outputs].all()
        kept[k + m - self.indirect : k + m] = False
        return kept

    @cached_property
    def _leverage(self) -> Floats:
        """M_iᵀ c_o of both parameters of a block (n_blocks, 2, 2, p)."""
        c, b = self.linear.states, self.blocks.shape[:, None]
        other = np.stack([-b * c[:, 1], c[:, 0]], axis=1)
        return np.stack([other, c], axis=1)

    @cached_property
    def _scale(self) -> Floats:
        """−s for the coefficients of the poles, 1 for B and initial states, 0 for what is not."""
        families = self.sums.n_signals // (2 * self.blocks.n_blocks)
        scale = np.ones((families, self.blocks.n_blocks, 2)) * self.blocks.used
        scale[0] *= -self.blocks.spread[:, None]
        return scale

    @cached_property
    def gradient(self) -> Floats:
        """Half the derivative of the cost by each parameter (flattened step of `Blocks.moved`)."""
        p, q = len(self.weights), self.sums.n_signals
        total = np.zeros(self._scale.shape)
        for outputs, _, known in self.groups:
            left = self.sums.gram[:q, -p:] - known[:, :q].T @ known[:, -p:]
            weighing = np.where(np.outer(outputs, outputs), self.weighing, 0)
            left = (left @ weighing).reshape(*self._scale.shape, p)
            total -= np.einsum("fkio,kaio->fka", left, self._leverage)
        return self.tied((total * self._scale).ravel())

    def tied(self, derivatives: Floats) -> Floats:
        """Return derivatives (rows) by the parameters that are free: undamped blocks have one."""
        held = self.blocks.undamped
        if not held.any():
            return derivatives
        shaped = derivatives.reshape(*self._scale.shape, *derivatives.shape[1:]).copy()
        tie = self.blocks.tie[held].reshape(-1, *[1] * (derivatives.ndim - 1))
        shaped[0, held, 0] += tie * shaped[0, held, 1]
        shaped[0, held, 1] = 0
        return np.asarray(shaped.reshape(derivatives.shape))

    @cached_property
    def information(self) -> Floats:
        """JᵀJ: what the data say of each parameter, all that is linear left free."""
        return self.information_of(self.weighing)

    def information_of(self, weighing: Floats) -> Floats:
        """Return Jᵀ W J for a matrix W (p, p)."""
        families, k, _ = self._scale.shape
        q, p = self.sums.n_signals, len(self.weights)
        total = np.zeros((families, k, 2, families, k, 2))
        for outputs, _, known in self.groups:
            left = self.sums.gram[:q, :q] - known[:, :q].T @ known[:, :q]
            left = left.reshape(families, k, 2, families, k, 2)
            own = np.where(np.outer(outputs, outputs), weighing, 0)
            lever = self._leverage.reshape(-1, p)
            both = (lever @ own @ lever.T).reshape(k, 2, 2, k, 2, 2)
            for i in range(2):
                for j in range(2):
                    total += left[:, :, i, None, :, :, j, None] * both[None, :, :, i, None, :, :, j]
        scale = self._scale.ravel()
        free = self.tied(total.reshape(q, q) * scale * scale[:, None])
        return self.tied(free.T)

    @cached_property
    def neutral(self) -> Floats:
        """Steps that C undoes: B and initial states of a block multiplied by 1 or by J."""
        blocks = self.blocks
        vectors = np.concatenate([np.zeros((1, blocks.n_blocks, 2)), blocks.inputs, blocks.starts])
        turned = np.stack([vectors[..., 1], -blocks.shape[:, None].T * vectors[..., 0]], axis=-1)
        result = np.zeros((*vectors.shape, 2, blocks.n_blocks))
        each = np.arange(blocks.n_blocks)
        result[:, each, :, 0, each] = vectors.transpose(1, 0, 2)
        result[:, each, :, 1, each] = (turned * ~blocks.single[:, None]).transpose(1, 0, 2)
        return np.asarray(result.reshape(self.sums.n_signals, -1))

    def answered(self, by_rows: Floats) -> Floats:
        """Return derivatives by the step of what depends on the linear part, which follows it.

        Parameters
        ----------
        by_rows : array (n_quantities, rows, p)
            Derivatives by the stacked linear part.

        Returns
        -------
        array (n_quantities, n_parameters)
        """
        total, q = np.zeros((len(by_rows), *self._scale.shape)), self.sums.n_signals
        for outputs, root, known in self.groups:
            seen = np.einsum("rk,grp->pgk", root, by_rows[:, self.rows_of(outputs)])
            for o in np.flatnonzero(outputs):
                part = (seen[o] @ known[:, :q]).reshape(total.shape)
                total -= np.einsum("gfki,kai->gfka", part, self._leverage[..., o])
        return np.asarray((total * self._scale).reshape(len(by_rows), q))

    def moved(self, step: Floats) -> tuple[Blocks, Linear]:
        """Return blocks and linear part after a step, the latter to first order."""
        shaped, held = step.reshape(self._scale.shape).copy(), self.blocks.undamped
        shaped[0, held, 1] = (self.blocks.tie * shaped[0, :, 0])[held]
        blocks, T = self.blocks.moved(shaped)
        caused = np.einsum("fka,kaio->fkio", shaped * self._scale, self._leverage)
        caused = caused.reshape(self.sums.n_signals, -1)
        answers = [-known[:, : len(caused)] @ caused for _, _, known in self.groups]
        linear = self._added(self.linear, answers)
        states = np.linalg.solve(T.transpose(0, 2, 1), linear.states)
        return blocks, Linear(np.asarray(states), linear.direct, linear.constants)

    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        """Tell which parameters are those of poles at a bound that the step would cross."""
        held = np.zeros(self._scale.shape, dtype=bool)
        held[0] = self.blocks.pushed_out(step.reshape(held.shape))[:, None]
        return held.ravel()


def mixing(blocks: Blocks) -> Floats:
    """Return M with x = M ξ: response to (b₁, b₂) from that to e (…, n_blocks, 2, 2)."""
    vectors = np.concatenate([blocks.inputs, blocks.starts])
    result = vectors[..., 1, None, None] * np.eye(2)
    result[..., 0, 1] += vectors[..., 0]
    result[..., 1, 0] -= vectors[..., 0] * blocks.shape
    return np.asarray(result)


def _inverse_root(gram: Floats) -> Floats:
    """Return R with R Rᵀ = gram⁺; directions below rounding are left out."""
    size = np.sqrt(np.maximum(np.diag(gram), 0))
    size[size == 0] = np.inf
    values, vectors = sla.eigh(gram / size / size[:, None], check_finite=False, driver="evd")
    kept = values > DEPENDENT * values.max(initial=1e-300)
    return np.asarray(vectors[:, kept] / np.sqrt(values[kept]) / size[:, None])
