"""Blind identification over degrees of freedom, noise, knowledge and method.

Run `python -m studies.blind`; it goes on where it stopped: every run is a line of the rows file,
and the page is written from all lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from studies.blind_runs import grid_run
from studies.rows import PAGES, Cell, Row, Rows, study

DOFS = range(3, 9)
NOISES = (60, 50, 40, 30, 20, 10)
RUNS = 20
WAYS = (("ml", False), ("ml", True), ("subspace", False), ("subspace", True))


def middle(values: Sequence[float]) -> float:
    """Return the median; NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def cells(runs: int | None) -> list[Cell]:
    """Return all cells of the grid."""
    return [
        Cell(grid_run, (n, snr, *way), RUNS if runs is None else runs)
        for n in DOFS
        for snr in NOISES
        for way in WAYS
    ]


HEAD = """# Blind identification: noise and degrees of freedom

Chains of unit masses, first frequency 1 Hz, 1 to 2 % proportional damping, 60 s at 100 Hz from
rest, n + 2 unknown sines on every DOF; a run has the same draws at every noise and in every way.
Relative errors ‖X̂ − X‖ / ‖X‖ (Frobenius) of M⁻¹K and M⁻¹D, medians over the runs whose poles are
right (all frequencies within 2 %); *bound* is the median Cramér-Rao bound of the same draws (root
mean square; of real shapes for maximum likelihood, of free ones for the subspace method), so an
error a little below it is as it should be. Answers that the rules refuse, and M⁻¹D left out as
undetermined, count with their candidates; *accepted* says how many the rules let pass; *s* are
median seconds of one core.

Tests with limits, and excitations that are refused: [blind_acceptance.md](blind_acceptance.md).
Written by `python -m studies.blind`, which goes on where it stopped; run counts are in the tables.
"""


def page(chosen: Sequence[Cell], done: Rows) -> str:
    return HEAD + "".join(_tables(chosen, done)) + ANSWERS


def _tables(chosen: Sequence[Cell], done: Rows) -> Iterator[str]:
    head = "| n | SNR dB | M⁻¹K | bound | M⁻¹D | bound | right poles | accepted | runs | s |\n"
    for method, known in WAYS:
        name = "Maximum likelihood" if method == "ml" else "Subspace"
        yield f"\n## {name}, {'known' if known else 'unknown'} frequencies\n\n{head}"
        yield "|" + "---:|" * 10 + "\n"
        for cell in chosen:
            if cell.arguments[2:] == (method, known):
                n, snr = cell.arguments[:2]
                yield f"| {n} | {snr} | {_line(cell.rows(done))} |\n"


def _line(runs: list[Row]) -> str:
    right = [row for row in runs if row.get("right")]
    names = ("stiffness", "stiffness_bound", "damping", "damping_bound")
    values = [_median(right, name) for name in names]
    counts = [len(right), sum(row["accepted"] for row in runs), len(runs)]
    return " | ".join([*values, *map(str, counts), _median(runs, "fit_seconds")])


def _median(runs: list[Row], name: str) -> str:
    values = [row[name] for row in runs if name in row]
    return f"{middle(values):.2g}" if values else "–"


ANSWERS = """
## What is answered and what is refused

| excitation | answered | refused |
|---|---|---|
| periodic, forces measured | M⁻¹K, M⁻¹D, M⁻¹B | no transient and too few frequencies |
| periodic, frequencies known or not | M⁻¹K, M⁻¹D, force | R1 to R7 |
| free decay, or `force_free=` | M⁻¹K, M⁻¹D | R1 to R7 |
| any force at some DOFs (`point`) | free rows, where the forces act | no free row |
| base motion not measured (`base`) | storeys above the first | k₁, always |
| ambient, as the user says (`ambient`) | M⁻¹K, M⁻¹D | R1, R2, R6, R7 |
| on every DOF, modes outside `force_band=` | M⁻¹K, M⁻¹D, force | R1, a mode in the band |
| in the band of the modes, on every DOF | – | always: it explains any M⁻¹K and M⁻¹D |
"""


def main() -> None:
    study(__doc__ or "", cells, page, PAGES / "blind.md")


if __name__ == "__main__":
    main()
