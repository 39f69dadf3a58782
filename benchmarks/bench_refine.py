"""Time refinement, one BLAS thread: CPU seconds in all and for each step of the search.

Run ``python -m benchmarks.bench_refine``; ``--quick`` is short. Workloads: chains with modes of
4 to 40 Hz at 100 Hz, accelerations; noise on the sensors for the output-error form, unknown
forces beside the measured ones for the innovations form. "start" is the identification that
refinement begins from.
"""

from __future__ import annotations

import argparse

import numpy as np
from threadpoolctl import threadpool_limits

import vibrid as vb
from benchmarks.timing import peak_megabytes, seconds
from vibrid.structures import chain

HEADER = (
    "work                                       | start s | seconds | steps | s a step "
    "| MB above data"
)


def record_of(
    n_dof: int, n_inputs: int, n_outputs: int, n_samples: int, unknown: float
) -> vb.Record:
    """Return a record; `unknown` is the size of forces on the DOFs that are not inputs."""
    rng = np.random.default_rng(0)
    frame = chain(np.ones(n_dof), np.full(n_dof, 1.5e4), damping_ratio=0.01)
    force = rng.standard_normal((n_samples, n_dof))
    force[:, n_inputs:] *= unknown
    whole = frame.simulate(force, 0.01, forces=frame.dofs, noise=0.05, rng=rng)
    return whole.select(whole.output_names[:n_outputs], whole.input_names[:n_inputs])


def line(name: str, record: vb.Record, order: int, noise: str) -> str:
    """Return one line of the table."""
    method = vb.N4SID(block_rows=20) if record.n_inputs else vb.SSI(block_rows=20)
    found: list[vb.Fit] = []

    def begin() -> None:
        found.append(vb.identify(record, method, order, stability="project"))

    def work() -> None:
        found.append(vb.refine(found[0], record, noise=noise))

    start, spent = seconds(begin, 1), seconds(work, 1)
    steps = found[-1].diagnostics.figures["iterations"]
    each = spent / (steps + 2)  # the start and the check of it are passes too
    memory = peak_megabytes(work)
    return f"{name:42s} | {start:7.3f} | {spent:7.3f} | {steps:5d} | {each:8.3f} | {memory:13.0f}"


def main(arguments: list[str] | None = None) -> None:
    """Print the table; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a twentieth of the samples")
    share = 20 if parser.parse_args(arguments).quick else 1
    works = [
        ("output error, 2 in 10 out, 1e6, 20 states", 10, 2, 10, 10**6, "output_error"),
        ("innovations, 1 in 3 out, 1e5, 10 states", 5, 1, 3, 10**5, "innovations"),
        ("innovations, 0 in 3 out, 1e5, 10 states", 5, 0, 3, 10**5, "innovations"),
        ("innovations, 2 in 10 out, 1e5, 20 states", 10, 2, 10, 10**5, "innovations"),
        ("both by halves, 1 in 3 out, 1e5, 10 states", 5, 1, 3, 10**5, "auto"),
    ]
    print(HEADER)
    with threadpool_limits(limits=1):
        for name, n_dof, m, p, n_samples, noise in works:
            unknown = 0.0 if noise == "output_error" else 0.3 if m else 1.0
            record = record_of(n_dof, m, p, n_samples // share, unknown)
            print(line(name, record, 2 * n_dof, noise), flush=True)


if __name__ == "__main__":
    main()
