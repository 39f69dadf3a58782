"""Blind identification over DOFs, noise, knowledge and method, and the table of excitations.

Run `python -m studies.blind`; it goes on where it stopped: every run is a line of the rows file,
and the page is written from all lines. `--minutes` ends early, `--runs` sets the seeds per cell.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import vibrid as vb
from vibrid.blind import BlindFit, identify_blind
from vibrid.blind.likelihood.components import Components, Signals
from vibrid.blind.likelihood.modal import modal_estimate
from vibrid.blind.likelihood.place import Place

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))  # the records that the tests know the truth of

from blind_records import Case, off, reference, under_sines, uniform_chain  # noqa: E402
from test_blind_scenarios import BAD  # noqa: E402

PAGE = ROOT / "docs" / "studies" / "blind.md"
ROWS = ROOT / "docs" / "studies" / "blind.jsonl"
DOFS = range(3, 9)
NOISES = (60, 50, 40, 30, 20, 10)
RUNS = 5
WAYS = (("ml", False), ("ml", True), ("subspace", False), ("subspace", True))
SCENARIOS = ("good", "offset", *BAD)
SCENARIO_NOISES = (50, 30)
SCENARIO_RUNS = 20
RIGHT = 0.02  # of a frequency
Floats = NDArray[np.float64]
Row = dict[str, Any]


def grid_case(n_dof: int, snr_db: float, seed: int) -> tuple[Case, Floats]:
    """Return 60 s at 100 Hz from rest under n + 2 sines on every DOF, and their frequencies."""
    rng = np.random.default_rng([n_dof, seed])
    structure = uniform_chain(n_dof)
    hertz = np.sort(rng.uniform(0.5, 1.1 * structure.frequencies_hz[-1], n_dof + 2))
    phasors = np.exp(1j * rng.uniform(0, 2 * np.pi, (n_dof, n_dof + 2)))
    case = under_sines(
        structure,
        hertz,
        phasors,
        dt=0.01,
        n_samples=6000,
        start=np.zeros(2 * n_dof),
        snr_db=snr_db,
        rng=rng,
    )
    return case, hertz


def bound(case: Case, hertz: Floats, *, known: bool, real: bool) -> tuple[float, float]:
    """Return the Cramér-Rao bound of 𝒦 and 𝒟, relative, at the true poles."""
    n, poles = case.structure.n_dof, case.structure.poles
    rates = np.concatenate([poles.imag, [] if known else 2 * np.pi * hertz])
    modes = np.arange(len(rates)) < n
    decays = np.where(modes, np.resize(-poles.real, len(rates)), 0)
    given = 2 * np.pi * hertz if known else np.zeros(0)
    signals = Signals((np.asarray(case.record.outputs),), case.record.dt, given)
    free = Components(rates, decays, modes, np.zeros_like(modes), np.zeros((1, len(rates))))
    place = Place(free, signals)
    if real:
        phases = 0.5 * np.angle(np.sum(place.shapes(0) ** 2, axis=0)) * modes
        place = Place(Components(rates, decays, modes, modes, phases[None]), signals)
    variances = np.diag(modal_estimate(place, modes, np.full(n, 2)).normalized()[1])
    halves = np.sqrt([variances[: n * n].sum(), variances[n * n :].sum()])
    return (
        float(halves[0] / np.linalg.norm(case.stiffness)),
        float(halves[1] / np.linalg.norm(case.damping)),
    )


def candidates(fit: BlindFit) -> tuple[Floats, Floats]:
    """Return 𝒦 and 𝒟, also those of a refused answer."""
    figures = fit.diagnostics.figures
    return (
        figures.get("candidate_stiffness", fit.normalized_stiffness),
        figures.get("candidate_damping", fit.normalized_damping),
    )


def grid_row(n_dof: int, snr_db: float, method: str, known: bool, seed: int) -> Row:
    case, hertz = grid_case(n_dof, snr_db, seed)
    started = time.perf_counter()
    fit = identify_blind(
        case.record, n_dof, method=method, input_frequencies_hz=hertz.tolist() if known else None
    )
    seconds = time.perf_counter() - started
    K, D = candidates(fit)
    f, true = np.sort(fit.modes.frequencies_hz), case.structure.frequencies_hz
    right = len(f) == n_dof and bool(np.abs(f / true - 1).max() < RIGHT)
    limits = bound(case, hertz, known=known, real=method == "ml")
    return {
        "accepted": fit.accepted,
        "right": right,
        "stiffness": off(K, case.stiffness),
        "damping": off(D, case.damping),
        "stiffness_bound": limits[0],
        "damping_bound": limits[1],
        "seconds": seconds,
    }


def scenario_row(name: str, snr_db: float, seed: int) -> Row:
    if name in BAD:
        record = BAD[name](np.random.default_rng([seed, 77]), snr_db)
    else:
        record = reference(seed, snr_db, offset=3.0 * (name == "offset")).record
    fit = identify_blind(record, record.n_outputs)
    return {"accepted": fit.accepted, "rules": [each.rule for each in fit.verdict.refusals]}


def jobs(runs: int) -> Iterator[tuple[str, Callable[[], Row]]]:
    """Yield key and work of every run, one seed of all cells after the other."""
    for seed in range(max(runs, SCENARIO_RUNS)):
        if seed < runs:
            for n in DOFS:
                for snr in NOISES:
                    for method, known in WAYS:
                        key = f"grid|{n}|{snr}|{method}|{int(known)}|{seed}"
                        yield key, lambda a=(n, snr, method, known, seed): grid_row(*a)  # type: ignore[misc]
        for name in SCENARIOS:
            for snr in SCENARIO_NOISES:
                key = f"scenario|{name}|{snr}|{seed}"
                yield key, lambda a=(name, snr, seed): scenario_row(*a)  # type: ignore[misc]


def finished(path: Path) -> dict[str, Row]:
    if not path.exists():
        return {}
    lines = path.read_text(encoding="utf-8").splitlines()
    return {row.pop("key"): row for row in map(json.loads, lines)}


def work(path: Path, runs: int, minutes: float) -> None:
    """Append a line for every run that is not there yet."""
    done, end = finished(path), time.monotonic() + 60 * minutes
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        for key, run in jobs(runs):
            if key in done:
                continue
            if time.monotonic() > end:
                return
            try:
                row = run()
            except vb.DataError as problem:
                row = {"accepted": False, "failed": str(problem)}
            file.write(json.dumps({"key": key, **row}) + "\n")
            file.flush()


HEAD = """# Blind identification: noise, degrees of freedom, excitations

