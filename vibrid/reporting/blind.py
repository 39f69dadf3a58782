"""A blind identification as tables for the terminal and as plain values for JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..blind import BlindFit
from ..record import Floats
from .as_json import plain
from .words import add, findings_section, heading, indented, line, number, plural, table

KINDS = {
    "periodic": "periodic forces, seen with a transient",
    "decay": "a free decay",
    "point": "forces at some degrees of freedom",
    "base": "base motion that was not measured",
    "ambient": "broadband forces on every degree of freedom",
    "out_of_band": "forces outside the band of the modes",
    "force_free": "a stretch without forces",
    "none": "nothing could be told",
}
MOST_DOFS = 12  # of a printed matrix
MOST_FREQUENCIES = 12  # of a printed list


def describe_blind(fit: BlindFit) -> Group:
    """Return verdict, matrices, modes, force and findings, to be printed by rich."""
    parts: list[RenderableType] = []
    for section in (_verdict, _matrices, _modes, _force, _checks, _findings):
        lines = list(section(fit))
        if lines:
            parts += [*lines, Text("")]
    return Group(*parts[:-1])


def blind_as_json(fit: BlindFit) -> dict[str, Any]:
    """Return all that `describe_blind` prints, deviations, phasors and force levels."""
    names = (
        "normalized_stiffness",
        "normalized_damping",
        "normalized_stiffness_std",
        "normalized_damping_std",
        "normalized_input",
        "stiffness",
        "damping",
        "input_frequencies_hz",
        "force_phasors",
        "normalized_force_std",
        "forced_dofs",
        "dofs",
        "mass",
        "dt",
        "units",
    )
    verdict = fit.verdict
    facts = {
        **{name: getattr(fit, name) for name in names},
        "normalized_force_rms": _levels(fit.normalized_force),
        "force_rms": None if fit.force is None else _levels(fit.force),
        "frequencies_hz": fit.modes.frequencies_hz,
        "damping_ratios": fit.modes.damping_ratios,
        "shapes": fit.modes.shapes,
        "verdict": {
            "kind": verdict.kind,
            "accepted": verdict.accepted,
            "determined": verdict.determined,
            "missing": verdict.missing,
            "assumed": verdict.assumed,
            "checks": verdict.checks,
            "refusals": verdict.refusals,
            "findings": verdict.findings,
        },
        "figures": fit.diagnostics.figures,
    }
    return {key: plain(value) for key, value in facts.items()}


def _verdict(fit: BlindFit) -> Iterator[RenderableType]:
    verdict = fit.verdict
    yield heading("Blind identification")
    yield line(f"{plural(fit.n_dof, 'DOF')}: {', '.join(fit.dofs)}; in {fit.units}")
    if verdict.accepted:
        known = [name.replace("_", " ") for name, known in verdict.determined.items() if known]
        yield line(f"{KINDS.get(verdict.kind, verdict.kind)}")
        yield line(f"determined: {', '.join(known) or 'nothing'}")
        if fit.forced_dofs and fit.forced_dofs != fit.dofs:
            yield line(f"forces act at {', '.join(fit.forced_dofs)}")
    for refusal in verdict.refusals:
        yield line(f"refused, {refusal}", "yellow")
    for missing in verdict.missing if verdict.accepted else ():
        yield line(f"missing: {missing}")
    for assumed in verdict.assumed:
        yield line(f"assumed: {assumed}")


def _matrices(fit: BlindFit) -> Iterator[RenderableType]:
    si = fit.units == "SI"
    shown = [
        ("M⁻¹K", "1/s²", fit.normalized_stiffness, fit.normalized_stiffness_std),
        ("M⁻¹D", "1/s", fit.normalized_damping, fit.normalized_damping_std),
        ("K", "N/m", fit.stiffness, None),
        ("D", "N s/m", fit.damping, None),
    ]
    for symbol, unit, matrix, deviations in shown:
        if matrix is None or not np.isfinite(matrix).any():
            continue
        yield heading(f"{symbol} [{unit}]" if si or unit.startswith("1") else symbol)
        if len(matrix) > MOST_DOFS:
            yield line(f"{len(matrix)} × {len(matrix)}; --json gives all of it")
            continue
        yield indented(_matrix(matrix, fit.dofs))
        if deviations is not None and np.isfinite(deviations).any():
            yield line(f"standard deviations up to {np.nanmax(deviations):.2g}")
    if fit.normalized_input.shape[1]:
        yield heading("M⁻¹B")
        inputs = [f"u{k + 1}" for k in range(fit.normalized_input.shape[1])]
        yield indented(_matrix(fit.normalized_input, fit.dofs, inputs))


def _matrix(matrix: Floats, dofs: Sequence[str], columns: Sequence[str] | None = None) -> Table:
    made = table("", *(columns or dofs), left=("",))
    for name, row in zip(dofs, matrix, strict=True):
        add(made, name, *(number(value, ".5g") for value in row))
    return made


def _modes(fit: BlindFit) -> Iterator[RenderableType]:
    modes = fit.modes
    if not modes.n_modes:
        return
    yield heading("Modes")
    made = table("Hz", "±", "damping %", "± %")
    rows = zip(
        modes.frequencies_hz,
        modes.frequencies_std,
        modes.damping_ratios,
        modes.damping_std,
        strict=True,
    )
    for f, f_std, zeta, zeta_std in rows:
        ratio, spread = number(100 * zeta, ".3g"), number(100 * zeta_std, ".2g")
        add(made, number(f, ".6g"), number(f_std, ".2g"), ratio, spread)
    yield indented(made)


def _force(fit: BlindFit) -> Iterator[RenderableType]:
    levels = _levels(fit.normalized_force)
    if not fit.accepted or not (len(fit.input_frequencies_hz) or np.isfinite(levels).any()):
        return
    yield heading("Force per mass, M⁻¹f [m/s²]" if fit.units == "SI" else "Force per mass, M⁻¹f")
    if len(fit.input_frequencies_hz):
        listed = ", ".join(f"{f:.5g}" for f in fit.input_frequencies_hz[:MOST_FREQUENCIES])
        more = ", …" if len(fit.input_frequencies_hz) > MOST_FREQUENCIES else ""
        yield line(f"frequencies {listed}{more} Hz")
    lowest = np.asarray(fit.diagnostics.figures.get("lowest_force_hz", np.nan))
    if np.isfinite(lowest).any():
        yield line(f"from {np.nanmax(lowest):.3g} Hz on; what lies below drowns in noise")
    columns = [levels, fit.normalized_force_std]
    names = ["RMS", "RMS error"]
    if fit.force is not None:
        columns.append(_levels(fit.force))
        names.append("force f, RMS [N]" if fit.units == "SI" else "force f, RMS")
    made = table("DOF", *names, left=("DOF",))
    for dof, level, off, *force in zip(fit.dofs, *columns, strict=True):
        add(made, dof, number(level), number(off, ".2g"), *map(number, force))
    yield indented(made)


def _levels(force: Floats) -> Floats:
    """Return the root mean square of a force at each DOF."""
    return np.asarray(np.sqrt(np.mean(force**2, axis=0)))


def _checks(fit: BlindFit) -> Iterator[RenderableType]:
    if not fit.verdict.checks:
        return
    yield heading("Figures of the rules")
    made = table("figure", "value", left=("figure",))
    for name, value in fit.verdict.checks.items():
        add(made, name.replace("_", " "), number(float(value), ".3g"))
    yield indented(made)


def _findings(fit: BlindFit) -> Iterator[RenderableType]:
    return findings_section(fit.verdict.findings)
