"""identify_blind(): one call for all that can be told without measured forces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError, OptionError, check_choice
from ..fit import Finding
from ..physical import Topology
from ..record import Record
from ..statespace import HOLDS
from .ambient import blind_ambient
from .finite_signal import blind_finite_signal
from .likelihood import blind_likelihood, blind_measured
from .likelihood.data import records_of
from .likelihood.search import Progress
from .point import blind_rows
from .result import BlindFit
from .subspace import blind_subspace

EXCITATIONS = ("auto", "periodic", "point", "base", "ambient", "decay")
METHODS = ("ml", "subspace")
HEEDED = {  # what each way has a use for, besides masses
    "auto": (
        "input_frequencies_hz",
        "hold",
        "structure",
        "shapes",
        "force_band",
        "ungrounded",
    ),
    "excitation='periodic'": ("input_frequencies_hz", "hold", "structure", "shapes"),
    "excitation='decay'": ("structure", "shapes"),
    "excitation='point'": ("force_band", "ungrounded"),
    "excitation='base'": ("force_band", "ungrounded"),
    "excitation='ambient'": ("shapes",),
    "measured forces": ("input_frequencies_hz", "hold"),
    "method='subspace'": ("input_frequencies_hz", "hold"),
    "method='subspace' and force_band": ("force_band",),
    "method='subspace' and excitation='decay'": (),
}
TRIED = {"periodic": "A periodic force was", "point": "A force at some DOFs only was"}
UNTRIED = {
    "point": "A force at some DOFs only could not be tried",
    "band": "Modes outside force_band could not be tried",
}


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
        DOFs without a spring to the ground, which close the row of a point force where masses
        are given too.
    progress : callable (what, done, total), optional

    Returns
    -------
    BlindFit
        A refusal is a value: NaN matrices, `verdict.accepted` False, the rule and its figures,
        the best candidate in `diagnostics`.

    Raises
    ------
    OptionError
        n_dof other than the number of sensors; options that do not fit, or that the excitation
        has no use for.
    DataError
        Gaps, too few samples, constant channels, records that do not go together.

    Notes
    -----
    A force within the band of the modes on every DOF explains any record for any 𝒦 and 𝒟 by
    M⁻¹f = q̈ + 𝒟q̇ + 𝒦q: only its limits in band, time or place carry information.
    """
    check_choice("excitation", excitation, EXCITATIONS)
    check_choice("method", method, METHODS)
    check_choice("hold", hold, HOLDS)
    records = records_of(data)
    if force_free is not None:
        _check_free(excitation, force_band)
        records, excitation = [each.between(*force_free) for each in records], "decay"
    known = _Known(input_frequencies_hz, hold, structure, shapes, force_band, ungrounded)
    question = _Question(records, n_dof, known, mass, progress)
    if method == "subspace":
        return question.by_subspace(excitation)
    return question.by_excitation(excitation)


def _check_free(excitation: str, force_band: tuple[float, float] | None) -> None:
    if force_band is not None:
        raise OptionError("Give force_band or force_free, not both.")
    if excitation not in ("auto", "decay"):
        raise OptionError(f"force_free is a decay; it does not go with {excitation!r}.")


@dataclass(frozen=True)
class _Known:
    """What the user says of forces and structure, as in `identify_blind`."""

    input_frequencies_hz: Sequence[float] | None = None
    hold: str = "band_limited"
    structure: Topology | str | None = None
    shapes: str = "auto"
    force_band: tuple[float, float] | None = None
    ungrounded: Sequence[str] = ()

    def check_heeded(self, way: str) -> None:
        """Refuse options that a way has no use for: none is passed over in silence."""
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in HEEDED[way] and _is_given(value, field.default):
                shown = repr(value) if isinstance(field.default, str) else ""
                raise OptionError(f"{field.name}={shown} is not used with {way}; leave one out.")


def _is_given(value: object, default: object) -> bool:
    if value is None or isinstance(value, str):
        return value != default
    return np.size(np.asarray(value, dtype=object)) > 0


