"""Which form of noise suits a fit: the one that does better on unseen halves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..errors import DataError, OptionError
from ..fit import Fit
from ..methods.preparation import check_length
from ..refinement import Search, refine_innovations, refine_output_error
from ..refinement.place import errors_of, starts_of
from ..scores import start_samples
from ..varpro import SMALLEST_NOISE
from .candidates import LONGEST_RANKED, shortened
from .finishing import finished
from .held_out import halves_of, scored_segments, simulation_error, unseen_error
from .options import by_transition, leaves_transition
from .stability import settle

Progress = Callable[[str, int, int], None]
FORMS = ("output_error", "innovations")
EQUAL = 1.01  # ratio of errors up to which two forms do alike
FOLD_STEPS = 30  # of a search that compares forms
EXACT = 1e-6  # relative simulation error of data without noise
KEPT = 0.01  # of the outputs' deviation: what a start must simulate better by to be kept
LARGEST_PREDICTOR = 400  # signals: the search for a gain takes long beyond
APART = 0.05  # of a pole's distance from the circle: starts that differ more are both tried


def explained(fit: Fit, why: str, **figures: Any) -> Fit:
    """Return the fit with the reason of its refinement among the figures."""
    known = {"refinement_reason": why, **figures}
    return replace(fit, diagnostics=fit.diagnostics.joined(known))


def run_form(
    form: str, fit: Fit, stream: Stream, progress: Progress | None, steps: int | None = None
) -> Fit:
    """Return the fit refined in one form."""
    run = refine_innovations if form == "innovations" else refine_output_error
    search = Search() if steps is None else Search(largest=steps)
    return run(fit, stream, search, progress)


def best_of_starts(form: str, fit: Fit, stream: Stream, progress: Progress | None) -> Fit:
    """Return the best refinement of the fit, and of other starts where these differ."""
    others = _other_starts(fit, stream)
    first = _ranked_first(form, fit, others, stream) if _long(stream) else fit
    found = [run_form(form, first, stream, progress)]
    if _long(stream):
        return found[0]
    if form == "innovations" and stream.n_inputs and not found[0].diagnostics.figures["converged"]:
        # near data without process noise the gain hardly counts: begin without it
        others.append(refine_output_error(fit, stream, progress=progress))
    found += [run_form(form, other, stream, progress) for other in others]
    return min(found, key=lambda each: _misfit(form, each, stream)) if others else found[0]


def _long(stream: Stream) -> bool:
    return stream.n_samples > LONGEST_RANKED


def _ranked_first(form: str, fit: Fit, others: Sequence[Fit], stream: Stream) -> Fit:
    """Return the start whose refinement on the front of the data ends lowest."""
    if not others:
        return fit
    short = shortened(stream)
    # of another stream a fit has no initial states
    ends = [_misfit(form, run_form(form, each, short, None), short) for each in (fit, *others)]
    return (fit, *others)[int(np.argmin(ends))]


def _misfit(form: str, fit: Fit, stream: Stream) -> float:
    """Return ln det of the prediction errors' covariance, or the same of its diagonal."""
    predicts = form == "innovations"
    errors = errors_of(fit, stream, starts_of(fit, stream, predicts=predicts), predicts=predicts)
    if errors is None:
        return np.inf
    S = errors.covariance * np.outer(stream.output_balance, stream.output_balance)
    S = S + SMALLEST_NOISE * np.eye(len(S))
    return float(np.linalg.slogdet(S if predicts else np.diag(np.diag(S)))[1])


def _other_starts(fit: Fit, stream: Stream) -> list[Fit]:
    """Return the realization by regression or shift invariance that the fit is far from."""
    if not leaves_transition(fit.method) or fit.gram is None:
        return []
    if fit.segments != stream.segments:
        return []
    mask = fit.feedthrough.tolist()
    decomposition = fit.method.decompose(stream, feedthrough=mask, gram=fit.gram)
    if fit.order > decomposition.largest_order:
        return []
    found = []
    for option in by_transition(fit.method):
        other = option.realize(decomposition, fit.order)
        if _far(fit, other):
            other = settle(other, "project", option, decomposition)
            found.append(
                replace(
                    fit,
                    model=other.model,
                    kalman_gain=other.kalman_gain,
                    innovation_covariance=other.innovation_covariance,
                    initial_states=other.initial_states,
                    state_covariance=other.state_covariance,
                )
            )
    return found


def _far(fit: Fit, other: Fit) -> bool:
    poles = other.model.poles
    nearest = np.abs(poles[:, None] - fit.model.poles).min(axis=1)
    return bool((nearest > APART * np.abs(1 - np.abs(poles))).any())


