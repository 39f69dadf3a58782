"""A mechanical model as tables for the terminal and as plain values for JSON."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from ..physical import MechanicalModel, Rayleigh
from ..record import Floats
from .as_json import plain
from .words import add, findings_section, heading, indented, line, number, plural, table

KINDS = {
    "full": "all of M, R and K",
    "reduced": "a reduced model: more modes than instrumented DOFs",
    "subspace": "the subspace of the shapes: fewer modes than DOFs",
    "normalized": "without a force scale",
}
UNITS = {
    "mass": "kg",
    "damping": "N s/m",
    "stiffness": "N/m",
    "normalized_damping": "1/s",
    "normalized_stiffness": "1/s²",
}
SYMBOLS = {
    "mass": "M",
    "damping": "R",
    "stiffness": "K",
    "normalized_damping": "M⁻¹R",
    "normalized_stiffness": "M⁻¹K",
}
CHECKS = {
    "orthogonality": "W Wᵀ, which should vanish",
    "asymmetry_stiffness": "asymmetry of M (M⁻¹K) from the shapes",
    "asymmetry_damping": "asymmetry of M (M⁻¹R) from the shapes",
    "poles": "poles made again from the matrices, largest error",
    "transfer": "frequency responses made again, error",
    "change_mass": "change of M by the structure asked for",
    "change_damping": "change of R by the structure asked for",
    "change_stiffness": "change of K by the structure asked for",
    "misfit": "misfit of the modal equations under that structure",
}
MOST_DOFS = 12  # of a printed matrix


def describe_physical(model: MechanicalModel, law: Rayleigh | None = None) -> Group:
    """Return matrices, verdict and checks of a mechanical model, to be printed by rich.

    `law` is the proportional damping of its modes, where there are enough.
    """
    parts: list[RenderableType] = []
    sections = (_verdict(model), _matrices(model), _damping(model, law), _checks(model))
    for section in (*sections, findings_section(model.verdict.findings)):
        lines = list(section)
        if lines:
            parts += [*lines, Text("")]
    return Group(*parts[:-1])


def physical_as_json(model: MechanicalModel, law: Rayleigh | None = None) -> dict[str, Any]:
    """Return all that `describe_physical` prints, and the shapes."""
    names = (*SYMBOLS, *(f"{name}_std" for name in SYMBOLS), "flexibility", "mass_ratios")
    facts = {
        "dofs": model.dofs,
        "units": model.units,
        **{name: getattr(model, name) for name in names},
        "frequencies_hz": model.frequencies_hz,
        "shapes": model.shapes,
        "delays": model.delays,
        "rayleigh": law,
        "verdict": {
            "kind": model.verdict.kind,
            "accepted": model.verdict.accepted,
            "determined": model.verdict.determined,
            "missing": model.verdict.missing,
            "checks": model.verdict.checks,
            "findings": model.verdict.findings,
        },
    }
    return {key: plain(value) for key, value in facts.items()}


def _verdict(model: MechanicalModel) -> Iterator[RenderableType]:
    verdict = model.verdict
    modes = ", ".join(f"{hertz:.4g}" for hertz in model.frequencies_hz)
    yield heading("Physical coordinates")
    yield line(f"{plural(len(model.dofs), 'DOF')}, modes at {modes} Hz, in {model.units}")
    yield line(f"{KINDS[verdict.kind]}")
    known = [SYMBOLS[name] for name, is_known in verdict.determined.items() if is_known]
    yield line(f"determined: {', '.join(known) or 'nothing'}")
    for missing in verdict.missing:
        yield line(f"missing: {missing}")


def _matrices(model: MechanicalModel) -> Iterator[RenderableType]:
    for name, symbol in SYMBOLS.items():
        matrix = getattr(model, name)
        if not np.isfinite(matrix).all():
            continue
        unit = f" [{UNITS[name]}]" if model.units == "SI" else ""
        doubt = "" if model.verdict.determined[name] else ", not determined by these data"
        yield heading(f"{symbol} {name.replace('_', ' ')}{unit}{doubt}")
        if len(matrix) > MOST_DOFS:
            yield line(f"{len(matrix)} × {len(matrix)}; --json gives all of it")
        else:
            yield indented(_matrix(matrix, model.dofs))
        deviations = getattr(model, f"{name}_std")
        if np.isfinite(deviations).all() and deviations.any():
            yield line(f"standard deviations up to {number(deviations.max(), '.2g')}")
    if np.isfinite(model.mass_ratios).all() and len(model.dofs) > 1:
        ratios = ", ".join(number(each, ".3g") for each in model.mass_ratios)
        yield line(f"mass ratios that make K most symmetric: {ratios}")


def _matrix(matrix: Floats, dofs: Sequence[str]) -> Table:
    made = table("", *dofs, left=("",))
    for name, row in zip(dofs, matrix, strict=True):
        add(made, name, *(number(value, ".5g") for value in row))
    return made


def _damping(model: MechanicalModel, law: Rayleigh | None) -> Iterator[RenderableType]:
    if law is None:
        return
    yield heading("Proportional damping R* = αM + βK")
    ratios = ", ".join(f"{100 * each:.3g}" for each in law.damping_ratios)
    yield line(f"damping ratios {ratios} %; α = {law.alpha:.4g} 1/s, β = {law.beta:.4g} s")
    words = {True: "explains them", False: "does not explain them", None: "cannot be tested"}
    yield line(f"the law {words[law.explained]} (misfit {100 * law.misfit:.2g} %)")
    known = np.isfinite(model.mass).all() and np.isfinite(model.stiffness).all()
    if known and law.explained is not False:
        yield indented(_matrix(law.damping_matrix(model.mass, model.stiffness), model.dofs))


def _checks(model: MechanicalModel) -> Iterator[RenderableType]:
    checks = {k: v for k, v in model.verdict.checks.items() if k in CHECKS}
    if not checks:
        return
    yield heading("Checks")
    made = table("check", "%", left=("check",))
    for name, value in checks.items():
        add(made, CHECKS[name], number(100 * value, ".2g"))
    yield indented(made)
