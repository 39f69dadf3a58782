"""What a user should know of a finished fit: reasons of its choices, and doubts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..fit import Finding, Fit
from ..modes import modes_of
from .choice import Choice
from .finishing import DAMPING_LIMIT
from .options import leaves_transition
from .scan import LARGEST_DAMPING

SHORT_MEMORY = 1e-2  # what a predictor may still remember at the end of the past horizon
POOR_SIMULATION = 0.7  # rms error over standard deviation: half of the variance is missed
DRIFT_SHARE = 1 / 3  # of the record: a pole slower than this plays a drift
SLOWER = 20.0  # times slower than the slowest mode: a real pole no structure has


def with_reasons(fit: Fit, stream: Stream | None, choice: Choice) -> Fit:
    """Return the fit with the reasons of its choices, what the orders gave, and findings."""
    figures: dict[str, Any] = {"choices": choice.reasons}
    if choice.scan is not None:
        figures["orders"] = choice.scan.orders
        figures["criterion"] = choice.scan.criterion
        figures["held_out_errors"] = choice.held_out
        if choice.scan.rank is None:  # below the rank of noise-free data no order is right
            persistence = choice.scan.persistence(modes_of(fit), fit.order // 2)
            figures["persistence"] = persistence
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
    """Say when the predictor remembers more than the past rows hold: regression suffers.

    A note where shift invariance was taken for it, or agrees.
    """
    figures = fit.diagnostics.figures
    memory, rows = figures.get("predictor_memory", 0.0), figures.get("past_rows", 1)
    regressed = figures.get("transition") == "regression"
    if memory <= SHORT_MEMORY or not (regressed or leaves_transition(fit.method)):
        return []
    seen = (
        f"rho(A-KC)^s is {memory:.2g} after s = {rows} past rows (limit {SHORT_MEMORY:g}): the "
        "horizon is shorter than the predictor's memory, which biases the damping of a "
        "regression of the states"
    )
    apart = figures.get("damping_difference", np.inf)
    if not regressed:
        seen += "; shift invariance, which does not suffer, was taken"
        return [Finding("short-horizon", "note", f"{seen}.")] if apart > DAMPING_LIMIT else []
    if apart <= DAMPING_LIMIT:
        seen += f"; shift invariance, which does not suffer, agrees within {100 * apart:.2g} %"
        return [Finding("short-horizon", "note", f"{seen}.")]
    fed_back = any(finding.code == "feedback" for finding in fit.diagnostics.findings)
    cure = f"Use {_rows_needed(memory, rows)}" + ("" if fed_back else ', or transition="shift"')
    return [Finding("short-horizon", "doubt", f"{seen}.", f"{cure}.")]


def _rows_needed(memory: float, rows: int) -> str:
    """Return the past rows after which this predictor would remember little enough."""
    if memory >= 1:
        return "more block_rows"
    return f"about {int(np.ceil(rows * np.log(SHORT_MEMORY) / np.log(memory)))} block_rows"


def _drift_findings(fit: Fit, stream: Stream | None) -> list[Finding]:
    if stream is None:
        return []
    longest = max(segment.length for segment in stream.segments) * (fit.model.dt or 1.0)
    poles = fit.model.continuous_poles
    rates = np.abs(poles)
    slow = rates * longest * DRIFT_SHARE < 1
    lightly = (poles.imag != 0) & (-poles.real < LARGEST_DAMPING * rates)
    if lightly.any():
        slow |= (poles.imag == 0) & (SLOWER * rates < rates[lightly].min())
    if not slow.any():
        return []
    return [
        Finding(
            "drift-pole",
            "doubt",
            f"{int(slow.sum())} pole(s) are slower than a third of the record ({longest:.4g} s), "
            f"or real and {SLOWER:g} times slower than every mode: they play a drift, not the "
            "structure.",
            "Detrend the record, or identify in a band (--band).",
        )
    ]
