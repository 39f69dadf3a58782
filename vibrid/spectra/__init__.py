"""Spectra, frequency responses, correlations, and impulse responses from frequency responses."""

from .correlations import next_correlations
from .inversion import Inversion, Remark, impulse_responses, invert, undo_wrap
from .power import power_spectrum
from .responses import averaged_responses, check_estimator, frequency_responses

__all__ = [
    "Inversion",
    "Remark",
    "averaged_responses",
    "check_estimator",
    "frequency_responses",
    "impulse_responses",
    "invert",
    "next_correlations",
    "power_spectrum",
    "undo_wrap",
]
