"""A controller that answers within the sample: u(t) knows y(t), not y(t − 1) alone."""

from __future__ import annotations

import numpy as np
import pytest
from subspace_cases import codes

import vibrid as vb
from vibrid.structures import chain


def fed_back(seed: int, gain: float) -> vb.Record:
    """Return a chain of 1 % damping, 2.2 and 5.8 Hz, whose velocities drive its first force."""
    model = chain([1.0, 1.0], [500.0, 500.0], damping_ratio=0.01).state_space("velocity", ["f1"])
    plant = model.to_discrete(0.03)
    rng = np.random.default_rng(seed)
    disturbance = 0.3 * rng.standard_normal((20_000, 1)) @ plant.B.T
    x, u, y = np.zeros(4), 0.3 * rng.standard_normal((20_000, 1)), np.zeros((20_000, 2))
    for t in range(len(u)):
        y[t] = plant.C @ x + 0.002 * rng.standard_normal(2)
        u[t] += gain * y[t, 0]
        x = plant.A @ x + plant.B @ u[t] + disturbance[t]
    channels = [vb.Channel("v1", "velocity"), vb.Channel("v2", "velocity")]
    return vb.Record(y, u, dt=0.03, output_channels=channels)


@pytest.mark.parametrize("weighting", ["cva", "ssarx"])
def test_feedback_within_the_sample_does_not_bias_damping(weighting: str) -> None:
    """Without the innovations in the regression both would be 40 % too high."""
    found = []
    for seed in range(4):
        fit = vb.identify(fed_back(seed, -4.0), vb.N4SID(weighting, block_rows=40), order=4)
        assert "feedback" in codes(fit)
        found.append(vb.modes_of(fit).damping_ratios)
    np.testing.assert_allclose(np.mean(found, axis=0), 0.01, rtol=0.15)