Chains of unit masses, first frequency 1 Hz, 1 to 2 % proportional damping, 60 s at 100 Hz from
rest, n + 2 unknown sines on every DOF. Relative errors ‖X̂ − X‖ / ‖X‖ (Frobenius) of M⁻¹K and
M⁻¹D, medians over the runs whose poles are right (all frequencies within 2 %); *bound* is the
Cramér-Rao bound of the same records (root mean square; of real shapes for maximum likelihood,
of free ones for the subspace method), so a median below it is as it should be. Answers that
the rules refuse count with their candidates; *accepted* says how many they let pass.

Written by `python -m studies.blind`, which goes on where it stopped; run counts are in the tables.
"""


def page(rows: dict[str, Row]) -> str:
    return HEAD + "".join(_grid_tables(rows)) + _scenario_table(rows)


def _grid_tables(rows: dict[str, Row]) -> Iterator[str]:
    head = "| n | SNR dB | M⁻¹K | bound | M⁻¹D | bound | right poles | accepted | runs | s |\n"
    for method, known in WAYS:
        lines = []
        for n in DOFS:
            for snr in NOISES:
                start = f"grid|{n}|{snr}|{method}|{int(known)}|"
                runs = [row for key, row in rows.items() if key.startswith(start)]
                if runs:
                    lines.append(f"| {n} | {snr} | {_cells(runs)} |")
        if lines:
            name = "Maximum likelihood" if method == "ml" else "Subspace"
            yield f"\n## {name}, {'known' if known else 'unknown'} frequencies\n\n{head}"
            yield "|" + "---:|" * 10 + "\n" + "\n".join(lines) + "\n"


def _cells(runs: list[Row]) -> str:
    right = [row for row in runs if row.get("right")]
    names = ("stiffness", "stiffness_bound", "damping", "damping_bound")
    values = [_median(right, name) for name in names]
    counts = [len(right), sum(row["accepted"] for row in runs), len(runs)]
    return " | ".join([*values, *map(str, counts), _median(runs, "seconds")])


def _median(runs: list[Row], name: str) -> str:
    values = [row[name] for row in runs if row.get(name) is not None and np.isfinite(row[name])]
    return f"{np.median(values):.2g}" if values else "–"


def _scenario_table(rows: dict[str, Row]) -> str:
    lines = []
    for name in SCENARIOS:
        cells, rules = [], set()
        for snr in SCENARIO_NOISES:
            runs = [row for key, row in rows.items() if key.startswith(f"scenario|{name}|{snr}|")]
            cells.append(f"{sum(row['accepted'] for row in runs)} of {len(runs)}")
            rules |= {rule for row in runs for rule in row.get("rules", ())}
        lines.append(f"| {name} | {' | '.join(cells)} | {', '.join(sorted(rules)) or '–'} |")
    return (
        "\n## Excitations: accepted runs\n\nThe reference system of three masses, five sines on "
        "every DOF, 30 s at 50 Hz, `identify_blind(record, n_dof)` without a word more.\n\n"
        "| case | 50 dB | 30 dB | rules that refused |\n|---|---|---|---|\n"
        + "\n".join(lines)
        + "\n"
        + ANSWERS
    )


ANSWERS = """
## What is answered and what is refused

| excitation | answered | refused |
|---|---|---|
| periodic, forces measured | M⁻¹K, M⁻¹D, M⁻¹B | no transient and too few frequencies |
| periodic, frequencies known or not | M⁻¹K, M⁻¹D, force | R1 to R7 |
| free decay, or `force_free=` | M⁻¹K, M⁻¹D | R1 |
| any force at some DOFs (`point`) | free rows, where the forces act | no free row |
| base motion not measured (`base`) | storeys above the first | k₁, always |
| ambient, as the user says (`ambient`) | M⁻¹K | R6 |
| on every DOF, modes outside `force_band=` | M⁻¹K, M⁻¹D, force | R1, a mode in the band |
| in the band of the modes, on every DOF | – | always: it explains any M⁻¹K and M⁻¹D |
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--runs", "--seeds", type=int, default=RUNS, help="runs per cell of the grid"
    )
    parser.add_argument("--minutes", type=float, default=np.inf, help="stop after this long")
    parser.add_argument("--rows", type=Path, default=ROWS, help="file of finished runs")
    parser.add_argument("--output", type=Path, default=PAGE, help="page to write")
    options = parser.parse_args()
    with threadpool_limits(1, user_api="blas"):
        work(options.rows, options.runs, options.minutes)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(page(finished(options.rows)), encoding="utf-8")
    print(f"{options.output} written")


if __name__ == "__main__":
    main()
