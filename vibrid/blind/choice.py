"""identify_blind(): one call for all that can be told without measured forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from ..errors import OptionError, check_choice
from ..fit import Finding
from ..physical import Topology
from ..record import Record
from .ambient import blind_ambient
from .finite_signal import blind_finite_signal
from .likelihood import blind_likelihood, blind_measured
from .likelihood.search import Progress
from .point import blind_rows
from .result import BlindFit
from .subspace import blind_subspace

EXCITATIONS = ("auto", "periodic", "point", "base", "ambient", "decay")
METHODS = ("ml", "subspace")
TRIED = {"periodic": "A periodic force was", "point": "A force at some DOFs only was"}


def identify_blind(
    data: Record | Sequence[Record],
    n_dof: int,
    *,
    excitation: str = "auto",
    method: str = "ml",
    input_frequencies_hz: Sequence[float] | None = None,
    hold: str = "band_limited",
    mass: ArrayLike | None = None,
    structure: Topology | str | None = None,
    shapes: str = "auto",
    force_band: tuple[float, float] | None = None,
    force_free: tuple[float, float] | None = None,
    ungrounded: Sequence[str] = (),
    progress: Progress | None = None,
) -> BlindFit:
    """Return M⁻¹K, M⁻¹D and the unknown force from one sensor at every degree of freedom.

    Parameters
    ----------
    data : Record or sequence of Record
        Displacements, velocities or accelerations, mixed as they come. Several records share
        the structure, not the motion. Measured forces, where there are any, are used.
    n_dof : int
        As many as there are outputs.
    excitation : str
        "periodic": a few sines anywhere, seen with a transient. "decay": none, after an impact
        or a stop. "point": any force, at some DOFs only. "base": base motion that was not
        measured, floors in absolute acceleration. "ambient": broadband on every DOF, which is
        an assumption and never chosen by itself. "auto" tries periodic and decay, then point,
        then, where `force_band` is given, any force on every DOF with the modes outside it.
    method : "ml" or "subspace"
        Maximum likelihood, or the published subspace method (periodic forces and decays; with
        `force_band` a force that is not periodic, see `blind_finite_signal`).
    input_frequencies_hz : sequence of float, optional
        Of a periodic force, all of them.
    hold : "band_limited", "zoh" or "foh"
        How the force moves between samples; it concerns the force alone.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        [kg]: stiffness, damping and force in physical units.
    structure : Topology or "symmetric", "diagonal", "chain", optional
        The nearest matrices of this structure.
    shapes : "auto", "free" or "real"
        Real shapes, those of proportional damping, make 𝒟 far more certain.
    force_band : (low, high), optional
        Band [Hz] that holds all of a force that is not periodic. At some DOFs it may hold the
        modes too; on every DOF it must not, and a mode within it is refused ("in_band").
    force_free : (start, stop), optional
        A stretch without any force [s], taken as a decay.
    ungrounded : sequence of str
        DOFs without a spring to the ground, which close the row of a point force.
    progress : callable (what, done, total), optional

    Returns
    -------
    BlindFit
        A refusal is a value: NaN matrices, `verdict.accepted` False, the rule and its figures,
        the best candidate in `diagnostics`.

    Raises
    ------
    OptionError
        n_dof other than the number of sensors; options that do not fit.
    DataError
        Gaps, too few samples, constant channels, records that do not go together.

    Notes
    -----
    A force within the band of the modes on every DOF explains any record for any 𝒦 and 𝒟 by
    M⁻¹f = q̈ + 𝒟q̇ + 𝒦q: only its limits in band, time or place carry information.
    """
    check_choice("excitation", excitation, EXCITATIONS)
    check_choice("method", method, METHODS)
    records = [data] if isinstance(data, Record) else list(data)
    measured = all(record.n_inputs for record in records) and excitation in ("auto", "periodic")
    _check_unused(excitation, method, measured, structure, shapes)
    if force_band is not None:
        _check_band(excitation, measured and method == "ml", structure, force_free)
    if force_free is not None:
        if excitation not in ("auto", "decay"):
            raise OptionError(f"force_free is a decay; it does not go with {excitation!r}.")
        records, excitation = [each.between(*force_free) for each in records], "decay"
    if method == "subspace":
        if force_band is not None and excitation == "auto":
            return _limited(records, n_dof, force_band, input_frequencies_hz, mass)
        return _subspace(records, n_dof, excitation, input_frequencies_hz, hold, mass)
    if excitation == "ambient":
        return blind_ambient(
            _only(records, "excitation='ambient'"), n_dof, mass=mass, shapes=shapes
        )
    place = {"force_band": force_band, "mass": mass, "ungrounded": ungrounded}
    if excitation in ("point", "base"):
        return blind_rows(records, n_dof, excitation=excitation, **place)  # type: ignore[arg-type]
    if measured and excitation != "decay":
        _check_forces(records)
        return blind_measured(
            records,
            n_dof,
            input_frequencies_hz=input_frequencies_hz,
            hold=hold,
            mass=mass,
            progress=progress,
        )
    found = blind_likelihood(
        records,
        n_dof,
        input_frequencies_hz=input_frequencies_hz,
        hold=hold,
        mass=mass,
        structure=structure,
        shapes=shapes,
        progress=progress,
    )
    unexplained = any(each.rule == "R4" for each in found.verdict.refusals)
    if excitation != "auto" or not unexplained or structure is not None:
        return found
    tried = {"periodic": found}
    if n_dof > 1:  # else no row is free of force
        found = tried["point"] = blind_rows(records, n_dof, **place)  # type: ignore[arg-type]
    if not found.accepted and force_band is not None and len(records) == 1:
        found = blind_finite_signal(records[0], n_dof, force_band=force_band, mass=mass)
    return _after(found, {name: each for name, each in tried.items() if each is not found})


def _check_band(
    excitation: str, measured: bool, structure: object, force_free: tuple[float, float] | None
) -> None:
    """Refuse the band of a force where nothing would heed it."""
    if force_free is not None:
        raise OptionError("Give force_band or force_free, not both.")
    if excitation not in ("auto", "point", "base"):
        raise OptionError(f"force_band is not used with excitation={excitation!r}; leave it out.")
    if measured:
        raise OptionError(
            "force_band is not used with measured forces; leave it out, or them with "
            "select(inputs=[])."
        )
    if structure is not None:
        raise OptionError("structure= is not used with force_band; leave one out.")


def _check_unused(
    excitation: str, method: str, measured: bool, structure: object, shapes: str
) -> None:
    """Refuse options that the way chosen has no use for."""
    way = (
        "method='subspace'"
        if method == "subspace"
        else f"excitation={excitation!r}"
        if excitation in ("point", "base", "ambient")
        else "measured forces"
        if measured
        else ""
    )
    if way and structure is not None:
        raise OptionError(f"structure= is not used with {way}; leave it out.")
    if way and shapes != "auto" and excitation != "ambient":
        raise OptionError(f"shapes={shapes!r} is not used with {way}; leave it out.")


def _check_forces(records: Sequence[Record]) -> None:
    for channel in (c for record in records for c in record.input_channels):
        if channel.quantity == "base_acceleration":
            raise OptionError(
                f"Input {channel.name!r} is a base acceleration, no force; identify() takes it. "
                "Leave it out with select(inputs=[])."
            )


def _only(records: Sequence[Record], what: str) -> Record:
    if len(records) != 1:
        raise OptionError(f"{what} takes one record; got {len(records)}.")
    return records[0]


def _subspace(
    records: Sequence[Record],
    n_dof: int,
    excitation: str,
    input_frequencies_hz: Sequence[float] | None,
    hold: str,
    mass: ArrayLike | None,
) -> BlindFit:
    if excitation not in ("auto", "periodic", "decay"):
        raise OptionError(
            f"method='subspace' is for periodic forces and decays; leave method= out for "
            f"excitation={excitation!r}."
        )
    record = _only(records, "method='subspace'")
    return blind_subspace(
        record, n_dof, input_frequencies_hz=input_frequencies_hz, hold=hold, mass=mass
    )


def _limited(
    records: Sequence[Record],
    n_dof: int,
    force_band: tuple[float, float],
    input_frequencies_hz: Sequence[float] | None,
    mass: ArrayLike | None,
) -> BlindFit:
    """Return the answer of a force that is not periodic, by its band."""
    if input_frequencies_hz is not None:
        raise OptionError("Give force_band or input_frequencies_hz, not both.")
    record = _only(records, "method='subspace'")
    return blind_finite_signal(record, n_dof, force_band=force_band, mass=mass)


def _after(found: BlindFit, tried: Mapping[str, BlindFit]) -> BlindFit:
    """Return the last attempt, with what became of the earlier ones."""
    refusals, findings = list(found.verdict.refusals), list(found.verdict.findings)
    for name, each in tried.items():
        why = "; ".join(map(str, each.verdict.refusals))
        findings.append(Finding(f"tried_{name}", "note", f"{TRIED[name]} tried first: {why}"))
        if not found.accepted:
            refusals += each.verdict.refusals
    refusals.sort(key=lambda each: each.rule != "in_band")  # first what says why none can tell
    verdict = replace(found.verdict, refusals=tuple(refusals), findings=tuple(findings))
    return replace(found, verdict=verdict)