def by_folds(fit: Fit, stream: Stream, progress: Progress | None) -> Fit:
    """Return the refinement, or the start, that does best on unseen halves."""
    signals = fit.order * (stream.n_inputs + stream.n_outputs + 2)
    if signals > LARGEST_PREDICTOR:
        why = f"a predictor would need {signals} signals, more than {LARGEST_PREDICTOR}"
        return explained(best_of_starts("output_error", fit, stream, progress), why)
    halves = _usable_halves(fit, stream)
    if halves is None:
        return _by_criterion(fit, stream, progress)
    scores = [_half(fit, *each, progress) for each in (halves, halves[::-1])]
    errors = {form: float(np.mean([each[form][0] for each in scores])) for form in scores[0]}
    predicted = {form: float(np.mean([each[form][1] for each in scores])) for form in scores[0]}
    known = {"refinement_errors": errors}
    settled = np.isfinite(predicted["innovations"])
    if min(error for form, error in errors.items() if settled or form != "innovations") >= 1:
        # one of the halves may hold no force at all
        return _by_simulation(fit, stream, progress)
    form, why = _preferred(errors, predicted)
    if form == "none":
        return explained(fit, why, refinement="none", iterations=0, converged=True, **known)
    return explained(best_of_starts(form, fit, stream, progress), why, **known)


def _preferred(errors: dict[str, float], predicted: dict[str, float]) -> tuple[str, str]:
    """Return the form that simulates unseen halves best, and why."""
    one, other = sorted(FORMS, key=lambda form: errors[form])
    said = ", ".join(f"{name} {100 * value:.4g} %" for name, value in errors.items())
    if errors["output_error"] < EXACT:
        return "output_error", "simulation leaves nothing that could be noise"
    if not np.isfinite(predicted["innovations"]):
        one, other = "output_error", "output_error"
    if errors["none"] + KEPT < errors[one]:
        return "none", f"unseen halves are simulated clearly better by the start (errors: {said})"
    if one == other:
        return one, f"on halves the search for a Kalman gain did not settle (errors: {said})"
    if errors[other] <= EQUAL * errors[one]:
        if predicted["innovations"] * EQUAL < predicted["output_error"]:
            return "innovations", f"it predicts unseen halves better and simulates alike ({said})"
        return "output_error", f"both forms do alike on unseen halves ({said}); it is the simpler"
    return one, f"it simulates unseen halves better (errors: {said})"


def _usable_halves(fit: Fit, stream: Stream) -> tuple[Stream, Stream] | None:
    """Return both halves of the data, or None where they are too short to be refined on."""
    halves = halves_of(stream)
    rows = fit.gram.n_rows if fit.gram is not None else 2 * fit.order
    skipped = start_samples(fit.order)
    try:
        for half in halves:
            check_length(half, rows)
    except DataError:
        return None
    return halves if all(scored_segments(half, skipped) for half in halves) else None


def _half(
    fit: Fit, seen: Stream, unseen: Stream, progress: Progress | None
) -> dict[str, tuple[float, float]]:
    """Return the errors of simulation and prediction on one half of models of the other.

    A search for a gain that does not settle has an infinite error of prediction.
    """
    start, skipped = _twin(fit, seen), start_samples(fit.order)
    models = {"none": start}
    models |= {form: run_form(form, start, seen, progress, FOLD_STEPS) for form in FORMS}
    found = {}
    for form, model in models.items():
        settled = form == "none" or model.diagnostics.figures["converged"]
        error = unseen_error(model, unseen, skipped, predicts=True) if settled else np.inf
        found[form] = (unseen_error(model, unseen, skipped), error)
    return found


def _twin(fit: Fit, seen: Stream) -> Fit:
    """Return the fit's method and order on other data; the fit itself where that is impossible."""
    mask = fit.feedthrough.tolist()
    try:
        decomposition = fit.method.decompose(seen, feedthrough=mask)
    except (DataError, OptionError, TypeError):  # too short, or of responses
        return fit
    if fit.order > decomposition.largest_order:
        return fit
    found = finished(fit.method, decomposition, fit.order, seen, "auto")
    return fit if found is None else found


def _by_simulation(fit: Fit, stream: Stream, progress: Progress | None) -> Fit:
    """Return the form that simulates the record itself better: both have as many parameters."""
    found = [best_of_starts(form, fit, stream, progress) for form in FORMS]
    best = min(found, key=simulation_error)
    return explained(best, "unseen halves say nothing; it simulates the record itself better")


def _by_criterion(fit: Fit, stream: Stream, progress: Progress | None) -> Fit:
    """Return the form with the lower information criterion (Akaike 1974)."""
    found = {
        form: best_of_starts(form, fit, stream, progress)
        for form in ("output_error", "innovations")
    }
    n, p = fit.order, stream.n_outputs
    extra = {"output_error": 0, "innovations": 2 * n * p + p * (p - 1)}
    values = {
        form: stream.n_samples * _misfit(form, each, stream) + extra[form]
        for form, each in found.items()
    }
    best = min(values, key=lambda form: values[form])
    why = "the record is too short for unseen halves; it has the lower information criterion"
    return explained(found[best], why)
