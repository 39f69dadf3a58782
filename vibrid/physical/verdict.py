"""Verdict: what a layout and a model determine, what is missing, and what speaks against it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..fit import Finding
from ..modes import Complexes
from ..record import Floats
from .checks import (
    definiteness,
    orthogonality,
    pole_error,
    smallest_damping,
    symmetry_checks,
    transfer_error,
)
from .findings import UNDETERMINED, Evidence, findings_of
from .projection import Projection, relative_change
from .scaling import per_mass

Matrices = tuple[Floats, Floats, Floats]


@dataclass(frozen=True, eq=False)
class Verdict:
    """What is known, what is missing, and the self-checks.

    Attributes
    ----------
    kind : str
        "full"; "reduced": more modes than instrumented DOFs; "subspace": fewer modes than
        DOFs; "normalized": without a scale, M⁻¹K and M⁻¹R only.
    determined : mapping of name to bool
        mass, damping, stiffness, normalized_damping, normalized_stiffness.
    missing : tuple of str
        What would have to be added for the rest.
    checks : mapping of name to number
        `orthogonality`: size of W Wᵀ, which should vanish; `asymmetry_stiffness`,
        `asymmetry_damping`: ‖X − Xᵀ‖ / ‖X‖ of M (M⁻¹K) and M (M⁻¹R) from the shapes alone;
        `smallest_mass`, …: smallest over largest eigenvalue, negative where not definite;
        `poles`, `transfer`: largest relative error of the poles, and relative error of the
        frequency responses, made again from M, R and K; with a structure or a known mass
        `change_mass`, …: what it changes, relative, and `misfit` of the modal equations.
    findings : tuple of Finding
    """

    kind: str
    determined: Mapping[str, bool]
    missing: tuple[str, ...]
    checks: Mapping[str, float]
    findings: tuple[Finding, ...]

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against the matrices that are given."""
        return not any(each.severity == "warning" for each in self.findings)

    def __str__(self) -> str:
        known = [name for name, is_known in self.determined.items() if is_known]
        return f"{self.kind}: determined are {', '.join(known) or 'none'}"


def verdict_of(
    evidence: Evidence,
    shapes: Complexes,
    matrices: Matrices,
    normalized: tuple[Floats, Floats],
    ratios: Floats,
    projection: Projection | None,
    raw: Matrices,
) -> Verdict:
    """Return kind, what is determined, what is missing, checks and findings."""
    kind = _kind(evidence)
    checks = _checks(evidence, kind, shapes, matrices, normalized, ratios)
    if projection is not None:
        checks |= _costs(projection, raw)
    determined = _determined(kind, matrices, checks)
    missing = () if evidence.scaled else (evidence.layout.missing_pair(),)
    findings = findings_of(evidence, kind, checks, projection)
    return Verdict(kind, determined, missing, checks, findings)


def _kind(evidence: Evidence) -> str:
    data = evidence.selection.data
    if len(data.poles) < 2 * evidence.layout.n_dof:
        return "subspace"
    if len(evidence.selection.left_out.poles):
        return "reduced"
    return "full" if evidence.scaled else "normalized"


def _checks(
    evidence: Evidence,
    kind: str,
    shapes: Complexes,
    matrices: Matrices,
    normalized: tuple[Floats, Floats],
    ratios: Floats,
) -> dict[str, float]:
    data, layout = evidence.selection.data, evidence.layout
    checks = {"orthogonality": orthogonality(shapes)} if evidence.scaled else {}
    M, R, K = matrices
    known = np.isfinite(M).all()
    if not known and np.isfinite(ratios).all():
        M = np.diag(ratios)
    checks |= symmetry_checks(shapes, data.poles, M)
    least = smallest_damping(M, data.poles) if np.isfinite(M).all() else 0.0
    checks |= definiteness({"mass": matrices[0], "damping": R, "stiffness": K}, least)
    if kind == "subspace":
        return checks
    made = per_mass(*matrices) if known else normalized
    checks["poles"] = pole_error(*made, data.poles)
    checks["transfer"] = transfer_error(data, layout, made, M if evidence.scaled else None)
    return {name: value for name, value in checks.items() if np.isfinite(value)}


def _costs(projection: Projection, raw: Matrices) -> dict[str, float]:
    new = (projection.mass, projection.damping, projection.stiffness)
    costs = {
        f"change_{name}": relative_change(a, b)
        for name, a, b in zip(("mass", "damping", "stiffness"), new, raw, strict=True)
        if np.isfinite(b).all()
    }
    return {**costs, "misfit": projection.misfit}


def _determined(kind: str, matrices: Matrices, checks: dict[str, float]) -> dict[str, bool]:
    """Return which matrices the data determine."""
    damping = checks.get("asymmetry_damping", 0.0) <= UNDETERMINED
    stiffness = checks.get("asymmetry_stiffness", 0.0) <= UNDETERMINED
    whole = kind != "subspace"
    M, R, K = (bool(np.isfinite(x).all()) for x in matrices)
    return {
        "mass": M and whole,
        "damping": R and whole and damping,
        "stiffness": K and whole and stiffness,
        "normalized_damping": whole and damping,
        "normalized_stiffness": whole and stiffness,
    }
