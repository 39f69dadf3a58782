"""Shaker tests of a four-storey frame, which tests of `identify` share."""

from __future__ import annotations

import numpy as np

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.structures import Structure, shear_frame

DT = 0.02


def shaker_test(
    rng: np.random.Generator, *, n_samples: int = 6000, noise: float = 0.02
) -> tuple[Structure, vb.Record]:
    """Return a four-storey frame of 1 % damping, shaken at the first floor."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.01)
    force = white_noise(n_samples, rng=rng, std=100.0)
    return frame, frame.simulate(force, DT, forces=["f1"], noise=noise, rng=rng)
