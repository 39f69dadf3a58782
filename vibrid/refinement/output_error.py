"""Output-error refinement: the simulation that comes nearest to the data.

By variable projection (Golub & Pereyra 1973, Kaufman 1975): poles, B and initial states are
searched by damped Gauss-Newton; C, D and offsets are eliminated. Of white noise on the sensors
alone, independent between them, it is maximum likelihood.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ..chunks import Stream
from ..errors import check_choice
from ..fit import Finding, Fit
from ..linalg import one_blas_thread
from ..record import Floats
from ..varpro import LARGEST_POLE, SMALLEST_NOISE, Descent, Progress, descend, split_poles
from .deviations import with_deviations
from .place import Errors, Place, errors_of, place_of, starts_of
from .result import fit_of, with_collinearity

P = TypeVar("P", bound=Place)
WEIGHTS = ("auto", "noise", "balanced")
LIKELIHOOD_STEP = 1e-3  # of the log-likelihood: a full step that promises less ends the search
LARGEST_SEARCH = 60  # steps
SMALL_ERROR = 1e-6  # of the outputs' squares: below it sums are made of errors from the start
ROUNDING = 1e-22  # of the outputs' squares: errors that the sums cannot tell from zero
ROUNDS = 3  # of weighing the outputs anew
NEW_WEIGHTS = 1.1  # ratio of variances from which on outputs are weighed anew
WHITE = 0.2  # correlation of neighbouring errors up to which they are noise, not misfit


@dataclass(frozen=True)
class Search:
    """What a search may do.

    Attributes
    ----------
    weights : "auto", "noise" or "balanced"
        Weigh the outputs by the variance of their errors, which is maximum likelihood where
        these are noise; or by their own variance, so that each counts alike. "auto" begins
        balanced and goes over to noise where the errors left are white.
    drift : float
        Real poles stay below exp(−drift / N) of the longest piece's N samples, and elimination
        removes all that is slower first: 3 keeps out what decays over more than a third of the
        piece. 0 leaves all free.
    largest : int
        Number of steps taken at most.
    """

    weights: str = "auto"
    drift: float = 0.0
    largest: int = LARGEST_SEARCH

    def __post_init__(self) -> None:
        check_choice("weights", self.weights, WEIGHTS)


DEFAULT = Search()


def refine_output_error(
    fit: Fit, stream: Stream, search: Search = DEFAULT, progress: Progress | None = None
) -> Fit:
    """Return the fit whose simulation comes nearest to the data, starting from `fit`.

    Parameters
    ----------
    fit : Fit
        Poles outside the unit circle are reflected into it first.
    stream : Stream
    search : Search
    progress : callable (what, done, total), optional

    Returns
    -------
    Fit
        In a basis of real 2 × 2 blocks, Kalman gain zero, with the covariance of the poles'
        coefficients (see `varpro.pole_covariance`) as `parameter_covariance`. The start itself
        where nothing better was found.
    """
    starts = starts_of(fit, stream)
    before = errors_of(fit, stream, starts)
    first = start_of(fit, stream, search, starts, before)
    found = _weighed(fit, searched(first, search, progress), search, progress)
    allowed = before is not None and _same_poles(fit, first)
    start = _measure(before.variance if before and allowed else first.variance, found.point)
    reached = _measure(found.point.variance, found.point)
    return ended(fit, found, (start, reached), allowed, "output_error")


def ended(fit: Fit, found: Descent[P], costs: tuple[float, float], allowed: bool, form: str) -> Fit:
    """Return the model that a search ended at, or its start where that may stay and is better.

    `costs` are those of the start and of the end.
    """
    start, reached = costs
    figures = {
        "refinement": form,
        "iterations": found.iterations,
        "converged": found.converged,
        "start_cost": start,
        "cost": min(costs),
    }
    if allowed and start < reached:
        does = "predicts" if form == "innovations" else "simulates"
        return replace(fit, diagnostics=fit.diagnostics.joined(figures, [kept(does)]))
    refined = with_collinearity(with_deviations(fit_of(fit, found.point, figures), found.point))
    doubts = [] if found.converged else [unfinished(found.iterations)]
    return replace(refined, diagnostics=refined.diagnostics.joined({}, doubts))


def start_of(
    fit: Fit,
    stream: Stream,
    search: Search,
    starts: Floats,
    errors: Errors | None,
    *,
    pair_real: bool = True,
) -> Place:
    """Return the place where a search from this fit begins.

    Parameters
    ----------
    starts : array (n_segments, n)
    errors : Errors or None
        Of the fit's own simulation.
    pair_real : bool
        Whether real poles share blocks, so that they can become a complex pair.
    """
    variance = output_variance(stream)
    if errors is not None and search.weights == "noise":
        variance = noise_of(errors.variance, stream)
    longest = max(segment.length for segment in stream.segments)
    slowest = float(min(np.exp(-search.drift / longest), LARGEST_POLE))
    B = fit.model.B * stream.input_scale
    blocks = split_poles(fit.model.A, B, starts, slowest, pair_real=pair_real)
    place = place_of(stream, blocks, None, 1 / variance, fit.feedthrough)
    small = (place.variance < SMALL_ERROR * output_variance(stream)).any()
    return place.again() if small and pair_real else place


def output_variance(stream: Stream) -> Floats:
    """Return the variance of each output in the stream's units."""
    return np.asarray(1 / stream.output_balance**2)


