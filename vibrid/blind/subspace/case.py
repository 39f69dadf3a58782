"""What the steps from poles to an answer share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from numpy.typing import ArrayLike

from ...record import Floats, Record
from ..sensors import Sensors
from .division import Division
from .poles import FreePoles


@dataclass(frozen=True, eq=False)
class Case:
    """A record with its poles found and divided, and what is asked of it.

    Attributes
    ----------
    record : Record
    sensors : Sensors
    found : FreePoles
    division : Division
    again : tuple of FreePoles
        From other parts or at other horizons, to see whether poles stay.
    hold : "band_limited", "zoh" or "foh"
    mass : array or None
        As of `blind_subspace`.
    part : slice or None
        Rows that the force's amplitudes are fitted to; None for all.
    limited : bool
        Whether the force's band told the division: its lines are many, and depend on each other.
    """

    record: Record
    sensors: Sensors
    found: FreePoles
    division: Division
    again: tuple[FreePoles, ...]
    hold: str = "band_limited"
    mass: ArrayLike | None = None
    part: slice | None = None
    limited: bool = False

    @cached_property
    def outputs(self) -> Floats:
        """In SI, in the direction of their DOFs (n_samples, n_dof)."""
        return self.sensors.outputs(self.record)

    @property
    def n_dof(self) -> int:
        return self.sensors.setting.n_dof

    @property
    def kind(self) -> str:
        """The excitation that the answer rests on."""
        if self.limited:
            return "out_of_band"
        return "periodic" if len(self.division.input_hz) else "decay"
