"""Acceptance of blind identification: what a good code reaches, with full counts of runs.

Run `python -m studies.blind_acceptance`; it goes on where it stopped. Runs of proportional chains
are those of `studies.blind`, made once for both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from studies import blind_runs as made
from studies.acceptance import HEAD, Line, Runs, median_line, range_line, share_line
from studies.blind import middle
from studies.blind_excitations import BAD, NEITHER
from studies.blind_runs import GOOD
from studies.rows import PAGES, Cell, Row, Rows, study

REFERENCE_NOISES = (80, 60, 40, 30, 20, 10)
CALIBRATION_RUNS = 50
EXCITATION_NOISES = (50, 30, 15)
LIMITED = (50, 30)
EVERYWHERE = ("auto", "periodic", "point", "base")
REFERENCE = {
    snr: Cell(made.reference_run, (snr,), CALIBRATION_RUNS if snr == 40 else 30)
    for snr in REFERENCE_NOISES
}
EXACT = {snr: Cell(made.exact_run, (snr,), 30) for snr in (None, 200, 120)}
HELD = Cell(made.held_run, (), 30)
CHAINS = {  # none lost of 60 runs, one of 100, show 95 % (one-sided)
    n: Cell(made.grid_run, (n, 40, "ml", False), 100 if n < 6 else 60) for n in range(3, 9)
}
SHAPES = Cell(made.shapes_run, (), 100)
EXCITATIONS = {
    (name, snr): Cell(made.excitation_run, (name, snr), 20)
    for name in (*GOOD, *BAD, *NEITHER)
    for snr in EXCITATION_NOISES
}
ROWS = {snr: Cell(made.rows_run, (snr,), 40) for snr in (None, 60, 40, 30, 20)}
MEASURED = Cell(made.measured_run, (), 20)
DECAY = Cell(made.decay_run, (), 20)
REFUSED = {
    (name, snr): Cell(made.everywhere_run, (name, snr), 20)
    for name in EVERYWHERE
    for snr in (50, 30)
}
BASE = {told: Cell(made.base_run, (told,), 20) for told in (False, True)}


def cells(runs: int | None) -> list[Cell]:
    """Return all cells, of at most so many runs."""
    groups = (REFERENCE, EXACT, CHAINS, EXCITATIONS, ROWS, REFUSED, BASE)
    every = [cell for group in groups for cell in group.values()]
    every += [HELD, SHAPES, MEASURED, DECAY]
    return [cell if runs is None else cell._replace(runs=min(runs, cell.runs)) for cell in every]


# -- the page

Look = Callable[[Cell], Runs]

TOP = """# Blind identification: acceptance

What is asked of blind identification, and what it reaches: 1 noise, 2 exactness, 3 predicted
deviations, 4 real shapes, 5 excitations, 6 rows under random forces, 7 measured forces and decay,
8 refusals. Every line is computed from the runs. Errors are ‖X̂ − X‖ / ‖X‖ (Frobenius); a median
counts a run without an answer as infinite. *95 % band* is the binomial band of a share (Clopper &
Pearson); *met* compares what was measured, not its band, with the limit. *Reference*: masses of 2,
1.5, 1 kg, general damping, five sines of unknown frequency on every DOF, 30 s at 50 Hz from a
displacement; a run has the same draws at every noise. *Chain*: as in [blind.md](blind.md), which
has errors over noise and degrees of freedom. Times: [benchmarks](../benchmarks.md).

Written by `python -m studies.blind_acceptance`, which goes on where it stopped.

