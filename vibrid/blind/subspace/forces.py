"""The forces behind the steady part of a record, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...modes import Complexes
from ...record import Floats
from ..coordinates import force_history, periodic_force
from ..forces import phasor_deviations
from .case import Case
from .division import Amplitudes

KNOWN = 0.5  # of a force's size: a larger error leaves nothing to be shown


@dataclass(frozen=True, eq=False)
class PeriodicForces:
    """Forces at lines, M⁻¹f.

    Attributes
    ----------
    phasors : complex array (n_dof, n_frequencies)
    history : array (n_samples, n_dof)
    deviations : array (n_dof,)
        Root mean square of the expected error: from noise and from [𝒦 𝒟], or from noise alone
        where nothing is known of [𝒦 𝒟].
    """

    phasors: Complexes
    history: Floats
    deviations: Floats

    @property
    def known(self) -> bool:
        """Whether the errors are smaller than the forces; no force at all is known too."""
        size = np.sqrt(np.mean(self.history**2, axis=0)).max()
        return not self.phasors.size or bool((self.deviations < KNOWN * size).all())


def periodic_forces(
    case: Case, fitted: Amplitudes, P: Floats, covariance: Floats | None
) -> PeriodicForces:
    """Return the forces of sensor phasors, P = [𝒦 𝒟]."""
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
    return PeriodicForces(phasors, history, np.sqrt(squares))
