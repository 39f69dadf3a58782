"""Findings: what speaks for and against matrices in physical coordinates, in sentences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..fit import Finding
from ..record import Floats
from .checks import is_absolute
from .delays import Delays
from .layout import Layout
from .modal import Selection
from .projection import Projection
from .scaling import drive_point_motion

UNDETERMINED = 0.5  # asymmetry of M (M⁻¹R) or M (M⁻¹K) beyond which it is not determined
UNLIKE = 0.25  # error of the frequency responses beyond which the matrices are doubted
WRONG = 0.75  # and beyond which they are wrong
CONTRADICTED = 0.25  # change of M or K by what was given beyond which the data speak against it
LATE = 0.02  # of the fastest mode's phase [rad]: a smaller delay is not worth a word
EXACT_PHASE = 1e-6  # rad: no phase at all
CLEARER = 0.5  # of the shapes' imaginary part must go for a delay to be believed
NEAR_NODE = 0.05  # of a mode's largest motion at the co-located DOFs: less is little
UNEQUAL = 0.1  # difference of the shapes of sensors at one DOF, relative
NOT_DEFINITE = -1e-7  # smallest over largest eigenvalue


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a mechanical model is made from; `corrected` are the delays taken off [s]."""

    layout: Layout
    selection: Selection
    delays: Delays | None
    corrected: Floats
    as_given: bool
    mass: Floats | None

    @property
    def scaled(self) -> bool:
        return bool(len(self.layout.pairs))

    @property
    def phase(self) -> float:
        """Largest phase that was taken off [rad]."""
        return float(np.abs(self.corrected).max() * np.abs(self.selection.data.poles).max())


def findings_of(
    evidence: Evidence, kind: str, checks: Mapping[str, float], projection: Projection | None
) -> tuple[Finding, ...]:
    """Return all findings."""
    return (
        *_of_kind(evidence, kind),
        *_of_channels(evidence),
        *_of_doubles(evidence),
        *_of_nodes(evidence),
        *_of_all_delays(evidence),
        *_of_asymmetry(checks),
        *_of_definiteness(checks),
        *_of_responses(checks, kind),
        *_of_costs(evidence, kind, checks),
        *_of_projection(projection),
    )


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
    if known and not evidence.corrected.any():
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


def _of_doubles(evidence: Evidence) -> list[Finding]:
    layout, shapes = evidence.layout, evidence.selection.data.shapes
    unit = shapes / np.abs(shapes).max(axis=0)
    found = []
    for place in range(layout.n_dof):
        rows = np.flatnonzero(layout.sensor_dofs == place)
        apart = np.abs(unit[rows] - unit[rows].mean(axis=0)).max() if len(rows) > 1 else 0.0
        if apart > UNEQUAL:
            names = ", ".join(layout.output_channels[row].name for row in rows)
            found.append(
                Finding(
                    "unequal_sensors",
                    "warning",
                    f"The sensors {names} are all at {layout.dofs[place]}, but their motion "
                    f"differs by {100 * apart:.0f} % of the largest; their mean is used.",
                    "Check DOF, quantity, unit, sign and delay of these channels.",
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


def _of_all_delays(evidence: Evidence) -> list[Finding]:
    if evidence.as_given:
        largest = 1e3 * np.abs(evidence.corrected).max()
        sentence = f"Delays of up to {largest:.3g} ms were taken off as given."
        return [Finding("delays_given", "note", sentence)]
    found = [*_of_delays(evidence), *_of_common_delay(evidence)]
    if found or evidence.phase < EXACT_PHASE:
        return found
    return [
        Finding(
            "delays_unclear",
            "doubt",
            f"Delays of up to {1e3 * np.abs(evidence.corrected).max():.2g} ms were set right as "
            "asked, but are not seen clearly: damping that is not proportional, or noise, may have "
            "been taken for them, and R feels it.",
            "Leave delays out, or give the seconds by channel.",
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
    if evidence.corrected.any():
        return [Finding("delays", "note", sentence + " This was set right.")]
    return [Finding("delays", "doubt", sentence, "Set them right with delays=True.")]


def _of_common_delay(evidence: Evidence) -> list[Finding]:
    delays = evidence.delays
    if delays is None or not delays.corrected_imaginary < CLEARER * delays.imaginary:
        return []
    if abs(delays.common) * np.abs(evidence.selection.data.poles).max() < LATE:
        return []
    inputs, effect = "base", "poles and shapes do not feel it"
    if evidence.scaled:
        inputs, effect = "forces", "the scale, and M, R and K with it, feel it"
    sentence = (
        f"All sensors together lag behind the {inputs} by about {1e3 * delays.common:.2g} ms "
        f"(imaginary part of the participation {100 * delays.imaginary:.2g} %, without that "
        f"{100 * delays.corrected_imaginary:.2g} %); {effect}."
    )
    if not evidence.scaled:
        return [Finding("common_delay", "note", sentence)]
    if evidence.corrected.any():
        return [Finding("common_delay", "note", sentence + " This was set right.")]
    cure = "Set it right with delays=True; half a sample speaks of another hold of the forces."
    return [Finding("common_delay", "doubt", sentence, cure)]


def _of_asymmetry(checks: Mapping[str, float]) -> list[Finding]:
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


def _of_definiteness(checks: Mapping[str, float]) -> list[Finding]:
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


def _of_responses(checks: Mapping[str, float], kind: str) -> list[Finding]:
    off = checks.get("transfer", 0.0)
    if off <= UNLIKE:
        return []
    return [
        Finding(
            "unlike",
            "warning" if off > WRONG and kind == "full" else "doubt",
            f"The frequency responses made from the matrices are off by {100 * off:.0f} %.",
            "Check signs, DOFs, delays and hold of the channels, or ask for "
            "structure='symmetric'; modes close together cannot be told apart.",
        )
    ]


def _of_costs(evidence: Evidence, kind: str, checks: Mapping[str, float]) -> list[Finding]:
    costs = {name: checks.get(f"change_{name}", 0.0) for name in ("mass", "stiffness")}
    if kind == "subspace" or max(costs.values()) <= CONTRADICTED:
        return []
    given = "mass" if evidence.mass is not None and evidence.scaled else "structure"
    return [
        Finding(
            "contradicted",
            "warning",
            f"The {given} given contradicts the data: it changes M by {100 * costs['mass']:.0f} % "
            f"and K by {100 * costs['stiffness']:.0f} %.",
            "Check units and signs of the channels and what was given, or leave it out.",
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
