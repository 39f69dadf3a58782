"""blind_likelihood(): 𝒦, 𝒟 and periodic forces by maximum likelihood."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...errors import OptionError, check_choice
from ...fit import Diagnostics, Finding
from ...modes import Complexes
from ...physical import Topology
from ...record import Floats, Record
from ...statespace import HOLDS
from .. import forces, refusals
from ..closure import whole_mass
from ..coordinates import force_history, periodic_force
from ..result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from ..sensors import Sensors
from .components import Signals
from .data import most_oscillations, signals_of
from .division import Division, Shapes, certainty, divide, real_shapes
from .modal import ModalEstimate, modal_estimate
from .place import ROUNDING, Place
from .search import Progress, grow
from .structure import Constrained, constrain

SHAPES = ("auto", "free", "real")
UNLIKELY = 0.01  # probability of a structure's misfit below which it is doubted
KNOWN_FORCE = 0.5  # of a force's size: a larger error leaves nothing to be shown


@dataclass(frozen=True, eq=False)
class Found:
    """What the signals alone say, before anything is judged."""

    signals: Signals
    division: Division
    shapes: Shapes | None
    estimate: ModalEstimate
    P: Floats
    covariance: Floats
    constrained: Constrained | None

    @property
    def place(self) -> Place:
        """The fit that the answer rests on, of real shapes where they were taken."""
        return self.division.place if self.shapes is None else self.shapes.place


def blind_likelihood(
    data: Record | Sequence[Record],
    n_dof: int,
    *,
    input_frequencies_hz: Sequence[float] | None = None,
    hold: str = "band_limited",
    mass: ArrayLike | None = None,
    structure: Topology | str | None = None,
    shapes: str = "auto",
    progress: Progress | None = None,
) -> BlindFit:
    """Return 𝒦, 𝒟 and the unknown periodic force from a transient, or from a free decay.

    The motion is a sum of n decaying oscillations, the structure's, and of undamped ones, the
    force's, with free amplitudes in every channel. There are as many parameters as 𝒦, 𝒟 and
    the initial state have, so the likelihood of the sum is theirs. The number of sines need
    not be given, and their frequencies may be.

    Parameters
    ----------
    data : Record or sequence of Record
        Outputs only; records share poles and shapes, not amplitudes. Time starts anew in each.
    n_dof : int
        As many as there are outputs.
    input_frequencies_hz : sequence of float, optional
        Of the force, all of them.
    hold : "zoh", "foh" or "band_limited"
        How the force moves between samples; it concerns the force alone.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        [kg].
    structure : Topology or "symmetric", "diagonal", "chain", optional
        The nearest 𝒦 and 𝒟 of it by covariance, with the given masses or with their ratios.
    shapes : "auto", "free" or "real"
        Real shapes (proportional damping) make 𝒟 as certain as 𝒦; "auto" takes them where the
        likelihood-ratio test does not reject them (99 %).

    Returns
    -------
    BlindFit
        Refused by the rules R1 to R7 where the data do not determine it. Forces of several
        records stand one below the other.

    Raises
    ------
    OptionError
        n_dof other than the number of sensors; options that do not fit.
    DataError
        Records that differ in sensors or rate, are too short, or have missing samples.

    Notes
    -----
    Separable least squares with the Jacobian of Kaufman (1975); oscillations are found
    greedily. 𝒦 and 𝒟 follow in closed form (Han, Bohn & Bauer 2021, step III).
    """
    records = [data] if isinstance(data, Record) else list(data)
    sensors, signals = signals_of(records, n_dof, input_frequencies_hz)
    check_choice("shapes", shapes, SHAPES)
    check_choice("hold", hold, HOLDS)
    topology = None if structure is None else Topology.of(structure)
    growth = grow(signals, most_oscillations(signals), progress)
    if not growth.explained:
        return _unexplained(sensors, growth.place)
    early = refusals.of_certainty(np.sort(certainty(growth.place))[::-1], n_dof)[1]
    hopeless = any(each.rule in ("R2", "R3") for each in early)
    division = divide(growth.place, n_dof, swaps=not hopeless)
    if int(division.modes.sum()) < n_dof:
        return _without_modes(sensors, division)
    found = _estimated(sensors, signals, division, shapes, topology, mass)
    return answer(sensors, found, hold, mass)


def _unexplained(sensors: Sensors, place: Place) -> BlindFit:
    """Return the refusal of a record that a few oscillations do not explain."""
    left = 100 * place.relative_errors
    refusal = Refusal(
        "R4",
        f"{len(place.components)} oscillations leave {left:.3g} % of the motion, and the next ones "
        "would take little of it: the force is not a sum of a few sines.",
        "Say what the force is with excitation=, or give a stretch without force.",
        {"n_oscillations": len(place.components), "relative_errors": place.relative_errors},
    )
    return _refusal(sensors, {"relative_errors": place.relative_errors}, (refusal,))


def _without_modes(sensors: Sensors, division: Division) -> BlindFit:
    n = sensors.setting.n_dof
    return _refusal(sensors, *refusals.together(refusals.of_certainty(division.certainty, n)))


def _refusal(
    sensors: Sensors, checks: Mapping[str, float], refused: tuple[Refusal, ...]
) -> BlindFit:
    setting, n = sensors.setting, sensors.setting.n_dof
    unknown = np.full((n, n), np.nan)
    no_modes = modes_from(np.zeros(0, complex), np.zeros((n, 0), complex), setting)
    verdict = BlindVerdict("none", _determined(False), checks=checks, refusals=refused)
    return blind_fit(setting, unknown, unknown, no_modes, verdict)


def _estimated(
    sensors: Sensors,
    signals: Signals,
    division: Division,
    shapes: str,
    topology: Topology | None,
    mass: ArrayLike | None,
) -> Found:
    alike = len(set(sensors.powers)) == 1
    if shapes == "real" and not alike:
        raise OptionError(
            "shapes='real' needs sensors of one quantity; the record mixes them. Use 'free'."
        )
    if shapes == "real" and topology is not None:
        raise OptionError("shapes='real' does not go with structure=; leave one of them out.")
    tested = None
    if shapes != "free" and alike and topology is None:
        tested = real_shapes(division)
        tested = tested if shapes == "real" or tested.ratio < tested.limit else None
    place = division.place if tested is None else tested.place
    estimate = modal_estimate(place, division.modes, sensors.powers)
    P, V = estimate.normalized()
    constrained = None
    if topology is not None:
        constrained = constrain(P, V, topology, whole_mass(mass, len(P)))
        P, V = constrained.P, constrained.covariance
    return Found(signals, division, tested, estimate, P, V, constrained)


def answer(sensors: Sensors, found: Found, hold: str, mass: ArrayLike | None) -> BlindFit:
    """Return the judged result."""
    setting = sensors.setting
    n = setting.n_dof
    checks, refused = _judged(found)
    rates, phasors = steady_phasors(found)
    force, spread, force_phasors = _force(sensors, found, rates, phasors, hold)
    damping = checks["damping_deviation"] <= refusals.DAMPING
    size = np.linalg.norm(force_phasors, axis=0)
    known_force = len(rates) == 0 or bool((spread < KNOWN_FORCE * size.max()).all())
    determined = _determined(True, damping, known_force)
    verdict = BlindVerdict(
        "periodic" if len(rates) else "decay",
        determined,
        _missing(determined),
        checks,
        refused,
        (*sensors.findings, *_findings(found, checks, damping)),
    )
    modes = modes_from(
        found.estimate.poles,
        found.estimate.shapes,
        setting,
        **dict(zip(("frequencies_std", "damping_std"), found.estimate.deviations, strict=True)),
    )
    known_damping = found.P[:, n:] if damping else np.full((n, n), np.nan)
    return blind_fit(
        setting,
        found.P[:, :n],
        known_damping,
        modes,
        verdict,
        covariance=found.covariance,
        force=force if known_force else None,
        force_std=spread,
        phasors=force_phasors if known_force else None,
        input_frequencies_hz=rates / (2 * np.pi),
        mass=mass,
        diagnostics=_diagnostics(found),
    )


def _judged(found: Found) -> tuple[Mapping[str, float], tuple[Refusal, ...]]:
    place, division = found.place, found.division
    n = place.signals.n_channels
    hertz = np.concatenate([place.components.frequencies, place.signals.known]) / (2 * np.pi)
    judged = [
        refusals.of_certainty(division.certainty, n),
        refusals.of_lead(division.lead),
        refusals.of_deviations(found.P, found.covariance),
        refusals.of_matrices(found.P, found.estimate.condition()),
    ]
    if place.relative_errors > 10 * ROUNDING:
        errors = [place.residual(r) / np.sqrt(v) for r, v in enumerate(place.variances)]
        band = float(hertz.min()), float(hertz.max())
        judged.append(refusals.of_errors(errors, place.signals.dt, band))
    return refusals.together(*judged)


def steady_phasors(found: Found) -> tuple[Floats, list[Complexes]]:
    """Return ω of the force, ascending, and the sensors' phasors in each record."""
    place = found.place
    sines = ~found.division.modes
    rates = np.concatenate([place.components.frequencies[sines], place.signals.known])
    order = np.argsort(rates)
    phasors = [
        np.hstack([2 * place.shapes(r)[:, sines], place.known_shapes(r)])[:, order]
        for r in range(len(place.parts))
    ]
    return rates[order], phasors