@dataclass(frozen=True, eq=False)
class _Question:
    """Records and what is known of them; each method is one way to an answer."""

    records: list[Record]
    n_dof: int
    known: _Known
    mass: ArrayLike | None
    progress: Progress | None

    def by_excitation(self, excitation: str) -> BlindFit:
        if excitation in ("auto", "periodic") and all(each.n_inputs for each in self.records):
            return self._by_measured_forces()
        way = excitation if excitation == "auto" else f"excitation={excitation!r}"
        self.known.check_heeded(way)
        if excitation == "auto":
            return self._automatically()
        if excitation == "ambient":
            return self._as_ambient()
        if excitation in ("point", "base"):
            return self._by_rows(excitation)
        found = self._by_oscillations()
        return _doubted(found) if excitation == "decay" else found

    def by_subspace(self, excitation: str) -> BlindFit:
        if excitation not in ("auto", "periodic", "decay"):
            raise OptionError(
                f"method='subspace' is for periodic forces and decays; leave method= out for "
                f"excitation={excitation!r}."
            )
        record, known = self._only("method='subspace'"), self.known
        if known.force_band is not None and excitation == "auto":
            known.check_heeded("method='subspace' and force_band")
            return self._outside_the_band()
        decay = excitation == "decay"
        known.check_heeded("method='subspace'" + " and excitation='decay'" * decay)
        self._report("subspace")
        found = blind_subspace(
            record,
            self.n_dof,
            input_frequencies_hz=known.input_frequencies_hz,
            hold=known.hold,
            mass=self.mass,
        )
        return _doubted(found) if decay else found

    def _automatically(self) -> BlindFit:
        """Try periodic forces and decays, then forces at some DOFs, then outside the modes."""
        known = self.known
        if known.force_band is not None and known.structure is not None:
            raise OptionError("structure= is not used with force_band; leave one out.")
        found = self._by_oscillations()
        unexplained = any(each.rule == "R4" for each in found.verdict.refusals)
        if not unexplained or known.structure is not None:
            return found
        further: dict[str, Callable[[], BlindFit]] = {}
        if self.n_dof > 1:  # else no row is free of force
            further["point"] = lambda: self._by_rows("point")
        if known.force_band is not None:
            further["band"] = self._outside_the_band
        attempts, notes = [("periodic", found)], []
        for name, attempt in further.items():
            try:
                attempts.append((name, attempt()))
            except DataError as error:
                notes.append(Finding(f"untried_{name}", "note", f"{UNTRIED[name]}: {error}"))
            if attempts[-1][1].accepted:
                break
        return _with(_after(attempts[-1][1], attempts[:-1]), *notes)

    def _by_oscillations(self) -> BlindFit:
        return blind_likelihood(
            self.records,
            self.n_dof,
            input_frequencies_hz=self.known.input_frequencies_hz,
            hold=self.known.hold,
            mass=self.mass,
            structure=self.known.structure,
            shapes=self.known.shapes,
            progress=self.progress,
        )

    def _by_measured_forces(self) -> BlindFit:
        self.known.check_heeded("measured forces")
        _check_forces(self.records)
        return blind_measured(
            self.records,
            self.n_dof,
            input_frequencies_hz=self.known.input_frequencies_hz,
            hold=self.known.hold,
            mass=self.mass,
            progress=self.progress,
        )

    def _by_rows(self, excitation: str) -> BlindFit:
        self._report("rows")
        return blind_rows(
            self.records,
            self.n_dof,
            excitation=excitation,
            force_band=self.known.force_band,
            mass=self.mass,
            ungrounded=self.known.ungrounded,
        )

    def _as_ambient(self) -> BlindFit:
        return blind_ambient(
            self._only("excitation='ambient'"),
            self.n_dof,
            mass=self.mass,
            shapes=self.known.shapes,
            progress=self.progress,
        )

    def _outside_the_band(self) -> BlindFit:
        if len(self.records) > 1:
            raise DataError(f"this way takes one record; got {len(self.records)}.")
        self._report("subspace")
        return blind_finite_signal(
            self.records[0], self.n_dof, force_band=self.known.force_band, mass=self.mass
        )

    def _only(self, what: str) -> Record:
        if len(self.records) != 1:
            raise OptionError(f"{what} takes one record; got {len(self.records)}.")
        return self.records[0]

    def _report(self, what: str) -> None:
        if self.progress is not None:
            self.progress(what, 0, 1)


def _check_forces(records: Sequence[Record]) -> None:
    for channel in (c for record in records for c in record.input_channels):
        if channel.quantity == "base_acceleration":
            raise OptionError(
                f"Input {channel.name!r} is a base acceleration, no force; identify() takes it. "
                "Leave it out with select(inputs=[])."
            )


def _doubted(found: BlindFit) -> BlindFit:
    """Return the answer of what was said to be a decay, with a doubt where forces were found."""
    if found.verdict.kind != "periodic" or not found.accepted:
        return found
    hertz = ", ".join(f"{each:.4g}" for each in found.input_frequencies_hz)
    sentence = (
        f"The record was said to be a decay, but holds motion that does not decay: {hertz} Hz."
    )
    return _with(found, Finding("not_a_decay", "doubt", sentence))


def _with(found: BlindFit, *findings: Finding) -> BlindFit:
    verdict = found.verdict
    return replace(found, verdict=replace(verdict, findings=(*verdict.findings, *findings)))


def _after(found: BlindFit, tried: Sequence[tuple[str, BlindFit]]) -> BlindFit:
    """Return the last attempt, with what became of the earlier ones."""
    refusals, findings = list(found.verdict.refusals), list(found.verdict.findings)
    for name, each in tried:
        why = "; ".join(map(str, each.verdict.refusals))
        findings.append(Finding(f"tried_{name}", "note", f"{TRIED[name]} tried first: {why}"))
        if not found.accepted:
            refusals += each.verdict.refusals
    refusals.sort(key=lambda each: each.rule != "in_band")  # first what says why none can tell
    verdict = replace(found.verdict, refusals=tuple(refusals), findings=tuple(findings))
    return replace(found, verdict=verdict)
