"""A model on its data: a point of the search, made by one pass."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..fit import Fit
from ..kalman import STABLE_TO
from ..linalg import one_blas_thread
from ..record import Floats, rows_per_chunk
from ..scores import initial_state, start_samples
from ..statespace import Lifting
from ..varpro import Blocks, Linear, Projected, Projecting, SignalSums, Sums

WILD = 1e4  # of the outputs' squares: errors of a guess beyond it would cost more than they save


@dataclass(frozen=True, eq=False)
class Place(Projecting):
    """A model that simulates, on its data: a point of the search."""

    stream: Stream
    projected: Projected

    @property
    def variance(self) -> Floats:
        """Mean square of each output's error (p,), in the stream's units."""
        return np.maximum(np.diag(self.projected.errors), 0) / self.stream.n_samples

    def moved(self, step: Floats) -> Self:
        """Return the place after a step: one pass over the data."""
        return self._at(*self.projected.moved(step))

    def again(self) -> Self:
        """Return the same place with sums made of its errors, which small errors need."""
        return self._at(self.projected.blocks, self.projected.linear)

    def weighted(self, weights: Floats) -> Self:
        """Return the same place with other weights of the outputs; no pass."""
        return replace(self, projected=replace(self.projected, weights=weights))

    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        """Tell which parameters are at a bound that the step would cross."""
        return self.projected.pushed_out(step)

    def _at(self, blocks: Blocks, linear: Linear) -> Self:
        sums = sums_of(self.stream, blocks, linear, predicts=self.projected.indirect > 0)
        return replace(self, projected=replace(self.projected, sums=sums))


def place_of(
    stream: Stream,
    blocks: Blocks,
    linear: Linear | None,
    weights: Floats,
    feedthrough: NDArray[np.bool_],
) -> Place:
    """Return the place of blocks on the data, after one pass over them.

    Parameters
    ----------
    linear : Linear, optional
        A guess of the linear part, whose errors are what is fitted; else the outputs are.
    weights, feedthrough : array (p,)
        Of the outputs' squared errors; and which outputs have D.
    """
    return Place(stream, Projected(sums_of(stream, blocks, linear), weights, feedthrough))


def sums_of(
    stream: Stream, blocks: Blocks, linear: Linear | None, *, predicts: bool = False
) -> Sums:
    """Return the products of the signals over all data: one pass.

    Parameters
    ----------
    linear : Linear, optional
        A guess of the linear part, whose errors are what is fitted; else the outputs are.
    predicts : bool
        Whether the outputs drive the states as well as the inputs.
    """
    m, p, guess = stream.n_inputs, stream.n_outputs, linear
    if linear is None:
        constants = len(stream.records) * (stream.offset == "estimate")
        states, direct = np.zeros((blocks.n_blocks, 2, p)), np.zeros((len(blocks.inputs), p))
        linear = Linear(states, direct, np.zeros((constants, p)))
    sums = SignalSums(blocks, linear)
    rows = max(1, rows_per_chunk(len(stream.scale)) // sums.rows) * sums.rows
    with one_blas_thread():
        for owner, segment in enumerate(stream.segments):
            sums.begin(owner, segment.record)
            for _, samples in stream.chunks(segment, rows):
                sums.add(np.hstack([samples, samples[:, m:]]) if predicts else samples)
    total = sums.total()
    largest = WILD * stream.n_samples / stream.output_balance**2
    if guess is not None and not (np.diag(total.gram)[-p:] < largest).all():
        return sums_of(stream, blocks, None, predicts=predicts)
    return total


def starts_of(fit: Fit, stream: Stream, *, predicts: bool = False) -> Floats:
    """Return an initial state for each segment: the fit's own, or by MAP where it has none.

    Parameters
    ----------
    predicts : bool
        Whether it is the predictor that starts.
    """
    own = fit.initial_states if fit.segments == stream.segments else None
    model = fit.predictor(None if predicts else np.zeros_like(fit.kalman_gain))
    found = []
    for owner, segment in enumerate(stream.segments):
        if own is not None and np.isfinite(own[owner]).all():
            found.append(own[owner])
            continue
        stop = segment.start + min(segment.length, start_samples(fit.order))
        z = stream.records[segment.record].read(segment.start, stop)
        z = z - np.concatenate([fit.input_offset, fit.output_offset])
        y = z[:, stream.n_inputs :]
        innovation = fit.innovation_covariance if fit.innovation_covariance.size else None
        prior = fit.state_covariance if fit.state_covariance.size else None
        found.append(initial_state(model, z, y, "map", innovation, prior))
    return np.array(found)


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of a model in the stream's units.

    Attributes
    ----------
    covariance : array (p, p)
        Mean products.
    correlation : array (p,)
        Of errors with those one sample later.
    """

    covariance: Floats
    correlation: Floats

    @property
    def variance(self) -> Floats:
        """Mean squares (p,)."""
        return np.diag(self.covariance)


def errors_of(fit: Fit, stream: Stream, starts: Floats, *, predicts: bool = False) -> Errors | None:
    """Return the errors of the fit's own simulation, or None where it is unstable.

    Parameters
    ----------
    starts : array (n_segments, n)
        Initial states.
    predicts : bool
        Of its one-step predictions instead.
    """
    u, y = stream.input_scale, stream.output_scale
    model = fit.predictor() if predicts else fit.model
    if model.spectral_radius > STABLE_TO:
        return None
    drives = stream.scale[: model.n_inputs]
    lifting = Lifting(
        model.A, model.B * drives, model.C / y[:, None], model.D * drives / y[:, None]
    )
    offsets = offsets_of(fit, stream)
    products, neighbours = np.zeros((len(y), len(y))), np.zeros(len(y))
    with one_blas_thread():
        for segment, state in zip(stream.segments, starts, strict=True):
            zero = np.concatenate([fit.input_offset, offsets[segment.record]])
            zero = (zero - stream.centre) / stream.scale
            for _, z in stream.chunks(segment):
                z -= zero
                modelled, state = lifting.run(z[:, : model.n_inputs], state)
                error = z[:, len(u) :] - modelled
                products += error.T @ error
                neighbours += np.einsum("to,to->o", error[1:], error[:-1])
    squares = np.maximum(np.diag(products), 1e-300)
    return Errors(products / stream.n_samples, neighbours / squares)


def offsets_of(fit: Fit, stream: Stream) -> Floats:
    """Return the output offset of each record (n_records, p), in the data's units."""
    own = fit.diagnostics.figures.get("record_offsets") if fit.segments == stream.segments else None
    if own is not None and np.shape(own) == (len(stream.records), stream.n_outputs):
        return np.asarray(own)
    return np.tile(fit.output_offset, (len(stream.records), 1))
