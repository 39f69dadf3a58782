"""𝒦, 𝒟, modes and force from a division of poles, or the refusal of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fit import Diagnostics, Finding
from ...modes import Modes
from ...physical.units import si_factors
from ...record import Floats
from ..coordinates import displacement_shapes, input_matrix, normalized_matrices
from ..forces import PeriodicForce
from ..likelihood.modal import condition
from ..refusals import DAMPING, of_condition, of_deviations, of_stiffness, together
from ..result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from .accuracy import accuracy
from .case import Case
from .checks import check_figures, refusals
from .division import Amplitudes, amplitudes
from .forces import periodic_forces

NEGATIVE = -1e-9  # real part of an eigenvalue of 𝒟 over the largest: rounding
NO_MASS = "a mass, for stiffness, damping and force in physical units"
ABOVE_NOISE = Finding(
    "above_noise",
    "note",
    "As many modes as sensors stand above the noise; one below it would not show.",
)


def in_physical_coordinates(case: Case) -> BlindFit:
    """Return the answer that a division of poles gives, or its refusal."""
    fitted = amplitudes(case.outputs, case.record.dt, case.division)
    figures = check_figures(case, fitted)
    problems = refusals(figures, case.n_dof, case.record.duration, case.limited)
    diagnostics = _diagnostics(case, figures)
    if len(case.division.structure) < case.n_dof:
        return _without_matrices(case, problems, diagnostics)
    made = _structure(case, fitted)
    if case.part is not None:
        fitted = amplitudes(case.outputs, case.record.dt, case.division, case.part)
    forces = periodic_forces(case, fitted, made.P, made.covariance)
    return _as_fit(case, made, forces, [*problems, *made.refused], diagnostics)


def _diagnostics(case: Case, figures: dict[str, float]) -> Diagnostics:
    findings = [*case.sensors.findings, ABOVE_NOISE]
    if len(case.division.missing_hz):
        listed = ", ".join(f"{each:g}" for each in case.division.missing_hz)
        findings.append(
            Finding(
                "frequency_unseen",
                "doubt",
                f"No pole of a sine stands within 1 % of the input frequencies {listed} Hz.",
                "Check them; the amplitudes there may be nothing but noise.",
            )
        )
    shown = {
        "order": case.found.order,
        "block_rows": case.found.block_rows,
        "singular_values": case.found.singular_values,
        "poles": case.found.poles,
    }
    return Diagnostics({**shown, **figures}, tuple(findings))


@dataclass(frozen=True, eq=False)
class Structural:
    """P = [𝒦 𝒟] and modes, with their covariance (None where not known), and what was checked."""

    P: Floats
    modes: Modes
    covariance: Floats | None
    checks: dict[str, float]
    refused: tuple[Refusal, ...]

    @property
    def damped(self) -> bool:
        """Whether 𝒟 is determined: accurate enough, and taking energy out only."""
        values = np.linalg.eigvals(self.P[:, len(self.P) :])
        takes = values.real.min() > NEGATIVE * np.abs(values).max()
        return bool(takes and self.checks.get("damping_deviation", 0.0) <= DAMPING)


def _structure(case: Case, fitted: Amplitudes) -> Structural:
    poles, powers, setting = case.division.structure, case.sensors.powers, case.sensors.setting
    P = np.hstack(normalized_matrices(poles, fitted.structure, powers))
    shapes = displacement_shapes(poles, fitted.structure, powers)
    checks, refused = together(of_condition(condition(poles, shapes)), of_stiffness(P))
    if refused or case.limited:  # nothing to judge, or no bound of lines that depend on each other
        return Structural(P, modes_from(poles, shapes, setting), None, dict(checks), refused)
    off = accuracy(case.outputs, case.record.dt, case.division, powers)
    more, wide = of_deviations(P, off.covariance)
    modes = modes_from(
        poles,
        shapes,
        setting,
        frequencies_std=off.frequencies_std,
        damping_std=off.damping_std,
    )
    return Structural(P, modes, off.covariance, {**checks, **more}, tuple(wide))


def _as_fit(
    case: Case,
    made: Structural,
    forces: PeriodicForce,
    problems: list[Refusal],
    diagnostics: Diagnostics,
) -> BlindFit:
    D, accepted = made.P[:, case.n_dof :], not problems
    known = diagnostics.joined(made.checks)
    if accepted and not made.damped:
        known = known.joined({"candidate_damping": D}, [_undamped(D, made.checks)])
    pushed = accepted and forces.known
    if accepted and not pushed:
        known = known.joined({}, [_unpushed(forces)])
    inputs = _inputs(case) if pushed else np.zeros((0, 0))
    determined = {
        "normalized_stiffness": accepted,
        "normalized_damping": accepted and made.damped,
        "normalized_force": pushed,
        "normalized_input": inputs.shape[1] > 0,
    }
    return blind_fit(
        case.sensors.setting,
        made.P[:, : case.n_dof],
        D if made.damped or not accepted else np.full_like(D, np.nan),
        made.modes,
        _verdict(case, determined, problems, known),
        covariance=made.covariance,
        force=forces.history if pushed else None,
        force_std=None if made.covariance is None else forces.deviations,
        phasors=forces.phasors if pushed else None,
        input_frequencies_hz=case.division.input_hz,
        normalized_input=input_matrix(forces.history, inputs) if inputs.size else None,
        mass=case.mass,
        diagnostics=known,
    )


def _without_matrices(case: Case, problems: list[Refusal], diagnostics: Diagnostics) -> BlindFit:
    setting, n = case.sensors.setting, case.n_dof
    nothing = np.full((n, n), np.nan)
    shapes = np.full((n, len(case.division.structure)), np.nan + 0j)
    names = ("normalized_stiffness", "normalized_damping", "normalized_force", "normalized_input")
    verdict = _verdict(case, dict.fromkeys(names, False), problems, diagnostics)
    modes = modes_from(case.division.structure, shapes, setting)
    return blind_fit(setting, nothing, nothing, modes, verdict, diagnostics=diagnostics)


def _undamped(damping: Floats, checks: dict[str, float]) -> Finding:
    lowest = float(np.linalg.eigvals(damping).real.min())
    off = checks.get("damping_deviation", np.nan)
    return Finding(
        "damping_undetermined",
        "doubt",
        f"M⁻¹D is not determined: its predicted relative deviation is {off:.2g} (limit "
        f"{DAMPING:g}), its lowest eigenvalue {lowest:.3g} 1/s. It rests on the small phases of "
        "the shapes.",
        'Use method="ml", where real shapes can be assumed; the estimate is kept as a candidate.',
    )


def _unpushed(forces: PeriodicForce) -> Finding:
    size = float(np.sqrt(np.mean(forces.history**2, axis=0)).max())
    return Finding(
        "force_undetermined",
        "doubt",
        f"The force is not determined: its expected error is {forces.deviations.max():.2g} m/s² "
        f"and its size {size:.2g} m/s² at most.",
        "It needs smaller errors of M⁻¹K and M⁻¹D, or sensors with less noise.",
    )


def _inputs(case: Case) -> Floats:
    """Return measured inputs (n_samples, n_inputs) in SI; those without a unit as they are."""
    channels = case.record.input_channels
    factors = np.array([float(channel.sign) for channel in channels])
    for k, channel in enumerate(channels):
        if channel.unit and channel.quantity != "other" and case.sensors.setting.units == "SI":
            factors[k] *= si_factors([channel])[0][0]
    return np.asarray(case.record.inputs[:] * factors, dtype=np.float64)


def _verdict(
    case: Case, determined: dict[str, bool], problems: list[Refusal], diagnostics: Diagnostics
) -> BlindVerdict:
    missing = () if case.mass is not None else (NO_MASS,)
    figures = {k: v for k, v in diagnostics.figures.items() if isinstance(v, float)}
    return BlindVerdict(
        case.kind, determined, missing, figures, tuple(problems), diagnostics.findings
    )
