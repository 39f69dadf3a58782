"""Whether the structure's shapes are real, and what the test of it could not have seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...linalg import one_blas_thread
from ...record import Floats
from ..coordinates import Powers
from ..refusals import relative_deviations
from .components import Components
from .division import Division
from .modal import ModalEstimate, modal_estimate
from .place import Place
from .search import settle

CONFIDENCE = 0.99  # of the likelihood-ratio test
POWER = 0.9  # probability with which it notices a departure


@dataclass(frozen=True, eq=False)
class RealShapes:
    """Shapes in phase, as proportional damping has them, and their likelihood-ratio test.

    Attributes
    ----------
    place : Place
        With real shapes.
    estimate : ModalEstimate
    ratio : float
        2 (log L of free shapes − log L of real ones).
    limit : float
        99 % of χ² with as many degrees of freedom as real shapes take away.
    free : array (n, 2 n)
        [𝒦 𝒟] of free shapes.
    free_deviation : float
        Of that 𝒟, relative to its size.
    hidden : float
        Largest change of 𝒟, relative to its size, that couples the modes and that the test
        might not notice (with a probability of 90 % it notices any larger one).
    """

    place: Place
    estimate: ModalEstimate
    ratio: float
    limit: float
    free: Floats
    free_deviation: float
    hidden: float

    @property
    def rejected(self) -> bool:
        return self.ratio > self.limit


def real_shapes(division: Division, free: ModalEstimate, powers: Powers) -> RealShapes:
    """Fit one phase for all channels of each mode; two or more sensors of one quantity."""
    from scipy.special import chndtrinc
    from scipy.stats import chi2  # slow to import, and used only here

    place, modes = division.place, division.modes
    n_records, n = len(place.signals.samples), place.signals.n_channels
    with one_blas_thread():
        found = settle(Place(_in_phase(division), place.signals))
    estimate = modal_estimate(found, modes, powers)
    P, covariance = free.normalized()
    freedom = n_records * int(modes.sum()) * (n - 1)
    limit = float(chi2.ppf(CONFIDENCE, freedom))
    spread = _coupling_spread(estimate.shapes.real, covariance[n * n :, n * n :])
    noticed = chndtrinc(limit, freedom, 1 - POWER)  # noncentrality of the test
    damping = estimate.normalized()[0][:, n:]
    return RealShapes(
        found,
        estimate,
        found.cost - place.cost,
        limit,
        P,
        relative_deviations(P, covariance)["damping_deviation"],
        float(np.sqrt(noticed) * spread / np.linalg.norm(damping)),
    )


def _in_phase(division: Division) -> Components:
    """Return the components with real shapes, each of the phase that fits it best."""
    place, modes = division.place, division.modes
    phases = np.zeros_like(place.components.phases)
    for record, v in enumerate(place.variances):
        c = place.shapes(record)
        phases[record, modes] = 0.5 * np.angle(np.sum(c**2 / v[:, None], axis=0))[modes]
    return replace(place.components, real=modes, phases=phases)


def _coupling_spread(shapes: Floats, covariance: Floats) -> float:
    """Return the largest deviation of 𝒟 in a direction that couples modes: Φ⁻¹ 𝒟 Φ off diagonal."""
    inverse = np.linalg.pinv(shapes)
    couples = 1 - np.eye(len(shapes)).ravel()
    keep = np.kron(inverse.T, shapes) @ (couples[:, None] * np.kron(shapes.T, inverse))
    return float(np.sqrt(np.linalg.eigvalsh(keep @ covariance @ keep.T)[-1]))
