"""Models as good as the data allow, from a start: by simulation or by prediction errors."""

from .elimination import Elimination, eliminate, held_out_curve
from .innovations import refine_innovations
from .output_error import Search, refine_output_error

__all__ = [
    "Elimination",
    "Search",
    "eliminate",
    "held_out_curve",
    "refine_innovations",
    "refine_output_error",
]
