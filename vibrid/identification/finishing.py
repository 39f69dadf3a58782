"""Realize one order, keep the transition that simulates better, and complete it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..fit import Finding, Fit
from ..linalg import one_blas_thread
from ..modes import match_modes, mode_quality, modes_of
from .candidates import AS_GOOD, stretches
from .completion import Completion, complete
from .held_out import simulation_error
from .options import by_transition, completion_of
from .stability import is_stable, projected, settle, worst_pole

LONGEST_COMPARED = 20_000  # samples that transitions and forms of completion are compared on
LIGHT_DAMPING = 0.1  # modes damped more are not compared: their damping is loose anyway
DAMPING_LIMIT = 0.2  # relative difference that is worth a word


@one_blas_thread()
def finish(method: Any, decomposition: Any, order: int, stream: Stream, stability: str) -> Fit:
    """Return the finished model of one order, as the stability policy wants it.

    With inputs and transition "auto", regression and shift invariance are both simulated
    and the better one is kept: the Gram ranks them over the horizon only, and a
    lightly damped structure remembers longer.
    """
    form = completion_of(method)
    projects = stability == "project"
    found = finished(method, decomposition, order, stream, form, projects=projects)
    if found is not None:
        return with_quality(found, decomposition)
    fit = settled(method, decomposition, order, stability)
    return complete(fit, stream, form) if is_stable(fit) else fit


def settled(method: Any, decomposition: Any, order: int, stability: str) -> Fit:
    """Return the realization of one order as the stability policy wants it."""
    fit = with_quality(method.realize(decomposition, order), decomposition)
    return settle(fit, stability, method, decomposition)


def with_quality(fit: Fit, decomposition: Any) -> Fit:
    """Return the fit with how well the data's own factors agree with each mode."""
    quality = mode_quality(fit, *decomposition.factors(fit.order))
    return replace(fit, diagnostics=fit.diagnostics.joined(quality.as_figures()))


def finished(
    method: Any,
    decomposition: Any,
    order: int,
    stream: Stream,
    form: str,
    *,
    projects: bool = False,
) -> Fit | None:
    """Return the best stable model of this order, completed, or None where none is stable.

    Of two transitions an unstable one counts, if `projects`, with its poles reflected; else
    a finding says where it would simulate better so. Stretches of a long stream are enough
    to choose transition and form of completion.
    """
    fits = [option.realize(decomposition, order) for option in _transitions(method, stream)]
    front = stretches(stream, LONGEST_COMPARED)
    tried = [Completion(fit, front, compare=form == "auto") for fit in fits if is_stable(fit)]
    better = _better_reflected(fits, tried, front, form) if len(fits) > 1 else []
    if projects:
        tried += better
    if not tried:
        return None
    best, done = _simulating_best(tried, form)
    if front is not stream:
        known = done.diagnostics.figures
        chosen = known["completion"] if form == "auto" else form
        whole = Completion(best, stream, compare=False)
        done = whole.complete(chosen, known.get("completion_reason", ""))
    figures, doubts = _compared_damping([each.fit for each in tried])
    if better and not projects:
        doubts.append(_passed_over(fits, better[0], done))
    return replace(done, method=method, diagnostics=done.diagnostics.joined(figures, doubts))


def _better_reflected(
    fits: Sequence[Fit], stable: Sequence[Completion], stream: Stream, form: str
) -> list[Completion]:
    """Return the unstable fits, reflected, that simulate clearly better than every stable one.

    A lightly damped mode needs little noise to leave the unit circle: reflected, a transition
    that is right but for that beats one that is biased.
    """
    found = [
        Completion(projected(fit), stream, compare=form == "auto")
        for fit in fits
        if not is_stable(fit)
    ]
    if not found:
        return []
    limit = min((each.simulation_error for each in stable), default=np.inf) / AS_GOOD
    return [each for each in found if each.simulation_error < limit]


def _passed_over(fits: Sequence[Fit], better: Completion, done: Fit) -> Finding:
    """Say that an unstable transition would simulate better than the stable one taken."""
    names = {"regression": "regression of the states", "shift": "shift invariance"}
    other, own = (each.diagnostics.figures["transition"] for each in (better.fit, done))
    pole = next(worst_pole(fit) for fit in fits if not is_stable(fit))
    return Finding(
        "unstable-alternative",
        "warning",
        f"The model by {names[other]} is unstable ({pole}), so that by {names[own]} was taken; "
        f"with its poles reflected the other would miss {100 * better.simulation_error:.3g} % of "
        f"the outputs' standard deviation instead of {100 * simulation_error(done):.3g} %.",
        'Use stability="project" (--stability project), another order, or a longer record.',
    )


def _simulating_best(tried: Sequence[Completion], form: str) -> tuple[Fit, Fit]:
    """Return the fit that simulates best once completed, before and after.

    None simulates better completed than by least squares on the simulation, so those whose
    least squares is worse than a completed fit need not be completed.
    """
    ranked = sorted(tried, key=lambda each: each.simulation_error) if len(tried) > 1 else tried
    best, done = ranked[0], ranked[0].complete(form)
    for each in ranked[1:]:
        if each.simulation_error >= simulation_error(done):
            break
        other = each.complete(form)
        if simulation_error(other) < simulation_error(done):
            best, done = each, other
    return best.fit, done


def _compared_damping(found: Sequence[Fit]) -> tuple[dict[str, float], list[Finding]]:
    """Return how far regression and shift invariance are apart on damping, and say if far.

    Each is biased in its own way: regression where the horizon is shorter than the
    predictor's memory, shift invariance under feedback.
    """
    if len(found) < 2:
        return {}, []
    first, second = (modes_of(fit) for fit in found)
    pairs = match_modes(first, second)
    one, two = first.damping_ratios[pairs[:, 0]], second.damping_ratios[pairs[:, 1]]
    apart = np.where(
        np.maximum(one, two) < LIGHT_DAMPING, np.abs(one - two) / np.maximum(one, two), 0
    )
    figures = {"damping_difference": float(apart.max(initial=0.0))}
    if not (apart > DAMPING_LIMIT).any():
        return figures, []
    worst = int(np.argmax(apart))
    return figures, [
        Finding(
            "damping-doubt",
            "doubt",
            f"Regression and shift invariance disagree on {int((apart > DAMPING_LIMIT).sum())} "
            f"of {len(pairs)} damping ratios, worst at "
            f"{first.frequencies_hz[pairs[worst, 0]]:.4g} Hz: {100 * one[worst]:.3g} and "
            f"{100 * two[worst]:.3g} %.",
            "Use more block_rows or a longer record, or believe frequencies only.",
        )
    ]


def _transitions(method: Any, stream: Stream) -> list[Any]:
    return by_transition(method) if stream.n_inputs else [method]
