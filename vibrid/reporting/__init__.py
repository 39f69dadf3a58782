"""What was found, as tables for the terminal and as plain values for JSON."""

from .as_json import (
    fit_as_json,
    outcome_as_json,
    responses_as_json,
    responses_outcome_as_json,
    survey_as_json,
)
from .information import describe_record, describe_responses
from .outcome import Outcome, Reference, ResponsesOutcome
from .summary import describe_fit, summary, summary_of_responses

__all__ = [
    "Outcome",
    "Reference",
    "ResponsesOutcome",
    "describe_fit",
    "describe_record",
    "describe_responses",
    "fit_as_json",
    "outcome_as_json",
    "responses_as_json",
    "responses_outcome_as_json",
    "summary",
    "summary_of_responses",
    "survey_as_json",
]
