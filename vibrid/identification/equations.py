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
from ..gram import triangle_of
from ..record import Floats
from ..statespace import Lifting
from .modal_basis import ModalBasis

SOLVE_TOLERANCE = 1e-13  # relative, for the triangles' least squares
NEGLIGIBLE = 1e-100  # length of a decay that has vanished before its piece begins
CHUNK_ELEMENTS = 2**21  # of the columns made at a time


@dataclass(frozen=True)
class Piece:
    """Samples [start, stop) of segment `owner`; pieces of a segment share its initial state."""

    owner: int
    start: int
    stop: int


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What the equations solve for, in modal coordinates and scaled units.

    Attributes
    ----------
    shared : array (n_shared,)
        [offset (p, if any), D where free, B column by column].
    states : array (n_segments, n)
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
    constant : 1 with an offset to estimate, else 0
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
    def n_shared(self) -> int:
        free = int(self.feedthrough.sum()) * self.n_inputs
        return self.constant * self._p + free + self._n * self.n_inputs

    @cached_property
    def _parts(self) -> tuple[tuple[Floats, Floats, Floats, Floats], ...]:
        """For each piece (state columns, shared columns, target, what no basis reaches)."""
        return tuple(self._part(triangle) for triangle in self.triangles)

    def _part(self, triangle: Floats) -> tuple[Floats, Floats, Floats, Floats]:
        p, n, m, one = self._p, self._n, self.n_inputs, self.constant
        q = len(triangle) - p
        top, target, rest = triangle[:q, :q], triangle[:q, q:], triangle[q:, q:]
        rows = self.weight @ self.rows
        columns = [np.kron(self.weight, top[:, :one])] if one else []
        free = np.flatnonzero(self.feedthrough)
        columns += [np.kron(self.weight[:, [k]], top[:, one : one + m]) for k in free if m]
        for j in range(m):
            signals = top[:, one + m + j * n : one + m + (j + 1) * n]
            columns.append(self.basis.regressors(signals, rows).reshape(p * q, n))
        states = self.basis.regressors(top[:, q - n :], rows).reshape(p * q, n)
        shared = np.hstack(columns) if columns else np.zeros((p * q, 0))
        return states, shared, (target @ self.weight.T).T.ravel(), rest

    def solve(self, pieces: Sequence[int] | None = None) -> Unknowns:
        """Return the least-squares solution over some or all pieces.

        The state of every segment is projected out before the shared part is solved.
        """
        left, right = [], []
        for chosen in self._by_segment(pieces):
            states, shared, target = self._stacked(chosen)
            rest = _without(states, np.hstack([shared, target[:, None]]))
            triangle = sla.qr(rest, mode="r", overwrite_a=True, check_finite=False)[0]
            left.append(triangle[: self.n_shared + 1, :-1])
            right.append(triangle[: self.n_shared + 1, -1])
        answer = np.zeros(0)
        if self.n_shared:
            answer = sla.lstsq(np.vstack(left), np.concatenate(right), cond=SOLVE_TOLERANCE)[0]
        return self.with_states(answer, pieces)

    def with_states(self, shared: Floats, pieces: Sequence[int] | None = None) -> Unknowns:
        """Return the shared unknowns with the state that fits each segment best."""
        found = []
        for chosen in self._by_segment(pieces):
            states, columns, target = self._stacked(chosen)
            unit, size = _unit_columns(states)
            state = sla.lstsq(unit, target - columns @ shared, cond=SOLVE_TOLERANCE)[0] / size
            found.append(state)
        return Unknowns(shared, np.array(found))

    def squares(self, unknowns: Unknowns, pieces: Sequence[int] | None = None) -> Floats:
        """Return Σ e eᵀ (p, p), unweighted, over some or all pieces."""
        total = np.zeros((self._p, self._p))
        back = np.linalg.inv(self.weight)
        for chosen, state in zip(self._by_segment(pieces), unknowns.states, strict=True):
            for k in chosen:
                own, columns, target, rest = self._parts[k]
                missing = target - columns @ unknowns.shared - own @ state
                error = back @ missing.reshape(self._p, -1)
                total += error @ error.T + rest.T @ rest
        return total

    def _by_segment(self, pieces: Sequence[int] | None) -> list[list[int]]:
        groups: dict[int, list[int]] = {}
        for k in range(len(self.pieces)) if pieces is None else pieces:
            groups.setdefault(self.pieces[k].owner, []).append(k)
        return list(groups.values())

    def _stacked(self, chosen: Sequence[int]) -> tuple[Floats, Floats, Floats]:
        parts = [self._parts[k] for k in chosen]
        return (
            np.vstack([part[0] for part in parts]),
            np.vstack([part[1] for part in parts]),
            np.concatenate([part[2] for part in parts]),
        )

    def covariance(self, unknowns: Unknowns) -> Floats:
        """Return the covariance of the errors, degrees of freedom taken off."""
        used = (self.n_shared + unknowns.states.size) / self._p
        samples = sum(piece.stop - piece.start for piece in self.pieces)
        return self.squares(unknowns) / max(1.0, samples - used)

    def unpack(self, shared: Floats) -> tuple[Floats, Floats, Floats]:
        """Return offset (p,), D (p, m) and B in modal coordinates (n, m)."""
        p, m = self._p, self.n_inputs
        cut = self.constant * p
        offset = shared[:cut] if cut else np.zeros(p)
        D = np.zeros((p, m))
        last = cut + int(self.feedthrough.sum()) * m
        D[self.feedthrough] = shared[cut:last].reshape(int(self.feedthrough.sum()), m)
        return offset, D, shared[last:].reshape(m, self._n).T

    def pack(self, offset: Floats, D: Floats, B: Floats) -> Floats:
        """Return `shared` of given parts: the inverse of `unpack`."""
        first = offset if self.constant else offset[:0]
        return np.concatenate([first, D[self.feedthrough].ravel(), B.T.ravel()])


def _without(columns: Floats, matrix: Floats) -> Floats:
    """Return what the columns cannot explain of a matrix; columns may be dependent or zero."""
    unit, _ = _unit_columns(columns)
    Q, R, _ = sla.qr(unit, mode="economic", pivoting=True, check_finite=False)
    size = np.abs(np.diag(R))
    Q = Q[:, size > SOLVE_TOLERANCE * max(size[0], 1e-300)]
    return np.asarray(matrix - Q @ (Q.T @ matrix))


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