def _force(
    sensors: Sensors, found: Found, rates: Floats, phasors: list[Complexes], hold: str
) -> tuple[Floats, Floats, Complexes]:
    """Return the history, its deviations, and the phasors of the first record."""
    place, powers, dt = found.place, sensors.powers, sensors.setting.dt
    n, hertz = len(powers), rates / (2 * np.pi)
    K, D = found.P[:, :n], found.P[:, n:]
    each, variance = [], np.zeros(n)
    for record, c in enumerate(phasors):
        n_samples = place.signals.lengths[record]
        each.append(periodic_force(K, D, powers, hertz, c, dt=dt, hold=hold))
        off = forces.phasor_deviations(
            found.P, found.covariance, c, rates, powers, place.noise(record), n_samples
        )
        variance += 0.5 * n_samples / place.signals.count * (off**2).sum(axis=1)
    lengths = place.signals.lengths
    history = [force_history(p, hertz, m, dt) for p, m in zip(each, lengths, strict=True)]
    return np.vstack(history), np.sqrt(variance), each[0]


def _determined(known: bool, damping: bool = False, force: bool = False) -> dict[str, bool]:
    return {
        "normalized_stiffness": known,
        "normalized_damping": known and damping,
        "normalized_force": known and force,
    }


def _missing(determined: dict[str, bool]) -> tuple[str, ...]:
    cures = {
        "normalized_damping": "M⁻¹D: a stronger transient, or shapes='real' where damping is "
        "proportional",
        "normalized_force": "the force: a smaller error of M⁻¹K",
    }
    return tuple(cure for name, cure in cures.items() if not determined[name])


