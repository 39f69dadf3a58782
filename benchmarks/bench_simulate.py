"""Time StateSpace.simulate against scipy.signal.dlsim, one BLAS thread.

Run ``python -m benchmarks.bench_simulate``; ``--quick`` is short. dlsim is timed on fewer
samples and scaled: its cost per sample does not depend on their number.
"""

from __future__ import annotations

import argparse

import numpy as np
import scipy.signal
from threadpoolctl import threadpool_limits

from benchmarks.timing import seconds
from vibrid.statespace import StateSpace
from vibrid.structures import chain

CASES = ((5, 1, 3), (10, 2, 10), (50, 2, 20))  # DOFs, forces, sensors
HEADER = "states in out |  samples | vibrid us/sample | dlsim us/sample | ratio | largest error"


def model_of(n_dof: int, n_inputs: int, n_outputs: int) -> StateSpace:
    """Return a discrete chain with accelerometers, 1 % damping, modes below 40 Hz."""
    stiffness = (2 * np.pi * 20) ** 2
    structure = chain(np.ones(n_dof), np.full(n_dof, stiffness), damping_ratio=0.01)
    sensors = [("acceleration", structure.dofs[k % n_dof]) for k in range(n_outputs)]
    return structure.state_space(sensors, structure.dofs[:n_inputs]).to_discrete(0.01)


def compare(model: StateSpace, n_samples: int, peer_samples: int) -> str:
    """Return one line of the table."""
    u = np.random.default_rng(0).standard_normal((n_samples, model.n_inputs))
    peer = (model.A, model.B, model.C, model.D, model.dt)
    ours = 1e6 / n_samples * seconds(lambda: model.simulate(u), 3)
    theirs = 1e6 / peer_samples * seconds(lambda: scipy.signal.dlsim(peer, u[:peer_samples]), 2)
    expected = scipy.signal.dlsim(peer, u[:peer_samples])[1]
    error = np.abs(model.simulate(u[:peer_samples]) - expected).max() / np.abs(expected).max()
    sizes = f"{model.order:6d} {model.n_inputs:2d} {model.n_outputs:3d}"
    return (
        f"{sizes} | {n_samples:8d} | {ours:16.4f} | {theirs:15.3f} | {theirs / ours:5.0f} | "
        f"{error:.1e}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Print the table; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="50 000 samples, not a million")
    quick = parser.parse_args(arguments).quick
    n_samples, peer_samples = (50_000, 10_000) if quick else (1_000_000, 50_000)
    print(f"dlsim timed on {peer_samples} samples, per sample; one BLAS thread")
    print(HEADER)
    with threadpool_limits(limits=1):
        for sizes in CASES:
            print(compare(model_of(*sizes), n_samples, peer_samples))


if __name__ == "__main__":
    main()
