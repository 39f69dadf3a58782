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
    is_absolute,
    orthogonality,
    pole_error,
    symmetry_checks,
    transfer_error,
)
from .delays import Delays
from .layout import Layout
from .modal import Selection
from .projection import Projection, relative_change
from .scaling import drive_point_motion, per_mass

UNDETERMINED = 0.5  # asymmetry of M (M⁻¹R) or M (M⁻¹K) beyond which it is not determined
UNLIKE = 0.25  # error of the frequency responses beyond which the matrices are doubted
LATE = 0.02  # of the fastest mode's phase [rad]: a smaller delay is not worth a word
CLEARER = 0.5  # of the shapes' imaginary part must go for a delay to be believed
NEAR_NODE = 0.05  # of a mode's largest motion at the co-located DOFs: less is little
NOT_DEFINITE = -1e-7  # smallest over largest eigenvalue

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
        frequency responses, made again from M, R and K.
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


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a mechanical model is made from."""

    layout: Layout
    selection: Selection
    delays: Delays | None
    corrected: bool
    mass: Floats | None

    @property
    def scaled(self) -> bool:
        return bool(len(self.layout.pairs))


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
    findings = (
        *_of_kind(evidence, kind),
        *_of_channels(evidence),
        *_of_nodes(evidence),
        *_of_delays(evidence),
        *_of_common_delay(evidence),
        *_of_checks(checks, projection),
    )
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
    checks |= definiteness(mass=matrices[0], damping=R, stiffness=K)
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


def _of_kind(evidence: Evidence, kind: str) -> list[Finding]:
    layout, selection = evidence.layout, evidence.selection
    modes = len(selection.data.poles) // 2
    found = []
    if kind == "reduced":
        more = len(selection.left_out.poles) // 2
        found.append(
            Finding(
                "reduced",
                "doubt",
                f"The model has {modes + more} modes and {layout.n_dof} DOFs are instrumented: "
                f"this is a reduced model of {modes} modes on these DOFs (De Angelis et al. 2002, "
                "Luş et al. 2003), not the structure's own matrices.",
                "Instrument more DOFs, or choose other modes with frequencies_hz.",
            )
        )
    if kind == "subspace":
        found.append(
            Finding(
                "subspace",
                "doubt",
                f"The model has {modes} modes for {layout.n_dof} DOFs: M, R and K are those of "
                "the subspace of the shapes (pseudoinverses of the flexibility and the like).",
                "Use a higher order; a free structure hides its rigid-body modes from "
                "accelerometers.",
            )
        )
    if not evidence.scaled:
        known = "the given mass sets it" if evidence.mass is not None else "M, R and K need it"
        found.append(
            Finding(
                "no_scale",
                "note",
                f"There is no force scale ({layout.missing_pair()}); {known}.",
            )
        )
    if selection.dropped:
        found.append(Finding("dropped", "note", f"Left out: {'; '.join(selection.dropped)}."))
    return found


def _of_channels(evidence: Evidence) -> list[Finding]:
    layout = evidence.layout
    found = []
    if layout.units != "SI":
        found.append(
            Finding(
                "units",
                "note",
                "The channels have no units: M, R and K are in consistent units that follow "
                "from the data's.",
            )
        )
    if layout.ignored:
        found.append(Finding("ignored", "note", f"Not used: {'; '.join(layout.ignored)}."))
    if len(layout.bases) and not evidence.scaled and (layout.powers == 2).any():
        motion = "absolute" if is_absolute(evidence.selection.data, layout) else "relative"
        found.append(Finding("base", "note", f"The accelerometers measure {motion} motion."))
    known = [c for c in layout.output_channels if c.delay]
    if known and not evidence.corrected:
        found.append(
            Finding(
                "channel_delays",
                "doubt",
                f"The channel {known[0].name!r} lags by {1e3 * known[0].delay:.3g} ms by its "
                "label, and nothing was done about it.",
                "Use record.correct_delays() before identification, or delays={name: seconds}.",
            )
        )
    return found


def _of_nodes(evidence: Evidence) -> list[Finding]:
    if not evidence.scaled:
        return []
    motion = drive_point_motion(evidence.selection.data, evidence.layout)
    worst = int(np.argmin(motion))
    if motion[worst] >= NEAR_NODE:
        return []
    hertz = abs(evidence.selection.data.poles[worst]) / (2 * np.pi)
    return [
        Finding(
            "near_node",
            "doubt",
            f"The mode at {hertz:.4g} Hz moves the co-located DOFs by {100 * motion[worst]:.1f} % "
            "of its largest motion only: its scale, and M, R and K with it, hang on that.",
            "Add a co-located pair elsewhere.",
        )
    ]


def _of_delays(evidence: Evidence) -> list[Finding]:
    delays, poles = evidence.delays, evidence.selection.data.poles
    if delays is None:
        return []
    phase = np.abs(delays.seconds).max() * np.abs(poles).max()
    before = 1 - delays.phase_collinearity
    after = 1 - delays.corrected_collinearity
    if phase < LATE or after.sum() > (1 - CLEARER) * before.sum():
        return []
    listed = ", ".join(
        f"{name} {1e3 * value:.3g} ms"
        for name, value in zip(delays.names[1:], delays.seconds[1:], strict=True)
    )
    sentence = (
        f"Behind {delays.names[0]}, sensors lag by {listed}; without that the phase collinearity "
        f"of the shapes is at least {delays.corrected_collinearity.min():.4f} instead of "
        f"{delays.phase_collinearity.min():.4f}."
    )
    if evidence.corrected:
        return [Finding("delays", "note", sentence + " This was set right.")]
    return [Finding("delays", "doubt", sentence, "Set them right with delays=True.")]


def _of_common_delay(evidence: Evidence) -> list[Finding]:
    delays = evidence.delays
    if delays is None or not delays.corrected_imaginary < CLEARER * delays.imaginary:
        return []
    if abs(delays.common) * np.abs(evidence.selection.data.poles).max() < LATE:
        return []
    return [
        Finding(
            "common_delay",
            "note",
            f"All sensors together lag behind the base by about {1e3 * delays.common:.2g} ms "
            f"(imaginary part of the participation {100 * delays.imaginary:.2g} %, without that "
            f"{100 * delays.corrected_imaginary:.2g} %); poles and shapes do not feel it.",
        )
    ]


def _of_checks(checks: dict[str, float], projection: Projection | None) -> list[Finding]:
    return [
        *_of_asymmetry(checks),
        *_of_definiteness(checks),
        *_of_responses(checks),
        *_of_projection(projection),
    ]


def _of_asymmetry(checks: dict[str, float]) -> list[Finding]:
    found = []
    for name, symbol in (("damping", "M⁻¹R"), ("stiffness", "M⁻¹K")):
        off = checks.get(f"asymmetry_{name}", 0.0)
        if off > UNDETERMINED:
            found.append(
                Finding(
                    f"{name}_undetermined",
                    "doubt" if name == "damping" else "warning",
                    f"{symbol} is not determined by these data: M times it is asymmetric by "
                    f"{100 * off:.0f} % where it should be symmetric.",
                    "Use the modal damping ratios, or αM + βK of fit_rayleigh."
                    if name == "damping"
                    else "Check signs and DOFs of the channels, and the order.",
                )
            )
    return found


def _of_definiteness(checks: dict[str, float]) -> list[Finding]:
    found = []
    for name in ("mass", "stiffness", "damping"):
        smallest = checks.get(f"smallest_{name}", 0.0)
        if smallest < NOT_DEFINITE:
            found.append(
                Finding(
                    f"{name}_indefinite",
                    "doubt" if name == "damping" else "warning",
                    f"The {name} matrix is not positive definite (smallest over largest "
                    f"eigenvalue {smallest:.2g}).",
                    "Check the signs of the channels, or ask for structure='symmetric'.",
                )
            )
    return found


def _of_responses(checks: dict[str, float]) -> list[Finding]:
    if checks.get("transfer", 0.0) <= UNLIKE:
        return []
    return [
        Finding(
            "unlike",
            "doubt",
            "The frequency responses made from the matrices are off by "
            f"{100 * checks['transfer']:.0f} %.",
            "Check signs, DOFs, delays and hold of the channels, or ask for "
            "structure='symmetric'; modes at one frequency cannot be told apart.",
        )
    ]


def _of_projection(projection: Projection | None) -> list[Finding]:
    if projection is None or not projection.definite_bound:
        return []
    return [
        Finding(
            "definite",
            "note",
            "The matrices were moved to the nearest positive (semi)definite ones.",
        )
    ]
