"""Realize one order, keep the transition that simulates better, and complete it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..fit import Finding, Fit
from ..modes import match_modes, mode_quality, modes_of
from .completion import complete
from .stability import is_stable, settle

LIGHT_DAMPING = 0.1  # modes damped more are not compared: their damping is loose anyway
DAMPING_LIMIT = 0.2  # relative difference that is worth a word


def finish(method: Any, decomposition: Any, order: int, stream: Stream, stability: str) -> Fit:
    """Return the finished model of one order, as the stability policy wants it.

    With inputs and transition "auto", regression and shift invariance are both completed
    and the better simulation is kept: the Gram ranks them over the horizon only, and a
    lightly damped structure remembers longer.
    """
    form = getattr(method, "completion", "auto")
    found = finished(method, decomposition, order, stream, form)
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
    if not hasattr(decomposition, "factors"):
        return fit
    quality = mode_quality(fit, *decomposition.factors(fit.order))
    return replace(fit, diagnostics=fit.diagnostics.joined(quality.as_figures()))


def finished(method: Any, decomposition: Any, order: int, stream: Stream, form: str) -> Fit | None:
    """Return the best stable model of this order, completed, or None where none is stable."""
    found = []
    for option in _transitions(method, stream):
        fit = option.realize(decomposition, order)
        if is_stable(fit):
            found.append(complete(fit, stream, form))
    if not found:
        return None
    best = min(found, key=lambda fit: fit.diagnostics.figures.get("simulation_error", np.inf))
    doubts = _damping_doubts(found)
    return replace(best, method=method, diagnostics=best.diagnostics.joined({}, doubts))


def _damping_doubts(found: Sequence[Fit]) -> list[Finding]:
    """Say where regression and shift invariance disagree on damping.

    Each is biased in its own way: regression where the horizon is shorter than the
    predictor's memory, shift invariance under feedback.
    """
    if len(found) < 2:
        return []
    first, second = (modes_of(fit) for fit in found)
    pairs = match_modes(first, second)
    one, two = first.damping_ratios[pairs[:, 0]], second.damping_ratios[pairs[:, 1]]
    apart = np.where(
        np.maximum(one, two) < LIGHT_DAMPING, np.abs(one - two) / np.maximum(one, two), 0
    )
    if not (apart > DAMPING_LIMIT).any():
        return []
    worst = int(np.argmax(apart))
    figures = found[0].diagnostics.figures
    return [
        Finding(
            "damping-doubt",
            "doubt",
            f"Regression and shift invariance disagree on {int((apart > DAMPING_LIMIT).sum())} "
            f"of {len(pairs)} damping ratios, worst at "
            f"{first.frequencies_hz[pairs[worst, 0]]:.4g} Hz: {100 * one[worst]:.3g} and "
            f"{100 * two[worst]:.3g} %. After the {figures['past_rows']} past rows the predictor "
            f"still remembers {100 * figures['predictor_memory']:.2g} %.",
            "Use more block_rows or a longer record, or believe frequencies only.",
        )
    ]


def _transitions(method: Any, stream: Stream) -> list[Any]:
    if stream.n_inputs and getattr(method, "transition", "") == "auto":
        return [replace(method, transition=name) for name in ("regression", "shift")]
    return [method]
