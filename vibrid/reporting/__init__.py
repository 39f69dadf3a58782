"""What was found, as tables for the terminal and as plain values for JSON."""

from .as_json import outcome_as_json, responses_as_json, survey_as_json
from .information import describe_record, describe_responses
from .outcome import Outcome, Reference
from .summary import summary

__all__ = [
    "Outcome",
    "Reference",
    "describe_record",
    "describe_responses",
    "outcome_as_json",
    "responses_as_json",
    "summary",
    "survey_as_json",
]