def _findings(found: Found, checks: object, damping: bool) -> list[Finding]:
    findings = [
        Finding(
            "above_noise",
            "note",
            f"{len(found.estimate.poles)} modes stand above the noise; a mode below it would not "
            "be seen, and the matrices would be those of fewer sensors than modes.",
        )
    ]
    if found.shapes is not None:
        findings.append(
            Finding(
                "real_shapes",
                "note",
                f"The shapes were taken as real: 2 Δ log L = {found.shapes.ratio:.3g}, 99 % of "
                f"χ² is {found.shapes.limit:.3g}.",
            )
        )
    if not damping:
        findings.append(
            Finding(
                "damping_undetermined",
                "doubt",
                "M⁻¹D is not determined: it hangs on the phases of the shapes, which noise hides. "
                "Frequencies and damping ratios of the modes stand.",
                "Use a stronger transient, or shapes='real' where damping is proportional.",
            )
        )
    constrained = found.constrained
    if constrained is not None and constrained.chance < UNLIKELY:
        findings.append(
            Finding(
                "structure_doubt",
                "doubt",
                f"The structure asked for does not go with the data: χ² = "
                f"{constrained.distance:.3g} of {constrained.freedom} degrees of freedom.",
                "Leave structure= out, or give a Topology with more entries.",
            )
        )
    return findings


def _diagnostics(found: Found) -> Diagnostics:
    figures = {
        "n_oscillations": len(found.place.components),
        "certainty": found.division.certainty,
        "relative_errors": found.place.relative_errors,
        "noise_std": np.sqrt(
            np.mean([found.place.noise(r) for r in range(len(found.place.parts))], 0)
        ),
        "shapes": "free" if found.shapes is None else "real",
    }
    if found.constrained is not None:
        figures["structure_distance"] = found.constrained.distance
        figures["structure_freedom"] = found.constrained.freedom
    return Diagnostics(figures)
