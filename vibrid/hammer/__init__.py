"""Hammer tests: hits in a record, segments, windows and their correction, averaged responses."""

from .averaging import hammer_responses
from .hits import Hit, Hits, find_hits
from .segments import hit_segments
from .windows import exponential_window, force_window, undo_exponential_window

__all__ = [
    "Hit",
    "Hits",
    "exponential_window",
    "find_hits",
    "force_window",
    "hammer_responses",
    "hit_segments",
    "undo_exponential_window",
]
