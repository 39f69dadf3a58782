"""Least squares for B, D, offset and initial states, from one pass over the data.

With A, C (and K) fixed, the simulated or predicted output is linear in the rest. The basis
signals [1, u, ξ, decay] and the target are reduced piece by piece to a triangle; all that
follows, cross-validation included, is small algebra on the triangles.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..chunks import Stream
from ..gram import scaled_cholesky, stacked_qr
from ..linalg import solve_upper
from ..record import Floats
from .modal_basis import ModalBasis
from .walk import NEGLIGIBLE, Piece, make_filters, reduce_piece

REDUCED_PIVOT = 1e-6  # these normal equations are only taken where they cost few digits
SOLVE_TOLERANCE = 1e-13  # relative, for the triangles' least squares
DEPENDENT = 1e-10  # of a column's length: what the columns before it leave of a dependent one


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What the equations solve for, in modal coordinates and scaled units.

    Attributes
    ----------
    shared : array (n_shared,)
        [constants record by record, D where free, B column by column].
    states : array (n_segments, n)
        Initial state of each segment.
    """

    shared: Floats
    states: Floats


@dataclass(frozen=True, eq=False)
class Equations:
    """Triangles of [1, u, ξ, decay | target] for each piece, and how outputs weigh.

    Attributes
    ----------
    basis : ModalBasis
        Of A (simulation) or A − K C (prediction).
    rows : array (p, n)
        C V.
    triangles : one (q + p, q + p) array a piece
    pieces : tuple of Piece
    weight : array (p, p)
        W with W cov(e) Wᵀ = I.
    feedthrough : array (p,)
        Which outputs have D.
    constant : 1 with an offset to estimate for every record, else 0
    predicts : whether the target is the prediction's
    """

    basis: ModalBasis
    rows: Floats
    triangles: tuple[Floats, ...]
    pieces: tuple[Piece, ...]
    weight: Floats
    feedthrough: NDArray[np.bool_]
    n_inputs: int
    constant: int
    predicts: bool

    @property
    def _n(self) -> int:
        return int(self.rows.shape[1])

    @property
    def _p(self) -> int:
        return int(self.rows.shape[0])

    @property
    def _c(self) -> int:
        return self.constant * self._p

    @property
    def n_direct(self) -> int:
        """Unknowns in D and B."""
        return (int(self.feedthrough.sum()) + self._n) * self.n_inputs

    @property
    def n_shared(self) -> int:
        return self._n_constants + self.n_direct

    @cached_property
    def _n_constants(self) -> int:
        return self._c * (max(piece.record for piece in self.pieces) + 1)

    def solve(self, pieces: Sequence[int] | None = None) -> Unknowns:
        """Return the least-squares solution over some or all pieces.

        The state of every segment, then the constants of every record, are projected out
        before D and B are solved.
        """
        c, records = self._c, self._by_record(pieces)
        direct = np.zeros(self.n_direct)
        if self.n_direct:
            joined = _joined([_eliminated(rows, c) for rows in records.values()])
            size = np.linalg.norm(joined[:, :-1], axis=0)
            size[size == 0] = 1
            direct = solve_upper(joined[:-1, :-1] / size, joined[:-1, -1:])[:, 0] / size
        constants = np.zeros((self._n_constants // max(1, c), c))
        if c:
            for record, rows in records.items():
                constants[record] = _solve(rows[:, :c], rows[:, -1] - rows[:, c:-1] @ direct)
        return self.with_states(np.concatenate([constants.ravel(), direct]), pieces)

    def with_states(self, shared: Floats, pieces: Sequence[int] | None = None) -> Unknowns:
        """Return the shared unknowns with the state that fits each segment best."""
        found = []
        for chosen in self._by_segment(pieces):
            triangle = self._reduced(chosen)
            target = triangle[:, -1] - triangle[:, self._n : -1] @ self._local(shared, chosen[0])
            found.append(_solve(triangle[:, : self._n], target))
        return Unknowns(shared, np.array(found))

    def squares(self, unknowns: Unknowns, pieces: Sequence[int] | None = None) -> Floats:
        """Return Σ e eᵀ (p, p), unweighted, over some or all pieces."""
        q, back = self._q, np.linalg.inv(self.weight)
        coefficients, columns = self._design
        total = np.zeros((self._p, self._p))
        for chosen, state in zip(self._by_segment(pieces), unknowns.states, strict=True):
            answer = np.concatenate([state, self._local(unknowns.shared, chosen[0])])
            combination = np.zeros((q, self._p))
            for coefficient, column in zip(coefficients, columns, strict=True):
                np.add.at(combination, column, (coefficient * answer).T)
            modelled = combination @ back.T
            for k in chosen:
                error = self.triangles[k][:, :q] @ modelled - self.triangles[k][:, q:]
                total += error.T @ error
        return total

    def energies(self, piece: int) -> Floats:
        """Return the sum of squares of each target over a piece (p,)."""
        return np.asarray((self.triangles[piece][:, self._q :] ** 2).sum(axis=0))

    def _local(self, shared: Floats, piece: int) -> Floats:
        """Return what of the shared unknowns acts on a piece: its record's constants, D, B."""
        first = self.pieces[piece].record * self._c
        return np.concatenate([shared[first : first + self._c], shared[self._n_constants :]])

    def _by_record(self, pieces: Sequence[int] | None) -> dict[int, Floats]:
        """Return rows [constants, D, B, target] of every record, states projected out."""
        groups: dict[int, list[Floats]] = {}
        for chosen in self._by_segment(pieces):
            rest = _eliminated(self._reduced(chosen), self._n)
            groups.setdefault(self.pieces[chosen[0]].record, []).append(rest)
        return {record: _joined(rests) for record, rests in groups.items()}

    def covariance(self, unknowns: Unknowns) -> Floats:
        """Return the covariance of the errors, degrees of freedom taken off."""
        used = (self.n_shared + unknowns.states.size) / self._p
        samples = sum(piece.stop - piece.start for piece in self.pieces)
        return self.squares(unknowns) / max(1.0, samples - used)

    def states(self, unknowns: Unknowns) -> Floats:
        """Return the initial state of each segment in model coordinates (n_segments, n)."""
        return np.asarray(unknowns.states @ self.basis.vectors.T)

    def unpack(self, shared: Floats) -> tuple[Floats, Floats, Floats]:
        """Return constants (n_records, p), D (p, m) and B in modal coordinates (n, m)."""
        m, free, first = self.n_inputs, int(self.feedthrough.sum()), self._n_constants
        D = np.zeros((self._p, m))
        D[self.feedthrough] = shared[first : first + free * m].reshape(free, m)
        constants = shared[:first].reshape(-1, self._p)
        return constants, D, shared[first + free * m :].reshape(m, self._n).T

    def pack(self, constants: Floats, D: Floats, B: Floats) -> Floats:
        """Return `shared` of given parts: the inverse of `unpack`."""
        return np.concatenate([constants.ravel(), D[self.feedthrough].ravel(), B.T.ravel()])

    def _by_segment(self, pieces: Sequence[int] | None) -> list[tuple[int, ...]]:
        groups: dict[int, list[int]] = {}
        for k in range(len(self.pieces)) if pieces is None else pieces:
            groups.setdefault(self.pieces[k].owner, []).append(k)
        return [tuple(group) for group in groups.values()]

    def _reduced(self, chosen: tuple[int, ...]) -> Floats:
        """Return the triangle of [state, shared, target] over the outputs of some pieces."""
        if chosen not in self._triangles:
            gram = np.sum([self._normal(k) for k in chosen], axis=0)
            triangle, pivot = scaled_cholesky(gram)
            if triangle is None or not pivot > REDUCED_PIVOT:
                rows = (rows for k in chosen for rows in self._weighted_rows(k))
                triangle = stacked_qr(rows, len(gram))
            self._triangles[chosen] = triangle
        return self._triangles[chosen]

    @cached_property
    def _triangles(self) -> dict[tuple[int, ...], Floats]:
        return {}

    @cached_property
    def _normals(self) -> dict[int, Floats]:
        return {}

    @property
    def _q(self) -> int:
        """Columns of the triangles before the targets."""
        return len(self.triangles[0]) - self._p

    @cached_property
    def _design(self) -> tuple[Floats, NDArray[np.int64]]:
        """Return how each unknown [state, constants, D, B] acts on the weighted outputs.

        Coefficients (2, p, width) of two of the columns [1, u, ξ, decay] each, and which
        columns (2, width): a modal signal and its partner.
        """
        n, m, p, W = self._n, self.n_inputs, self._p, self.weight
        own, partner = self.basis.coefficients(W @ self.rows)
        direct = np.repeat(W[:, self.feedthrough], m, axis=1)
        first = self.constant + m + n * np.arange(m + 1)[:, None]
        signals, partners = first + np.arange(n), first + self.basis.partners
        plain = [np.zeros(self._c, int), self.constant + np.arange(direct.shape[1]) % max(1, m)]
        coefficients = [
            np.hstack([own, W[:, : self._c], direct, np.tile(own, m)]),
            np.hstack([partner, np.zeros((p, self._c + direct.shape[1])), np.tile(partner, m)]),
        ]
        columns = [
            np.concatenate([each[-1], *plain, each[:-1].ravel()]) for each in (signals, partners)
        ]
        return np.array(coefficients), np.array(columns)

    def _normal(self, piece: int) -> Floats:
        """Return the normal matrix of [unknowns, target] of one piece, all outputs together.

        Each unknown acts on output o by a coefficient times a column, so the sum over outputs
        of products of rows is the products of columns times sums of products of coefficients.
        """
        if piece not in self._normals:
            q, (coefficients, columns) = self._q, self._design
            products = self.triangles[piece].T @ self.triangles[piece]
            gram = np.zeros((coefficients.shape[2] + 1,) * 2)
            for left, i in zip(coefficients, columns, strict=True):
                gram[:-1, -1] += np.einsum("cp,pc->c", products[i, q:], self.weight.T @ left)
                for right, j in zip(coefficients, columns, strict=True):
                    gram[:-1, :-1] += (left.T @ right) * products[np.ix_(i, j)]
            gram[-1, :-1] = gram[:-1, -1]
            gram[-1, -1] = np.trace(self.weight @ products[q:, q:] @ self.weight.T)
            self._normals[piece] = gram
        return self._normals[piece]

    def _weighted_rows(self, piece: int) -> Iterator[Floats]:
        """Yield the rows [state, shared, target] of one weighted output after the other."""
        q, (coefficients, columns) = self._q, self._design
        top = self.triangles[piece][:q]
        for (own, partner), weight in zip(
            coefficients.transpose(1, 0, 2), self.weight, strict=True
        ):
            acting = top[:, columns[0]] * own + top[:, columns[1]] * partner
            yield np.hstack([acting, top[:, q:] @ weight[:, None]])


def _joined(triangles: Sequence[Floats]) -> Floats:
    """Return the triangle of triangles stacked on each other."""
    return triangles[0] if len(triangles) == 1 else stacked_qr(iter(triangles), len(triangles[0].T))


def _eliminated(triangle: Floats, count: int) -> Floats:
    """Return the triangle of what the first columns cannot explain of the others.

    The columns may be dependent or zero: a state that has decayed.
    """
    columns, others = triangle[:, :count], triangle[:, count:]
    unit, _ = _unit_columns(columns)
    if (np.abs(np.diag(unit)) > DEPENDENT).all():
        return triangle[count:, count:]
    Q, R, _ = sla.qr(unit, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(R))
    Q = Q[:, size > SOLVE_TOLERANCE * max(size[0], 1e-300)]
    return stacked_qr(iter([others - Q @ (Q.T @ others)]), others.shape[1])


def _solve(columns: Floats, target: Floats) -> Floats:
    """Return the least-squares solution of triangular columns, dependent or zero as they may be."""
    unit, size = _unit_columns(columns)
    n = len(size)
    if (np.abs(np.diag(unit)) > DEPENDENT).all():
        return np.asarray(np.linalg.solve(unit[:n], target[:n]) / size)
    return np.asarray(sla.lstsq(unit, target, cond=SOLVE_TOLERANCE)[0] / size)


def _unit_columns(columns: Floats) -> tuple[Floats, Floats]:
    """Return the columns scaled to length 1, and their lengths; a decayed column stays zero."""
    size = np.linalg.norm(columns, axis=0)
    size[size < NEGLIGIBLE] = np.inf
    return columns / size, size


def set_up(
    stream: Stream,
    pieces: Sequence[Piece],
    A: Floats,
    C: Floats,
    basis: ModalBasis,
    gain: Floats,
    weight: Floats,
    feedthrough: NDArray[np.bool_],
) -> Equations:
    """Walk the data once and reduce every piece to its triangle.

    Parameters
    ----------
    A : array (n, n)
        The matrix whose modal form `basis` is: A, or A − K C for prediction.
    gain : array (n, p)
        Zero for simulation, K for prediction: the target is y − C (q − A)⁻¹ gain y.
    """
    constant = int(stream.offset == "estimate")
    filters = make_filters(basis, A, C, gain, stream.n_inputs, constant)
    triangles = []
    for piece in pieces:
        if piece.start == 0:
            states = filters.at_rest()
        triangle, states = reduce_piece(stream, piece, filters, states)
        triangles.append(triangle)
    return Equations(
        basis=basis,
        rows=C @ basis.vectors,
        triangles=tuple(triangles),
        pieces=tuple(pieces),
        weight=weight,
        feedthrough=feedthrough,
        n_inputs=stream.n_inputs,
        constant=constant,
        predicts=bool(gain.any()),
    )
