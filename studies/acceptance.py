"""Lines of a table of acceptance: what was asked, what was measured, and whether that is enough."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from studies.rows import Cell, Row, Rows

Hit = str | Callable[[Row], object]
CONFIDENCE = 0.95
HEAD = "| test | what | limit | measured | runs | 95 % band | met |\n|" + "---|" * 7 + "\n"


class Runs(NamedTuple):
    """The rows of a cell that are there, and how many were asked for."""

    rows: list[Row]
    asked: int

    @classmethod
    def of(cls, chosen: Sequence[Cell], done: Rows, like: Cell) -> Runs:
        """Return the first runs of the cell that is chosen, as many as `like` has at most."""
        asked = max(cell.runs for cell in chosen if cell[:2] == like[:2])
        cell = like._replace(runs=min(asked, like.runs))
        return cls(cell.rows(done), like.runs)

    def values(self, name: str) -> list[float]:
        """Return a figure of all runs, infinite where a run has none."""
        found = [float(row.get(name, np.nan)) for row in self.rows]
        return [value if np.isfinite(value) else np.inf for value in found]

    def count(self, hit: Hit) -> int:
        """Return how many runs have a figure that is true, or are a hit."""
        if isinstance(hit, str):
            return sum(bool(row.get(hit)) for row in self.rows)
        return sum(bool(hit(row)) for row in self.rows)

    def where(self, name: str) -> Runs:
        """Return the runs in which a figure is true."""
        kept = [row for row in self.rows if row.get(name)]
        return Runs(kept, self.asked - len(self.rows) + len(kept))

    def __str__(self) -> str:
        done = len(self.rows)
        return str(done) if done == self.asked else f"{done} of {self.asked}"


class Line(NamedTuple):
    """One line; `met` is None where nothing is asked or nothing was run."""

    test: str
    what: str
    limit: str
    measured: str
    runs: Runs
    band: str
    met: bool | None

    def __str__(self) -> str:
        verdict = "–" if self.met is None else "yes" if self.met else "**no**"
        if self.met is not None and len(self.runs.rows) < self.runs.asked:
            verdict += ", so far"
        return f"| {' | '.join(map(str, [*self[:6], verdict]))} |\n"


def median_line(test: str, what: str, runs: Runs, name: str, limit: float) -> Line:
    """Ask that the median of a figure is at most the limit; the worst is told beside it."""
    if not runs.rows:
        return Line(test, what, f"≤ {limit:g}", "–", runs, "–", None)
    values = runs.values(name)
    median = float(np.median(values))
    shown = f"{median:.2g} (worst {max(values):.2g})"
    return Line(test, what, f"≤ {limit:g}", shown, runs, "–", median <= limit)


def range_line(test: str, what: str, runs: Runs, value: float, limits: tuple[float, float]) -> Line:
    """Ask that a figure of all runs lies within limits."""
    limit = f"{limits[0]:g} to {limits[1]:g}"
    if not runs.rows:
        return Line(test, what, limit, "–", runs, "–", None)
    return Line(test, what, limit, f"{value:.2f}", runs, "–", limits[0] <= value <= limits[1])


def share_line(
    test: str,
    what: str,
    runs: Runs,
    hit: Hit,
    *,
    least: float | None = None,
    most: float | None = None,
) -> Line:
    """Ask for a share of the runs, at least or at most; its binomial band is told."""
    hits, n = runs.count(hit), len(runs.rows)
    limit = "–" if least is None else f"≥ {100 * least:.3g} %"
    limit = limit if most is None else f"≤ {100 * most:.3g} %"
    if not n:
        return Line(test, what, limit, "–", runs, "–", None)
    share, (low, high) = hits / n, binomial_band(hits, n)
    met = None
    if least is not None or most is not None:
        met = (least or 0.0) - 1e-9 <= share <= (1.0 if most is None else most) + 1e-9
    return Line(
        test, what, limit, f"{hits} of {n}", runs, f"{100 * low:.0f} to {100 * high:.0f} %", met
    )


def binomial_band(hits: int, n: int) -> tuple[float, float]:
    """Return the shares that hits of n leave likely (Clopper & Pearson 1934).

    Examples
    --------
    >>> [round(each, 4) for each in binomial_band(20, 20)]
    [0.8316, 1.0]
    """
    from scipy.stats import beta

    tail = (1 - CONFIDENCE) / 2
    low = float(beta.ppf(tail, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(1 - tail, hits + 1, n - hits)) if hits < n else 1.0
    return low, high
