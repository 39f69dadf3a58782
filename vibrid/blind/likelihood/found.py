"""What the signals alone say of a structure, before anything is judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ...errors import OptionError
from ...modes import Complexes
from ...physical import Topology
from ...record import Floats
from ..closure import whole_mass
from ..coordinates import Powers
from .division import Division
from .modal import ModalEstimate, swinging
from .place import Place
from .real_shapes import RealShapes, real_shapes
from .structure import Constrained, constrain


@dataclass(frozen=True, eq=False)
class Found:
    """[𝒦 𝒟] of a division into modes and forces.

    Attributes
    ----------
    division : Division
    tested : RealShapes or None
        The fit of real shapes, where one was tried.
    real : bool
        Whether the answer rests on it.
    estimate : ModalEstimate
        Poles and shapes of the signals, of real shapes where these were taken.
    P : array (n, 2 n)
        [𝒦 𝒟], of the structure asked for.
    covariance : array (2 n², 2 n²)
        Of its columns stacked.
    constrained : Constrained or None
    """

    division: Division
    tested: RealShapes | None
    real: bool
    estimate: ModalEstimate
    P: Floats
    covariance: Floats
    constrained: Constrained | None

    @property
    def taken(self) -> RealShapes | None:
        """The real shapes that the answer rests on, if it does."""
        return self.tested if self.real else None

    @property
    def place(self) -> Place:
        """The fit that the answer rests on."""
        return self.division.place if self.taken is None else self.taken.place

    @property
    def modes(self) -> tuple[Complexes, Complexes, tuple[Floats, Floats]]:
        """Poles, shapes, and deviations of frequencies and damping ratios, as P has them."""
        if self.constrained is None:
            return self.estimate.poles, self.estimate.shapes, self.estimate.deviations
        return swinging(self.P, self.covariance)

    def steady(self) -> tuple[Floats, Complexes]:
        """Return ω of the force, ascending, and the sensors' phasors (n_records, n, n_ω)."""
        place, sines = self.place, ~(self.division.modes | self.division.drifting)
        rates = np.concatenate([place.components.frequencies[sines], place.signals.known])
        order = np.argsort(rates)
        phasors = [
            np.hstack([2 * place.shapes(r)[:, sines], place.known_shapes(r)])[:, order]
            for r in range(len(place.parts))
        ]
        return rates[order], np.array(phasors)


def found_in(
    division: Division,
    free: ModalEstimate,
    powers: Powers,
    shapes: str,
    topology: Topology | None = None,
    mass: ArrayLike | None = None,
) -> Found:
    """Return [𝒦 𝒟] of free shapes, as given, or of real ones, or the nearest of a topology.

    Raises
    ------
    OptionError
        Real shapes of sensors that measure different quantities, or with a topology.
    """
    alike = len(set(powers)) == 1
    if shapes == "real" and not alike:
        raise OptionError(
            "shapes='real' needs sensors of one quantity; the record mixes them. Use 'free'."
        )
    if shapes == "real" and topology is not None:
        raise OptionError("shapes='real' does not go with structure=; leave one of them out.")
    tested = None
    if shapes != "free" and alike and topology is None and len(powers) > 1:
        tested = real_shapes(division, free, powers)
    if tested is not None and (shapes == "real" or not tested.rejected):
        estimate = tested.estimate
        return Found(division, tested, True, estimate, *estimate.normalized(), None)
    P, V = free.normalized()
    if topology is None:
        return Found(division, tested, False, free, P, V, None)
    nearest = constrain(P, V, topology, whole_mass(mass, len(P)))
    return Found(division, tested, False, free, nearest.P, nearest.covariance, nearest)
