"""Reduce a piece of data to the triangle of its basis signals, a block of samples at a time.

The columns [1, u, ξ, decay, target] of the T samples of a block are linear in the block's
samples z and the filters' states x at its start. So a piece is reduced to a root of the Gram of
[1, z, x], one row a block, and only this root is expanded to the columns: several times fewer
products than making the columns and multiplying them, and no less exact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..gram import scaled_cholesky, stacked_qr, triangle_of
from ..linalg import one_blas_thread, semidefinite_root
from ..record import Floats
from ..statespace import Lifting, block_states
from .modal_basis import ModalBasis

NEGLIGIBLE = 1e-100  # size of a decay that has vanished
CHUNK_ELEMENTS = 2**18  # of the rows made at a time: they stay in the cache
SHORTEST_BLOCK, LONGEST_BLOCK = 8, 64


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
class States:
    """Filter states: of ξ for each input and the decay (m + 1, n), and of the target (n,)."""

    modal: Floats
    target: Floats


@dataclass(frozen=True, eq=False)
class Filters:
    """What makes the columns: ξ = (q − Λ)⁻¹ e u, decay = Λᵗ e, target = y − C (q − Ã)⁻¹ K y.

    Attributes
    ----------
    modal : Lifting
        From u to ξ.
    target : Lifting or None
        From y to the target; None where the target is y itself.
    start : array (n,)
        e.
    constant : 1 with a column of ones, else 0
    """

    modal: Lifting
    target: Lifting | None
    start: Floats
    n_inputs: int
    n_outputs: int
    constant: int

    @property
    def block(self) -> int:
        """Samples of a block, T."""
        return int(self.modal.block)

    @property
    def n_columns(self) -> int:
        """Columns [1, u, ξ, decay, target]."""
        n, m = self.modal.n, self.n_inputs
        return int(self.constant + m + (m + 1) * n + self.n_outputs)

    @property
    def n_lifted(self) -> int:
        """Columns of [1, z, x]."""
        n_systems = self.n_inputs + 1 + (self.target is not None)
        channels = self.n_inputs + self.n_outputs
        return int(self.constant + self.block * channels + n_systems * self.modal.n)

    def at_rest(self) -> States:
        """Return the states at the start of a segment."""
        modal = np.zeros((self.n_inputs + 1, self.modal.n))
        modal[-1] = self.start
        return States(modal, np.zeros(self.modal.n))

    def lift(self, z: Floats, states: States) -> tuple[Floats, States]:
        """Return the rows [1, z, x target, x inputs, x decay] of whole blocks, and the states."""
        T, m, n, one = self.block, self.n_inputs, self.modal.n, self.constant
        count, first = len(z) // T, one + T * z.shape[1]
        rows = np.empty((count, self.n_lifted))
        rows[:, :one] = 1
        rows[:, one:first] = z.reshape(count, T * z.shape[1])
        target = states.target
        if self.target is not None:
            drives = z[:, m:].reshape(count, T * self.n_outputs) @ self.target.to_state
            before = rows[:, None, first : first + n]
            target = block_states(self.target.power, drives[:, None], target[None], before)[0]
        drives = np.zeros((count, m + 1, n))
        drives[:, :m] = z[:, :m].reshape(count, T, m).transpose(0, 2, 1) @ self.modal.to_state
        before = rows[:, self.n_lifted - (m + 1) * n :].reshape(count, m + 1, n)
        modal = block_states(self.modal.power, drives, states.modal, before)
        modal[np.abs(modal).max(axis=1) < NEGLIGIBLE] = 0
        return rows, States(modal, target)

    def expand(self, rows: Floats) -> Floats:
        """Return the columns of every sample of lifted rows (k · T, n_columns)."""
        T, m, p, n = self.block, self.n_inputs, self.n_outputs, self.modal.n
        k, first = len(rows), self.constant + T * (m + p)
        z = rows[:, self.constant : first].reshape(k, T, m + p)
        x = rows[:, rows.shape[1] - (m + 1) * n :].reshape(k, m + 1, n)
        pushed = np.zeros((k, m + 1, T + n))
        pushed[:, :m, :T] = z[:, :, :m].transpose(0, 2, 1)
        pushed[:, :, T:] = x
        signals = (pushed @ self.modal.to_outputs).reshape(k, m + 1, T, n)
        target = z[:, :, m:]
        if self.target is not None:
            both = np.hstack([target.reshape(k, T * p), rows[:, first : first + n]])
            target = (both @ self.target.to_outputs).reshape(k, T, p)
        ones = np.repeat(rows[:, None, : self.constant], T, axis=1)
        spread = signals.transpose(0, 2, 1, 3).reshape(k, T, (m + 1) * n)
        columns = np.concatenate([ones, z[:, :, :m], spread, target], axis=2)
        return np.asarray(columns.reshape(k * T, self.n_columns))

    def rest(self, z: Floats, states: States) -> tuple[Floats, States]:
        """Return the columns of fewer samples than a block, and the states after them."""
        m = self.n_inputs
        padded = np.zeros((self.block, z.shape[1]))
        padded[: len(z)] = z
        columns = self.expand(self.lift(padded, states)[0])[: len(z)]
        modal, target = states.modal, states.target
        for sample in z:
            pushed = np.append(sample[:m], 0.0)[:, None] * self.start
            modal = modal @ self.modal.A.T + pushed
            if self.target is not None:
                target = self.target.A @ target + self.target.B @ sample[m:]
        return columns, States(modal, target)


def make_filters(
    basis: ModalBasis, A: Floats, C: Floats, gain: Floats, n_inputs: int, constant: int
) -> Filters:
    """Return the filters of A, or of A − K C for prediction, whose modal form `basis` is."""
    n, p = A.shape[0], C.shape[0]
    systems = n_inputs + 1 + bool(gain.any())
    # T samples and the states: about as many columns of each is cheapest
    even = systems * n / (n_inputs + p)
    T = int(np.clip(2 ** np.ceil(np.log2(even)), SHORTEST_BLOCK, LONGEST_BLOCK))
    modal = Lifting(basis.blocks, basis.start[:, None], np.eye(n), np.zeros((n, 1)), T)
    target = Lifting(A, -gain, C, np.eye(p), T) if gain.any() else None
    return Filters(modal, target, basis.start, n_inputs, p, constant)


def reduce_piece(
    stream: Stream, piece: Piece, filters: Filters, states: States
) -> tuple[Floats, States]:
    """Return the triangle of the piece's columns, and the filters' states after it."""
    walk = _Walk(stream, piece, filters, states)
    blocks = [filters.expand(_root(walk, filters)), walk.rest]
    return triangle_of(lambda: iter(blocks), filters.n_columns), walk.last


def _root(walk: _Walk, filters: Filters) -> Floats:
    """Return a root of the Gram of the lifted rows: these themselves where they are few.

    Where the samples and the states they drive allow no Cholesky, by QR in a second pass. The
    decays may well coincide at the blocks' starts: their part is only semidefinite.
    """
    width, n = filters.n_lifted, filters.modal.n
    if walk.n_blocks <= width:
        return np.vstack([np.zeros((0, width)), *walk.rows()])
    gram = np.zeros((width, width))
    with one_blas_thread():
        for rows in walk.rows():
            used = rows if rows[0, -n:].any() else rows[:, :-n]
            gram[: used.shape[1], : used.shape[1]] += used.T @ used
        if scaled_cholesky(gram[:-n, :-n])[0] is None:
            return stacked_qr(walk.rows(), width)
        return semidefinite_root(gram)


class _Walk:
    """Lifted rows of one piece, as often as asked; then its last samples and states."""

    def __init__(self, stream: Stream, piece: Piece, filters: Filters, states: States) -> None:
        self.stream, self.piece, self.filters, self.first = stream, piece, filters, states
        self.n_blocks = (piece.stop - piece.start) // filters.block
        self.rest: NDArray[np.float64] = np.zeros((0, filters.n_columns))
        self.last = states

    def rows(self) -> Iterator[Floats]:
        """Yield the lifted rows chunk after chunk, states carried on."""
        filters, piece, states = self.filters, self.piece, self.first
        segment = self.stream.segments[piece.owner]
        whole = piece.start + self.n_blocks * filters.block
        step = filters.block * max(16, CHUNK_ELEMENTS // filters.n_lifted)
        for start in range(piece.start, whole, step):
            z = self.stream.read(segment, start, min(start + step, whole))
            rows, states = filters.lift(z, states)
            yield rows
        if whole < piece.stop:
            z = self.stream.read(segment, whole, piece.stop)
            self.rest, states = filters.rest(z, states)
        self.last = states
