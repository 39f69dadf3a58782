"""Signals as outputs of autonomous systems, and structures augmented with them."""

from .augmented import Observability, augmented_model, augmented_observability
from .jordan import RealJordan, real_jordan_form
from .signals import finite_signal, harmonics, periodic_signal, phasor_signal, signal_basis

__all__ = [
    "Observability",
    "RealJordan",
    "augmented_model",
    "augmented_observability",
    "finite_signal",
    "harmonics",
    "periodic_signal",
    "phasor_signal",
    "real_jordan_form",
    "signal_basis",
]
