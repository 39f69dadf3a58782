"""Observer Markov parameters of every order from one triangular factor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ...chunks import Stream
from ...gram import BlockGram, Factor, factorize
from ...linalg import RANK_TOLERANCE
from ...record import Floats

NOISE_FREE = 1e-8  # innovation over output, rms: below it rounding outweighs the noise


@dataclass(frozen=True, eq=False)
class Regression:
    """The triangle R of [z(t−1), …, z(t−P), z(t)] over all t that have P samples before them.

    The present sample stands last, so that the rows of R below the first k blocks hold what
    k past samples leave of it: regressions of all observer orders are nested, with and
    without the present input among the regressors.

    Attributes
    ----------
    factor : Factor
    n_inputs, n_outputs, n_columns : int
    feedthrough : array of bool (n_outputs,)
        Which outputs the present input enters.
    """

    factor: Factor
    n_inputs: int
    n_outputs: int
    n_columns: int
    feedthrough: NDArray[np.bool_]

    @property
    def triangle(self) -> Floats:
        return self.factor.triangle

    @property
    def n_channels(self) -> int:
        return self.n_inputs + self.n_outputs

    @property
    def largest_order(self) -> int:
        """Past samples that the triangle holds."""
        return len(self.triangle) // self.n_channels - 1

    @cached_property
    def past(self) -> slice:
        return slice(0, len(self.triangle) - self.n_channels)

    @cached_property
    def inputs(self) -> slice:
        return slice(self.past.stop, self.past.stop + self.n_inputs)

    @cached_property
    def outputs(self) -> slice:
        return slice(self.inputs.stop, len(self.triangle))

    @cached_property
    def output_sizes(self) -> Floats:
        """Mean square of each output (n_outputs,)."""
        return np.asarray((self.triangle[:, self.outputs] ** 2).sum(axis=0) / self.n_columns)

    @cached_property
    def _rests(self) -> list[Floats]:
        """What k past samples leave of the present one, as triangles (c, c), k = 0 … P."""
        c, present = self.n_channels, self.triangle[:, self.past.stop :]
        rests = [present[self.past.stop :]]
        for k in range(self.largest_order - 1, -1, -1):
            stacked = np.vstack([present[k * c : (k + 1) * c], rests[-1]])
            rests.append(np.asarray(sla.qr(stacked, mode="r", check_finite=False)[0])[:c])
        return rests[::-1]

    def innovation(self, order: int) -> Floats:
        """Return the covariance of the one-step errors of this observer order (p, p)."""
        rest = self._rests[order][:, self.n_inputs :].copy()
        rest[: self.n_inputs, self.feedthrough] = 0
        return np.asarray(rest.T @ rest / self.n_columns)

    def is_exact(self, order: int) -> bool:
        """Whether nothing but rounding is left of every output."""
        left = np.diag(self.innovation(order))
        return bool((left <= NOISE_FREE**2 * self.output_sizes).all())

    def observer(self, order: int) -> Floats:
        """Return the observer Markov parameters of this order (order + 1, p, m + p).

        By triangular solves; of minimum norm where the factor came by QR, because then the
        data may be noise-free and the regressors dependent.
        """
        m, p, c, R = self.n_inputs, self.n_outputs, self.n_channels, self.triangle
        q = order * c
        system = np.zeros((q + m, q + c))
        system[:q] = np.hstack([R[:q, :q], R[:q, self.past.stop :]])
        system[q:, q:] = self._rests[order][:m]
        observer = np.zeros((order + 1, p, c))
        for direct, k in ((True, q + m), (False, q)):
            outputs = np.flatnonzero(self.feedthrough == direct)
            found = self._solve(system[:k, :k], system[:k, q + m + outputs])
            observer[1:, outputs] = found[:q].reshape(order, c, -1).transpose(0, 2, 1)
            observer[0, outputs, : k - q] = found[q:].T
        return observer

    def _solve(self, upper: Floats, right_hand_side: Floats) -> Floats:
        if len(upper) == 0 or right_hand_side.shape[1] == 0:
            return np.zeros((len(upper), right_hand_side.shape[1]))
        if self.factor.path == "cholesky":
            return np.asarray(sla.solve_triangular(upper, right_hand_side, check_finite=False))
        solved = sla.lstsq(
            upper, right_hand_side, cond=RANK_TOLERANCE, lapack_driver="gelsy", check_finite=False
        )
        return np.asarray(solved[0])


def regress(
    stream: Stream, gram: BlockGram, n_lags: int, feedthrough: NDArray[np.bool_]
) -> Regression:
    """Return the regressions on up to `n_lags` past samples, from a Gram of one row more."""
    c = gram.n_channels
    lags = np.concatenate([np.arange(n_lags - 1, -1, -1), [n_lags]])
    rows = (lags[:, None] * c + np.arange(c)).ravel()
    return Regression(
        factorize(gram, stream, rows),
        gram.n_inputs,
        gram.n_outputs,
        gram.projected_columns,
        feedthrough,
    )
