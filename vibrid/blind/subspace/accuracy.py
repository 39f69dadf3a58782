"""How far the answer of the subspace method is from the truth: noise, and the method itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...record import Floats
from ..coordinates import Powers
from ..likelihood.components import Components, Signals
from ..likelihood.modal import modal_estimate
from ..likelihood.place import Place
from .division import Division


@dataclass(frozen=True, eq=False)
class Accuracy:
    """Deviations of poles and matrices.

    Attributes
    ----------
    frequencies_std : array (n_modes,)
        [Hz]
    damping_std : array (n_modes,)
        Of damping ratios.
    covariance : array (2 n_dof², 2 n_dof²)
        Of vec [𝒦 𝒟], columns stacked.
    """

    frequencies_std: Floats
    damping_std: Floats
    covariance: Floats


def accuracy(outputs: Floats, dt: float, division: Division, powers: Powers) -> Accuracy:
    """Return the Cramér-Rao bounds and, squared and added, the distance to the likeliest poles.

    The bound alone would say too little: a horizon much shorter than the record leaves poles,
    where sines are near them, tens of times as far off as noise allows. One step of scoring
    towards the greatest likelihood measures that.
    """
    rates = np.concatenate([division.structure.imag, 2 * np.pi * division.found_hz])
    modes = np.arange(len(rates)) < len(division.structure)
    decays = np.zeros(len(rates))
    decays[modes] = -division.structure.real
    free = Components(rates, decays, modes, np.zeros_like(modes), np.zeros((1, len(rates))))
    here = Place(free, Signals((outputs,), dt, 2 * np.pi * division.given_hz))
    there = here.moved(-here.covariance @ here.gradient)
    bound, likelier = (modal_estimate(place, modes, powers) for place in (here, there))
    (P, covariance), (better, _) = bound.normalized(), likelier.normalized()
    moved = (better - P).ravel(order="F")
    ratios = [-poles.real / np.abs(poles) for poles in (bound.poles, likelier.poles)]
    hertz = (np.abs(likelier.poles) - np.abs(bound.poles)) / (2 * np.pi)
    return Accuracy(
        np.hypot(bound.deviations[0], hertz),
        np.hypot(bound.deviations[1], ratios[1] - ratios[0]),
        covariance + np.outer(moved, moved),
    )