"""


def page(chosen: Sequence[Cell], done: Rows) -> str:
    def look(cell: Cell) -> Runs:
        return Runs.of(chosen, done, cell)

    lines = list(all_lines(look))
    counts = [sum(line.met is met for line in lines) for met in (True, False)]
    missing = sum(line.met is None and line.limit != "–" for line in lines)
    partly = any(len(line.runs.rows) < line.runs.asked for line in lines)
    result = f"**{counts[0]} of {sum(counts)} limits met{', so far' if partly else ''}.**"
    result += f" {missing} not run yet.\n\n" if missing else "\n\n"
    parts = [TOP, result, HEAD, *map(str, lines), *_reference_table(look), *_excitations(look)]
    return "".join(parts)


def all_lines(look: Look) -> Iterator[Line]:
    """Yield the lines of all tests."""
    for lines in (_reference, _exact, _calibrated, _shapes, _judged, _rows, _known, _refused):
        yield from lines(look)


def _reference(look: Look) -> Iterator[Line]:
    limits = {60: 2e-4, 40: 2e-3, 30: 6e-3, 20: 2e-2}
    for snr, limit in limits.items():
        runs = look(REFERENCE[snr]._replace(runs=30))
        yield median_line("1", f"reference, {snr} dB: M⁻¹K", runs, "stiffness", limit)
    for snr, least in {60: 30, 40: 30, 30: 29, 20: 27, 10: 24}.items():
        runs = look(REFERENCE[snr]._replace(runs=30))
        what = f"reference, {snr} dB: right poles"
        yield share_line("1", what, runs, "right", least=least / 30)
    what = "reference, 10 dB: wrong poles that are accepted"
    yield share_line("1", what, look(REFERENCE[10]), _wrongly_accepted, most=0)


def _wrongly_accepted(row: Row) -> bool:
    return bool(row["accepted"] and not row.get("right"))


def _exact(look: Look) -> Iterator[Line]:
    limits = {None: (1e-10, 1e-10, 1e-10), 200: (1e-10, 1e-8, 1e-8), 120: (5e-7, 1e-4, 2e-5)}
    for snr, each in limits.items():
        noise = "no noise" if snr is None else f"{snr} dB"
        yield from _three("2", f"reference with offset, {noise}", look(EXACT[snr]), each)
    yield from _three("2", "reference, held forces, no noise", look(HELD), limits[None])


def _three(test: str, what: str, runs: Runs, limits: tuple[float, float, float]) -> Iterator[Line]:
    names = {"stiffness": "M⁻¹K", "damping": "M⁻¹D", "force": "M⁻¹f"}
    for (name, shown), limit in zip(names.items(), limits, strict=True):
        yield median_line(test, f"{what}: {shown}", runs, name, limit)


def _calibrated(look: Look) -> Iterator[Line]:
    runs = look(REFERENCE[40])
    for name, shown in (("stiffness", "M⁻¹K"), ("damping", "M⁻¹D")):
        what = f"reference, 40 dB, {shown}:"
        rms = float(np.sqrt(np.mean(np.square(runs.values(f"{name}_ratio") or [np.nan]))))
        scores = [z for row in runs.rows for z in row.get(f"{name}_scores", [np.inf])]
        yield range_line("3", f"{what} rms of error / predicted", runs, rms, (0.7, 1.4))
        whole = f"{what} median of error / deviation, all entries"
        yield range_line("3", whole, runs, middle(scores), (0.5, 0.9))


def _shapes(look: Look) -> Iterator[Line]:
    for n, cell in CHAINS.items():
        runs, what = look(cell), f"chain of {n}, 40 dB"
        yield median_line("4", f"{what}: M⁻¹K", runs, "stiffness", 2e-2)
        yield median_line("4", f"{what}: M⁻¹D", runs, "damping", 2e-2)
        yield share_line("4", f"{what}: right poles", runs, "right")
        yield share_line(
            "4", f"{what}: wrong poles that are accepted", runs, _wrongly_accepted, most=0
        )
        # with a wrong pole there is no proportional damping to be recognized
        real, right = f"{what}: real shapes taken, poles right", runs.where("right")
        yield share_line("4", real, right, lambda row: row.get("shapes") == "real", least=0.95)
    what = "reference, 40 dB: real shapes rejected"
    yield share_line("4", what, look(SHAPES), lambda row: row.get("shapes") == "free", least=0.95)


def _judged(look: Look) -> Iterator[Line]:
    for snr in LIMITED:
        for name in GOOD:
            runs, what = look(EXCITATIONS[name, snr]), f"{name}, {snr} dB: accepted"
            yield share_line("5", what, runs, "accepted", least=19 / 20)
        for name in BAD:
            runs, what = look(EXCITATIONS[name, snr]), f"{name}, {snr} dB: accepted"
            yield share_line("5", what, runs, "accepted", most=0)


def _rows(look: Look) -> Iterator[Line]:
    limits = {None: 1e-6, 60: None, 40: 1e-3, 30: None, 20: 1e-2}
    for snr, limit in limits.items():
        runs = look(ROWS[snr])
        what = f"chain of 5, two random forces, 20 s, {'no noise' if snr is None else f'{snr} dB'}"
        told = f"{what}: forced and free rows told"
        yield share_line("6", told, runs, "told", least=1)
        if limit is not None:
            yield median_line("6", f"{what}: M⁻¹K, free rows", runs, "stiffness", limit)


def _known(look: Look) -> Iterator[Line]:
    what, runs = "chain of 5, one measured force, 40 dB", look(MEASURED)
    yield median_line("7", f"{what}: M⁻¹K", runs, "stiffness", 1e-3)
    yield median_line("7", f"{what}: M⁻¹B", runs, "input", 1.5e-3)
    what, runs = "chain of 8, free decay, 40 dB", look(DECAY)
    yield median_line("7", f"{what}: M⁻¹K", runs, "stiffness", 3e-3)
    yield median_line("7", f"{what}: M⁻¹D", runs, "damping", 3e-3)


def _refused(look: Look) -> Iterator[Line]:
    for (name, snr), cell in REFUSED.items():
        what = f"random forces among the modes on every DOF, {snr} dB, `{name}`"
        yield share_line("8", f"{what}: refused, NaN only", look(cell), "nothing", least=1)
        if name != "periodic":  # which tells only that the force is none
            yield share_line("8", f"{what}: rule in_band says why", look(cell), "said", least=1)
    for told, cell in BASE.items():
        what = f"base motion not measured{', masses told' if told else ''}"
        yield share_line("8", f"{what}: k₁ is a number", look(cell), "k1", most=0)
        said = f"{what}: the rows above are answered, k₁ is said to be missing"
        yield share_line("8", said, look(cell), "said")


def _reference_table(look: Look) -> Iterator[str]:
    yield (
        "\n## Reference example\n\nMedians, order and frequencies unknown, free shapes; *bound*: "
        "the median Cramér-Rao bound of the same draws (root mean square). Errors of refused "
        "answers count with their candidates; the force where it is answered.\n\n"
        "| SNR dB | M⁻¹K | bound | M⁻¹D | bound | right poles | accepted | M⁻¹f | answered | runs "
        "|\n|" + "---:|" * 10 + "\n"
    )
    for snr, cell in REFERENCE.items():
        runs = look(cell)
        names = ("stiffness", "stiffness_bound", "damping", "damping_bound")
        cells = [f"{middle(runs.values(name)):.2g}" for name in names]
        cells += [str(runs.count(name)) for name in ("right", "accepted")]
        forces = [value for value in runs.values("force") if np.isfinite(value)]
        cells += [f"{middle(forces):.2g}", str(len(forces)), str(runs)]
        yield f"| {snr} | {' | '.join(cells)} |\n"


def _excitations(look: Look) -> Iterator[str]:
    noises = " | ".join(f"{snr} dB" for snr in EXCITATION_NOISES)
    yield (
        "\n## Excitations: accepted runs\n\nThe reference system, `identify_blind(record, n_dof)` "
        "without a word more. A sine at a mode's frequency is neither good nor bad.\n\n"
        f"| case | {noises} | rules that refused |\n|" + "---|" * 5 + "\n"
    )
    for name in (*GOOD, *BAD, *NEITHER):
        runs = [look(EXCITATIONS[name, snr]) for snr in EXCITATION_NOISES]
        cells = [f"{each.count('accepted')} of {len(each.rows)}" for each in runs]
        broken = {rule for each in runs for row in each.rows for rule in row.get("rules", ())}
        yield f"| {name} | {' | '.join(cells)} | {', '.join(sorted(broken)) or '–'} |\n"
    ratios = [
        row["stiffness_ratio"]
        for name in GOOD
        for snr in EXCITATION_NOISES
        for row in look(EXCITATIONS[name, snr]).rows
        if row.get("accepted")
    ]
    if ratios:
        yield (
            f"\nThe largest error of M⁻¹K over the predicted one, {len(ratios)} accepted good "
            f"runs: {max(ratios):.1f}.\n"
        )


def main() -> None:
    study(__doc__ or "", cells, page, PAGES / "blind_acceptance.md")


if __name__ == "__main__":
    main()
