"""blind_likelihood(): 𝒦, 𝒟 and periodic forces by maximum likelihood."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ...errors import check_choice
from ...modes import Complexes
from ...physical import Topology
from ...record import Floats, Record
from ...statespace import HOLDS
from .. import refusals
from ..coordinates import force_history, periodic_force
from ..forces import PeriodicForce, phasor_deviations
from ..result import BlindFit, BlindVerdict, blind_fit, modes_from
from ..sensors import Sensors
from .data import most_oscillations, signals_of
from .division import divide
from .found import Found, found_in
from .judged import (
    CURES,
    assumed_in,
    diagnostics_of,
    findings_of,
    hidden_sines,
    judge,
    refused,
    unexplained,
)
from .modal import modal_estimate
from .search import Progress, grow

SHAPES = ("auto", "free", "real")


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
    check_choice("shapes", shapes, SHAPES)
    check_choice("hold", hold, HOLDS)
    sensors, signals = signals_of(data, n_dof, input_frequencies_hz)
    topology = None if structure is None else Topology.of(structure)
    growth = grow(signals, most_oscillations(signals), progress)
    if not growth.explained:
        return unexplained(sensors, growth.place)
    division = divide(growth.place, n_dof)
    sure = refusals.of_certainty(division.certainty, n_dof)
    if int(division.modes.sum()) < n_dof:
        return refused(sensors, *refusals.together(sure))
    free = modal_estimate(division.place, division.modes, sensors.powers)
    coinciding = refusals.of_condition(free.condition())
    if coinciding[1]:
        return refused(sensors, *refusals.together(sure, coinciding))
    found = found_in(division, free, sensors.powers, shapes, topology, mass)
    return answer(sensors, found, hold, mass)


def answer(sensors: Sensors, found: Found, hold: str, mass: ArrayLike | None) -> BlindFit:
    """Return the judged result."""
    setting, n = sensors.setting, sensors.setting.n_dof
    checks, broken = judge(found)
    rates, columns = found.steady()
    force = None if broken else _force(sensors, found, rates, columns, hold)
    force = force if force is not None and force.known else None
    damping = checks["damping_deviation"] <= refusals.DAMPING
    determined = {
        "normalized_stiffness": True,
        "normalized_damping": damping,
        "normalized_force": force is not None,
    }
    findings = [*sensors.findings, *findings_of(found, damping)]
    if force is not None and len(rates):
        findings += hidden_sines(found, sensors.powers, force.history)
    verdict = BlindVerdict(
        "periodic" if len(rates) else "decay",
        determined,
        tuple(cure for name, cure in CURES.items() if not determined[name]),
        checks,
        broken,
        tuple(findings),
        assumed_in(found),
    )
    poles, shapes, deviations = found.modes
    return blind_fit(
        setting,
        found.P[:, :n],
        found.P[:, n:] if damping else np.full((n, n), np.nan),
        modes_from(
            poles, shapes, setting, frequencies_std=deviations[0], damping_std=deviations[1]
        ),
        verdict,
        covariance=found.covariance,
        force=None if force is None else force.history,
        force_std=None if force is None else force.deviations,
        phasors=np.full_like(columns, np.nan) if force is None else force.phasors,
        input_frequencies_hz=rates / (2 * np.pi),
        mass=mass,
        diagnostics=diagnostics_of(found),
    )


def _force(
    sensors: Sensors, found: Found, rates: Floats, columns: Complexes, hold: str
) -> PeriodicForce:
    """Return the force behind the sensors' phasors in each record."""
    place, powers, dt = found.place, sensors.powers, sensors.setting.dt
    n, hertz, signals = len(powers), rates / (2 * np.pi), found.place.signals
    K, D = found.P[:, :n], found.P[:, n:]
    phasors = [periodic_force(K, D, powers, hertz, c, dt=dt, hold=hold) for c in columns]
    pairs = list(zip(phasors, signals.lengths, strict=True))
    variance = np.zeros(n)
    for record, (c, length) in enumerate(zip(columns, signals.lengths, strict=True)):
        off = phasor_deviations(
            found.P,
            found.covariance,
            c,
            rates,
            powers,
            place.noise(record),
            length,
            dt=dt,
            hold=hold,
        )
        variance += 0.5 * length / signals.count * (off**2).sum(axis=1)
    history = np.vstack([force_history(p, hertz, length, dt) for p, length in pairs])
    return PeriodicForce(np.array(phasors), history, np.sqrt(variance))
