"""What is printed of a blind identification, and what goes into JSON."""

from __future__ import annotations

import json

import numpy as np
from blind_records import reference, under_noise, uniform_chain
from rich.console import Console

from vibrid.blind import BlindFit, identify_blind
from vibrid.reporting.blind import blind_as_json, describe_blind


def printed(fit: BlindFit) -> str:
    console = Console(width=100, record=True, force_terminal=False, quiet=False, file=None)
    with console.capture() as capture:
        console.print(describe_blind(fit))
    return capture.get()


def test_an_answer_is_printed_whole() -> None:
    """Matrices, modes, frequencies of the force and its level."""
    text = printed(identify_blind(reference(0, 60).record, 3, mass=[2.0, 1.5, 1.0]))
    for word in (
        "M⁻¹K",
        "M⁻¹D",
        "K",
        "Modes",
        "frequencies 0.7, 1.9, 3.3",
        "RMS",
        "periodic forces",
    ):
        assert word in text
    assert "nan" not in text


def test_a_refusal_names_its_rule(rng: np.random.Generator) -> None:
    """No matrix, but the rule, its figures and the cure."""
    case = under_noise(uniform_chain(3), [0, 1, 2], duration=20.0, snr_db=50, rng=rng)
    text = printed(identify_blind(case.record, 3, excitation="point"))
    assert "refused, in_band" in text and "M⁻¹K [" not in text


def test_rows_that_are_not_known_are_dashes(rng: np.random.Generator) -> None:
    """A partial answer keeps its rows, prints – for the others and says what is missing."""
    case = under_noise(uniform_chain(3), [2], duration=30.0, snr_db=50, rng=rng)
    text = printed(identify_blind(case.record, 3, excitation="point"))
    for word in ("–", "missing: the rows of f3", "forces act at f3"):
        assert word in text


def test_json_holds_plain_values() -> None:
    """The dictionary is JSON, with the verdict and its figures."""
    facts = json.loads(json.dumps(blind_as_json(identify_blind(reference(0, 60).record, 3))))
    assert facts["verdict"]["accepted"] is True
    assert np.shape(facts["normalized_stiffness"]) == (3, 3)
    assert len(facts["input_frequencies_hz"]) == 5
