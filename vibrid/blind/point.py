"""blind_rows(): what can be told under unknown forces at some degrees of freedom."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import check_names
from ..fit import Diagnostics, Finding
from ..modes import Modes
from ..record import Floats, Record
from . import refusals
from .closure import Closed, close_rows, whole_mass
from .forces import InverseForce, inverse_force
from .likelihood.data import signals_of
from .result import BlindFit, BlindVerdict, Refusal, Setting, blind_fit, modes_from
from .sensors import Sensors
from .weak_rows import Rows, regress_rows
from .windowed import Spectra, spectra_of

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
        Band of the force [Hz]; the noise is read above it.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        [kg]; lumped masses close forced rows by symmetry.
    ungrounded : sequence of str
        DOFs without a spring to the ground; that closes the diagonal of a forced row.

    Returns
    -------
    BlindFit
        Rows of NaN where a force hides them.

    Raises
    ------
    OptionError, DataError
        As `blind_likelihood`; a band without lines, or none above it for the noise.

    Notes
    -----
    Weak form of each row with a smooth window, errors in variables; see `weak_rows`.
    """
    records = [data] if isinstance(data, Record) else list(data)
    sensors, signals = signals_of(records, n_dof, None)
    check_names("DOF", ungrounded, sensors.setting.dofs)
    spectra = spectra_of(signals.samples, signals.dt, sensors.powers, force_band)
    rows = regress_rows(spectra)
    base = excitation == "base"
    free = rows.free(base)
    refused = _refused(rows, spectra, free, rows.forced(base))
    raised = np.sqrt(np.maximum(rows.misfits, 1))  # where the noise is not all that is left
    deviations = np.sqrt([np.diag(V) for V in rows.covariances]) * raised[:, None]
    closed = _closed(rows, deviations, free, mass, ungrounded, sensors.setting, base)
    verdict = _verdict(excitation, sensors, rows, free, closed, spectra, refused, base)
    inverse = _force(closed.P, signals.samples, sensors, spectra)
    known = verdict.determined["normalized_force"]
    setting = sensors.setting
    return blind_fit(
        setting,
        closed.P[:, :n_dof] if not refused else rows.P[:, :n_dof],
        closed.P[:, n_dof:] if not refused else rows.P[:, n_dof:],
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


def _refused(
    rows: Rows, spectra: Spectra, free: NDArray[np.bool_], forced: NDArray[np.bool_]
) -> tuple[Refusal, ...]:
    figures = {"row_misfits": rows.misfits, "limit": rows.limit, "row_seconds": rows.seconds}
    shown = ", ".join(f"{each:.3g}" for each in rows.misfits)
    low, high = spectra.band_hz
    if not free.any():
        return (
            Refusal(
                "in_band",
                f"No degree of freedom is free of force from {low:.3g} to {high:.3g} Hz (χ² per "
                f"degree of freedom {shown}, limit {rows.limit:.3g}). A force within the band on "
                "every degree of freedom explains the record for any M⁻¹K and M⁻¹D, so none "
                "follows from it.",
                "Measure the forces, record a decay, or say more of them (excitation=).",
                figures,
            ),
        )
    if not forced.any():
        return (
            Refusal(
                "in_band",
                f"No degree of freedom is seen to be forced (χ² per degree of freedom {shown}), "
                "though something moves the structure: the band does not tell forced rows from "
                "free ones.",
                "Excite the modes themselves; for a decay use excitation='decay'.",
                figures,
            ),
        )
    return ()


def _closed(
    rows: Rows,
    deviations: Floats,
    free: NDArray[np.bool_],
    mass: ArrayLike | None,
    ungrounded: Sequence[str],
    setting: Setting,
    base: bool,
) -> Closed:
    known = whole_mass(mass, setting.n_dof)
    floating = np.array([dof in ungrounded for dof in setting.dofs])
    # a base moves exactly the DOFs that have a spring to the ground
    return close_rows(rows.P, deviations, free, known, floating & (not base))


def _verdict(
    excitation: str,
    sensors: Sensors,
    rows: Rows,
    free: NDArray[np.bool_],
    closed: Closed,
    spectra: Spectra,
    refused: tuple[Refusal, ...],
    base: bool,
) -> BlindVerdict:
    n = len(free)
    checks = {
        f"row_misfit_{d}": float(x) for d, x in zip(sensors.setting.dofs, rows.misfits, strict=True)
    }
    checks |= _deviations(closed)
    damping = checks.get("damping_deviation", np.inf) <= refusals.DAMPING
    if not damping:
        closed.P[:, n:] = np.nan
    stiffness = checks.get("stiffness_deviation", np.inf)
    if not refused and stiffness > refusals.STIFFNESS:
        refused = (
            Refusal(
                "R6",
                f"The predicted relative deviation of the free rows of M⁻¹K is {stiffness:.2g}, "
                f"and {refusals.STIFFNESS:g} is the most.",
                "Use a longer record, or a force that reaches the modes.",
                {"stiffness_deviation": stiffness, "limit": refusals.STIFFNESS},
            ),
        )
    whole = bool(np.isfinite(closed.P[:, :n]).all())
    determined = {
        "rows without force": not refused,
        "normalized_stiffness": whole,
        "normalized_damping": whole and bool(np.isfinite(closed.P[:, n:]).all()),
        "normalized_force": bool(np.isfinite(closed.P).all()),
    }
    return BlindVerdict(
        excitation if not refused else "none",
        determined,
        _missing(sensors.setting, closed, free, base),
        checks,
        refused,
        (*sensors.findings, *_findings(sensors.setting, rows, free, closed, base, damping)),
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
    if not len(closed.open_dofs):
        return ()
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
    damping: bool,
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
                f"{rows.misfits[unsure].max():.3g}, several relations fit); the row is left out.",
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
                "Look for delays between sensors and for masses that are not lumped.",
            )
        )
    if not damping:
        findings.append(
            Finding(
                "damping_undetermined",
                "doubt",
                "M⁻¹D is not determined by these data.",
                "Use a longer record.",
            )
        )
    return findings


def _force(
    P: Floats, samples: tuple[Floats, ...], sensors: Sensors, spectra: Spectra
) -> InverseForce:
    """Return the force of all records, one below the other."""
    dt, powers = sensors.setting.dt, sensors.powers
    each = [inverse_force(P, y, dt, powers, spectra.noise, spectra.band_hz) for y in samples]
    return InverseForce(
        np.vstack([one.values for one in each]),
        np.sqrt(np.mean([one.deviations**2 for one in each], axis=0)),
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
