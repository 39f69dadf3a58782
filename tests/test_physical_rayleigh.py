"""Proportional damping: its coefficients, and whether it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from known_fits import structure_fit

import vibrid as vb
from vibrid.errors import OptionError
from vibrid.mechanics import undamped_modes
from vibrid.physical import fit_rayleigh, mechanical_model, shape_complexity
from vibrid.structures import Structure, chain

MASSES, SPRINGS = [2.0, 1.5, 1.0, 1.2], [500.0, 700.0, 600.0, 800.0]


def modes(**damping) -> vb.Modes:
    return vb.modes_of(structure_fit(chain(MASSES, SPRINGS, **damping), "acceleration", ["f1"]))


def test_rayleigh_coefficients_and_matrix():
    """α and β exactly, and R* = αM + βK is the damping matrix."""
    true = chain(MASSES, SPRINGS, rayleigh=(0.2, 3e-4))
    found = mechanical_model(structure_fit(true, "velocity", ["f2"]))
    law = fit_rayleigh(found)
    np.testing.assert_allclose([law.alpha, law.beta], [0.2, 3e-4], rtol=1e-9)
    np.testing.assert_allclose(
        law.damping_matrix(found.mass, found.stiffness), true.damping, atol=1e-9
    )
    assert law.explained and law.misfit < 1e-9
    np.testing.assert_allclose(law.complexity, 0, atol=1e-12)
    np.testing.assert_allclose(law.ratios_at(law.frequencies_hz), law.damping_ratios, rtol=1e-9)


def test_caughey_series():
    """Damping of three terms needs three: two leave a misfit, three give it all."""
    M, K = chain(MASSES, SPRINGS).mass, chain(MASSES, SPRINGS).stiffness
    R = 0.3 * M + 1e-4 * K + 4e-7 * K @ np.linalg.solve(M, K)
    found = vb.modes_of(structure_fit(Structure(M, R, K), "acceleration", ["f1"]))
    assert fit_rayleigh(found).misfit > 1e-3
    law = fit_rayleigh(found, n_terms=3)
    np.testing.assert_allclose(law.coefficients, [0.3, 1e-4, 4e-7], rtol=1e-8)
    np.testing.assert_allclose(law.damping_matrix(M, K), R, rtol=1e-8, atol=1e-10)


def test_damping_that_is_not_proportional_is_told():
    """Ratios that no two terms give, and a dashpot that makes the shapes complex."""
    law = fit_rayleigh(modes(damping_ratio=[0.01, 0.05, 0.01, 0.04]))
    assert law.explained is False and law.misfit > 0.1
    law = fit_rayleigh(modes(dashpots=[5.0, 0.0, 0.0, 0.0]))
    assert law.complexity.max() > 1e-3
    np.testing.assert_allclose(
        law.complexity,
        0.5 * (1 - np.sqrt(modes(dashpots=[5.0, 0.0, 0.0, 0.0]).phase_collinearity)),
    )


def test_known_deviations_make_a_probability(rng):
    """With standard deviations the verdict is a χ² test, and it holds its level."""
    true = modes(rayleigh=(0.2, 3e-4))
    sigma = 0.02 * true.damping_ratios
    rejected = 0
    for _ in range(200):
        ratios = true.damping_ratios + sigma * rng.standard_normal(4)
        w = np.abs(true.poles)
        poles = w * (-ratios + 1j * np.sqrt(1 - ratios**2))
        law = fit_rayleigh(replace(true, poles=poles, damping_std=sigma))
        rejected += not law.explained
    assert 1 <= rejected <= 24  # 5 % of 200, three deviations each way
    off = replace(modes(damping_ratio=[0.01, 0.02, 0.01, 0.02]), damping_std=sigma)
    assert fit_rayleigh(off).explained is False and fit_rayleigh(off).probability < 1e-6


def test_weights():
    """A mode of weight zero does not count."""
    true = modes(rayleigh=(0.2, 3e-4))
    poles = true.poles.copy()
    poles[3] = poles[3].imag * 1j - 3 * abs(poles[3].real)
    bent = replace(true, poles=poles)
    law = fit_rayleigh(bent, weights=[1, 1, 1, 0])
    np.testing.assert_allclose([law.alpha, law.beta], [0.2, 3e-4], rtol=1e-8)
    assert abs(fit_rayleigh(bent).beta - 3e-4) > 1e-5


def test_two_modes_test_nothing():
    """Two ratios fit any two terms; one mode is not enough."""
    true = modes(rayleigh=(0.2, 3e-4))
    assert fit_rayleigh(true.select([0, 1])).explained is None
    with pytest.raises(OptionError, match="2 terms needs as many modes; there are 1"):
        fit_rayleigh(true.select([0]))
    with pytest.raises(OptionError, match="weights must be 4 numbers"):
        fit_rayleigh(true, weights=[1.0])


def test_complexity_of_known_shapes():
    """Real up to a phase: 0. A quarter period apart and of one size: the most, ½."""
    _, shapes = undamped_modes(np.eye(2), [[2.0, -1.0], [-1.0, 2.0]])
    np.testing.assert_allclose(shape_complexity(shapes * np.exp(0.7j)), 0, atol=1e-15)
    np.testing.assert_allclose(shape_complexity(np.array([[1.0], [1j]])), 0.5)
