"""Chains of three masses under noise, which tests of the subspace family share."""

from __future__ import annotations

import numpy as np
import scipy.signal as ss

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.structures import chain

DT = 0.05


def noisy_chain(rng: np.random.Generator, n_samples: int = 3000, noise: float = 0.05) -> vb.Record:
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    force = white_noise(n_samples, 2, rng=rng)
    return frame.simulate(force, DT, forces=["f1", "f3"], noise=noise, rng=rng)


def coloured(seed: int) -> vb.Record:
    """Return 1000 noisy samples of a chain with 0.5 % damping under a low-pass force."""
    rng = np.random.default_rng(seed)
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.005)
    b, a = ss.butter(4, 0.4)
    force = ss.lfilter(b, a, white_noise(1000, 1, rng=rng), axis=0)
    return frame.simulate(force, 0.02, forces=["f1"], noise=0.3, rng=rng)


def codes(fit: vb.Fit) -> list[str]:
    return [finding.code for finding in fit.diagnostics.findings]
