"""What a user should know of a finished fit: reasons of its choices, and doubts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..fit import Finding, Fit
from ..modes import modes_of
from .choice import Choice

SHORT_MEMORY = 1e-2  # what a predictor may still remember at the end of the past horizon
POOR_SIMULATION = 0.7  # rms error over standard deviation: half of the variance is missed
DRIFT_SHARE = 1 / 3  # of the record: a real pole slower than this plays a drift


def with_reasons(fit: Fit, stream: Stream | None, choice: Choice) -> Fit:
    """Return the fit with the reasons of its choices, what the orders gave, and findings."""
    figures: dict[str, Any] = {"choices": choice.reasons}
    if choice.scan is not None:
        figures["orders"] = choice.scan.orders
        figures["criterion"] = choice.scan.criterion
        figures["held_out_errors"] = choice.held_out
        figures["persistence"] = choice.scan.persistence(modes_of(fit), fit.order // 2)
    known = fit.diagnostics.findings
    more = [each for each in choice.decomposition.findings if each not in known]
    return with_findings(replace(fit, diagnostics=fit.diagnostics.joined(figures, more)), stream)


def with_findings(fit: Fit, stream: Stream | None) -> Fit:
    """Return the fit with what its figures give reason to doubt."""
    findings = [
        *_input_findings(fit),
        *_error_findings(fit),
        *_memory_findings(fit),
        *_drift_findings(fit, stream),
    ]
    return replace(fit, diagnostics=fit.diagnostics.joined({}, findings))


def _input_findings(fit: Fit) -> list[Finding]:
    """Say when what usually drives a structure was taken as a response."""
    drives = [
        channel.name
        for channel in fit.output_channels
        if channel.quantity in ("force", "base_acceleration")
    ]
    if not drives or fit.input_channels:
        return []
    names = ",".join(drives)
    return [
        Finding(
            "input-as-response",
            "warning",
            f"{', '.join(drives)} measured what usually drives a structure and was taken as a "
            "response.",
            f"If it drives: select(inputs=[…]), or --inputs {names}.",
        )
    ]


def _error_findings(fit: Fit) -> list[Finding]:
    error = fit.diagnostics.figures.get("simulation_error", 0.0)
    is_decay = fit.diagnostics.figures.get("responses") == "decay"
    if not (fit.input_channels or is_decay) or error <= POOR_SIMULATION:
        return []
    how, cure = "Simulated from the inputs", "check that the inputs are what drives the structure."
    if is_decay:
        how = "As free decays"
        cure = (
            'name the inputs, or take ambient vibration for what it is (responses="correlations").'
        )
    return [
        Finding(
            "poor-simulation",
            "warning",
            f"{how}, the model misses {100 * error:.3g} % of the outputs' standard deviation.",
            f"Try another order, a band, or {cure}",
        )
    ]


def _memory_findings(fit: Fit) -> list[Finding]:
    figures = fit.diagnostics.figures
    memory, rows = figures.get("predictor_memory", 0.0), figures.get("past_rows")
    # shift invariance does not suffer; with inputs and "auto" the two were compared
    compared = bool(fit.input_channels) and getattr(fit.method, "transition", "") == "auto"
    if memory <= SHORT_MEMORY or compared or figures.get("transition") != "regression":
        return []
    return [
        Finding(
            "short-horizon",
            "doubt",
            f"The predictor still remembers {100 * memory:.2g} % after the {rows} past rows "
            f"(limit {100 * SHORT_MEMORY:g} %), which biases damping.",
            "Use more block_rows.",
        )
    ]


def _drift_findings(fit: Fit, stream: Stream | None) -> list[Finding]:
    if stream is None:
        return []
    longest = max(segment.length for segment in stream.segments) * (fit.model.dt or 1.0)
    rates = np.abs(fit.model.continuous_poles)
    slow = int((rates * longest * DRIFT_SHARE < 1).sum())
    if not slow:
        return []
    return [
        Finding(
            "drift-pole",
            "doubt",
            f"{slow} pole(s) are slower than a third of the record ({longest:.4g} s): they play "
            "a drift, not the structure.",
            "Detrend the record, or identify in a band (--band).",
        )
    ]
