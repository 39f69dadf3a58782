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
from ..gram import stacked_qr, triangle_of
from ..record import Floats
from ..statespace import Lifting
from .modal_basis import ModalBasis

REDUCED_PIVOT = 1e-6  # these normal equations are only taken where they cost few digits
SOLVE_TOLERANCE = 1e-13  # relative, for the triangles' least squares
NEGLIGIBLE = 1e-100  # length of a decay that has vanished before its piece begins
CHUNK_ELEMENTS = 2**21  # of the columns made at a time


@dataclass(frozen=True)
class Piece:
    """Samples [start, stop) of segment `owner`; pieces of a segment share its initial state.

    Pieces of a record share its constant: a gap does not move a sensor's zero.
    """

    record: int
    owner: int
    start: int
    stop: int


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

    @property
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
            rests = [_without(rows[:, :c], rows[:, c:]) for rows in records.values()]
            stacked = stacked_qr(iter(rests), self.n_direct + 1)
            direct = sla.lstsq(stacked[:, :-1], stacked[:, -1], cond=SOLVE_TOLERANCE)[0]
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
        p, back = self._p, np.linalg.inv(self.weight)
        total = np.zeros((p, p))
        for chosen, state in zip(self._by_segment(pieces), unknowns.states, strict=True):
            answer = np.concatenate([state, self._local(unknowns.shared, chosen[0]), [-1.0]])
            for k in chosen:
                missing = np.stack([rows @ answer for rows in self._weighted_rows(k)])
                error = back @ missing
                rest = self.triangles[k][-p:, -p:]
                total += error @ error.T + rest.T @ rest
        return total

    def _local(self, shared: Floats, piece: int) -> Floats:
        """Return what of the shared unknowns acts on a piece: its record's constants, D, B."""
        first = self.pieces[piece].record * self._c
        return np.concatenate([shared[first : first + self._c], shared[self._n_constants :]])

    def _by_record(self, pieces: Sequence[int] | None) -> dict[int, Floats]:
        """Return rows [constants, D, B, target] of every record, states projected out."""
        groups: dict[int, list[Floats]] = {}
        for chosen in self._by_segment(pieces):
            triangle = self._reduced(chosen)
            rest = _without(triangle[:, : self._n], triangle[:, self._n :])
            groups.setdefault(self.pieces[chosen[0]].record, []).append(rest)
        width = self._c + self.n_direct + 1
        return {record: stacked_qr(iter(rests), width) for record, rests in groups.items()}

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
            width = self._n + self._c + self.n_direct + 1
            self._triangles[chosen] = triangle_of(
                lambda: (rows for k in chosen for rows in self._weighted_rows(k)),
                width,
                REDUCED_PIVOT,
            )
        return self._triangles[chosen]

    @cached_property
    def _triangles(self) -> dict[tuple[int, ...], Floats]:
        return {}

    def _weighted_rows(self, piece: int) -> Iterator[Floats]:
        """Yield the rows [state, shared, target] of one weighted output after the other."""
        n, m, one = self._n, self.n_inputs, self.constant
        triangle = self.triangles[piece]
        q = len(triangle) - self._p
        top, target = triangle[:q, :q], triangle[:q, q:]
        for weight in self.weight:
            row = weight[None, :] @ self.rows
            signals = [
                self.basis.regressors(top[:, first : first + n], row)[0]
                for first in range(one + m, q, n)
            ]
            direct = weight[None, self.feedthrough, None] * top[:, None, one : one + m]
            constants = top[:, :one] * weight if one else top[:, :0]
            yield np.hstack(
                [
                    signals[-1],
                    constants,
                    direct.reshape(q, -1),
                    *signals[:-1],
                    target @ weight[:, None],
                ]
            )


def _without(columns: Floats, matrix: Floats) -> Floats:
    """Return what the columns cannot explain of a matrix; columns may be dependent or zero."""
    if columns.shape[1] == 0:
        return matrix
    unit, _ = _unit_columns(columns)
    Q, R, _ = sla.qr(unit, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(R))
    Q = Q[:, size > SOLVE_TOLERANCE * max(size[0], 1e-300)]
    return np.asarray(matrix - Q @ (Q.T @ matrix))


def _solve(columns: Floats, target: Floats) -> Floats:
    """Return the least-squares solution; columns may be dependent or zero."""
    unit, size = _unit_columns(columns)
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
    m, p, n = stream.n_inputs, stream.n_outputs, len(A)
    constant = int(stream.offset == "estimate")
    width = constant + m + n * m + n + p
    bank = _Bank(
        Lifting(basis.blocks, basis.start[:, None], np.eye(n), np.zeros((n, 1))),
        Lifting(A, -gain, C, np.eye(p)),
        basis.start,
        constant,
    )
    triangles = []
    for piece in pieces:
        if piece.start == 0:
            states = bank.at_rest(m)
        walk = _Walk(stream, piece, bank, states)
        triangles.append(triangle_of(walk.rows, width))
        states = walk.last
    return Equations(
        basis=basis,
        rows=C @ basis.vectors,
        triangles=tuple(triangles),
        pieces=tuple(pieces),
        weight=weight,
        feedthrough=feedthrough,
        n_inputs=m,
        constant=constant,
        predicts=bool(gain.any()),
    )


@dataclass(frozen=True, eq=False)
class _Bank:
    """The filters that make the columns: modal signals, and the target."""

    modal: Lifting
    target: Lifting
    start: Floats
    constant: int

    def at_rest(self, n_inputs: int) -> list[Floats]:
        """Return the states at the start: one an input, the decay, the target filter."""
        return [*(np.zeros_like(self.start) for _ in range(n_inputs)), self.start, 0 * self.start]


class _Walk:
    """Rows of one piece, as often as asked; `last` holds the filters' states at its end."""

    def __init__(self, stream: Stream, piece: Piece, bank: _Bank, states: list[Floats]) -> None:
        self.stream, self.piece, self.bank, self.first = stream, piece, bank, states
        self.last = states

    def rows(self) -> Iterator[Floats]:
        """Yield the columns [1, u, ξ, decay, target] chunk after chunk, states carried on."""
        stream, piece, bank, m = self.stream, self.piece, self.bank, self.stream.n_inputs
        segment = stream.segments[piece.owner]
        width = (m + 1) * (len(bank.start) + 1) + stream.n_outputs
        step = max(4096, CHUNK_ELEMENTS // width)
        self.last = list(self.first)
        for start in range(piece.start, piece.stop, step):
            z = stream.read(segment, start, min(start + step, piece.stop))
            drives = np.hstack([z[:, :m], np.zeros((len(z), 1))])
            signals = []
            for j in range(m + 1):
                signal, self.last[j] = bank.modal.run(drives[:, j : j + 1], self.last[j])
                signals.append(signal)
            target, self.last[-1] = bank.target.run(z[:, m:], self.last[-1])
            yield np.hstack([np.ones((len(z), bank.constant)), z[:, :m], *signals, target])
