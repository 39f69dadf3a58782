"""Make the signals of a model chunk by chunk, and sum their products."""

from __future__ import annotations

import numpy as np

from ..record import Floats
from .blocks import Blocks
from .filters import STRETCH, BlockFilter
from .projection import Linear, Sums, mixing

CHUNK_ELEMENTS = 2**19  # of the signals made at a time: they stay in the cache
VANISHED = 1e-18  # of its start: a decay that adds nothing from here on


class SignalSums:
    """Sum products over segments: `begin` each, `add` its samples in turn, then `total`.

    Parameters
    ----------
    blocks : Blocks
    linear : Linear
        The model whose errors are the target.

    Attributes
    ----------
    rows : int
        Samples of a chunk: `add` takes any multiple of it, and at last the rest.
    """

    def __init__(self, blocks: Blocks, linear: Linear) -> None:
        self.blocks, self.linear = blocks, linear
        self._filter = BlockFilter(blocks.transition)
        self._mixing = mixing(blocks)
        self._m, p = linear.direct.shape
        self._constant = int(len(linear.constants) > 0)
        k = blocks.n_blocks
        # decay, responses, W; then u, 1, e
        self._n_signals = 2 * k * (self._m + 2)
        self._width = self._n_signals + self._m + self._constant + p
        families = 1 + self._m + len(blocks.starts)
        rest = self._m + len(linear.constants) + p
        self._gram = np.zeros((2 * k * families + rest,) * 2)
        stretches = max(1, CHUNK_ELEMENTS // (self._width * STRETCH))
        self.rows: int = STRETCH * stretches

    def begin(self, segment: int, record: int) -> None:
        """Start a segment: its decay and its record's constant from here on."""
        k = self.blocks.n_blocks
        self._segment, self._record = segment, record
        self._states = np.zeros((1 + self._m, k, 2))
        self._states[0, :, 1] = 1
        self._driven = np.zeros((k, 2))
        self._columns = self._places(segment, record)

    def _places(self, segment: int, record: int) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
        """Return where the columns of a segment stand among all."""
        k, m = self.blocks.n_blocks, self._m
        families = [1 + m + segment, *range(1, 1 + m), 0]
        signals = [2 * k * family + np.arange(2 * k) for family in families]
        first = 2 * k * (1 + m + len(self.blocks.starts))
        records = len(self.linear.constants)
        errors = first + m + records + np.arange(self._width - self._n_signals - m - self._constant)
        constant = np.arange(self._constant) + first + m + record * self._constant
        return np.concatenate([*signals, first + np.arange(m), constant, errors])

    def add(self, samples: Floats) -> None:
        """Take samples [u, y] (n_samples, m + p) that follow those before."""
        for start in range(0, len(samples), self.rows):
            self._add(samples[start : start + self.rows])

    def _add(self, samples: Floats) -> None:
        count, m = len(samples), self._m
        padded = -(-count // STRETCH) * STRETCH
        z = np.zeros((samples.shape[1], padded))
        z[:, :count] = samples.T
        table = np.empty((self._width, padded))
        skipped = int(np.abs(self._states[0]).max() < VANISHED)
        k = self.blocks.n_blocks
        signals = table[: self._n_signals].reshape(m + 2, k, 2, padded)
        x = self._fill(z[:m], signals, skipped)
        rest = table[self._n_signals :]
        rest[:m] = z[:m]
        rest[m : m + self._constant] = 1
        rest[m + self._constant :] = z[m:] - self._modelled(x, rest[: m + self._constant])
        used = table[2 * k * skipped :, :count]
        columns = self._columns[2 * k * skipped :]
        self._gram[np.ix_(columns, columns)] += used @ used.T

    def _fill(self, u: Floats, signals: Floats, skipped: int) -> Floats:
        """Fill the signals of a chunk and return the states (2 n_blocks, rows)."""
        drives = np.concatenate([np.zeros((1 - skipped, u.shape[1])), u])[:, None]
        run = slice(skipped, 1 + self._m)
        if len(drives):
            self._states[run] = self._filter.run(drives, self._states[run], signals[run])
        start, m = self._segment, self._m
        matrices = np.concatenate([self._mixing[m + start][None], self._mixing[:m]])
        x = np.zeros(signals.shape[1:])
        for matrix, signal in zip(matrices[run], signals[run], strict=True):
            x += matrix @ signal
        first = np.where(self.blocks.single[:, None], x[:, 1], x[:, 0])
        self._driven = self._filter.run(first, self._driven, signals[-1])
        return np.asarray(x.reshape(-1, signals.shape[-1]))

    def _modelled(self, x: Floats, rest: Floats) -> Floats:
        linear, p = self.linear, self.linear.direct.shape[1]
        constant = linear.constants[self._record : self._record + self._constant]
        rows = np.concatenate([linear.states.reshape(-1, p), linear.direct, constant])
        return np.asarray(rows.T @ np.concatenate([x, rest]))

    def total(self) -> Sums:
        """Return the sums over all segments."""
        return Sums(self._gram, self.blocks, self.linear)
