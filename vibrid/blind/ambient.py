"""blind_ambient(): 𝒦 and 𝒟 under broadband forces on every DOF, which the user vouches for."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError, check_choice
from ..fit import Diagnostics
from ..identification import OrderScan, scan_orders, steady_modes
from ..identification.scan import LARGEST_DAMPING
from ..methods import SSI
from ..methods.subspace import Subspace
from ..modes import Complexes, Modes, modes_of
from ..physical.scaling import normalized_of
from ..record import Floats, Record
from . import refusals
from .likelihood.answer import SHAPES
from .likelihood.search import Progress
from .result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from .sensors import Sensors, sensors_of

PIECES = 20  # of the record: each is left out once, for the deviations
HORIZON = 0.5  # of the lowest mode's period, in block rows (Reynders & De Roeck 2008)
SHORTEST, LONGEST = 10, 80  # block rows
ROOM = 4  # times the samples that block rows need at least
SURPLUS = 4  # states a DOF: at the least order the damping is biased
OFTEN = 0.5  # of the larger orders that a mode must appear in
NEAR = 0.1  # of a frequency: a mode of a part of the record further off is another one
WHITE = "broadband forces act on every degree of freedom (nothing in the record tells it)"
REAL = "real shapes (proportional damping), on which M⁻¹D rests"


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
    record: Record,
    n_dof: int,
    *,
    mass: ArrayLike | None = None,
    shapes: str = "auto",
    progress: Progress | None = None,
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
    progress : callable (what, done, total), optional

    Returns
    -------
    BlindFit
        Errors fall with the square root of the length: of three modes with 1 to 2 % damping
        expect .4 % of 𝒦 and 5 % of 𝒟 over 600 periods of the lowest, and over 60 periods 2 %
        of 𝒦 and seldom any 𝒟.

    Notes
    -----
    Deviations are from leaving out each twentieth of the record. Of 30 records of three masses
    under white forces up to 10 Hz, of 60 and of 600 s, the true entries of 𝒦 and 𝒟 were within
    two deviations in 95 to 98 %. That needs block rows over half a period of the lowest mode
    and a surplus order: with fewer the error of the method, which no deviation shows, is larger
    than its noise.

    References
    ----------
    Reynders, De Roeck, Mech. Syst. Signal Process. 22 (2008) 617-637: the horizon.
    """
    check_choice("shapes", shapes, SHAPES)
    report: Progress = progress or (lambda what, done, total: None)
    sensors = sensors_of(record, n_dof)
    known = Record(sensors.outputs(record), dt=record.dt, output_channels=sensors.setting.channels)
    report("orders", 0, 2)
    method = _half_a_period(known, n_dof)
    report("orders", 1, 2)
    decomposition = method.decompose(known)
    steady = _steady(scan_orders(method, decomposition), n_dof)
    if steady is None or steady[1].n_modes != n_dof:
        return _refused(sensors, steady)
    order, modes = _with_surplus(method, decomposition, *steady)
    estimate = _estimate(modes, sensors, shapes)
    P = estimate.normalized()
    parts = _without_pieces(known, method, order, modes, report)
    covariance = None if parts is None else _jackknife(parts, sensors, shapes)
    return _answer(sensors, estimate, P, covariance, mass, Diagnostics({"order": order}), shapes)


