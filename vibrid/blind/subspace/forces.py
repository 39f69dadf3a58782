"""The forces behind the steady part of a record, and how well they are known."""

from __future__ import annotations

import numpy as np

from ...modes import Complexes
from ...record import Floats
from ..coordinates import force_history, periodic_force
from ..forces import PeriodicForce, phasor_deviations
from .case import Case
from .division import Amplitudes


def periodic_forces(
    case: Case, fitted: Amplitudes, P: Floats, covariance: Floats | None
) -> PeriodicForce:
    """Return the forces of sensor phasors, P = [𝒦 𝒟].

    Their errors come from noise and from [𝒦 𝒟], from noise alone without a covariance of these.
    """
    setting, powers, hertz = case.sensors.setting, case.sensors.powers, case.division.input_hz
    K, D = P[:, : setting.n_dof], P[:, setting.n_dof :]

    def made_of(columns: Complexes) -> tuple[Complexes, Floats]:
        phasors = periodic_force(K, D, powers, hertz, columns, dt=setting.dt, hold=case.hold)
        return phasors, force_history(phasors, hertz, setting.n_samples, setting.dt)

    phasors, history = made_of(fitted.inputs)
    squares = np.mean([np.mean(made_of(draw)[1] ** 2, axis=0) for draw in fitted.noise], axis=0)
    if covariance is not None:
        rates, quiet = 2 * np.pi * hertz, np.zeros(setting.n_dof)
        off = phasor_deviations(
            P,
            covariance,
            fitted.inputs,
            rates,
            powers,
            quiet,
            1,
            dt=setting.dt,
            hold=case.hold,
        )
        squares = squares + (off**2).sum(axis=1) / 2
    return PeriodicForce(phasors, history, np.sqrt(squares))
