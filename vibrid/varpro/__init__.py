"""Separable least squares: a model's poles are searched, everything linear is eliminated."""

from .blocks import LARGEST_POLE, Blocks, split_poles
from .decays import Decays, decays
from .deviations import (
    derived_covariance,
    frequency_and_damping,
    mode_deviations,
    parameter_covariance,
    pole_covariance,
)
from .filters import BlockFilter
from .likelihood import SMALLEST_NOISE, Likely
from .marquardt import Descent, Progress, Projecting, descend
from .projection import Linear, Projected, Sums
from .removal import removals
from .signals import SignalSums

__all__ = [
    "LARGEST_POLE",
    "SMALLEST_NOISE",
    "BlockFilter",
    "Blocks",
    "Decays",
    "Descent",
    "Likely",
    "Linear",
    "Progress",
    "Projected",
    "Projecting",
    "SignalSums",
    "Sums",
    "decays",
    "derived_covariance",
    "descend",
    "frequency_and_damping",
    "mode_deviations",
    "parameter_covariance",
    "pole_covariance",
    "removals",
    "split_poles",
]
