"""What an identification or a file has to say as plain dictionaries, lists and numbers."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..files.survey import Survey
from ..fit import Fit
from ..identification import Assessment
from ..modes import modes_of
from ..record import Channel, FrequencyResponses, Record
from .outcome import Outcome, ResponsesOutcome, method_name


def plain(value: Any) -> Any:
    """Return a value as JSON knows it: NaN and infinity as None, complex as [real, imaginary].

    >>> plain({"a": np.array([1.0, np.nan]), "b": 1 + 2j})
    {'a': [1.0, None], 'b': [1.0, 2.0]}
    """
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain({f.name: getattr(value, f.name) for f in dataclasses.fields(value)})
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [plain(each) for each in value]
    return value


def outcome_as_json(outcome: Outcome) -> dict[str, Any]:
    """Return all that `summary` prints, and the mode shapes."""
    facts = {
        "record": {
            **_record(outcome.source),
            "gaps": outcome.survey.n_gaps,
            "missing_s": outcome.survey.missing_duration,
            "remarks": outcome.survey.findings,
        },
        "band": {
            "used_hz": outcome.band,
            "suggested_hz": outcome.survey.suggested_band_hz,
            "suggestion": outcome.survey.suggestion,
            "why": outcome.band_reason,
            "n_samples": outcome.record.n_samples,
            "dt": outcome.record.dt,
        },
        "choices": _choices(outcome),
        "modes": [_mode(outcome, k) for k in outcome.listed],
        "modes_outside_band": outcome.modes.n_modes - len(outcome.listed),
        "real_poles": outcome.modes.real_poles,
        "fit": {"seen": _score(outcome.seen), "unseen": _score(outcome.unseen)},
        "findings": outcome.findings,
        "saved": outcome.saved,
    }
    if outcome.reference is not None:
        facts["reference"] = _reference(outcome)
    return dict(plain(facts))


def survey_as_json(survey: Survey, record: Record) -> dict[str, Any]:
    """Return what `vibrid info` says of a record."""
    looked = {field.name: getattr(survey, field.name) for field in dataclasses.fields(survey)}
    channels = {each.name: each for each in (*record.output_channels, *record.input_channels)}
    looked["channels"] = [
        {
            **plain(each),
            "dof": channels[each.name].dof,
            "sign": channels[each.name].sign,
            "delay": channels[each.name].delay,
        }
        for each in survey.channels
    ]
    more = {"kind": "record", "duration_s": survey.duration, "rate_hz": survey.rate}
    return dict(plain({**more, **looked}))


def responses_as_json(responses: FrequencyResponses, name: str) -> dict[str, Any]:
    """Return what `vibrid info` says of a file of frequency responses."""
    lines = responses.frequencies_hz
    return dict(
        plain(
            {
                "kind": "frequency responses",
                "name": name,
                "n_lines": len(lines),
                "lowest_hz": lines[0],
                "highest_hz": lines[-1],
                "references": responses.input_channels,
                "responses": responses.output_channels,
                "has_coherence": responses.coherence is not None,
            }
        )
    )


def fit_as_json(fit: Fit, name: str) -> dict[str, Any]:
    """Return what `vibrid info` says of a saved model."""
    modes, method = modes_of(fit), method_name(fit)
    return dict(
        plain(
            {
                "kind": "model",
                "name": name,
                "method": method,
                "options": fit.method,
                "order": fit.order,
                "dt": fit.model.dt,
                "inputs": fit.input_channels,
                "outputs": fit.output_channels,
                "modes": [
                    {
                        "frequency_hz": modes.frequencies_hz[k],
                        "damping_ratio": modes.damping_ratios[k],
                        "phase_collinearity": modes.phase_collinearity[k],
                        "shape": modes.shapes[:, k],
                    }
                    for k in range(modes.n_modes)
                ],
                "real_poles": modes.real_poles,
                "findings": fit.diagnostics.findings,
            }
        )
    )


def responses_outcome_as_json(outcome: ResponsesOutcome) -> dict[str, Any]:
    """Return a realization of frequency responses."""
    figures = outcome.fit.diagnostics.figures
    return {
        "source": responses_as_json(outcome.source, outcome.name),
        **fit_as_json(outcome.fit, outcome.name),
        "choices": plain(figures.get("choices", ())),
        "reconstruction_error": plain(figures["reconstruction_error"]),
        "saved": plain(outcome.saved),
    }


def _record(record: Record) -> dict[str, Any]:
    return {
        "name": record.name,
        "n_samples": record.n_samples,
        "dt": record.dt,
        "rate_hz": 1 / record.dt,
        "duration_s": record.duration,
        "inputs": _labels(record.input_channels),
        "outputs": _labels(record.output_channels),
    }


def _labels(channels: Sequence[Channel]) -> list[Any]:
    return [plain(channel) for channel in channels]


def _choices(outcome: Outcome) -> dict[str, Any]:
    fit: Fit = outcome.fit
    figures = fit.diagnostics.figures
    return {
        "method": outcome.method_name,
        "method_why": outcome.method_reason,
        "options": fit.method,
        "order": fit.order,
        "why": figures.get("choices", ()),
        "completion": figures.get("completion"),
        "completion_why": figures.get("completion_reason"),
    }


def _mode(outcome: Outcome, k: int) -> dict[str, Any]:
    modes, share = outcome.modes, outcome.persistence
    return {
        "frequency_hz": modes.frequencies_hz[k],
        "damping_ratio": modes.damping_ratios[k],
        "frequency_std_hz": modes.frequencies_std[k],
        "damping_std": modes.damping_std[k],
        "phase_collinearity": modes.phase_collinearity[k],
        "seen_in": None if share is None else share[k],
        "steady": outcome.is_steady(k),
        "shape": modes.shapes[:, k],
    }


def _score(assessment: Assessment | None) -> dict[str, Any] | None:
    return None if assessment is None else dict(plain(assessment))


def _reference(outcome: Outcome) -> dict[str, Any]:
    reference = outcome.reference
    assert reference is not None
    return {
        "source": reference.source,
        "frequencies_hz": reference.frequencies_hz,
        "damping_ratios": reference.damping_ratios,
        "modes": [
            None if mode is None else outcome.listed.index(mode) for mode in outcome.reference_pairs
        ],
        "found": outcome.is_reference_found,
    }
