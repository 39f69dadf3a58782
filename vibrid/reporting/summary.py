"""The summary of an identification as tables and lines for the terminal."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..files.survey import Survey
from ..fit import Fit
from ..identification import Assessment
from ..modes import ModeQuality, Modes, modes_of, quality_of
from ..record import Channel, Floats
from .information import describe_responses
from .outcome import STEADY_SHARE, Outcome, ResponsesOutcome, method_name
from .words import (
    add,
    change,
    channel_names,
    finding_line,
    findings_section,
    heading,
    indented,
    kinds,
    line,
    number,
    plural,
    size,
    table,
)

MOST_OUTPUTS = 12  # of a table of fits; beyond, mean, smallest and largest
SLOWEST_SHOWN = 4  # time constants of real poles
SIGNIFICANT = 5  # digits of the largest frequency


def summary(outcome: Outcome) -> Group:
    """Return all that a user should know about an identification, to be printed by rich."""
    parts: list[RenderableType] = []
    for section in (_read, _chosen, _modes, _reference, _fit, _findings, _saved):
        lines = list(section(outcome))
        if lines:
            parts += [*lines, Text("")]
    return Group(*parts[:-1])


def describe_fit(fit: Fit, name: str) -> Group:
    """Return what a saved model holds: method, order, channels, modes, findings."""
    rate = f" at {1 / fit.model.dt:.6g} Hz" if fit.model.dt else ""
    parts: list[RenderableType] = [
        heading(name),
        line(
            f"a saved model{rate}: order {fit.order}, method={method_name(fit)} ({_options(fit)})"
        ),
    ]
    for role, channels in (("input", fit.input_channels), ("output", fit.output_channels)):
        if channels:
            parts.append(line(_side(role, channels)))
    return Group(*parts, *model_sections(fit))


def summary_of_responses(outcome: ResponsesOutcome) -> Group:
    """Return all that a user should know about a realization of frequency responses."""
    fit = outcome.fit
    figures = fit.diagnostics.figures
    return Group(
        describe_responses(outcome.source, outcome.name),
        Text(""),
        heading("Chosen"),
        line(f"method={method_name(fit)} {outcome.method_reason} ({_options(fit)})"),
        *map(line, figures.get("choices", ())),
        line(
            "the model misses "
            f"{number(100 * figures['reconstruction_error'], '.3g')} % (rms) of the impulse "
            "responses"
        ),
        *model_sections(fit),
        Text(""),
        _written(outcome.saved),
    )


def model_sections(fit: Fit) -> Iterator[RenderableType]:
    """Yield the modes and the findings of a fit."""
    modes, findings = modes_of(fit), fit.diagnostics.findings
    yield Text("")
    yield heading("Modes" if modes.n_modes else "Modes: none")
    if modes.n_modes:
        columns = _mode_columns(modes, quality_of(fit), list(range(modes.n_modes)))
        made = table(*columns)
        for row in zip(*columns.values(), strict=True):
            add(made, *row)
        yield indented(made)
    if len(modes.real_poles):
        yield line(_real_poles(modes.real_poles))
    if findings:
        yield Text("")
        yield from findings_section(findings)


def _read(outcome: Outcome) -> Iterator[RenderableType]:
    source, survey = outcome.source, outcome.survey
    yield heading("Read")
    yield line(f"{source.name or 'record'}: {size(source)}, {_gaps(survey)}")
    for role, channels in (("input", source.input_channels), ("output", source.output_channels)):
        if channels:
            yield line(_side(role, channels))
    yield from _band(outcome)
    suggestion = (survey.suggestion,) if survey.suggestion and outcome.band is None else ()
    for remark in (*survey.findings, *suggestion):
        yield line(f"! {remark}")


def _side(role: str, channels: Sequence[Channel]) -> str:
    return f"{plural(len(channels), role)} ({kinds(channels)}): {channel_names(channels)}"


def _gaps(survey: Survey) -> str:
    if not survey.n_gaps:
        return "no gaps"
    return f"{plural(survey.n_gaps, 'gap')} of together {survey.missing_duration:.4g} s"


def _band(outcome: Outcome) -> Iterator[RenderableType]:
    if outcome.band is not None:
        low, high = outcome.band
        yield line(
            f"in the band {low:g} to {high:g} Hz {outcome.band_reason}: {size(outcome.record)}"
        )


def _chosen(outcome: Outcome) -> Iterator[RenderableType]:
    figures = outcome.fit.diagnostics.figures
    yield heading("Chosen")
    options = _options(outcome.fit)
    yield line(f"method={outcome.method_name} {outcome.method_reason} ({options})")
    for reason in figures.get("choices", ()):
        yield line(reason)
    if "completion" in figures and outcome.record.n_inputs:
        why = figures.get("completion_reason")
        because = f": {why}" if why else ""
        yield line(f"B, D and initial states by {figures['completion']}{because}")


def _options(fit: Fit) -> str:
    return ", ".join(
        f"{field.name}={_value(getattr(fit.method, field.name))}"
        for field in dataclasses.fields(fit.method)
        if getattr(fit.method, field.name) is not None
    )


def _value(value: object) -> str:
    return " ".join(map(str, value)) if isinstance(value, tuple) else str(value)


def _modes(outcome: Outcome) -> Iterator[RenderableType]:
    modes, listed = outcome.modes, outcome.listed
    where = "" if outcome.band is None else f" from {outcome.band[0]:g} to {outcome.band[1]:g} Hz"
    yield heading(f"Modes{where}" if listed else f"Modes{where}: none")
    if listed:
        yield indented(_mode_table(outcome))
    doubtful = sum(not outcome.is_steady(k) for k in listed)
    if listed:
        yield line(
            "MPC: 1 for a shape whose points move in phase. EMAC: 1 for a mode that the data "
            "follow to the end of the horizon.",
            "dim",
        )
    if outcome.persistence is not None and listed:
        said = "Seen in: share of the orders tried that show the mode"
        mark = f"; ? marks those below {STEADY_SHARE:.0%}, not to be relied on" if doubtful else ""
        yield line(f"{said}{mark}.", "dim")
    if len(listed) < modes.n_modes:
        outside = modes.n_modes - len(listed)
        yield line(
            f"{plural(outside, 'mode')} outside the band {'is' if outside == 1 else 'are'}"
            " not listed."
        )
    if len(modes.real_poles):
        yield line(_real_poles(modes.real_poles))


def _mode_table(outcome: Outcome) -> Table:
    share, listed = outcome.persistence, list(outcome.listed)
    columns = _mode_columns(outcome.modes, quality_of(outcome.fit), listed)
    if share is not None:
        columns["seen in"] = [number(100 * share[k], ".0f") + " %" for k in listed]
        columns[" "] = ["" if outcome.is_steady(k) else "?" for k in listed]
    made = table(*columns)
    for k, row in zip(listed, zip(*columns.values(), strict=True), strict=True):
        add(made, *row, style="" if outcome.is_steady(k) else "dim")
    return made


def _mode_columns(modes: Modes, quality: ModeQuality, listed: list[int]) -> dict[str, list[str]]:
    f_std, damping_std = modes.frequencies_std[listed], modes.damping_std[listed]
    digits = frequency_digits(modes.frequencies_hz[listed])
    columns: dict[str, list[str]] = {"#": [str(k + 1) for k in range(len(listed))]}
    columns["f [Hz]"] = [number(f, f".{digits}f") for f in modes.frequencies_hz[listed]]
    if np.isfinite(f_std).any():
        columns["± [Hz]"] = [number(s, ".2g") for s in f_std]
    columns["ζ [%]"] = [number(100 * z, ".3f") for z in modes.damping_ratios[listed]]
    if np.isfinite(damping_std).any():
        columns["± [%]"] = [number(100 * s, ".2g") for s in damping_std]
    columns["MPC"] = [number(c, ".3f") for c in modes.phase_collinearity[listed]]
    emac = quality.emac if np.isfinite(quality.emac).any() else quality.emac_outputs
    if np.isfinite(emac).any():
        columns["EMAC"] = [number(e, ".3f") for e in emac[listed]]
    return columns


def frequency_digits(frequencies_hz: Floats) -> int:
    """Return how many decimals give the largest frequency five significant digits.

    >>> frequency_digits(np.array([1.8, 10.1]))
    3
    """
    return int(np.clip(SIGNIFICANT - 1 - np.floor(np.log10(frequencies_hz.max())), 0, 9))


def _real_poles(poles: NDArray[np.complex128]) -> str:
    at_nyquist = np.abs(poles.imag) > 0
    constants = np.sort(1 / np.abs(poles[~at_nyquist & (poles != 0)].real))[::-1]
    said = []
    if len(constants):
        slowest = "slowest " if len(constants) > SLOWEST_SHOWN else ""
        times = ", ".join(f"{seconds:.3g}" for seconds in constants[:SLOWEST_SHOWN])
        said.append(
            f"{plural(len(constants), 'real pole')} that {_do(len(constants))} not oscillate "
            f"({slowest}time {'constant' if len(constants) == 1 else 'constants'} {times} s)"
        )
    if (poles == 0).any():
        said.append("a pure integrator")
    if at_nyquist.any():
        said.append(f"{plural(int(at_nyquist.sum()), 'pole')} at the Nyquist frequency")
    return "Also " + "; ".join(said) + "."


def _do(count: int) -> str:
    return "does" if count == 1 else "do"


def _reference(outcome: Outcome) -> Iterator[RenderableType]:
    reference, modes = outcome.reference, outcome.modes
    if reference is None:
        return
    zeta = reference.damping_ratios
    yield heading(f"Compared with the {reference.source} modes")
    columns = [f"{reference.source} f [Hz]", "found f [Hz]", "error [%]"]
    if zeta is not None:
        columns += [f"{reference.source} ζ [%]", "found ζ [%]", "error [%]"]
    made = table(*columns)
    for k, (f, mode) in enumerate(
        zip(reference.frequencies_hz, outcome.reference_pairs, strict=True)
    ):
        g = np.nan if mode is None else modes.frequencies_hz[mode]
        cells = [number(f, ".5g"), number(g, ".5g"), change(g / f, 3)]
        if zeta is not None:
            z = np.nan if mode is None else modes.damping_ratios[mode]
            cells += [
                number(100 * zeta[k], ".4f"),
                number(100 * z, ".4f"),
                change(z / zeta[k], 2),
            ]
        add(made, *cells)
    yield indented(made)
    found = "All" if outcome.is_reference_found else "NOT all"
    yield line(f"{found} frequencies agree within {100 * reference.limit:g} %.")


def _fit(outcome: Outcome) -> Iterator[RenderableType]:
    shown = [each for each in (outcome.seen, outcome.unseen) if each is not None]
    if not shown:
        return
    yield heading("Fit, 100 (1 − ‖y − ŷ‖ / ‖y − ȳ‖) %")
    for assessment in shown:
        yield line(_assessment(outcome, assessment))
    names = outcome.record.output_names
    if 1 < len(names) <= MOST_OUTPUTS:
        yield indented(_fit_table(names, shown))
    if outcome.unseen_finding is not None:
        yield finding_line(outcome.unseen_finding)


def _assessment(outcome: Outcome, assessment: Assessment) -> str:
    where = "same record" if assessment.seen else f"unseen ({outcome.unseen_part})"
    kind = "one-step prediction" if assessment.kind == "prediction" else "simulation"
    fit = assessment.fit_percent
    score = f"{fit[0]:.1f} %"
    if len(fit) > 1:
        score = f"mean {fit.mean():.1f} %, outputs from {fit.min():.1f} to {fit.max():.1f} %"
    stretch = f"{assessment.start:.4g} to {assessment.stop:.4g} s"
    return f"{where}, {stretch}, {kind}: {score}; {assessment.rule}"


def _fit_table(names: Sequence[str], shown: Sequence[Assessment]) -> Table:
    columns = ["output"]
    for assessment in shown:
        where = "" if assessment.seen else "unseen "
        columns += [f"{where}fit [%]", f"{where}VAF [%]"]
    made = table(*columns, left=("output",))
    for k, name in enumerate(names):
        cells = [
            number(values[k], ".1f")
            for assessment in shown
            for values in (assessment.fit_percent, assessment.vaf_percent)
        ]
        add(made, name, *cells)
    return made


def _findings(outcome: Outcome) -> Iterator[RenderableType]:
    return findings_section(outcome.fit.diagnostics.findings)


def _saved(outcome: Outcome) -> Iterator[RenderableType]:
    yield _written(outcome.saved)


def _written(path: Path | None) -> Text:
    if path is None:
        return Text("The model was not written; --save FILE keeps it.")
    # a path that is cut into two lines cannot be copied
    return Text(f"Model written to {path}", no_wrap=True, overflow="ignore")
