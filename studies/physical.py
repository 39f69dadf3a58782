"""Errors of M, K, R and R* from noisy records of small chains, method by method.

Run `python -m studies.physical`; `--seeds` for a smaller number, `--output` for another page.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.methods import ERADC, OKID
from vibrid.physical import fit_rayleigh, mechanical_model
from vibrid.structures import Structure, chain

PAGE = Path(__file__).resolve().parent.parent / "docs" / "studies" / "physical.md"
SEEDS = 100
NOISES = (0.01, 0.05)
N_SAMPLES, DT = 4000, 0.02
COLUMNS = ("M", "K", "R", "R, symmetric", "R*")

CHAINS = {
    "two masses": chain([2.0, 1.0], [900.0, 600.0], rayleigh=(0.1, 4e-4)),
    "three masses": chain([2.0, 1.5, 1.0], [900.0, 700.0, 600.0], rayleigh=(0.1, 4e-4)),
}
METHODS: dict[str, Any] = {
    "ERA-OKID": OKID(observer_order=20),
    "ERA/DC-OKID": OKID(observer_order=20, realization=ERADC()),
    "CVA": vb.N4SID(weighting="cva", block_rows=20),
    "MOESP": vb.N4SID(weighting="moesp", block_rows=20),
    "SSARX": vb.N4SID(weighting="ssarx", block_rows=20),
}
Finish = Callable[[vb.Fit, vb.Record], vb.Fit]
Floats = NDArray[np.float64]

FINISHES: dict[str, Finish] = {
    "plain": lambda fit, record: fit,
    "refined": lambda fit, record: vb.refine(fit, record, noise="output_error"),
}


@dataclass(frozen=True, eq=False)
class Cell:
    """Errors of one method on one chain at one noise; a seed that failed is a row of NaN."""

    chain: str
    noise: float
    method: str
    finish: str
    errors: Floats  # (n_seeds, len(COLUMNS))

    @property
    def median(self) -> Floats:
        return np.asarray(np.nanmedian(self.errors, axis=0))

    @property
    def failures(self) -> int:
        return int(np.isnan(self.errors[:, 0]).sum())


def record_of(structure: Structure, noise: float, seed: int) -> vb.Record:
    """Return accelerations of all masses under white noise on the last, with output noise."""
    rng = np.random.default_rng(seed)
    force = white_noise(N_SAMPLES, rng=rng)
    return structure.simulate(force, DT, forces=[structure.dofs[-1]], noise=noise, rng=rng)


def errors_of(fit: vb.Fit, true: Structure) -> Floats:
    """Return the relative errors (Frobenius) of M, K, R, R by projection, and R*."""
    found = mechanical_model(fit)
    improved = fit_rayleigh(found).damping_matrix(found.mass, found.stiffness)
    nearest = mechanical_model(fit, structure="symmetric").damping
    pairs = (
        (found.mass, true.mass),
        (found.stiffness, true.stiffness),
        (found.damping, true.damping),
        (nearest, true.damping),
        (improved, true.damping),
    )
    return np.array([np.linalg.norm(a - b) / np.linalg.norm(b) for a, b in pairs])


def run(n_seeds: int) -> Iterator[Cell]:
    """Yield the cells of the study."""
    for name, structure in CHAINS.items():
        for noise in NOISES:
            records = [record_of(structure, noise, seed) for seed in range(n_seeds)]
            for method in METHODS:
                yield from _cells(name, structure, noise, method, records)


def _cells(
    name: str, true: Structure, noise: float, method: str, records: list[vb.Record]
) -> Iterator[Cell]:
    errors = {kind: np.full((len(records), len(COLUMNS)), np.nan) for kind in FINISHES}
    for k, record in enumerate(records):
        try:
            fit = vb.identify(record, METHODS[method], 2 * true.n_dof)
        except vb.DataError:
            continue
        for kind, finish in FINISHES.items():
            try:
                errors[kind][k] = errors_of(finish(fit, record), true)
            except vb.DataError:
                continue
    for kind, rows in errors.items():
        yield Cell(name, noise, method, kind, rows)


def page(cells: list[Cell], n_seeds: int) -> str:
    """Return the page of the results."""
    head = f"""# Mass, stiffness and damping from noisy records

Chains of two and three masses with proportional damping (α = 0.1 1/s, β = 4e-4 s): white
force on the last mass, accelerations of all, {N_SAMPLES} samples at {1 / DT:g} Hz, white noise
on each output of the given share of its standard deviation. Medians over {n_seeds} seeds of
the relative error ‖X̂ − X‖ / ‖X‖ (Frobenius) in per cent.

R is that of the formula R = −M W Λ² Wᵀ M; "R, symmetric" that of the nearest symmetric
matrices (`structure="symmetric"`), where what hangs on the poles counts more than shapes and
scale; R* = αM + βK with the coefficients of `fit_rayleigh`. "Refined" is
`refine(fit, record, noise="output_error")`: all methods then end at one model.

Written by `python -m studies.physical`.
"""
    return head + "".join(_table(cells, name, noise) for name in CHAINS for noise in NOISES)


def _table(cells: list[Cell], name: str, noise: float) -> str:
    lines = [
        f"\n## {name.capitalize()}, {100 * noise:g} % noise\n",
        f"| method | | {' | '.join(COLUMNS)} | failed |",
        f"|---|---|{'---:|' * (len(COLUMNS) + 1)}",
    ]
    for cell in cells:
        if (cell.chain, cell.noise) == (name, noise):
            numbers = " | ".join(f"{100 * each:.3g}" for each in cell.median)
            lines.append(f"| {cell.method} | {cell.finish} | {numbers} | {cell.failures} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="records per case")
    parser.add_argument("--output", type=Path, default=PAGE, help="page to write")
    options = parser.parse_args()
    with threadpool_limits(1, user_api="blas"):
        cells = list(run(options.seeds))
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(page(cells, options.seeds), encoding="utf-8")
    print(f"{options.output} written")


if __name__ == "__main__":
    main()
