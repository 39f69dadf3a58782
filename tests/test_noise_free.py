"""Records without noise, or nearly: what has to be exact, and what must not be said."""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla
from subspace_cases import codes, noisy_chain

import vibrid as vb
from vibrid.kalman import innovation_form, spectral_radius


def test_a_short_horizon_does_no_harm_without_noise(rng: np.random.Generator) -> None:
    """There is no predictor whose memory could be too long; the damping is exact."""
    record = noisy_chain(rng, noise=0.0)
    fit = vb.identify(record, vb.N4SID("moesp", block_rows=10, transition="regression"), order=6)
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, 0.01, rtol=1e-8)
    assert "no-gain" in codes(fit)
    assert "short-horizon" not in codes(fit)


def test_innovations_of_one_dimension_are_no_error() -> None:
    """A covariance of rank one, positive by rounding alone, is refused or raised, never solved."""
    A = np.diag([0.5, -0.3])
    for seed in range(300):  # the last pivot is exactly zero in one of sixty
        rng = np.random.default_rng(seed)
        C, K, e = (rng.standard_normal(shape) for shape in [(3, 2), (2, 3), (3, 1)])
        P = sla.solve_discrete_lyapunov(A, 0.09 * K @ e @ e.T @ K.T)
        G = A @ P @ C.T + 0.3 * K @ e @ e.T
        found = innovation_form(A, C, G, C @ P @ C.T + e @ e.T)
        assert found is not None
        assert spectral_radius(A - found[0] @ C) < 1


def test_orders_below_the_rank_do_not_doubt_exact_modes(rng: np.random.Generator) -> None:
    """The rank chooses the order; that smaller ones miss the modes says nothing against them."""
    fit = vb.identify(noisy_chain(rng, noise=0.0), vb.N4SID(block_rows=10))
    assert fit.order == 6
    assert "persistence" not in fit.diagnostics.figures
