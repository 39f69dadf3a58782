"""Time blind identification, one BLAS thread: CPU seconds from a record to matrices and forces.

Run ``python -m benchmarks.bench_blind``; ``--quick`` leaves the largest out. Workloads: chains
under n + 2 unknown sines on every DOF, accelerations from rest with noise at 40 dB.
"""

from __future__ import annotations

import argparse

import numpy as np
from threadpoolctl import threadpool_limits

import vibrid as vb
from benchmarks.timing import peak_megabytes, seconds
from vibrid.structures import chain

HEADER = "work                               | seconds | MB above data | M⁻¹K off"
SNR = 100.0  # of amplitudes: 40 dB


def record_of(n_dof: int, n_samples: int, dt: float) -> tuple[vb.Record, np.ndarray]:
    """Return the record and M⁻¹K."""
    rng = np.random.default_rng([n_dof, 1])
    springs = np.full(n_dof, (2 * np.pi) ** 2 / (2 - 2 * np.cos(np.pi / (2 * n_dof + 1))))
    frame = chain(np.ones(n_dof), springs, damping_ratio=0.015)
    hertz = rng.uniform(0.5, 1.1 * frame.frequencies_hz[-1], n_dof + 2)
    time = np.arange(n_samples)[:, None, None] * dt
    phases = rng.uniform(0, 2 * np.pi, (n_dof + 2, n_dof))
    force = np.cos(2 * np.pi * hertz[:, None] * time + phases).sum(axis=1)
    moved = frame.simulate(force, dt, forces=frame.dofs)
    noise = moved.outputs.std() / SNR * rng.standard_normal(moved.outputs.shape)
    record = vb.Record(moved.outputs + noise, dt=dt, output_channels=moved.output_channels)
    return record, np.asarray(frame.stiffness) / np.diag(frame.mass)[:, None]


def line(n_dof: int, n_samples: int, dt: float, method: str, repeats: int) -> str:
    """Return one line of the table."""
    record, truth = record_of(n_dof, n_samples, dt)

    def work() -> vb.BlindFit:
        return vb.identify_blind(record, n_dof, method=method, hold="zoh")

    found = work().normalized_stiffness
    error = np.linalg.norm(found - truth) / np.linalg.norm(truth)
    shown = f"{error:.1e}" if np.isfinite(error) else "refused"
    name = f"{n_dof} DOF, {n_samples} samples, {method}"
    return f"{name:34s} | {seconds(work, repeats):7.2f} | {peak_megabytes(work):13.0f} | {shown}"


def main(arguments: list[str] | None = None) -> None:
    """Print the table; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="the small structure only")
    quick = parser.parse_args(arguments).quick
    print(HEADER)
    with threadpool_limits(limits=1):
        for method in ("ml", "subspace"):
            print(line(3, 1500, 0.02, method, 1 if quick else 5), flush=True)
            if not quick:
                print(line(8, 6000, 0.01, method, 1), flush=True)


if __name__ == "__main__":
    main()
