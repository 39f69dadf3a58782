"""Modes of any model, how to compare them, and how far to trust them."""

from .matching import match_modes
from .quality import ModeQuality, mode_quality, quality_of
from .shapes import mac, mpc
from .values import DERIVATIVES, PAIRING_LIMIT, Complexes, Modes, modes_of

__all__ = [
    "DERIVATIVES",
    "PAIRING_LIMIT",
    "Complexes",
    "ModeQuality",
    "Modes",
    "mac",
    "match_modes",
    "mode_quality",
    "modes_of",
    "mpc",
    "quality_of",
]
