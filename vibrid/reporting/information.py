"""What a file holds, as tables and lines for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..files.survey import ChannelSurvey, Survey
from ..record import Channel, FrequencyResponses, Record
from .words import (
    add,
    channel_names,
    heading,
    hertz,
    indented,
    kinds,
    line,
    number,
    plural,
    size,
    table,
)


def describe_record(survey: Survey, record: Record) -> Group:
    """Return channels, units, length, rate, gaps, spectrum and what deserves attention."""
    gaps = "no gaps"
    if survey.n_gaps:
        gaps = f"{plural(survey.n_gaps, 'gap')}, together {survey.missing_duration:.4g} s"
    counts = [plural(record.n_outputs, "output")]
    if record.n_inputs:
        counts.insert(0, plural(record.n_inputs, "input"))
    parts: list[RenderableType] = [
        heading(survey.name or "record"),
        line(f"{size(record)}; {gaps}; {' and '.join(counts)}"),
        *_unstated(survey),
        Text(""),
        indented(_channel_table(survey, record)),
        Text(""),
        heading("Spectrum"),
        *_spectrum(survey),
    ]
    said = (*survey.findings, survey.suggestion) if survey.suggestion else survey.findings
    if said:
        parts += [Text(""), heading("Worth attention")]
        parts += [line(sentence[0].upper() + sentence[1:] + ".") for sentence in said]
    return Group(*parts)


def describe_responses(responses: FrequencyResponses, name: str) -> Group:
    """Return lines, references and responses of a file of frequency responses."""
    lines = responses.frequencies_hz
    steps = np.diff(lines)
    step = ""
    if len(steps) and np.allclose(steps, steps[0], rtol=1e-3):
        step = f", every {steps[0]:.4g} Hz"
    parts: list[RenderableType] = [
        heading(name),
        line(
            f"frequency responses, not a time record: {plural(len(lines), 'line')} from "
            f"{lines[0]:.4g} to {lines[-1]:.4g} Hz{step}"
        ),
        line(_side("reference", responses.input_channels)),
        line(_side("response", responses.output_channels)),
        line("coherence known" if responses.coherence is not None else "no coherence"),
    ]
    return Group(*parts)


def _side(role: str, channels: tuple[Channel, ...]) -> str:
    return f"{plural(len(channels), role)} ({kinds(channels)}): {channel_names(channels)}"


def _unstated(survey: Survey) -> Iterator[RenderableType]:
    if all(each.quantity == "other" and not each.unit for each in survey.channels):
        yield line("quantities and units not stated (--quantity, --unit, --channels)")


def _channel_table(survey: Survey, record: Record) -> Table:
    """Return one row a channel, without the columns that would say nothing."""
    known = {each.name: each for each in (*record.input_channels, *record.output_channels)}
    labels = {
        "channel": [each.name for each in survey.channels],
        "role": [each.role for each in survey.channels],
        "quantity": [each.quantity.replace("_", " ") for each in survey.channels],
        "unit": [each.unit or "–" for each in survey.channels],
        "DOF": [known[each.name].dof or "–" for each in survey.channels],
    }
    silent = {"role": {"output"}, "quantity": {"other"}, "unit": {"–"}, "DOF": {"–"}}
    shown = {name: cells for name, cells in labels.items() if set(cells) != silent.get(name)}
    made = table(*shown, "mean", "std", "peak [Hz]", "state", left=(*shown, "state"))
    for each, *cells in zip(survey.channels, *shown.values(), strict=True):
        figures = [number(each.mean, ".3g"), number(each.std, ".3g"), number(each.peak_hz, ".4g")]
        add(made, *cells, *figures, _state(each))
    return made


def _state(channel: ChannelSurvey) -> str:
    if channel.missing_fraction == 1:
        return "empty"
    said = [
        word
        for word, holds in (
            ("constant", channel.is_constant),
            ("clipped", channel.is_clipped),
            ("drifts", channel.is_drifting),
            ("gaps", channel.missing_fraction > 0),
        )
        if holds
    ]
    return ", ".join(said) or "good"


def _spectrum(survey: Survey) -> Iterator[RenderableType]:
    low, high = survey.energy_band_hz
    if not np.isfinite([low, high]).all():
        yield line("not known: too few samples in a row, or none that moves")
        return
    nyquist = survey.rate / 2
    share = f"{100 * high / nyquist:.0f} % of the Nyquist frequency, {nyquist:g} Hz"
    yield line(
        f"95 % of the outputs' energy lies between {hertz(low)} and {hertz(high)} Hz; "
        f"{hertz(high)} Hz is {share}"
    )
    lines = [each.peak_hz for each in survey.channels if each.role == "output"]
    peaks = sorted({hertz(peak) for peak in lines if np.isfinite(peak)}, key=float)
    if peaks:
        some = peaks if len(peaks) <= 6 else [*peaks[:5], "…", peaks[-1]]
        word = "line" if len(peaks) == 1 else "lines"
        yield line(f"strongest {word} of the outputs: {', '.join(some)} Hz")
