"""Chains and their noisy shaker tests, which tests of OKID share."""

from __future__ import annotations

import numpy as np

import vibrid as vb
from vibrid.structures import Structure, chain

DT = 0.05


def structure(n_dof: int, damping_ratio: float = 0.01) -> Structure:
    return chain(np.ones(n_dof), np.full(n_dof, 800.0), damping_ratio=damping_ratio)


def noisy_test(rng: np.random.Generator, n_samples: int = 3000) -> vb.Record:
    """Return 2 forces and 3 accelerations of 5 DOF that unmeasured forces move too."""
    frame = structure(5)
    forces = 0.3 * rng.standard_normal((n_samples, 5))
    known = rng.standard_normal((n_samples, 2))
    forces[:, [0, 2]] += known
    full = frame.simulate(forces, DT, forces=frame.dofs, noise=0.05, rng=rng)
    return vb.Record(full.outputs[:, [0, 2, 4]], known, dt=DT)
