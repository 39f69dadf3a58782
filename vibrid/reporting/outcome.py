"""Outcome: everything that one identification has to say, before it becomes text or JSON."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..files.survey import Survey
from ..fit import Fit
from ..identification import Assessment
from ..methods import METHODS
from ..modes import Modes, modes_of
from ..record import Floats, Record

STEADY_SHARE = 0.5  # of the orders: a mode seen in fewer is marked as doubtful

Band = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Reference:
    """True or published modes to compare with; damping may be unknown.

    Attributes
    ----------
    source : str
        "published" or "true".
    frequencies_hz : array (n,)
    damping_ratios : array (n,) or None
    limit : float
        Largest relative error of a frequency that counts as found.
    """

    source: str
    frequencies_hz: Floats
    damping_ratios: Floats | None = None
    limit: float = 0.01


@dataclass(frozen=True, eq=False)
class Outcome:
    """One identification: what was read, chosen and found.

    Attributes
    ----------
    source, record : Record
        As read, and as identified (in the band).
    survey : Survey
        Of the record as read.
    band : (low, high) [Hz] or None
    band_reason, method_reason : str
    fit : Fit
    seen, unseen : Assessment or None
        On the record itself and on a part that was not used; None where too short.
    unseen_part : str
        What the unseen part is, in words.
    saved : Path or None
    reference : Reference or None
    """

    source: Record
    record: Record
    survey: Survey
    band: Band | None
    band_reason: str
    method_reason: str
    fit: Fit
    seen: Assessment | None
    unseen: Assessment | None
    unseen_part: str = ""
    saved: Path | None = None
    reference: Reference | None = None

    @cached_property
    def modes(self) -> Modes:
        """All modes of the model, frequencies ascending."""
        return modes_of(self.fit)

    @cached_property
    def persistence(self) -> Floats | None:
        """Share of the orders tried that each mode appears in; None for an order asked for."""
        share = self.fit.diagnostics.figures.get("persistence")
        return None if share is None else np.asarray(share)

    @cached_property
    def listed(self) -> tuple[int, ...]:
        """The modes within the band; all without one."""
        low, high = self.band or (0.0, np.inf)
        inside = (self.modes.frequencies_hz >= low) & (self.modes.frequencies_hz <= high)
        return tuple(int(k) for k in np.flatnonzero(inside))

    @property
    def method_name(self) -> str:
        """The method's name on the command line."""
        return next(name for name, kind in METHODS.items() if type(self.fit.method) is kind)

    def is_steady(self, mode: int) -> bool:
        """Return whether a mode appears in at least half of the orders (or nobody looked)."""
        return self.persistence is None or bool(self.persistence[mode] >= STEADY_SHARE)

    @cached_property
    def reference_pairs(self) -> tuple[int | None, ...]:
        """The steady mode nearest to each reference frequency; None where there is none."""
        steady = np.array([k for k in self.listed if self.is_steady(k)], dtype=int)
        if self.reference is None or not len(steady):
            return (None,) * (0 if self.reference is None else len(self.reference.frequencies_hz))
        f = self.modes.frequencies_hz[steady]
        wanted = self.reference.frequencies_hz
        return tuple(int(steady[np.argmin(np.abs(f - each))]) for each in wanted)

    @property
    def is_reference_found(self) -> bool:
        """Whether every reference frequency has a mode within the limit."""
        if self.reference is None:
            return True
        f, limit = self.modes.frequencies_hz, self.reference.limit
        return all(
            mode is not None and abs(f[mode] / each - 1) <= limit
            for mode, each in zip(self.reference_pairs, self.reference.frequencies_hz, strict=True)
        )
