"""Layout: where each block-Hankel row stands in the factor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Layout:
    """Where each Hankel row stands in the factor: [U_f; W_p; Y_f], each ordered by lag."""

    past_rows: int
    future_rows: int
    n_inputs: int
    n_outputs: int
    past_channels: tuple[int, ...]

    @property
    def n_rows(self) -> int:
        return self.past_rows + self.future_rows

    @property
    def n_channels(self) -> int:
        return self.n_inputs + self.n_outputs

    @cached_property
    def rows(self) -> NDArray[np.int64]:
        """Indices lag · n_channels + channel in factor order."""
        lags = np.arange(self.n_rows)[:, None] * self.n_channels
        past, future = lags[: self.past_rows], lags[self.past_rows :]
        inputs, outputs = np.arange(self.n_inputs), self.n_inputs + np.arange(self.n_outputs)
        return np.concatenate(
            [
                (future + inputs).ravel(),
                (past + np.array(self.past_channels)).ravel(),
                (future + outputs).ravel(),
            ]
        )

    @cached_property
    def _places(self) -> NDArray[np.int64]:
        places = np.full(self.n_rows * self.n_channels, -1)
        places[self.rows] = np.arange(len(self.rows))
        return places.reshape(self.n_rows, self.n_channels)

    @property
    def n_future_inputs(self) -> int:
        return self.future_rows * self.n_inputs

    @property
    def n_past(self) -> int:
        return self.past_rows * len(self.past_channels)

    @property
    def largest_order(self) -> int:
        """Most states that the rows can tell apart; shift invariance needs one row less."""
        return min((self.future_rows - 1) * self.n_outputs, self.n_past)

    @cached_property
    def past(self) -> NDArray[np.int64]:
        """The factor columns of W_p."""
        return self.n_future_inputs + np.arange(self.n_past)

    @cached_property
    def next_past(self) -> NDArray[np.int64]:
        """The factor columns of W_p, moved one sample on."""
        return self._places[1 : self.past_rows + 1, self.past_channels].ravel()

    def inputs(self, step: int) -> NDArray[np.int64]:
        """Return the factor columns of u at future step `step`."""
        return self._places[self.past_rows + step, : self.n_inputs]

    def outputs(self, step: int) -> NDArray[np.int64]:
        """Return the factor columns of y at future step `step`."""
        return self._places[self.past_rows + step, self.n_inputs :]
