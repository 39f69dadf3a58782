"""The rules applied to what was found, and what is said beside the numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ...fit import Diagnostics, Finding
from ...record import Floats
from .. import forces, refusals
from ..coordinates import Powers
from ..result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from ..sensors import Sensors
from .found import Found
from .place import ROUNDING, Place
from .real_shapes import RealShapes
from .search import LOWEST, price

UNLIKELY = 0.01  # probability of a structure's misfit below which it is doubted
LOOKED_AT = 400  # frequencies at which a sine of the force might hide
CURES = {
    "normalized_damping": "M⁻¹D: a stronger transient, or shapes='real' where damping is "
    "proportional",
    "normalized_force": "the force: a smaller error of M⁻¹K",
}


def judge(found: Found) -> tuple[Mapping[str, float], tuple[Refusal, ...]]:
    """Return the figures of the rules R1 to R7, and what they refuse."""
    place, division = found.place, found.division
    hertz = np.concatenate([place.components.frequencies, place.signals.known]) / (2 * np.pi)
    judged = [
        refusals.of_certainty(division.certainty, place.signals.n_channels),
        refusals.of_lead(division.lead),
        refusals.of_deviations(found.P, found.covariance),
        refusals.of_condition(found.estimate.condition()),
        refusals.of_stiffness(found.P),
    ]
    if found.taken is not None:
        free, hidden = found.taken.free_deviation, found.taken.hidden
        judged.append(({"free_damping_deviation": free, "hidden_damping": hidden}, []))
    if place.relative_errors > 10 * ROUNDING:
        errors = [place.residual(r) / np.sqrt(v) for r, v in enumerate(place.variances)]
        band = float(hertz.min()), float(hertz.max())
        judged.append(refusals.of_errors(errors, place.signals.dt, band))
    return refusals.together(*judged)


def refused(
    sensors: Sensors,
    checks: Mapping[str, float],
    broken: tuple[Refusal, ...],
    missing: tuple[str, ...] = (),
) -> BlindFit:
    """Return the refusal of a record that gives no candidate."""
    setting, n = sensors.setting, sensors.setting.n_dof
    unknown = np.full((n, n), np.nan)
    none = modes_from(np.zeros(0, complex), np.zeros((n, 0), complex), setting)
    determined = dict.fromkeys(("normalized_stiffness", *CURES), False)
    verdict = BlindVerdict("none", determined, missing, checks, broken, sensors.findings)
    return blind_fit(setting, unknown, unknown, none, verdict)


def unexplained(sensors: Sensors, place: Place) -> BlindFit:
    """Return the refusal of a record that a few oscillations do not explain."""
    count, left = len(place.components), place.relative_errors
    refusal = Refusal(
        "R4",
        f"{count} oscillations leave {100 * left:.3g} % of the motion, and the next ones "
        "would take little of it: the force is not a sum of a few sines.",
        "Say what the force is with excitation=, or give a stretch without force.",
        {"n_oscillations": count, "relative_errors": left},
    )
    return refused(sensors, {"relative_errors": left}, (refusal,))


def findings_of(found: Found, damping: bool) -> Iterator[Finding]:
    """Yield what is to be said of shapes, damping and structure."""
    yield Finding(
        "above_noise",
        "note",
        f"{len(found.estimate.poles)} modes stand above the noise; a mode below it would not "
        "be seen, and the matrices would be those of fewer sensors than modes.",
    )
    if found.division.drifting.any():
        yield Finding(
            "drift",
            "note",
            "The sensors drift: what swings less than once in the record was taken out, and is no "
            "part of the force.",
            "Take it out with detrend() before, if it is a straight line.",
        )
    if found.taken is not None:
        yield _of_real_shapes(found.taken)
    if not damping:
        yield Finding(
            "damping_undetermined",
            "doubt",
            "M⁻¹D is not determined: it hangs on the phases of the shapes, which noise hides. "
            "Frequencies and damping ratios of the modes stand.",
            "Use a stronger transient, or shapes='real' where damping is proportional.",
        )
    constrained = found.constrained
    if constrained is not None and constrained.chance < UNLIKELY:
        yield Finding(
            "structure_doubt",
            "doubt",
            f"The structure asked for does not go with the data: χ² = "
            f"{constrained.distance:.3g} of {constrained.freedom} degrees of freedom.",
            "Leave structure= out, or give a Topology with more entries.",
        )


def assumed_in(found: Found) -> tuple[str, ...]:
    """Return what the answer rests on where the test of it says little, or no."""
    taken = found.taken
    if taken is not None and (taken.rejected or taken.hidden > refusals.DAMPING):
        return ("real shapes (proportional damping), on which M⁻¹D rests",)
    return ()


def _of_real_shapes(tested: RealShapes) -> Finding:
    figures = f"2 Δ log L is {tested.ratio:.3g}, 99 % of χ² {tested.limit:.3g}"
    free = f"With free shapes its deviation is {100 * tested.free_deviation:.2g} %."
    if tested.rejected:
        return Finding(
            "real_shapes_rejected",
            "doubt",
            f"Real shapes were asked for and the data reject them ({figures}): M⁻¹D is the nearest "
            f"that is proportional. {free}",
            "Leave shapes= out, or use 'free'.",
        )
    hidden = f"{100 * tested.hidden:.2g} %"
    if tested.hidden > refusals.DAMPING:
        return Finding(
            "real_shapes_assumed",
            "doubt",
            f"M⁻¹D rests on real shapes (proportional damping), which these data hardly test: they "
            f"do not reject them ({figures}), but coupling of the modes by up to {hidden} of M⁻¹D "
            f"might pass unnoticed. {free}",
            "Use shapes='free' unless damping is known to be proportional, or a stronger "
            "transient.",
        )
    return Finding(
        "real_shapes",
        "note",
        f"The shapes were taken as real (proportional damping): {figures}. Coupling of the modes "
        f"by more than {hidden} of M⁻¹D would have shown.",
    )


def hidden_sines(found: Found, powers: Powers, force: Floats) -> Iterator[Finding]:
    """Yield where a sine of the force as large as half of the force would not be seen."""
    signals, place = found.place.signals, found.place
    shortest = min(signals.lengths)
    lowest, highest = LOWEST / signals.duration, 0.5 / signals.dt
    hertz = np.geomspace(lowest, highest, LOOKED_AT)
    noise = np.mean([place.noise(record) for record in range(len(place.parts))], axis=0)
    size = forces.KNOWN_FORCE * float(np.sqrt(np.mean(np.sum(force**2, axis=1))))
    low, high = forces.seen_band(
        found.P, powers, noise, shortest, hertz, size=size, gain=price(signals)
    )
    share = f"{100 * forces.KNOWN_FORCE:.0f} % of the force's RMS"
    if np.isnan(low):
        yield Finding(
            "hidden_sines",
            "doubt",
            f"Sines of the force were sought, but nowhere would one with {share} be seen, and the "
            "force's error does not count what is missing.",
            "Use sensors with less noise, or a longer record.",
        )
    elif not (low <= lowest and high >= highest):
        yield Finding(
            "hidden_sines",
            "note",
            f"Sines of the force were sought where the sensors tell them from noise: outside "
            f"{low:.3g} to {high:.3g} Hz one with {share} might be missing, and the force's error "
            "does not count it.",
        )


def diagnostics_of(found: Found) -> Diagnostics:
    """Return the figures that an answer keeps."""
    place = found.place
    every = range(len(place.parts))
    figures = {
        "n_oscillations": len(place.components),
        "certainty": found.division.certainty,
        "relative_errors": place.relative_errors,
        "noise_std": np.sqrt(np.mean([place.noise(record) for record in every], axis=0)),
        "offsets": np.array([place.constants(record) for record in every]),
        "shapes": "real" if found.real else "free",
    }
    if found.tested is not None:
        figures["shape_ratio"], figures["shape_limit"] = found.tested.ratio, found.tested.limit
        figures["free_damping"] = found.tested.free[:, len(found.P) :]
    if found.constrained is not None:
        figures["structure_distance"] = found.constrained.distance
        figures["structure_freedom"] = found.constrained.freedom
    return Diagnostics(figures)
