"""blind_rows(): what can be told under unknown forces at some degrees of freedom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import check_choice, check_names
from ..fit import Diagnostics, Finding
from ..modes import Modes
from ..record import Floats, Record
from . import refusals
from .closure import Closed, close_rows, lag_between, whole_mass
from .forces import InverseForce, inverse_force
from .likelihood.data import signals_of
from .result import BlindFit, BlindVerdict, Refusal, Setting, blind_fit, modes_from
from .sensors import Sensors
from .weak_rows import SINGLE, TOO_QUIET, Rows, regress_rows
from .windowed import Spectra, spectra_of, window_energy

PLACES = ("point", "base")
LAGGING = 5.0  # standard deviations that 𝒟 of free rows is off symmetry, above which it is wrong
LEAST_LAG = 1e-3  # of a sample: without noise less is rounding
POINT_CURE = (
    "Measure the forces, record a decay, or say more of them: excitation='base' allows rows that "
    "leave a little more than the noise."
)
BASE_CURE = (
    "Sensors must show absolute motion, without delays, and masses be lumped; else measure the "
    "base, or record a decay."
)
GROUND = (
    "the ground spring (k₁) under unmeasured base motion: floors alone can never tell it; measure "
    "the base"
)


def blind_rows(
    data: Record | Sequence[Record],
    n_dof: int,
    *,
    excitation: str = "point",
    force_band: tuple[float, float] | None = None,
    mass: ArrayLike | None = None,
    ungrounded: Sequence[str] = (),
) -> BlindFit:
    """Return the rows of 𝒦 and 𝒟 at DOFs without force, and where the forces act.

    Parameters
    ----------
    data : Record or sequence of Record
    n_dof : int
        As many as there are outputs.
    excitation : "point" or "base"
        Forces at some DOFs, or base motion that was not measured (absolute accelerations):
        a force on every DOF with a spring to the ground. With "base", small errors of the
        model beyond the noise are tolerated, and deviations raised accordingly.
    force_band : (low, high), optional
        Band of the force [Hz]; the noise is read where the sensors are quiet above it.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        [kg]; lumped masses close forced rows by symmetry.
    ungrounded : sequence of str
        DOFs without a spring to the ground; that closes the diagonal of a forced row.

    Returns
    -------
    BlindFit
        Rows of NaN where a force hides them; 𝒟 is NaN where it is uncertain, or not symmetric
        as if sensors lagged behind each other.

    Raises
    ------
    OptionError, DataError
        As `blind_likelihood`; a band without lines, or none above it for the noise.

    Notes
    -----
    Weak form of each row with a smooth window, errors in variables; see `weak_rows`. Masses must
    be lumped: with others a force at one DOF is felt in several rows, and none is free.
    """
    check_choice("excitation", excitation, PLACES)
    sensors, signals = signals_of(data, n_dof, None)
    setting, base = sensors.setting, excitation == "base"
    check_names("DOF", ungrounded, setting.dofs)
    # where the user says which rows are free, no force makes the floor of all sensors
    spectra = spectra_of(signals.samples, signals.dt, sensors.powers, force_band, believed=base)
    rows = regress_rows(spectra)
    free = rows.free(base)
    refused = _refused(rows, spectra, free, base)
    raised = np.sqrt(np.maximum(rows.misfits, 1))  # where the noise is not all that is left
    deviations = np.sqrt([np.diag(V) for V in rows.covariances]) * raised[:, None]
    # a base moves exactly the DOFs that have a spring to the ground
    floating = np.array([dof in ungrounded and not base for dof in setting.dofs])
    closed = close_rows(rows.P, deviations, free, whole_mass(mass, n_dof), floating)
    closed, doubts = _without_doubtful_damping(closed, free, setting)
    doubts += _unused(mass, ungrounded, closed)
    verdict = _verdict(excitation, sensors, rows, free, closed, refused, doubts)
    inverse = _force(closed.P, signals.samples, sensors, spectra)
    known = bool(np.isfinite(inverse.lowest_hz[~free]).any())
    shown = rows.P if refused else closed.P  # candidates of a refusal
    return blind_fit(
        setting,
        shown[:, :n_dof],
        shown[:, n_dof:],
        _modes(closed, setting),
        verdict,
        stiffness_std=closed.deviations[:, :n_dof],
        damping_std=closed.deviations[:, n_dof:],
        force=np.where(free, 0.0, inverse.values) if known else None,
        force_std=np.where(free, 0.0, inverse.deviations) if known else None,
        forced_dofs=[d for d, is_free in zip(setting.dofs, free, strict=True) if not is_free],
        mass=whole_mass(mass, n_dof),
        diagnostics=_diagnostics(rows, spectra, inverse),
    )


def _without_doubtful_damping(
    closed: Closed, free: NDArray[np.bool_], setting: Setting
) -> tuple[Closed, list[Finding]]:
    """Return what is known without an uncertain or an asymmetric 𝒟, and why it is left out."""
    off = _deviations(closed).get("damping_deviation", np.inf)
    lag = lag_between(closed.P, closed.deviations, free)
    if lag is not None and lag.certainty > LAGGING and abs(lag.seconds) > LEAST_LAG * setting.dt:
        late, early = setting.dofs[lag.second], setting.dofs[lag.first]
        if lag.seconds < 0:
            late, early = early, late
        doubt = Finding(
            "asymmetric_damping",
            "doubt",
            "M⁻¹D is not determined: with the masses that M⁻¹K shows it is not symmetric "
            f"({lag.certainty:.3g} standard deviations), as if the sensor at {late} lagged "
            f"{1e3 * abs(lag.seconds):.3g} ms behind that at {early}.",
            "Set delays of sensors right (correct_delays).",
        )
    elif off > refusals.DAMPING:
        doubt = Finding(
            "damping_undetermined",
            "doubt",
            f"M⁻¹D is not determined by these data (relative deviation {off:.2g}, and "
            f"{refusals.DAMPING:g} is the most).",
            "Use a longer record.",
        )
    else:
        return closed, []
    P = closed.P.copy()
    P[:, setting.n_dof :] = np.nan
    return replace(closed, P=P), [doubt]


def _unused(mass: ArrayLike | None, ungrounded: Sequence[str], closed: Closed) -> list[Finding]:
    """Return what was given to close rows and could not."""
    n = len(closed.P)
    matrix = whole_mass(mass, n)
    if not len(closed.open_dofs) or (mass is None and not ungrounded):
        return []
    if mass is None:
        why = "ungrounded= closes rows only together with masses (mass=)."
    elif matrix is None:
        why = "A total mass closes no row; give mass= one a DOF."
    elif np.count_nonzero(matrix - np.diag(np.diag(matrix))):
        why = "Masses that are not lumped close no row: a force then shows in several."
    else:
        return []
    return [Finding("not_closed", "note", why)]


def _refused(
    rows: Rows, spectra: Spectra, free: NDArray[np.bool_], base: bool
) -> tuple[Refusal, ...]:
    forced = rows.forced(base)
    if free.any() and forced.any():
        return ()
    low, high = spectra.band_hz
    band = f"from {low:.3g} to {high:.3g} Hz"
    shown = ", ".join(f"{each:.3g}" for each in rows.misfits)
    if free.any():
        sentence = (
            f"No degree of freedom is seen to be forced {band} (χ² per degree of freedom {shown}), "
            "though something moves the structure: the band does not tell forced rows from free "
            "ones."
        )
        cure = "Excite the modes themselves; for a decay use excitation='decay'."
    elif rows.too_quiet:
        sentence = (
            f"What the rows leave {band} is less than the noise read above it (χ² per degree of "
            f"freedom {shown}, and {TOO_QUIET:g} is the least): the floor there is not the "
            "sensors' noise, and without it free rows cannot be told from forced ones."
        )
        cure = "Give force_band=, above which the sensors show nothing but noise, or sample faster."
    elif rows.ambiguous.any():
        sentence = (
            f"Several relations between the sensors hold equally well {band}, so that none is "
            f"known to be the structure's (the second best leaves {max(rows.seconds.min(), 0):.3g} "
            f"times the noise, and {SINGLE:g} is asked)."
        )
        cure = "Excite all modes, and put each sensor where it moves on its own."
    else:
        sentence = (
            f"No degree of freedom is free of force {band} (χ² per degree of freedom {shown}, "
            f"limit {rows.limit:.3g}). A force within the band on every degree of freedom explains "
            "the record for any M⁻¹K and M⁻¹D, so none follows from it."
        )
        cure = BASE_CURE if base else POINT_CURE
    figures = {"row_misfits": rows.misfits, "limit": rows.limit, "row_seconds": rows.seconds}
    return (Refusal("in_band", sentence, cure, figures),)


def _verdict(
    excitation: str,
    sensors: Sensors,
    rows: Rows,
    free: NDArray[np.bool_],
    closed: Closed,
    refused: tuple[Refusal, ...],
    doubts: list[Finding],
) -> BlindVerdict:
    n, dofs, base = len(free), sensors.setting.dofs, excitation == "base"
    checks = {f"row_misfit_{d}": float(x) for d, x in zip(dofs, rows.misfits, strict=True)}
    checks |= _deviations(closed)
    stiffness = checks.get("stiffness_deviation", np.inf)
    if not refused and stiffness > refusals.STIFFNESS:
        sentence = (
            f"The predicted relative deviation of the free rows of M⁻¹K is {stiffness:.2g}, "
            f"and {refusals.STIFFNESS:g} is the most."
        )
        cure = "Use a longer record, or a force that reaches the modes."
        figures = {"stiffness_deviation": stiffness, "limit": refusals.STIFFNESS}
        refused = (Refusal("R6", sentence, cure, figures),)
    known = np.isfinite(closed.P)
    determined = {
        "rows without force": not refused,
        "normalized_stiffness": bool(known[:, :n].all()),
        "normalized_damping": bool(known.all()),
        "normalized_force": bool(known.all()),
    }
    findings = [] if refused else [*_findings(sensors.setting, rows, free, closed, base), *doubts]
    return BlindVerdict(
        excitation if not refused else "none",
        determined,
        () if refused else _missing(sensors.setting, closed, free, base),
        checks,
        refused,
        (*sensors.findings, *findings),
    )


def _deviations(closed: Closed) -> dict[str, float]:
    """Return the relative deviations of what is known of 𝒦 and 𝒟."""
    n = len(closed.P)
    checks = {}
    for name, part in (("stiffness", slice(n)), ("damping", slice(n, 2 * n))):
        known = np.isfinite(closed.P[:, part])
        if known.any():
            size = np.linalg.norm(closed.P[:, part][known])
            off = np.linalg.norm(closed.deviations[:, part][known])
            checks[f"{name}_deviation"] = float(off / size)
    return checks


def _missing(
    setting: Setting, closed: Closed, free: NDArray[np.bool_], base: bool
) -> tuple[str, ...]:
    names = ", ".join(setting.dofs[k] for k in closed.open_dofs if not free[k])
    if not names:
        return ()
    if base:
        return (f"the row of {names}, with {GROUND}",)
    return (
        f"the rows of {names}: a free force takes them up; masses (mass=) and DOFs without a "
        "spring to the ground (ungrounded=) would close them",
    )


def _findings(
    setting: Setting,
    rows: Rows,
    free: NDArray[np.bool_],
    closed: Closed,
    base: bool,
) -> list[Finding]:
    findings = [Finding("closure", "note", f"Closed: {said}.") for said in closed.said]
    unsure = ~free & ~rows.forced(base)
    if unsure.any():
        names = ", ".join(d for d, u in zip(setting.dofs, unsure, strict=True) if u)
        findings.append(
            Finding(
                "undecided",
                "doubt",
                f"Whether {names} is forced cannot be told (χ² per degree of freedom "
                f"{rows.misfits[unsure].max():.3g}, limit {rows.limit:.3g}; second best relation "
                f"{rows.seconds[unsure].min():.3g} times the noise, limit {SINGLE:g}); left out.",
                "Use a longer record.",
            )
        )
    if base and rows.misfits[free].max(initial=0) > rows.limit:
        findings.append(
            Finding(
                "beyond_noise",
                "doubt",
                "The free rows leave more than the noise (χ² per degree of freedom up to "
                f"{rows.misfits[free].max():.3g}, of forced ones from "
                f"{rows.misfits[~free].min():.3g}); that they are free rests on excitation='base', "
                "and deviations were raised.",
                "Look for delays between sensors, masses that are not lumped, and damping against "
                "the ground.",
            )
        )
    return findings


def _force(
    P: Floats, samples: tuple[Floats, ...], sensors: Sensors, spectra: Spectra
) -> InverseForce:
    """Return the force of all records, one below the other."""
    dt, powers, lengths = sensors.setting.dt, sensors.powers, [len(y) for y in samples]
    each = [
        inverse_force(P, y, dt, powers, window_energy(len(y)) * spectra.noise, spectra.band_hz)
        for y in samples
    ]
    return InverseForce(
        np.vstack([one.values for one in each]),
        np.sqrt(np.average([one.deviations**2 for one in each], axis=0, weights=lengths)),
        np.max([one.lowest_hz for one in each], axis=0),
    )


def _modes(closed: Closed, setting: Setting) -> Modes:
    """Return the modes where all of 𝒦 and 𝒟 is known, else none."""
    n = setting.n_dof
    if not np.isfinite(closed.P).all():
        return modes_from(np.zeros(0, complex), np.zeros((n, 0), complex), setting)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-closed.P]])
    poles, vectors = np.linalg.eig(A)
    kept = poles.imag > 0
    return modes_from(poles[kept], vectors[:n, kept], setting)


def _diagnostics(rows: Rows, spectra: Spectra, inverse: InverseForce) -> Diagnostics:
    return Diagnostics(
        {
            "row_misfits": rows.misfits,
            "row_seconds": rows.seconds,
            "row_limit": rows.limit,
            "band_hz": spectra.band_hz,
            "lowest_force_hz": inverse.lowest_hz,
        }
    )
