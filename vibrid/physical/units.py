"""Factors that turn the units of channels into SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..errors import OptionError
from ..record import Channel, Floats

GRAVITY = 9.80665  # standard gravity [m/s²]

_LENGTHS = {
    **{"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9},
    **{"in": 0.0254, "ft": 0.3048},
}
_PER_SECOND = ("/s",)
_PER_SECOND_SQUARED = ("/s2", "/s^2", "/s²", "/s**2")
_FORCES = {
    **{"N": 1.0, "mN": 1e-3, "kN": 1e3, "MN": 1e6},
    **{"lbf": 4.4482216152605, "kgf": GRAVITY},
}
_ACCELERATIONS = {
    **{name + end: size for name, size in _LENGTHS.items() for end in _PER_SECOND_SQUARED},
    **{"g": GRAVITY, "mg": 1e-3 * GRAVITY, "Gal": 1e-2, "gal": 1e-2},
}
_FACTORS = {
    "displacement": _LENGTHS,
    "velocity": {name + end: size for name, size in _LENGTHS.items() for end in _PER_SECOND},
    "acceleration": _ACCELERATIONS,
    "base_acceleration": _ACCELERATIONS,
    "force": _FORCES,
}


def si_factors(channels: Sequence[Channel]) -> tuple[Floats, str]:
    """Return what multiplies each channel into SI, and "SI" or "consistent units".

    Where no channel has a unit, all factors are 1: the data are taken to be in consistent
    units (the matrices are then in units that follow from the data's).

    Raises
    ------
    OptionError
        Some channels have a known unit and others none or an unknown one.

    Examples
    --------
    >>> si_factors([Channel("a", "acceleration", "g"), Channel("f", "force", "kN")])
    (array([   9.80665, 1000.     ]), 'SI')
    """
    if not any(channel.unit for channel in channels):
        return np.ones(len(channels)), "consistent units"
    return np.array([_factor(channel) for channel in channels]), "SI"


def _factor(channel: Channel) -> float:
    known = _FACTORS[channel.quantity]
    if channel.unit not in known:
        unit = f"the unit {channel.unit!r}" if channel.unit else "no unit"
        raise OptionError(
            f"Channel {channel.name!r} ({channel.quantity}) has {unit}, and others have units: "
            f"masses cannot be told. Give it one of {_shown(known)}, or no channel a unit."
        )
    return known[channel.unit]


def _shown(known: Mapping[str, float]) -> str:
    """Return the units without the other ways to write them."""
    return ", ".join(
        unit for unit in known if unit.isascii() and "^" not in unit and "*" not in unit
    )
