"""A transition matrix as real 2 × 2 companion blocks, and small steps of it.

Symbols: a block is A = [[r, s], [−s b, r]], the companion matrix of (μ² + b) in the shifted
and scaled variable μ = (q − r) / s: a complex pair r ± is for b = 1, two real poles r ± s for
b = −1. A step (β₁, β₂) makes it [[r − s β₁, s], [−s (b + β₂), r]], so that every pair of poles
in the neighbourhood is reached smoothly, pairs that become real and real poles that become a
pair included. Every step ends by new r, s, b for the poles reached: the states stay balanced
however slow the poles are. In an odd order one block is single: its first state rests.

An undamped block has its pair on the circle: β₂ = r β₁ / s keeps it there exactly.

B and the initial states of a block may be multiplied by any matrix that commutes with it
(C takes the inverse), so two directions of each block change nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..record import Floats

SPREAD_FLOOR = 0.1  # of the distance to the circle: nearer real poles share the block's scale
LARGEST_POLE = 1 - 1e-9
CLOSEST = 1e-12  # of eigenvectors' conditioning: beyond it poles coincide to working precision


@dataclass(frozen=True, eq=False)
class Blocks:
    """The states of a discrete model, block by block: all but what is linear.

    Attributes
    ----------
    centre, spread, shape : array (n_blocks,)
        r, s, b of each block; a single block has its pole in r.
    single : array of bool (n_blocks,)
    inputs : array (m, n_blocks, 2)
        B.
    starts : array (n_segments, n_blocks, 2)
        Initial states.
    undamped : array of bool (n_blocks,)
        Which blocks keep a complex pair on the unit circle.
    slowest : float
        Largest magnitude that real poles may have.
    """

    centre: Floats
    spread: Floats
    shape: Floats
    single: NDArray[np.bool_]
    inputs: Floats
    starts: Floats
    undamped: NDArray[np.bool_]
    slowest: float = LARGEST_POLE

    @property
    def n_blocks(self) -> int:
        return len(self.centre)

    @cached_property
    def used(self) -> NDArray[np.bool_]:
        """Which states (n_blocks, 2) exist."""
        return np.column_stack([~self.single, np.ones(self.n_blocks, dtype=bool)])

    @property
    def order(self) -> int:
        return int(self.used.sum())

    @cached_property
    def transition(self) -> Floats:
        """A of each block (n_blocks, 2, 2)."""
        r, s, b = self.centre, self.spread, self.shape
        A = np.array([[r, s], [-s * b, r]]).transpose(2, 0, 1)
        A[self.single] *= np.array([[0.0, 0.0], [0.0, 1.0]])
        return np.asarray(A)

    @cached_property
    def poles(self) -> NDArray[np.complex128]:
        """Discrete poles (order,)."""
        root = self.spread * np.sqrt(-self.shape.astype(complex))
        both = np.column_stack([self.centre - root, self.centre + root])
        both[self.single] = self.centre[self.single, None]
        return np.asarray(both[self.used])

    def select(self, kept: NDArray[np.bool_]) -> Blocks:
        """Return some of the blocks."""
        return replace(
            self,
            centre=self.centre[kept],
            spread=self.spread[kept],
            shape=self.shape[kept],
            single=self.single[kept],
            inputs=self.inputs[:, kept],
            starts=self.starts[:, kept],
            undamped=self.undamped[kept],
        )

    def on_circle(self, undamped: NDArray[np.bool_]) -> Blocks:
        """Return the blocks with some pairs moved onto the unit circle, to be held there."""
        centre, square = self.centre, -self.shape * self.spread**2
        size = np.where(undamped, np.sqrt(np.maximum(centre**2 - square, 1e-300)), 1)
        held = replace(self, undamped=undamped)
        centre, square = held._bounded(centre / size, square / size**2)
        spread, shape = _scaled(centre, square, self.single, self.spread)
        return replace(held, centre=centre, spread=spread, shape=shape)

    @property
    def tie(self) -> Floats:
        """r / s of the undamped blocks: what β₂ is of β₁; 0 of the others."""
        return np.where(self.undamped, self.centre / self.spread, 0.0)

    def matrices(self) -> tuple[Floats, Floats, Floats]:
        """Return A (n, n), B (n, m) and the initial states (n_segments, n)."""
        A = np.zeros((self.n_blocks, 2, self.n_blocks, 2))
        each = np.arange(self.n_blocks)
        A[each, :, each, :] = self.transition
        used = self.used.ravel()
        A = A.reshape(len(used), len(used))[np.ix_(used, used)]
        flat = (-1, len(used))
        return A, self.inputs.reshape(flat)[:, used].T, self.starts.reshape(flat)[:, used]

    def moved(self, step: Floats) -> tuple[Blocks, Floats]:
        """Return the blocks after a step, and what takes their states there.

        Parameters
        ----------
        step : array (1 + m + n_segments, n_blocks, 2)
            (β₁, β₂) of each block, then changes of B input by input, then of initial states;
            β₂ of an undamped block does not count.

        Returns
        -------
        Blocks
            Poles outside the bounds are moved onto them.
        array (n_blocks, 2, 2)
            T of x_new = T x_old.
        """
        m, (first, second) = len(self.inputs), step[0].T
        second = np.where(self.undamped, self.tie * first, second)
        r, s = self.centre, self.spread
        single = self.single
        centre = np.where(single, r - s * second, r - s * first / 2)
        square = np.where(single, 0, s**2 * (first**2 / 4 - self.shape - second))
        centre, square = self._bounded(centre, square)
        spread, shape = _scaled(centre, square, single, s)
        T = np.zeros((self.n_blocks, 2, 2))
        T[:, 0, 0], T[:, 1, 1] = spread / s, 1
        T[:, 1, 0] = np.where(single, 0, (centre - r) / s)
        moved = replace(
            self,
            centre=centre,
            spread=spread,
            shape=shape,
            inputs=_turned(self.inputs + self.used * step[1 : 1 + m], T),
            starts=_turned(self.starts + self.used * step[1 + m :], T),
        )
        return moved, T

    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        """Tell which blocks have a pole at its bound that the step would move on outwards."""
        free = replace(self, slowest=np.inf).moved(step)[0]
        outwards = (self._excess() > -1e-3 * self._room()) & (free._excess(self.slowest) > 0)
        return np.asarray(outwards & ~self.undamped)

    def _room(self) -> Floats:
        size = self._sizes()[0]
        return np.maximum(1 - size, 1e-12)

    def _sizes(self) -> tuple[Floats, NDArray[np.bool_]]:
        """Return the largest magnitude of each block's poles, and which are real."""
        real = self.single | (self.shape < 0)
        root = self.spread * np.sqrt(np.abs(self.shape))
        size = np.where(real, np.abs(self.centre) + root, np.hypot(self.centre, root))
        return np.where(self.single, np.abs(self.centre), size), real

    def _excess(self, slowest: float | None = None) -> Floats:
        size, real = self._sizes()
        bound = self.slowest if slowest is None else slowest
        return np.asarray(size - np.where(real, min(bound, LARGEST_POLE), LARGEST_POLE))

    def _bounded(self, centre: Floats, square: Floats) -> tuple[Floats, Floats]:
        """Move poles centre ± √square inside the bounds."""
        if np.isinf(self.slowest):
            return centre, square
        pair = square < 0
        size = np.sqrt(np.maximum(centre**2 - square, 0))
        shrink = np.where(pair & (size > LARGEST_POLE), LARGEST_POLE / np.maximum(size, 1), 1)
        root = np.sqrt(np.maximum(square, 0))
        low = np.clip(centre - root, -self.slowest, self.slowest)
        high = np.clip(centre + root, -self.slowest, self.slowest)
        on_circle = np.clip(centre, -LARGEST_POLE, LARGEST_POLE)
        inside = np.where(pair, shrink * centre, (low + high) / 2)
        part = np.where(pair, shrink**2 * square, (high - low) ** 2 / 4)
        return (
            np.where(self.undamped, on_circle, inside),
            np.where(self.undamped, on_circle**2 - 1, part),
        )


