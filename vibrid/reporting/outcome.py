"""Outcome: everything that one identification has to say, before it becomes text or JSON."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..files.survey import Survey
from ..fit import Finding, Fit
from ..identification import Assessment
from ..methods import METHODS
from ..modes import Modes, modes_of
from ..record import Floats, FrequencyResponses, Record

WORSE_UNSEEN = 10.0  # points of fit: beyond, the unseen part is not explained as well
WEAK_UNSEEN = 0.2  # of the standard deviation before: noise decides over such a part
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
        return method_name(self.fit)

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The findings of the fit, and what the scores say about it."""
        more = () if self.unseen_finding is None else (self.unseen_finding,)
        return (*self.fit.diagnostics.findings, *more)

    @cached_property
    def unseen_finding(self) -> Finding | None:
        """Why the unseen part fits much worse than the seen one; None where it does not."""
        if self.seen is None or self.unseen is None:
            return None
        worse = float(self.seen.fit_percent.mean() - self.unseen.fit_percent.mean())
        if not worse > WORSE_UNSEEN:
            return None
        strength = self._unseen_strength(self.unseen)
        if strength < WEAK_UNSEEN:
            return Finding(
                "weak-unseen",
                "note",
                f"The unseen part fits {worse:.0f} points worse, but it moves only "
                f"{100 * strength:.2g} % as strongly as the part before it: noise and small errors "
                "weigh more.",
                "Judge the model by a stretch that moves.",
            )
        return Finding(
            "worse-unseen",
            "doubt",
            f"The unseen part fits {worse:.0f} points worse: the model is overfitted or the "
            "structure behaves differently there.",
            "Try a lower --order, a --band, or another stretch.",
        )

    def _unseen_strength(self, unseen: Assessment) -> float:
        """Return the standard deviation in the unseen part over that before, median of outputs.

        NaN where the unseen part does not belong to the record.
        """
        cut, end = (round(t / self.record.dt) for t in (unseen.start, unseen.stop))
        if end > self.record.n_samples or cut < 2:
            return float("nan")
        before = np.nanstd(self.record.outputs[:cut], axis=0)
        after = np.nanstd(self.record.outputs[cut:end], axis=0)
        return float(np.median(after / np.where(before > 0, before, np.nan)))

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


@dataclass(frozen=True, eq=False)
class ResponsesOutcome:
    """One identification from frequency responses: what was read and found."""

    source: FrequencyResponses
    name: str
    method_reason: str
    fit: Fit
    saved: Path | None = None


def method_name(fit: Fit) -> str:
    """Return the name of a fit's method on the command line."""
    return next(name for name, kind in METHODS.items() if type(fit.method) is kind)
