"""Refinement in innovations form: the one-step predictions that are most likely.

The predictor x̂⁺ = F x̂ + G u + K y, ŷ = C x̂ + D u + d is a model that "simulates" the outputs
from the inputs and from the outputs themselves. So variable projection serves it too: with
F = A − K C in real 2 × 2 blocks, G, K and initial states searched and C, D, d eliminated, the
parametrization is the full one up to the choice of state coordinates, whose remaining
freedom the minimum-norm steps leave alone (data-driven local coordinates; McKelvey,
Helmersson & Ribarits 2004). The cost is the likelihood N ln det S of innovations with
unknown covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..chunks import Stream
from ..fit import Fit
from ..kalman import spectral_radius
from ..linalg import one_blas_thread
from ..record import Floats
from ..varpro import LARGEST_POLE, Likely, Progress, descend, split_poles
from .output_error import SMALL_ERROR, Search, ended, output_variance
from .place import Errors, Place, errors_of, offsets_of, starts_of, sums_of
from .result import innovations_of

PROMISE = 1e-3  # fall of −2 × log-likelihood: a full step that promises less ends the search


@dataclass(frozen=True, eq=False)
class Prediction(Place):
    """A predictor on its data. Where the model that it predicts is unstable it costs infinity."""

    @property
    def cost(self) -> float:
        radius = spectral_radius(innovations_of(self)[0])
        return self.projected.cost if radius <= LARGEST_POLE else np.inf


def refine_innovations(
    fit: Fit, stream: Stream, search: Search | None = None, progress: Progress | None = None
) -> Fit:
    """Return the fit whose one-step predictions are most likely, starting from `fit`.

    Parameters
    ----------
    fit : Fit
        Poles outside the unit circle are reflected into it first.
    stream : Stream
    search : Search, optional
        Of it only the number of steps counts.
    progress : callable (what, done, total), optional

    Returns
    -------
    Fit
        Model and predictor are stable. The start itself where nothing better was found.
        Figures as of `refine`; the cost is ln det of the predictions' error covariance over
        the outputs' variances.
    """
    largest = (search or Search()).largest
    starts = starts_of(fit, stream, predicts=True)
    before = errors_of(fit, stream, starts, predicts=True)
    allowed = before is not None and fit.model.spectral_radius <= LARGEST_POLE
    first = _start_of(fit, stream, starts)
    with one_blas_thread():
        found = descend(
            first, tolerance=0.0, negligible=PROMISE, largest=largest, progress=progress
        )
    start = _measure(before, stream) if before and allowed else _measure_of(first)
    reached = _measure_of(found.point)
    return ended(fit, found, (start, reached), allowed, "innovations")


def _start_of(fit: Fit, stream: Stream, starts: Floats) -> Prediction:
    """Return the place where the search begins; without gain where the gain is of no use."""
    for gain in (fit.kalman_gain, np.zeros_like(fit.kalman_gain)):
        place = _place_of(replace(fit, kalman_gain=gain), stream, starts)
        if np.isfinite(place.cost):
            break
    small = (place.variance < SMALL_ERROR * output_variance(stream)).any()
    return place.again() if small else place


def _place_of(fit: Fit, stream: Stream, starts: Floats) -> Prediction:
    u, y = stream.input_scale, stream.output_scale
    A, C, K = fit.model.A, fit.model.C / y[:, None], fit.kalman_gain * y
    B, D = fit.model.B * u, fit.model.D * u / y[:, None]
    F = A - K @ C
    offsets = (offsets_of(fit, stream) - stream.centre[len(u) :]) / y
    if stream.offset == "estimate" and K.any():
        # the predictor runs on data that still hold the offsets
        held = np.linalg.lstsq(np.eye(len(F)) - F, K @ offsets.T, rcond=None)[0].T
        starts = starts + held[[segment.record for segment in stream.segments]]
    blocks = split_poles(F, np.hstack([B - K @ D, K]), starts)
    sums = sums_of(stream, blocks, None, predicts=True)
    weights = 1 / output_variance(stream)
    projected = Likely(sums, weights, fit.feedthrough, indirect=len(y), count=stream.n_samples)
    return Prediction(stream, projected)


def _measure_of(place: Place) -> float:
    return place.projected.cost / place.stream.n_samples + _unit(place.stream)


def _measure(errors: Errors, stream: Stream) -> float:
    floor = np.diag(1e-14 * output_variance(stream))
    return float(np.linalg.slogdet(errors.covariance + floor)[1]) + _unit(stream)


def _unit(stream: Stream) -> float:
    return float(np.log(stream.output_balance**2).sum())