def _half_a_period(record: Record, n_dof: int) -> SSI:
    """Return SSI with block rows over half a period of the lowest mode, as a long horizon sees it.

    A longer horizon than needed costs certainty, a shorter one bends the lowest mode.
    """
    longest = max(2, min(LONGEST, record.n_samples // (ROOM * (n_dof + 1))))
    method = SSI(kind="covariance", block_rows=longest)
    seen = _steady(scan_orders(method, method.decompose(record)), n_dof)
    if seen is None:
        return method
    wanted = HORIZON / (seen[1].frequencies_hz.min() * record.dt)
    return SSI(kind="covariance", block_rows=min(longest, max(SHORTEST, int(np.ceil(wanted)))))


def _with_surplus(
    method: SSI, decomposition: Subspace, order: int, modes: Modes
) -> tuple[int, Modes]:
    """Return the same modes at an order with states to spare, where it still has them."""
    larger = min(SURPLUS * modes.n_modes, decomposition.largest_order)
    if larger <= order:
        return order, modes
    same = _nearest(modes, modes_of(method.realize(decomposition, larger)))
    return (order, modes) if same is None else (larger, same)


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


def _without_pieces(
    record: Record, method: SSI, order: int, modes: Modes, report: Progress
) -> list[Modes] | None:
    """Return the modes of the record without each of its pieces; None where one is lost."""
    edges = np.linspace(0, record.n_samples, PIECES + 1).astype(int)
    parts = []
    for k, (start, stop) in enumerate(pairwise(edges)):
        report("pieces", k, PIECES)
        rest = [record.slice(0, int(start))] if start else []
        rest += [record.slice(int(stop))] if stop < record.n_samples else []
        try:
            found = modes_of(method.realize(method.decompose(rest), order))
        except DataError:
            return None
        same = _nearest(modes, found)
        if same is None:
            return None
        parts.append(same)
    return parts


def _jackknife(parts: list[Modes], sensors: Sensors, shapes: str) -> Floats:
    """Return the covariance of vec P from estimates without a piece each."""
    values = [_estimate(each, sensors, shapes).normalized().ravel(order="F") for each in parts]
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


def _assumed(shapes: str) -> tuple[str, ...]:
    return (WHITE,) if shapes == "free" else (WHITE, REAL)


def _refused(sensors: Sensors, steady: tuple[int, Modes] | None) -> BlindFit:
    setting, n = sensors.setting, sensors.setting.n_dof
    modes = steady[1] if steady is not None else None
    count = 0 if modes is None else modes.n_modes
    refusal = Refusal(
        "R1" if count < n else "R2",
        f"Modes that stay from order to order: {count}; as many as sensors, {n}, are asked.",
        "Use a longer record, or filter to the band that holds as many modes as sensors.",
        {"steady_modes": count},
    )
    unknown = np.full((n, n), np.nan)
    none = modes_from(np.zeros(0, complex), np.zeros((n, 0), complex), setting)
    verdict = BlindVerdict(
        "ambient",
        {"normalized_stiffness": False, "normalized_damping": False, "normalized_force": False},
        (),
        {"steady_modes": count},
        (refusal,),
        sensors.findings,
        (WHITE,),
    )
    return blind_fit(setting, unknown, unknown, none if modes is None else modes, verdict)


def _answer(
    sensors: Sensors,
    estimate: _Estimate,
    P: Floats,
    covariance: Floats | None,
    mass: ArrayLike | None,
    diagnostics: Diagnostics,
    shapes: str,
) -> BlindFit:
    n = len(P)
    known = _lost(P) if covariance is None else refusals.of_deviations(P, covariance)
    checks, refused = refusals.together(refusals.of_stiffness(P), known)
    damping = checks.get("damping_deviation", np.inf) <= refusals.DAMPING
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
        sensors.findings,
        _assumed(shapes),
    )
    return blind_fit(
        sensors.setting,
        P[:, :n],
        P[:, n:] if damping else np.full((n, n), np.nan),
        modes_from(estimate.poles, estimate.shapes, sensors.setting),
        verdict,
        covariance=covariance,
        mass=mass,
        diagnostics=diagnostics,
    )


def _lost(P: Floats) -> refusals.Judged:
    """R6 where a mode is lost with a piece of the record."""
    sentence = (
        f"A mode is lost when one of {PIECES} pieces of the record is left out, so that no "
        "deviation of M⁻¹K can be told."
    )
    return {}, [Refusal("R6", sentence, "Use a longer record.", {"pieces": PIECES})]
