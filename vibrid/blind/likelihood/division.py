"""Which oscillations are the structure's, and whether its shapes are real."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ...linalg import one_blas_thread
from ...record import Floats
from .components import Mask
from .place import Place
from .search import COARSE, LONG, SECOND_START, settle

RIVALS = 2  # modes with the least, and forces with the greatest decay, that change places
CONFIDENCE = 0.99  # of the likelihood-ratio test for real shapes


@dataclass(frozen=True, eq=False)
class Division:
    """The best division of the oscillations into modes and forces.

    Attributes
    ----------
    place : Place
        Refitted, the forces' oscillations undamped.
    modes : array of bool (k,)
        Which oscillations are modes of the structure.
    certainty : array (k,)
        σ over its standard deviation, before anything was divided, descending.
    lead : float
        Log-likelihood above that of the next division; infinite where there is none.
    """

    place: Place
    modes: Mask
    certainty: Floats
    lead: float


def divide(place: Place, n_modes: int, *, swaps: bool = True) -> Division:
    """Take the oscillations that surely decay as modes; try what the next ones give instead.

    Without `swaps` nothing else is tried: where the record is refused anyway.
    """
    with one_blas_thread():
        z = certainty(place)
        order = np.argsort(-z, kind="stable")
        first = np.isin(np.arange(len(z)), order[:n_modes])
        others = _swaps(order, n_modes) if swaps else ()
        tried = [_refitted(place, modes) for modes in (first, *others)]
        ranked = sorted(tried, key=lambda each: each[0].cost)
        lead = 0.5 * (ranked[1][0].cost - ranked[0][0].cost) if len(ranked) > 1 else np.inf
        best, modes = ranked[0]
        return Division(settle(best), modes, z[order], float(lead))


def certainty(place: Place) -> Floats:
    """Return σ over its standard deviation for each oscillation."""
    k = len(place.components)
    deviations = np.sqrt(np.diag(place.covariance))[k : 2 * k] / place.signals.duration
    return np.asarray(place.components.decays / np.where(deviations > 0, deviations, np.inf))


def _swaps(order: np.ndarray[tuple[int], np.dtype[np.intp]], n_modes: int) -> Iterator[Mask]:
    """Yield divisions in which a weak mode and a strong force change places."""
    for weak in order[max(n_modes - RIVALS, 0) : n_modes]:
        for strong in order[n_modes : n_modes + RIVALS]:
            modes = np.isin(np.arange(len(order)), order[:n_modes])
            modes[[weak, strong]] = False, True
            yield modes


def _refitted(place: Place, modes: Mask) -> tuple[Place, Mask]:
    held = place.components.held(modes, SECOND_START / place.signals.duration)
    trial = Place(held, place.signals)
    return settle(trial, largest=LONG, negligible=COARSE), modes


@dataclass(frozen=True, eq=False)
class Shapes:
    """Whether the structure's shapes are real, by likelihood ratio.

    Attributes
    ----------
    ratio : float
        2 (log L of free shapes − log L of real ones).
    limit : float
        99 % of χ² with as many degrees of freedom as real shapes take away.
    place : Place
        With real shapes.
    """

    ratio: float
    limit: float
    place: Place


def real_shapes(division: Division) -> Shapes:
    """Fit one phase for all channels of each mode, as proportional damping has it."""
    from scipy.stats import chi2  # slow to import, and used only here

    place, modes = division.place, division.modes
    n_records, n = len(place.signals.samples), place.signals.n_channels
    phases = np.zeros((n_records, len(modes)))
    for record, v in enumerate(place.variances):
        c = place.shapes(record)
        phases[record, modes] = 0.5 * np.angle(np.sum(c**2 / v[:, None], axis=0))[modes]
    start = replace(place.components, real=modes, phases=phases)
    with one_blas_thread():
        found = settle(Place(start, place.signals))
    freedom = n_records * int(modes.sum()) * (n - 1)
    limit = float(chi2.ppf(CONFIDENCE, freedom)) if freedom else 0.0
    return Shapes(found.cost - place.cost, limit, found)
