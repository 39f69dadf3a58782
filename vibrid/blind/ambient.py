"""blind_ambient(): 𝒦 and 𝒟 under broadband forces on every DOF, which the user vouches for."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError, check_choice
from ..fit import Diagnostics, Finding
from ..identification import OrderScan, identify, scan_orders, steady_modes
from ..identification.scan import LARGEST_DAMPING
from ..methods import SSI
from ..modes import Complexes, Modes, modes_of
from ..physical.scaling import normalized_of
from ..record import Floats, Record
from . import refusals
from .likelihood.answer import SHAPES
from .result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from .sensors import Sensors, sensors_of

PIECES = 10  # of the record: each is left out once, for the deviations
OFTEN = 0.5  # of the larger orders that a mode must appear in
NEAR = 0.1  # of a frequency: a mode of a part of the record further off is another one


@dataclass(frozen=True, eq=False)
class _Estimate:
    """Poles and displacement shapes of as many modes as there are DOFs."""

    poles: Complexes
    shapes: Complexes

    def normalized(self) -> Floats:
        both = np.hstack([self.shapes, self.shapes.conj()])
        damping, stiffness = normalized_of(both, np.concatenate([self.poles, self.poles.conj()]))
        return np.hstack([stiffness, damping])


def blind_ambient(
    record: Record, n_dof: int, *, mass: ArrayLike | None = None, shapes: str = "auto"
) -> BlindFit:
    """Return 𝒦 and 𝒟 from ambient motion: white forces on every DOF.

    Covariance-driven SSI of surplus order; the modes that stay from order to order, with real
    shapes (proportional damping) unless `shapes` is "free". Nothing in the data tells whether
    the forces are white; the verdict repeats that it was assumed.

    Parameters
    ----------
    record : Record
        Outputs only.
    n_dof : int
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
    shapes : "auto", "free" or "real"
        "auto" is "real".

    Returns
    -------
    BlindFit
        Deviations from leaving out each tenth of the record. Errors fall with the square root
        of its length: expect per cents of 𝒦, tens of per cents of 𝒟.
    """
    check_choice("shapes", shapes, SHAPES)
    sensors = sensors_of(record, n_dof)
    channels = sensors.setting.channels
    y = sensors.outputs(record)
    known = Record(y, dt=record.dt, output_channels=channels)
    method = identify(known, SSI(kind="covariance")).method
    decomposition = method.decompose(known)
    steady = _steady(scan_orders(method, decomposition), n_dof)
    if steady is None or steady[1].n_modes != n_dof:
        return _refused(sensors, steady)
    order, modes = steady
    estimate = _estimate(modes, sensors, shapes)
    P = estimate.normalized()
    covariance = _jackknife(known, method, order, modes, sensors, shapes, P)
    return _answer(sensors, estimate, P, covariance, mass, order)


def _steady(scan: OrderScan, n_dof: int) -> tuple[int, Modes] | None:
    """Return the modes that stay from order to order, at the smallest order that has enough."""
    surest = steady_modes(scan)
    if surest is not None and surest[1].n_modes >= n_dof:
        return surest
    for order, modes in zip(scan.orders, scan.modes, strict=True):
        seen, damping = scan.persistence(modes, int(order)), modes.damping_ratios
        kept = np.flatnonzero((seen >= OFTEN) & (damping > 0) & (damping < LARGEST_DAMPING))
        if len(kept) == n_dof and order < scan.orders[-1] / 2:
            return int(order), modes.select(kept)
    return surest


def _estimate(modes: Modes, sensors: Sensors, shapes: str) -> _Estimate:
    """Return displacement shapes; real ones are turned to where their imaginary part is least."""
    s = np.asarray(modes.shapes, dtype=np.complex128)
    signs = np.array([channel.sign for channel in sensors.setting.channels])
    s = s * signs[:, None]  # the outputs were turned already, and shapes turn again
    if shapes != "free":
        phase = 0.5 * np.angle(np.sum(s**2, axis=0))
        s = np.asarray((s * np.exp(-1j * phase)).real, dtype=np.complex128)
    return _Estimate(modes.poles, s)


def _jackknife(
    record: Record, method: SSI, order: int, modes: Modes, sensors: Sensors, shapes: str, P: Floats
) -> Floats | None:
    """Return the covariance of vec P from leaving out pieces; None where modes are lost."""
    edges = np.linspace(0, record.n_samples, PIECES + 1).astype(int)
    values = []
    for start, stop in pairwise(edges):
        rest = [record.slice(0, int(start))] if start else []
        rest += [record.slice(int(stop))] if stop < record.n_samples else []
        try:
            fit = method.realize(method.decompose(rest), order)
        except DataError:
            return None
        nearest = _nearest(modes, modes_of(fit))
        if nearest is None:
            return None
        values.append(_estimate(nearest, sensors, shapes).normalized().ravel(order="F"))
    off = np.array(values) - np.mean(values, axis=0)
    return np.asarray((PIECES - 1) / PIECES * (off.T @ off))


def _nearest(wanted: Modes, found: Modes) -> Modes | None:
    chosen = []
    for pole in wanted.poles:
        gaps = np.abs(found.poles - pole) / np.abs(pole)
        if not len(gaps) or gaps.min() > NEAR or int(np.argmin(gaps)) in chosen:
            return None
        chosen.append(int(np.argmin(gaps)))
    return found.select(chosen)


ASSUMED = Finding(
    "ambient_assumed",
    "note",
    "That broadband forces act on every degree of freedom is an assumption; nothing in the record "
    "tells it.",
)


def _refused(sensors: Sensors, steady: tuple[int, Modes] | None) -> BlindFit:
    setting, n = sensors.setting, sensors.setting.n_dof
    modes = steady[1] if steady is not None else None
    count = 0 if modes is None else modes.n_modes
    rule = "R1" if count < n else "R2"
    refusal = Refusal(
        rule,
        f"{count} modes stay from order to order; {n} sensors need {n}.",
        "Use a longer record, or filter to the band that holds as many modes as sensors.",
        {"steady_modes": count},
    )
    unknown = np.full((n, n), np.nan)
    none = modes_from(np.zeros(0, complex), np.zeros((n, 0), complex), setting)
    determined = {"normalized_stiffness": False, "normalized_damping": False}
    verdict = BlindVerdict(
        "ambient", determined, (), {"steady_modes": count}, (refusal,), (*sensors.findings, ASSUMED)
    )
    return blind_fit(setting, unknown, unknown, none if modes is None else modes, verdict)


def _answer(
    sensors: Sensors,
    estimate: _Estimate,
    P: Floats,
    covariance: Floats | None,
    mass: ArrayLike | None,
    order: int,
) -> BlindFit:
    n = len(P)
    judged = [refusals.of_matrices(P, 1.0)]
    spread = np.full((2 * n * n,) * 2, np.inf) if covariance is None else covariance
    judged.append(refusals.of_deviations(P, spread))
    checks, refused = refusals.together(*judged)
    checks = {name: value for name, value in checks.items() if name != "condition"}
    damping = checks["damping_deviation"] <= refusals.DAMPING
    verdict = BlindVerdict(
        "ambient",
        {
            "normalized_stiffness": True,
            "normalized_damping": damping,
            "normalized_force": False,
        },
        ("the force: it is broadband on every degree of freedom",),
        checks,
        refused,
        (*sensors.findings, ASSUMED),
    )
    return blind_fit(
        sensors.setting,
        P[:, :n],
        P[:, n:] if damping else np.full((n, n), np.nan),
        modes_from(estimate.poles, estimate.shapes, sensors.setting),
        verdict,
        covariance=covariance,
        mass=mass,
        diagnostics=Diagnostics({"order": order}),
    )
