"""Which oscillations are the structure's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...linalg import one_blas_thread
from ...record import Floats
from ..refusals import of_certainty
from .components import Mask
from .place import Place
from .search import COARSE, LONG, SECOND_START, settle

SLOWEST = 1.0  # cycles in the record; what swings less is a drift of the sensors
RIVALS = 2  # modes with the least, and forces with the greatest decay, that change places


@dataclass(frozen=True, eq=False)
class Division:
    """The best division of the oscillations into modes and forces.

    Attributes
    ----------
    place : Place
        Refitted, the forces' oscillations undamped.
    modes : array of bool (k,)
        Which oscillations are modes of the structure.
    drifting : array of bool (k,)
        Which are neither modes nor forces: too slow, with or without a decay.
    certainty : array (k,)
        σ over its standard deviation, before anything was divided, descending; drifts left out.
    lead : float
        Log-likelihood above that of the next division; infinite where there is none.
    """

    place: Place
    modes: Mask
    drifting: Mask
    certainty: Floats
    lead: float


def divide(place: Place, n_modes: int) -> Division:
    """Take the oscillations that surely decay as modes; try what the next ones give instead.

    Where more of them decay, or one grows, the record is refused and nothing else is tried.
    """
    with one_blas_thread():
        z, drifting = certainty(place), drifts(place)
        order = np.argsort(-z, kind="stable")
        order = order[~drifting[order]]
        first = np.isin(np.arange(len(z)), order[:n_modes])
        broken = {each.rule for each in of_certainty(z[order], n_modes)[1]}
        others = () if broken & {"R2", "R3"} else _swaps(order, n_modes, len(z))
        tried = [_refitted(place, modes, drifting) for modes in (first, *others)]
        ranked = sorted(tried, key=lambda each: each[0].cost)
        lead = 0.5 * (ranked[1][0].cost - ranked[0][0].cost) if len(ranked) > 1 else np.inf
        best, modes = settle(ranked[0][0]), ranked[0][1]
        drifting = (drifting | drifts(best)) & ~modes  # sines that only now became slow, too
        return Division(best, modes, drifting, z[order], float(lead))


def drifts(place: Place) -> Mask:
    """Tell which oscillations are too slow to be more than a drift of the sensors."""
    lowest = 2 * np.pi * SLOWEST / place.signals.duration
    return np.asarray(place.components.frequencies < lowest)


def certainty(place: Place) -> Floats:
    """Return σ over its standard deviation for each oscillation."""
    k = len(place.components)
    deviations = np.sqrt(np.diag(place.covariance))[k : 2 * k] / place.signals.duration
    return np.asarray(place.components.decays / np.where(deviations > 0, deviations, np.inf))


def _swaps(order: NDArray[np.intp], n_modes: int, count: int) -> Iterator[Mask]:
    """Yield divisions in which a weak mode and a strong force change places."""
    for weak in order[max(n_modes - RIVALS, 0) : n_modes]:
        for strong in order[n_modes : n_modes + RIVALS]:
            modes = np.isin(np.arange(count), order[:n_modes])
            modes[[weak, strong]] = False, True
            yield modes


def _refitted(place: Place, modes: Mask, drifting: Mask) -> tuple[Place, Mask]:
    held = place.components.held(modes | drifting, SECOND_START / place.signals.duration)
    trial = Place(held, place.signals)
    return settle(trial, largest=LONG, negligible=COARSE), modes
