"""BlockGram: everything a subspace method needs to know of a record, in a few matrices."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..chunks import Segment
from ..errors import OptionError, check_whole
from ..record import Floats

ROUNDING_SHARE = 1e-13  # of a channel's largest square sum: what rounding leaves of no motion


@dataclass(frozen=True, eq=False)
class BlockGram:
    """Hold lagged sums of z = [u; y] for consecutive time blocks.

    The Gram matrix of the block Hankel, G = Σ_t h(t) h(t)ᵀ with h(t) = [z(t); …; z(t+L−1)],
    follows exactly from the lagged sums R[l] = Σ_t z(t) z(t+l)ᵀ over its columns and the
    L − 1 samples at each edge, because moving one block row down and right adds the last and
    drops the first product: G[k+1, l+1] = G[k, l] + z(j+k) z(j+l)ᵀ − z(k) z(l)ᵀ.
    Sums of blocks, gaps, records and machines are sums of these.

    Attributes
    ----------
    lags : array (n_blocks, n_rows, c, c)
        R[l] of each time block; c = n_inputs + n_outputs.
    sums : array (n_blocks, c)
        Σ_t z(t) over the block's columns.
    heads, tails : array (n_blocks, n_rows − 1, c)
        The block's first samples, and those from its column count on.
    columns : array (n_blocks,)
        How many Hankel columns each block has.
    owners : array (n_blocks,)
        Which segment each block belongs to.
    segments : tuple of Segment
    centre, scale : array (c,)
        z = (measured − centre) / scale.
    n_inputs : int
    offset : str
        "estimate" projects a constant out of every Hankel row, segment by segment.
    """

    lags: Floats
    sums: Floats
    heads: Floats
    tails: Floats
    columns: np.ndarray[tuple[int], np.dtype[np.int64]]
    owners: np.ndarray[tuple[int], np.dtype[np.int64]]
    segments: tuple[Segment, ...]
    centre: Floats
    scale: Floats
    n_inputs: int
    offset: str

    def __repr__(self) -> str:
        return (
            f"<BlockGram: {self.n_rows} block rows of {self.n_channels} channels, "
            f"{self.n_columns} columns in {len(self.columns)} blocks>"
        )

    @property
    def n_rows(self) -> int:
        """Block rows of the Hankel matrix."""
        return int(self.lags.shape[1])

    @property
    def n_channels(self) -> int:
        return int(self.lags.shape[2])

    @property
    def n_outputs(self) -> int:
        return self.n_channels - self.n_inputs

    @property
    def n_columns(self) -> int:
        return int(self.columns.sum())

    @cached_property
    def projected_columns(self) -> int:
        """Columns left after the constant of every segment is projected out."""
        used = len(self._used) if self.offset == "estimate" else 0
        return self.n_columns - used

    def shorten(self, n_rows: int) -> BlockGram:
        """Return the Gram of the first `n_rows` block rows over the same columns."""
        check_whole("n_rows", n_rows, 1, self.n_rows)
        return replace(
            self,
            lags=self.lags[:, :n_rows],
            heads=self.heads[:, : n_rows - 1],
            tails=self.tails[:, : n_rows - 1],
        )

    def __add__(self, other: BlockGram) -> BlockGram:
        """Join the Grams of other segments, reduced with the same centre and scale."""
        same = np.array_equal(self.scale, other.scale) and np.array_equal(self.centre, other.centre)
        if not same or self.n_rows != other.n_rows or self.offset != other.offset:
            raise OptionError(
                "Only Grams with the same block rows, offset rule, centre and scale add up; "
                "reduce both from one stream."
            )
        return replace(
            self,
            lags=np.concatenate([self.lags, other.lags]),
            sums=np.concatenate([self.sums, other.sums]),
            heads=np.concatenate([self.heads, other.heads]),
            tails=np.concatenate([self.tails, other.tails]),
            columns=np.concatenate([self.columns, other.columns]),
            owners=np.concatenate([self.owners, other.owners + len(self.segments)]),
            segments=self.segments + other.segments,
        )

    def covariances(self) -> Floats:
        """Return Σ z(t) z(t+l)ᵀ over all columns, constants projected out: (n_rows, c, c)."""
        total = self.lags.sum(axis=0)
        if self.offset == "estimate":
            rows = self._row_sums().reshape(len(self._used), self.n_rows, self.n_channels)
            scaled = rows[:, 0] / self._lengths[:, None]
            total = total - np.einsum("sa,slb->lab", scaled, rows)
        return np.asarray(total)

    def matrix(self) -> Floats:
        """Return the Gram (n_rows · c, n_rows · c), rows ordered by lag, then channel.

        A row that holds nothing but a constant, or but rounding beside the channel's largest
        row (a force that acts once, before the row begins), comes out as exact zeros.
        """
        gram = self._expanded()
        size = gram.diagonal().reshape(self.n_rows, self.n_channels).max(axis=0)
        if self.offset == "estimate":
            rows = self._row_sums()
            gram -= (rows / self._lengths[:, None]).T @ rows
        left = gram.diagonal().reshape(self.n_rows, self.n_channels)
        still = (left <= ROUNDING_SHARE * size).ravel()
        if still.any():
            gram[still, :] = 0
            gram[:, still] = 0
        return gram

    @cached_property
    def _used(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """The segments that have columns."""
        return np.unique(self.owners)

    @cached_property
    def _lengths(self) -> Floats:
        """Columns of each used segment."""
        return np.add.reduceat(self.columns, self._starts).astype(float)

    @cached_property
    def _starts(self) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """The first block of each used segment; its blocks follow each other."""
        return np.searchsorted(self.owners, self._used)

    @cached_property
    def _edges(self) -> tuple[Floats, Floats]:
        """Return first and last samples of each used segment (n_used, (n_rows − 1) · c).

        Inner edges cancel.
        """
        last = np.searchsorted(self.owners, self._used, side="right") - 1
        flat = (len(self._used), (self.n_rows - 1) * self.n_channels)
        return self.heads[self._starts].reshape(flat), self.tails[last].reshape(flat)

    def _row_sums(self) -> Floats:
        """Return the sum of every Hankel row over each used segment (n_used, n_rows · c)."""
        c, used = self.n_channels, len(self._used)
        head, tail = self._edges
        first = np.add.reduceat(self.sums, self._starts, axis=0)
        steps = (tail - head).reshape(used, self.n_rows - 1, c)
        later = first[:, None, :] + np.cumsum(steps, axis=1)
        return np.concatenate([first[:, None, :], later], axis=1).reshape(used, -1)

    def _expanded(self) -> Floats:
        """Return the Gram by displacement, one block row from the one above it."""
        c, n = self.n_channels, self.n_rows
        head, tail = self._edges
        gram = np.empty((n * c, n * c))
        first = self.lags.sum(axis=0).transpose(1, 0, 2).reshape(c, n * c)
        gram[:c], gram[:, :c] = first, first.T
        gram[c:, c:] = np.concatenate([tail, head]).T @ np.concatenate([tail, -head])
        by_lag = gram.reshape(n, c, n * c)
        for k in range(n - 1):
            by_lag[k + 1, :, c:] += by_lag[k, :, :-c]
        return gram
