"""Structures with exact answers, and their exact simulation."""

from .builders import chain, shear_frame
from .structure import Structure

__all__ = ["Structure", "chain", "shear_frame"]
