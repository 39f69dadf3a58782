"""Blind identification: matrices in physical coordinates, and forces that were not measured."""

from .choice import identify_blind
from .finite_signal import blind_finite_signal
from .input_estimation import estimate_input
from .likelihood import blind_likelihood
from .point import blind_rows
from .result import BlindFit, BlindVerdict, Refusal
from .subspace import blind_subspace

__all__ = [
    "BlindFit",
    "BlindVerdict",
    "Refusal",
    "blind_finite_signal",
    "blind_likelihood",
    "blind_rows",
    "blind_subspace",
    "estimate_input",
    "identify_blind",
]
