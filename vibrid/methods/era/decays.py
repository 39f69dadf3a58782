"""ERA of free decays: one or several records that share A and C."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from ...chunks import Stream
from ...errors import DataError
from ...fit import Diagnostics, Fit, feedthrough_mask
from ...gram import BlockGram, Factor, factorize, reduce
from ...kalman import STABLE_TO
from ...record import Floats
from ...statespace import free_responses
from ..result import Realization, Remembering, as_fit, factor_findings, gain_findings
from .evidence import NO_GAIN, NOISE_FREE, Evidence, information
from .responses import Mask

TALL = 600  # elements of a block column: beyond it the decomposition takes most of a second
QUARTER = 4
DECAYED = 0.25  # energy of the last over that of the first quarter: amplitude halved


@dataclass(frozen=True, eq=False)
class DecayModels(Remembering, Evidence):
    """Models of free decays: all Hankel columns of all segments, by their triangle.

    Attributes
    ----------
    factor : Factor
        R with RᵀR the Gram of the block rows: H = Rᵀ Qᵀ for one orthonormal Q.
    heads : tuple of array (≤ rows, p)
        The first samples of every segment.
    """

    stream: Stream
    gram: BlockGram
    factor: Factor
    heads: tuple[Floats, ...]

    @property
    def n_columns(self) -> int:
        return self.gram.projected_columns

    def factors(self, order: int) -> tuple[Floats, Floats | None]:
        """Return the observability matrix (rows · p, n); decays have no inputs."""
        return self.kernel.observability(order), None

    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the Bayesian information criterion of this order, and whether it is stable.

        Of what the free responses of the model leave of each Hankel column, white within an
        output; n p parameters, and n of every decay.
        """
        model = self.realize(order)
        p = self.stream.n_outputs
        parameters = order * (p + len(np.unique(self.gram.owners)))
        errors = np.diag(model.innovation)
        if not np.isfinite(errors).all():
            return np.inf, False
        sizes = np.square(self._rows[:, :p]).sum(axis=0) / self.n_columns
        spread = float(np.log(errors + NOISE_FREE**2 * sizes).sum())
        return information(spread, self.n_columns, parameters), model.radius <= STABLE_TO

    @property
    def _rows(self) -> Floats:
        """The Hankel rows' triangle, a column for every row of H."""
        return self.factor.triangle[:, : (self.method.rows + 1) * self.stream.n_outputs]

    def _realized(self, order: int) -> Realization:
        A, _, C = self.kernel.triplet(order)
        p = self.stream.n_outputs
        observability = free_responses(A, C, self.method.rows + 1).reshape(-1, order)
        if np.isfinite(observability).all():
            states, left = _projected(observability, self._rows.T)
            freedom = self.n_columns * (1 - order / len(observability))
            each = np.square(left).sum(axis=1).reshape(-1, p).mean(axis=0)
            innovation = np.diag(each / freedom)
        else:
            states, innovation = np.full((order, 1), np.nan), np.full((p, p), np.nan)
        return Realization(
            A,
            np.zeros((order, 0)),
            C,
            np.zeros((p, 0)),
            type(self.method).__name__,
            np.zeros((order, p)),
            innovation,
            states @ states.T / self.n_columns,
            NO_GAIN.format("decays"),
        )

    def fit(self, order: int, method: Any) -> Fit:
        """Return the model of one order with the initial state of every decay."""
        found = self.realize(order)
        figures = {
            **self.figures(order, found.A),
            "columns": self.n_columns,
            "responses": "decay",
            "factorization": self.factor.path,
            "smallest_pivot": self.factor.smallest_pivot,
        }
        findings = (*self.remarks, *factor_findings(self.factor), *gain_findings(found))
        fit = as_fit(
            method,
            self.stream,
            found,
            singular_values=self.singular_values,
            feedthrough=self.feedthrough,
            diagnostics=Diagnostics(figures, findings),
            gram=self.gram,
        )
        states, constant = self._starts(found)
        offset = fit.output_offset + self.stream.output_scale * constant
        return replace(fit, initial_states=states, output_offset=offset)

    def _starts(self, found: Realization) -> tuple[Floats, Floats]:
        """Return the state at the first sample of every segment, and their mean constant.

        Least squares over the first samples, with a constant where one was projected out:
        eq. 1.71c of the realization chapter for any number of decays.
        """
        n, p = len(found.A), self.stream.n_outputs
        longest = max(len(head) for head in self.heads)
        free = free_responses(found.A, found.C, longest).reshape(-1, n)
        if not np.isfinite(free).all():
            return np.full((len(self.heads), n), np.nan), np.zeros(p)
        if self.stream.offset == "estimate":
            free = np.hstack([free, np.tile(np.eye(p), (len(free) // p, 1))])
        solved = np.array(
            [
                sla.lstsq(free[: head.size], head.ravel(), cond=1e-12, check_finite=False)[0]
                for head in self.heads
            ]
        )
        constants = np.average(solved[:, n:], axis=0, weights=[len(head) for head in self.heads])
        return solved[:, :n], constants if constants.size else np.zeros(p)


def _projected(basis: Floats, rows: Floats) -> tuple[Floats, Floats]:
    """Return least-squares coordinates of the columns in a basis, and what is left."""
    solved = np.asarray(sla.lstsq(basis, rows, cond=1e-12, check_finite=False)[0])
    return solved, rows - basis @ solved


def from_decays(
    method: Any, stream: Stream, feedthrough: Mask, gram: BlockGram | None, reason: str
) -> DecayModels:
    """Factor the block Hankel matrix of all decays, constants projected out."""
    p, extra = stream.n_outputs, method.reach
    rows = method.rows or _chosen_rows(stream, method)
    n_rows = rows + extra + 1
    used = stream if method.columns is None else _shortened(stream, n_rows - 1 + method.columns)
    _check_columns(used, n_rows, rows, method)
    if gram is None or used is not stream:
        gram = reduce(used, n_rows)
    gram = replace(gram.shorten(n_rows), segments=stream.segments)
    factor = factorize(gram, used, np.arange(n_rows * p))
    # fewer columns than rows leave rows of zeros
    R = factor.triangle[: gram.projected_columns]
    weights = stream.output_balance, np.ones(1)
    blocks = (R * np.tile(weights[0], n_rows)).T.reshape(n_rows, p, -1)
    option = replace(method, rows=rows, responses="decay")
    chosen = () if method.rows else (f"rows={rows} with all columns of the decays",)
    return DecayModels(
        method=option,
        kernel=option.factor_rows(blocks, weights),
        feedthrough=feedthrough_mask(feedthrough, stream.records[0].output_channels),
        stream=stream,
        gram=gram,
        reasons=(reason, *chosen),
        remarks=(),
        factor=factor,
        heads=tuple(stream.read(each, 0, min(rows, each.length)) for each in stream.segments),
    )


def _shortened(stream: Stream, n_samples: int) -> Stream:
    """Return the stream with the first samples of every segment only."""
    return replace(
        stream,
        segments=tuple(
            replace(segment, stop=min(segment.stop, segment.start + n_samples))
            for segment in stream.segments
        ),
    )


def _columns(stream: Stream, n_rows: int) -> int:
    used = [segment.length - n_rows + 1 for segment in stream.segments]
    constants = int(stream.offset == "estimate")
    return sum(max(0, columns - constants) for columns in used)


def _chosen_rows(stream: Stream, method: Any) -> int:
    """Return the most rows, up to half of the longest decay, that leave as many columns."""
    p, extra = stream.n_outputs, method.reach
    longest = max(segment.length for segment in stream.segments)
    rows = int(max(2, min(longest // 2, TALL // (p * max(1, method.stacked)))))
    while rows > 2 and _columns(stream, rows + extra + 1) < (rows + 1) * p:
        rows -= 1
    return rows


def _check_columns(stream: Stream, n_rows: int, rows: int, method: Any) -> None:
    if _columns(stream, n_rows) >= 1:
        return
    longest = max(segment.length for segment in stream.segments)
    constants = int(stream.offset == "estimate")
    extra = n_rows - rows - 1
    shifts = f" and {extra} samples of shifts" if extra else ""
    raise DataError(
        f"rows={rows}{shifts} needs a decay of at least {n_rows + constants} samples in one "
        f"piece; the longest of {len(stream.segments)} has {longest}. Use at most "
        f"{max(0, longest - constants - extra - 1)} rows or a longer record."
    )


def energy_ratio(stream: Stream) -> float:
    """Return the energy of the last quarter of all segments over that of their first."""
    first = last = 0.0
    for segment in stream.segments:
        quarter = max(1, segment.length // QUARTER)
        for start, rows in stream.chunks(segment):
            energy = np.square(rows * stream.output_balance).sum(axis=1)
            position = start + np.arange(len(rows))
            first += float(energy[position < quarter].sum())
            last += float(energy[position >= segment.length - quarter].sum())
    return last / first if first > 0 else np.inf
