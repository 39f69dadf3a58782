"""Errors of damping ratios against the Cramér-Rao bound, before and after refinement.

Run `python -m studies.refinement`; `--runs` for a smaller number, `--output` for another page.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

import vibrid as vb
from studies.bounds import ambient_bound, shaker_bound
from vibrid.excitation import white_noise
from vibrid.structures import Structure, chain

Floats = NDArray[np.float64]
PAGE = Path(__file__).resolve().parent.parent / "docs" / "studies" / "refinement.md"
RUNS = 400
DT = 0.01
NOISE = 0.1  # standard deviation on the sensors, relative to the outputs'
OUTLIER = 4.0  # times the bound
HEAD = """# Damping ratios against the bound

Written by `python -m studies.refinement`. Errors of each damping ratio over {runs} seeded runs,
divided by its Cramér-Rao bound computed from the true system: robust (1.48 × median |error|),
plain (root mean square), and the number of errors beyond 4 × the bound. "reported" is the mean
standard deviation that the fit gives, over the bound. The robust figure of {runs} runs is known to
{precision:.0f} %.
"""


@dataclass(frozen=True, eq=False)
class Case:
    """A structure, its records by seed, its bound, and how it is identified.

    Attributes
    ----------
    record : callable (seed) → Record
    start : callable (Record) → Fit
    bound : array (n_modes,)
        Of the damping ratios.
    noise : str
        The form that `refine` is asked for.
    """

    name: str
    frame: Structure
    record: Callable[[int], vb.Record]
    start: Callable[[vb.Record], vb.Fit]
    bound: Floats
    noise: str


@dataclass(frozen=True, eq=False)
class Errors:
    """Errors of damping ratios over the bound (n_runs, n_modes); reported deviations likewise."""

    start: Floats
    refined: Floats
    reported: Floats


def shaker_case(n_samples: int = 3000) -> Case:
    """Return a bench test: four DOF, ζ = 0.3 %, one force, noise on the sensors alone."""
    frame = chain(np.ones(4), np.full(4, 1.5e4), damping_ratio=0.003)
    force = white_noise(n_samples, rng=np.random.default_rng(0))
    clean = frame.simulate(force, DT, forces=["f1"])
    std = NOISE * np.asarray(clean.outputs).std(axis=0)
    model = frame.state_space("acceleration", ["f1"]).to_discrete(DT)

    def record(seed: int) -> vb.Record:
        return _noisy(clean, std, np.random.default_rng(1000 + seed))

    return Case(
        "4-DOF bench test, ζ = 0.3 %, N = 3000",
        frame,
        record,
        lambda data: vb.identify(data, vb.N4SID(block_rows=40), order=8, stability="project"),
        shaker_bound(model, clean, std)[1],
        "output_error",
    )


def ambient_case(n_samples: int = 10_000) -> Case:
    """Return ambient vibration: five DOF, ζ = 1 %, unknown white forces, three sensors."""
    frame = chain(np.ones(5), np.full(5, 1.5e4), damping_ratio=0.01)
    sensors = [("acceleration", dof) for dof in ("f1", "f3", "f5")]

    def clean(rng: np.random.Generator) -> vb.Record:
        force = white_noise(n_samples, 5, rng=rng)
        return frame.simulate(force, DT, sensors=sensors, forces=frame.dofs)

    std = NOISE * np.asarray(clean(np.random.default_rng(0)).outputs).std(axis=0)
    model = frame.state_space(sensors, frame.dofs).to_discrete(DT)

    def record(seed: int) -> vb.Record:
        rng = np.random.default_rng(2000 + seed)
        return _noisy(clean(rng).select(inputs=[]), std, rng)

    return Case(
        "5-DOF ambient vibration, ζ = 1 %, N = 10000",
        frame,
        record,
        lambda data: vb.identify(data, vb.SSI(block_rows=30), order=10, stability="project"),
        ambient_bound(model, n_samples, std)[1],
        "innovations",
    )


def _noisy(record: vb.Record, std: Floats, rng: np.random.Generator) -> vb.Record:
    y = np.asarray(record.outputs)
    inputs = record.inputs if record.n_inputs else None
    return vb.Record(y + std * rng.standard_normal(y.shape), inputs, dt=record.dt)


def errors_of(case: Case, runs: int) -> Errors:
    """Return the errors of all runs."""
    rows: tuple[list[Floats], list[Floats], list[Floats]] = ([], [], [])
    truth, n = case.frame.damping_ratios, len(case.bound)
    for seed in range(runs):
        record = case.record(seed)
        start = case.start(record)
        fit = vb.refine(start, record, noise=case.noise)
        rows[0].append(vb.modes_of(start).damping_ratios[:n] - truth)
        rows[1].append(vb.modes_of(fit).damping_ratios[:n] - truth)
        rows[2].append(fit.diagnostics.figures["damping_std"][:n])
    return Errors(*(np.array(each) / case.bound for each in rows))


def robust(errors: Floats) -> Floats:
    """Return 1.48 × median |error| of each mode."""
    return np.asarray(1.4826 * np.median(np.abs(errors), axis=0))


def plain(errors: Floats) -> Floats:
    """Return the root mean square of each mode."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


def table(case: Case, errors: Errors) -> str:
    """Return one case in words and a table."""
    lines = [
        f"\n## {case.name}\n",
        "| mode | Hz | bound / ζ | start: robust | plain | refined: robust | plain | outliers "
        "| reported |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for k, bound in enumerate(case.bound):
        start, refined = errors.start[:, [k]], errors.refined[:, [k]]
        lines.append(
            f"| {k + 1} | {case.frame.frequencies_hz[k]:.2f} "
            f"| {100 * bound / case.frame.damping_ratios[k]:.1f} % "
            f"| {robust(start)[0]:.2f} | {plain(start)[0]:.2f} "
            f"| {robust(refined)[0]:.2f} | {plain(refined)[0]:.2f} "
            f"| {int((np.abs(refined) > OUTLIER).sum())} | {errors.reported[:, k].mean():.2f} |"
        )
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--output", type=Path, default=PAGE)
    given = parser.parse_args(arguments)
    page = HEAD.format(runs=given.runs, precision=100 * 1.17 / np.sqrt(given.runs))
    with threadpool_limits(limits=1):
        for case in (shaker_case(), ambient_case()):
            page += table(case, errors_of(case, given.runs))
    given.output.parent.mkdir(parents=True, exist_ok=True)
    given.output.write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
