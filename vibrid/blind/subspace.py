"""PSSID and blind identification by stochastic subspaces (Han, Bohn & Bauer 2021), corrected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, check_choice, check_whole
from ..fit import Diagnostics, Finding
from ..modes import Complexes, Modes
from ..physical.units import si_factors
from ..record import Floats, Record
from ..statespace import HOLDS
from .coordinates import (
    displacement_shapes,
    force_history,
    input_matrix,
    normalized_matrices,
    periodic_force,
)
from .forces import phasor_deviations
from .refusals import DAMPING
from .refusals import of_deviations as judge_deviations
from .refusals import of_matrices as judge_matrices
from .result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from .sensors import Sensors, sensors_of
from .subspace_checks import accuracy, check_figures, refusals
from .subspace_poles import (
    Amplitudes,
    Division,
    FreePoles,
    amplitudes,
    divide,
    free_poles,
    usual_horizon,
)

DROWNED = 0.25  # share of noise in the force from which it is not given
OTHER_HORIZON = 2 / 3  # of the horizon, for the poles found again
NEGATIVE = -1e-9  # real part of an eigenvalue of 𝒟 over the largest: rounding
NO_MASS = "a mass, for stiffness, damping and force in physical units"
ABOVE_NOISE = Finding(
    "above_noise",
    "note",
    "As many modes as sensors stand above the noise; one below it would not show.",
)


def blind_subspace(
    record: Record,
    n_dof: int,
    *,
    input_frequencies_hz: Sequence[float] | None = None,
    hold: str = "band_limited",
    mass: ArrayLike | None = None,
    order: int | None = None,
    block_rows: int | None = None,
    stretch: tuple[float, float] | None = None,
) -> BlindFit:
    """Identify 𝒦 = M⁻¹K, 𝒟 = M⁻¹D and a periodic force from outputs alone.

    Structure and force together are one system that runs freely; its poles come from
    stochastic subspace identification. Those at the frequencies given (PSSID, algorithm 1),
    or those that do not decay (blind identification, algorithm 2), belong to the force. Where
    inputs were measured, ℬ follows too. Use `method="ml"` of `identify_blind` for records
    with more noise than 40 dB; this is the published method, and quick.

    Parameters
    ----------
    record : Record
        One displacement, velocity or acceleration at every degree of freedom, mixed as they
        come, from the start of the motion: only a transient tells modes from forces.
    n_dof : int
        Number of sensors.
    input_frequencies_hz : sequence of float, optional
        Of the force; blind without them.
    hold : "band_limited", "zoh" or "foh"
        How the force moves between samples; concerns the force only, not 𝒦 and 𝒟.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        Total, masses or matrix [kg], for stiffness, damping and force in physical units.
    order : int, optional
        States of structure and force together, 2 n_dof + 2 a frequency; from the singular
        values when left out.
    block_rows : int, optional
        Horizon [samples]; a tenth of the record when left out.
    stretch : (start, stop) [s], optional
        Rows from which the amplitudes of the force are fitted; all by default.

    Returns
    -------
    BlindFit
        A refusal is a value: NaN matrices, `verdict.accepted` False, the rules broken.

    Raises
    ------
    OptionError
        n_dof other than the number of sensors, unknown hold, frequencies that do not fit.
    DataError
        Gaps, too few samples, constant channels.

    Notes
    -----
    1. Poles by SSI, with a constant projected out of the Hankel rows: the offset of a force
       is unobservable from accelerations. 2. Division. 3. Columns c_i of the sensors by least
    squares over the whole record, no initial state needed. 4. [𝒦 𝒟] = −Φ Λ² [Φ; Φ Λ]⁻¹ with
    φ_i = c_i / λ_i², the closed form of step III. 5. Force phasors p_k = G(jω_k)⁻¹ c_k, on
    the axis exactly, so that the history cannot drift. Refused unless: exactly n_dof pairs
    decay clearly faster than all others, the same at another horizon and in the first half,
    the residual is white, and 𝒦 has positive eigenvalues.
    """
    check_choice("hold", hold, HOLDS)
    sensors = sensors_of(record, n_dof)
    known = _known_frequencies(input_frequencies_hz, record.dt)
    y = sensors.outputs(record)
    horizon = usual_horizon(len(y), n_dof) if block_rows is None else block_rows
    check_whole("block_rows", horizon, 2)
    found = free_poles(y, record.dt, horizon, 2 * n_dof, order)
    division = divide(found.poles, n_dof, record.duration, known)
    again = _again(y, record.dt, found)
    part = _rows(stretch, record)
    return in_physical_coordinates(
        record, sensors, found, division, again, hold=hold, mass=mass, part=part
    )


def _known_frequencies(frequencies_hz: Sequence[float] | None, dt: float) -> list[float]:
    values = sorted(float(each) for each in (() if frequencies_hz is None else frequencies_hz))
    wrong = [each for each in values if not 0 < each < 0.5 / dt]
    if wrong:
        raise OptionError(
            f"input_frequencies_hz must lie between 0 and the Nyquist frequency {0.5 / dt:g} Hz; "
            f"got {wrong[0]:g}."
        )
    if len(set(values)) < len(values):
        raise OptionError("input_frequencies_hz must be different.")
    return values


def _again(outputs: Floats, dt: float, found: FreePoles) -> list[FreePoles]:
    """Return the poles at another horizon, and of the first half, where the transient is."""
    other = max(2, int(OTHER_HORIZON * found.block_rows))
    half = max(2, found.block_rows // 2)
    front = outputs[: len(outputs) // 2]
    return [
        free_poles(outputs, dt, other, 2, found.order),
        free_poles(front, dt, half, 2, found.order),
    ]


def _rows(stretch: tuple[float, float] | None, record: Record) -> slice:
    if stretch is None:
        return slice(None)
    start, stop = (round(each / record.dt) for each in stretch)
    if not 0 <= start < stop <= record.n_samples:
        raise OptionError(
            f"stretch={stretch[0]:g} to {stretch[1]:g} s does not lie in the record of "
            f"{record.duration:g} s."
        )
    return slice(start, stop)


def _diagnostics(
    found: FreePoles, division: Division, sensors: Sensors, figures: dict[str, float]
) -> Diagnostics:
    findings = [*sensors.findings, ABOVE_NOISE]
    if len(division.missing_hz):
        listed = ", ".join(f"{each:g}" for each in division.missing_hz)
        findings.append(
            Finding(
                "frequency_unseen",
                "doubt",
                f"No pole stands within 1 % of the input frequencies {listed} Hz.",
                "Check them; the amplitudes there may be nothing but noise.",
            )
        )
    shown = {
        "order": found.order,
        "block_rows": found.block_rows,
        "singular_values": found.singular_values,
        "poles": found.poles,
    }
    return Diagnostics({**shown, **figures}, tuple(findings))


def in_physical_coordinates(
    record: Record,
    sensors: Sensors,
    found: FreePoles,
    division: Division,
    again: list[FreePoles],
    *,
    hold: str,
    mass: ArrayLike | None,
    part: slice = slice(None),
    kind: str = "periodic",
) -> BlindFit:
    """Return the answer that a division of poles gives, or its refusal.

    Parameters
    ----------
    again : list of FreePoles
        Found from other parts or at other horizons, to see whether poles stay.
    part : slice
        Rows that the force's amplitudes are fitted to.
    """
    y, n = sensors.outputs(record), sensors.setting.n_dof
    fitted = amplitudes(y, record.dt, division.structure, division.input_hz)
    separated = kind == "out_of_band"
    figures = check_figures(division, record.duration, again, fitted, y, record.dt, separated)
    problems = refusals(figures, n, record.duration, separated)
    diagnostics = _diagnostics(found, division, sensors, figures)
    if len(division.structure) < n:
        return _without_matrices(sensors, division, kind, problems, diagnostics)
    made = _structure(y, record.dt, sensors, division, fitted, separated)
    if part != slice(None):
        fitted = amplitudes(y, record.dt, division.structure, division.input_hz, part)
    forces = periodic_forces(made.P, made.covariance, sensors, division.input_hz, fitted, hold)
    return _as_fit(record, sensors, division, made, forces, kind, problems, diagnostics, mass)


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


def _structure(
    outputs: Floats,
    dt: float,
    sensors: Sensors,
    division: Division,
    fitted: Amplitudes,
    separated: bool,
) -> Structural:
    poles, powers = division.structure, sensors.powers
    P = np.hstack(normalized_matrices(poles, fitted.structure, powers))
    shapes = displacement_shapes(poles, fitted.structure, powers)
    checks, refused = judge_matrices(P, _condition(poles, shapes))
    if separated:  # the lines of a finite signal depend on each other: no covariance
        return Structural(P, modes_from(poles, shapes, sensors.setting), None, checks, (*refused,))
    estimate = accuracy(outputs, dt, division, powers)
    covariance = estimate.normalized()[1]
    more, wide = judge_deviations(P, covariance)
    hertz, ratios = estimate.deviations
    modes = modes_from(poles, shapes, sensors.setting, frequencies_std=hertz, damping_std=ratios)
    return Structural(P, modes, covariance, {**checks, **more}, (*refused, *wide))


def _as_fit(
    record: Record,
    sensors: Sensors,
    division: Division,
    made: Structural,
    forces: PeriodicForces,
    kind: str,
    problems: list[Refusal],
    diagnostics: Diagnostics,
    mass: ArrayLike | None,
) -> BlindFit:
    n, inputs = sensors.setting.n_dof, _inputs(record, sensors)
    D = made.P[:, n:]
    determined = {
        "normalized_damping": made.damped,
        "normalized_force": forces.noise_share <= DROWNED,
        "normalized_input": inputs.shape[1] > 0,
    }
    known = diagnostics.joined({**made.checks, "force_noise_share": forces.noise_share})
    if not made.damped:
        known = known.joined({"candidate_damping": D}, [_undamped(D, made.checks)])
    return blind_fit(
        sensors.setting,
        made.P[:, :n],
        D if made.damped else np.full_like(D, np.nan),
        made.modes,
        _verdict(kind, [*problems, *made.refused], known, determined, mass),
        covariance=made.covariance,
        force=forces.history if determined["normalized_force"] else None,
        force_std=forces.deviations,
        phasors=forces.phasors,
        input_frequencies_hz=division.input_hz,
        normalized_input=input_matrix(forces.history, inputs) if inputs.shape[1] else None,
        mass=mass,
        diagnostics=known,
    )


@dataclass(frozen=True, eq=False)
class PeriodicForces:
    """Forces at lines, M⁻¹f.

    Attributes
    ----------
    phasors : complex array (n_dof, n_frequencies)
    history : array (n_samples, n_dof)
    deviations : array (n_dof,)
        Root mean square of the expected error, from noise and from [𝒦 𝒟]; NaN if not known.
    noise_share : float
        Of the history's mean square that the sensors' noise alone would make, at the DOF
        where it is largest. The errors of 𝒦 and 𝒟 come on top.
    """

    phasors: Complexes
    history: Floats
    deviations: Floats
    noise_share: float


def periodic_forces(
    P: Floats,
    covariance: Floats | None,
    sensors: Sensors,
    input_hz: Floats,
    fitted: Amplitudes,
    hold: str,
) -> PeriodicForces:
    """Return the forces behind the steady part of a record, P = [𝒦 𝒟]."""
    setting, n = sensors.setting, sensors.setting.n_dof
    made = []
    for columns in (fitted.inputs, fitted.noise):
        phasors = periodic_force(
            P[:, :n], P[:, n:], sensors.powers, input_hz, columns, dt=setting.dt, hold=hold
        )
        made.append((phasors, force_history(phasors, input_hz, setting.n_samples, setting.dt)))
    (phasors, history), (_, noise) = made
    size = np.maximum(np.mean(history**2, axis=0), 1e-300)
    share = float((np.mean(noise**2, axis=0) / size).max())
    deviations = np.full(n, np.nan)
    if covariance is not None:
        rows, left = len(fitted.residuals), (fitted.residuals**2).mean(axis=0)
        rates = 2 * np.pi * input_hz
        off = phasor_deviations(P, covariance, fitted.inputs, rates, sensors.powers, left, rows)
        deviations = np.sqrt((off**2).sum(axis=1) / 2)
    return PeriodicForces(phasors, history, deviations, share)


def _without_matrices(
    sensors: Sensors,
    division: Division,
    kind: str,
    problems: list[Refusal],
    diagnostics: Diagnostics,
) -> BlindFit:
    n = sensors.setting.n_dof
    nothing = np.full((n, n), np.nan)
    shapes = np.full((n, len(division.structure)), np.nan + 0j)
    verdict = _verdict(kind, problems, diagnostics, {})
    modes = modes_from(division.structure, shapes, sensors.setting)
    return blind_fit(sensors.setting, nothing, nothing, modes, verdict, diagnostics=diagnostics)


def _condition(poles: Complexes, shapes: Complexes) -> float:
    """Return the condition of [Φ; Φ Λ], rows and columns scaled."""
    both = np.vstack([shapes, shapes * poles / np.abs(poles).mean()])
    both = np.hstack([both, both.conj()])
    return float(np.linalg.cond(both / np.linalg.norm(both, axis=0)))


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


def _inputs(record: Record, sensors: Sensors) -> Floats:
    """Return measured inputs (n_samples, n_inputs) in SI; those without a unit as they are."""
    factors = np.array([float(channel.sign) for channel in record.input_channels])
    for k, channel in enumerate(record.input_channels):
        if channel.unit and channel.quantity != "other" and sensors.setting.units == "SI":
            factors[k] *= si_factors([channel])[0][0]
    return np.asarray(record.inputs[:] * factors, dtype=np.float64)


def _verdict(
    kind: str,
    problems: list[Refusal],
    diagnostics: Diagnostics,
    determined: dict[str, bool],
    mass: ArrayLike | None = None,
) -> BlindVerdict:
    accepted = not problems
    known = {"normalized_stiffness": accepted, "normalized_damping": accepted}
    known |= {"normalized_force": accepted, "normalized_input": False}
    known |= {name: value and accepted for name, value in determined.items()}
    missing = () if mass is not None else (NO_MASS,)
    figures = {k: v for k, v in diagnostics.figures.items() if isinstance(v, float)}
    return BlindVerdict(kind, known, missing, figures, tuple(problems), diagnostics.findings)
