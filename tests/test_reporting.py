"""Tables and JSON of an identification: what is shown, marked and left out."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console, RenderableType

from vibrid import Channel, FrequencyResponses, Record, identify, modes_of
from vibrid.excitation import white_noise
from vibrid.files.survey import survey
from vibrid.identification import assess
from vibrid.reporting import (
    Outcome,
    Reference,
    describe_fit,
    describe_record,
    describe_responses,
    fit_as_json,
    outcome_as_json,
    responses_as_json,
    summary,
    survey_as_json,
)
from vibrid.reporting.as_json import plain
from vibrid.structures import shear_frame

FRAME = shear_frame(2, 100.0, 2e4, damping_ratio=0.01)


@pytest.fixture(scope="module")
def outcome() -> Outcome:
    """Return the outcome of a noisy record of two modes, identified with order 6."""
    rng = np.random.default_rng(5)
    record = FRAME.simulate(white_noise(1500, rng=rng), 0.05, forces=["f2"], noise=0.02, rng=rng)
    fit = identify(record, order=4)
    persistence = {"persistence": np.array([1.0, 0.25])}
    fit = replace(fit, diagnostics=fit.diagnostics.joined(persistence))
    return Outcome(
        source=record,
        record=record,
        survey=survey(record),
        band=None,
        band_reason="",
        method_reason="as asked for",
        fit=fit,
        seen=assess(fit, record),
        unseen=None,
    )


def printed(what: RenderableType, width: int = 80) -> str:
    """Return what a terminal of some width without colours would show."""
    console = Console(file=io.StringIO(), width=width, markup=True)
    console.print(what)
    text: str = console.file.getvalue()  # type: ignore[attr-defined]
    return text


def test_doubtful_modes_are_marked(outcome: Outcome) -> None:
    """A mode that few orders show has a mark, and a line explains it."""
    lines = [line for line in printed(summary(outcome)).splitlines() if "%" in line]
    rows = [line for line in lines if line.strip()[:1].isdigit() and "seen" not in line]
    assert rows[0].rstrip().endswith("100 %") and rows[1].rstrip().endswith("?")
    assert "not to be relied on" in printed(summary(outcome))


def test_unknown_columns_are_left_out(outcome: Outcome) -> None:
    """Standard deviations are shown only where they are known."""
    assert "±" not in printed(summary(outcome))
    known = replace(modes_of(outcome.fit), frequencies_std=np.array([0.01, np.nan]))
    other = replace(outcome)
    other.__dict__["modes"] = known
    shown = printed(summary(other))
    assert "± [Hz]" in shown and "± [%]" not in shown and "0.01" in shown


def test_modes_outside_the_band_are_counted(outcome: Outcome) -> None:
    """With a band, only the modes inside are listed."""
    inside = replace(outcome, band=(0.5, 2.0))
    assert "1 mode outside the band is not listed" in printed(summary(inside))
    facts = outcome_as_json(inside)
    assert len(facts["modes"]) == 1 and facts["modes_outside_band"] == 1


def test_reference_needs_a_steady_mode(outcome: Outcome) -> None:
    """A reference counts as found only when a steady mode lies within the limit."""
    low, high = FRAME.frequencies_hz
    assert replace(outcome, reference=Reference("true", np.array([low]))).is_reference_found
    missed = replace(outcome, reference=Reference("true", np.array([high])))
    assert not missed.is_reference_found
    assert "NOT all" in printed(summary(missed))


def test_findings_of_the_survey_suggest_a_band_once(outcome: Outcome) -> None:
    """The suggested band is not repeated where a band is used."""
    hint = "a band of 0 to 2 Hz is worth trying (--band 0 2)"
    looked = replace(outcome.survey, findings=("channel a drifts",), suggestion=hint)
    free = printed(summary(replace(outcome, survey=looked)), 200)
    banded = printed(summary(replace(outcome, survey=looked, band=(0.0, 5.0))), 200)
    assert hint in free and hint not in banded and "channel a drifts" in banded


@pytest.mark.parametrize(
    ("unseen_fit", "strength", "code"),
    [(88.0, 1.0, "worse-unseen"), (88.0, 0.05, "weak-unseen"), (92.0, 0.05, None)],
)
def test_a_much_worse_unseen_part_is_a_finding(
    outcome: Outcome, unseen_fit: float, strength: float, code: str | None
) -> None:
    """More than 10 points worse blames the model, unless the part hardly moves."""
    assert outcome.seen is not None
    cut, n = 1200, outcome.record.n_samples
    y = np.array(outcome.record.outputs)
    y[cut:] *= strength
    record = Record(y, outcome.record.inputs, dt=0.05)
    seen = replace(outcome.seen, fit_percent=np.array([99.0, 99.0]))
    scores = {"fit_percent": np.full(2, unseen_fit), "start": cut * 0.05, "stop": n * 0.05}
    judged = replace(outcome, record=record, seen=seen, unseen=replace(seen, seen=False, **scores))
    codes = [each["code"] for each in outcome_as_json(judged)["findings"]]
    shown = " ".join(printed(summary(judged)).split())
    assert (codes[-1:] == [code]) if code else not {"worse-unseen", "weak-unseen"} & set(codes)
    assert ("Try a lower --order, a --band, or another stretch." in shown) == (
        code == "worse-unseen"
    )
    assert shown.count("The unseen part fits 11 points worse") == (code is not None)


def test_a_saved_model_is_described(outcome: Outcome) -> None:
    """Method, order, channels and modes of a fit are told, as text and as JSON."""
    shown = printed(describe_fit(outcome.fit, "run.vibrid.h5"))
    for words in ("a saved model at 20 Hz: order 4, method=n4sid", "1 input (force", "f [Hz]"):
        assert words in shown
    facts = fit_as_json(outcome.fit, "run.vibrid.h5")
    assert (facts["kind"], facts["method"], facts["order"]) == ("model", "n4sid", 4)
    f = [mode["frequency_hz"] for mode in facts["modes"]]
    np.testing.assert_allclose(f, FRAME.frequencies_hz, rtol=0.01)


def test_names_are_never_markup(rng: np.random.Generator) -> None:
    """Brackets in names stay, in the table and on narrow terminals."""
    record = Record(
        rng.standard_normal((400, 2)),
        dt=0.1,
        output_channels=[Channel("[bold]x"), Channel("a" * 90)],
    )
    shown = printed(describe_record(survey(record), record))
    assert "[bold]x" in shown
    assert shown.replace("\n", "").replace(" ", "").count("a") >= 90
    assert survey_as_json(survey(record), record)["channels"][0]["sign"] == 1


def test_frequency_responses_are_described() -> None:
    """Lines, references and responses are told, as text and as JSON."""
    responses = FrequencyResponses(
        np.ones((5, 2, 1), complex),
        np.arange(1.0, 6.0),
        output_channels=["r1", "r2"],
        input_channels=[Channel("h", "force", unit="N")],
    )
    shown = printed(describe_responses(responses, "plate.uff"))
    for words in ("5 lines from 1 to 5 Hz, every 1 Hz", "1 reference (force in N): h", "r1, r2"):
        assert words in shown
    facts = responses_as_json(responses, "plate.uff")
    assert facts["n_lines"] == 5 and facts["references"][0]["unit"] == "N"


def test_plain_values_are_json() -> None:
    """NaN and infinity become null, arrays lists, complex numbers pairs."""
    assert plain({"a": np.array([1.0, np.nan]), "b": np.int64(3), "c": (1 + 2j, np.inf)}) == {
        "a": [1.0, None],
        "b": 3,
        "c": [[1.0, 2.0], None],
    }