def noise_of(variance: Floats, stream: Stream) -> Floats:
    """Return the errors' variances, held off zero."""
    return np.maximum(variance, SMALLEST_NOISE * output_variance(stream))


def searched(start: Place, search: Search, progress: Progress | None = None) -> Descent[Place]:
    """Return where damped Gauss-Newton steps from a place end, with the weights it has."""
    tolerance = LIKELIHOOD_STEP / (start.stream.n_samples * start.stream.n_outputs)
    squares = start.stream.n_samples * output_variance(start.stream)
    rounding = ROUNDING * float(squares @ start.projected.weights)
    with one_blas_thread():
        return descend(
            start,
            tolerance=tolerance,
            negligible=rounding,
            largest=search.largest,
            progress=progress,
        )


def _same_poles(fit: Fit, first: Place) -> bool:
    """Tell whether the start is inside the bounds of the search."""
    own, begun = (
        np.sort_complex(poles) for poles in (fit.model.poles, first.projected.blocks.poles)
    )
    return bool(np.allclose(own, begun, rtol=0, atol=1e-6))


def _weighed(
    fit: Fit, found: Descent[Place], search: Search, progress: Progress | None
) -> Descent[Place]:
    """Return where the search ends when outputs are weighed anew by the errors left."""
    taken, rounds = found.iterations, 1
    noise = search.weights == "noise"
    while rounds < ROUNDS and search.weights != "balanced" and _apart(found.point):
        if not noise and not _white(fit, found.point):
            break
        noise = True
        variance = noise_of(found.point.variance, found.point.stream)
        found = searched(found.point.weighted(1 / variance), search, progress)
        taken, rounds = taken + found.iterations, rounds + 1
    return replace(found, iterations=taken)


def _white(fit: Fit, place: Place) -> bool:
    model = fit_of(fit, place, {})
    errors = errors_of(model, place.stream, model.initial_states)
    return errors is not None and float(np.mean(np.abs(errors.correlation))) < WHITE


def _apart(place: Place) -> bool:
    """Tell whether outputs' errors have changed enough to be weighed anew."""
    ratio = noise_of(place.variance, place.stream) * place.projected.weights
    return bool(ratio.max() > NEW_WEIGHTS * ratio.min())


def _measure(variance: Floats, place: Place) -> float:
    """Return the weighted mean square of errors over the outputs."""
    return float(np.mean(noise_of(variance, place.stream) * place.projected.weights))


def kept(does: str) -> Finding:
    """Say that the start was kept, because nothing `does` better."""
    return Finding(
        "not-refined",
        "note",
        f"Refinement found no model that {does} better than its start, which was kept.",
    )


def unfinished(iterations: int) -> Finding:
    """Say that the search did not settle."""
    return Finding(
        "not-converged",
        "doubt",
        f"Refinement stopped after {iterations} steps without settling: the data hardly "
        "determine some of the model.",
        "Try a lower order.",
    )