def _scaled(
    centre: Floats, square: Floats, single: NDArray[np.bool_], spread: Floats
) -> tuple[Floats, Floats]:
    """Return s and b of poles centre ± √square; a single block keeps its scale."""
    floor = SPREAD_FLOOR * np.abs(1 - np.abs(centre)) + 1e-9
    s = np.where(single, floor, np.maximum(np.sqrt(np.abs(square)), floor))
    return s, np.where(single, 1, -square / s**2)


def _turned(vectors: Floats, T: Floats) -> Floats:
    return np.asarray(np.einsum("bij,kbj->kbi", T, vectors))


def split_poles(
    A: Floats,
    B: Floats,
    starts: Floats,
    slowest: float = LARGEST_POLE,
    *,
    pair_real: bool = True,
) -> Blocks:
    """Return the blocks of a state-space model; poles outside the circle are reflected.

    Real poles are paired by magnitude with their neighbours, the last one left over is
    single. Where eigenvectors nearly coincide the blocks only come near the model: they are a
    start, whose outputs are fitted anew.

    Parameters
    ----------
    A, B : arrays (n, n), (n, m)
    starts : array (n_segments, n)
    slowest : float
        Largest magnitude of real poles.
    pair_real : bool
        Whether two real poles share a block; else each has its own, and none can leave the axis.

    Examples
    --------
    >>> blocks = split_poles(np.diag([0.9, 0.5, 0.2]), np.ones((3, 1)), np.zeros((1, 3)))
    >>> np.sort(blocks.poles.real)
    array([0.2, 0.5, 0.9])
    """
    values, vectors = _eigen(A)
    modal = np.linalg.solve(vectors, np.hstack([B, starts.T]).astype(complex)).T
    pairs = np.flatnonzero(values.imag > 0)
    real = np.flatnonzero(values.imag == 0)
    real = real[np.argsort(-values[real].real, kind="stable")]
    n_pairs, n_both = len(pairs), (len(real) // 2) * pair_real
    count = n_pairs + len(real) - n_both
    centre, square = np.zeros(count), np.zeros(count)
    single = np.arange(count) >= n_pairs + n_both
    drive = np.zeros((len(modal), count, 2))
    centre[:n_pairs], square[:n_pairs] = values[pairs].real, -(values[pairs].imag ** 2)
    drive[:, :n_pairs] = np.stack([2 * modal[:, pairs].real, -2 * modal[:, pairs].imag], -1)
    one, two = real[0 : 2 * n_both : 2], real[1 : 2 * n_both : 2]
    both = slice(n_pairs, n_pairs + n_both)
    centre[both] = (values[one] + values[two]).real / 2
    square[both] = (values[one] - values[two]).real ** 2 / 4
    centre[single] = values[real[2 * n_both :]].real
    drive[:, single, 1] = modal[:, real[2 * n_both :]].real
    spread, shape = _scaled(centre, square, single, np.ones(count))
    # eigenvectors of a block with real poles are (s, ± half their difference)
    half = np.sqrt(np.maximum(square[both], 0))
    first, second = modal[:, one].real, modal[:, two].real
    drive[:, both] = np.stack([spread[both] * (first + second), half * (first - second)], -1)
    m = B.shape[1]
    free = np.zeros(count, dtype=bool)
    return _inside(Blocks(centre, spread, shape, single, drive[:m], drive[m:], free, slowest))


def _eigen(A: Floats) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return eigenvalues and vectors, coinciding poles parted so that all vectors exist."""
    for nudge in (0.0, 1e-9, 1e-6):
        values, vectors = np.linalg.eig(A + nudge * np.diag(np.linspace(-1, 1, len(A))))
        if np.linalg.cond(vectors) < 1 / CLOSEST:
            break
    return values.astype(complex), vectors.astype(complex)


def _inside(blocks: Blocks) -> Blocks:
    """Reflect poles outside the circle, then move all inside the bounds; states stay."""
    pair = ~blocks.single & (blocks.shape > 0)
    square = np.where(blocks.single, 0, -blocks.shape * blocks.spread**2)
    root = np.sqrt(np.maximum(square, 0))
    low, high = (_reflected(blocks.centre + sign * root) for sign in (-1, 1))
    shrink = np.maximum(blocks.centre**2 - square, 1)
    centre = np.where(pair, blocks.centre / shrink, (low + high) / 2)
    square = np.where(pair, square / shrink**2, (high - low) ** 2 / 4)
    centre, square = blocks._bounded(centre, square)
    spread, shape = _scaled(centre, square, blocks.single, blocks.spread)
    return replace(blocks, centre=centre, spread=spread, shape=shape)


def _reflected(real_poles: Floats) -> Floats:
    size = np.abs(real_poles)
    return np.asarray(np.where(size > 1, real_poles / np.maximum(size, 1) ** 2, real_poles))
