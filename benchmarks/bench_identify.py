"""Time whole identifications, one BLAS thread: CPU seconds and memory above the data.

Seconds are the median of five measurements. Run ``python -m benchmarks.bench_identify``;
``--quick`` is short. Workloads: a chain with modes of 4 to 40 Hz at 100 Hz, white forces,
accelerations, 5 % noise; "from the Gram" is A, B, C, D, K without a pass over the data for B, D
and initial states. The share of the one pass that no method can save, walking the data once for
means and scales, stands beside each.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

import vibrid as vb
from benchmarks.timing import peak_megabytes, seconds
from vibrid.chunks import open_stream
from vibrid.structures import chain

REPEATS = 5  # their median
HEADER = "work                                        | seconds | one walk s | MB above data"


def record_of(n_dof: int, n_inputs: int, n_samples: int) -> vb.Record:
    """Return a noisy shaker test of a chain."""
    rng = np.random.default_rng(0)
    frame = chain(np.ones(n_dof), np.full(n_dof, 1.5e4), damping_ratio=0.01)
    force = rng.standard_normal((n_samples, n_inputs))
    return frame.simulate(force, 0.01, forces=frame.dofs[:n_inputs], noise=0.05, rng=rng)


def torn_record(pieces: int) -> vb.Record:
    """Return a record with a missing sample after every 49."""
    whole = record_of(3, 1, 50 * pieces)
    outputs = np.array(whole.outputs)
    outputs[49::50] = np.nan
    return vb.Record(outputs, whole.inputs, dt=whole.dt)


def line(name: str, record: vb.Record, work: Callable[[], Any]) -> str:
    """Return one line of the table."""
    spent = seconds(work, REPEATS)
    walk = seconds(lambda: open_stream(record), REPEATS)
    return f"{name:43s} | {spent:7.3f} | {walk:10.3f} | {peak_megabytes(work):13.0f}"


def main(arguments: list[str] | None = None) -> None:
    """Print the table; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a twentieth of the samples")
    share = 20 if parser.parse_args(arguments).quick else 1
    print(HEADER)
    with threadpool_limits(limits=1):
        small, large = record_of(3, 1, 4096), record_of(10, 3, 100_000 // share)
        ambient = record_of(10, 3, 200_000 // share).select(inputs=[])
        cva, twenty = vb.N4SID(block_rows=15), vb.N4SID(block_rows=40)
        ssi, projected = vb.SSI(block_rows=40), vb.SSI(kind="data", block_rows=40)
        torn = torn_record(2000 // share)
        works: list[tuple[str, vb.Record, Callable[[], Any]]] = [
            (
                "1 in 3 out 4096, order 6, all matrices, x0",
                small,
                lambda: vb.identify(small, cva, order=6),
            ),
            (
                "1 in 3 out 4096, order 6, from the Gram",
                small,
                lambda: cva.realize(cva.decompose(small), 6),
            ),
            (
                "3 in 10 out, order 20, from the Gram",
                large,
                lambda: twenty.realize(twenty.decompose(large), 20),
            ),
            (
                "3 in 10 out, order 20, all matrices, x0",
                large,
                lambda: vb.identify(large, twenty, order=20),
            ),
            ("3 in 10 out, all chosen", large, lambda: vb.identify(large)),
            ("10 out, SSI covariance, orders 2..60", ambient, lambda: _sweep(ssi, ambient)),
            ("10 out, SSI data, orders 2..60", ambient, lambda: _sweep(projected, ambient)),
            (
                f"1 in 3 out, {2000 // share} pieces of 49 samples, order 6",
                torn,
                lambda: vb.identify(torn, vb.N4SID(block_rows=8), order=6),
            ),
        ]
        for name, record, work in works:
            print(line(name, record, work), flush=True)


def _sweep(method: vb.SSI, record: vb.Record) -> None:
    shared = method.decompose(record)
    for order in range(2, 62, 2):
        method.realize(shared, order)


if __name__ == "__main__":
    main()
