"""Chains under known and unknown forces, and fits to refine, which tests share."""

from __future__ import annotations

import numpy as np

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.record import Floats
from vibrid.structures import Structure, chain

DT = 0.01


def bench(n_dof: int = 2, damping_ratio: float = 0.01) -> Structure:
    """Return a chain with modes well inside the band."""
    return chain(np.ones(n_dof), np.full(n_dof, 1.5e4), damping_ratio=damping_ratio)


def shaken(
    rng: np.random.Generator, n_samples: int = 600, n_dof: int = 2, inputs: int = 1
) -> vb.Record:
    """Return a record that unknown forces drive besides the measured ones."""
    frame = bench(n_dof)
    force = white_noise(n_samples, n_dof, rng=rng)
    whole = frame.simulate(force, DT, forces=frame.dofs, noise=0.05, rng=rng)
    return whole.select(inputs=[channel.name for channel in whole.input_channels[:inputs]])


def sensed(
    rng: np.random.Generator,
    n_samples: int = 800,
    n_dof: int = 2,
    sensors: str | list[tuple[str, str]] = "acceleration",
) -> vb.Record:
    """Return a record with noise on the sensors only."""
    force = white_noise(n_samples, rng=rng)
    frame = bench(n_dof)
    return frame.simulate(force, DT, sensors=sensors, forces=["f1"], noise=0.05, rng=rng)


def started(data: vb.Record | list[vb.Record], order: int = 4, block_rows: int = 10) -> vb.Fit:
    """Return a fit to start from."""
    first = data if isinstance(data, vb.Record) else data[0]
    method = vb.N4SID if first.n_inputs else vb.SSI
    return vb.identify(data, method(block_rows=block_rows), order, stability="project")


def flat(fit: vb.Fit) -> Floats:
    """Return A, B, C, D, K, the initial states and the offset as one vector."""
    model, x0 = fit.model, fit.initial_states
    parts = (model.A, model.B, model.C, model.D, fit.kalman_gain, x0, fit.output_offset)
    return np.concatenate([part.ravel() for part in parts])
