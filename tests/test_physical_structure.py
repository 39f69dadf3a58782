"""Nearest matrices of a given structure: exact where it holds, at a stated cost where not."""

from __future__ import annotations

import numpy as np
import pytest
from known_fits import error, known_fit, structure_fit

import vibrid as vb
from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.physical import Topology, mechanical_model
from vibrid.structures import Structure, chain


def structure() -> Structure:
    return chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], dashpots=[0.3, 0.6, 0.1])


def disturbed(fit: vb.Fit, rng: np.random.Generator, size: float) -> vb.Fit:
    """Return the fit with noise on the modal rows of B and C."""
    m = fit.model
    C = m.C * (1 + size * rng.standard_normal(m.C.shape))
    B = m.B * (1 + size * rng.standard_normal(m.B.shape))
    return known_fit(vb.StateSpace(m.A, B, C, m.D, m.dt), fit.output_channels, fit.input_channels)


@pytest.mark.parametrize("shape", ["symmetric", "diagonal", "chain"])
def test_a_structure_that_holds_costs_nothing(shape):
    """Exact data of a chain: every structure that includes it gives M, R and K."""
    true = structure()
    found = mechanical_model(structure_fit(true, "acceleration", ["f1"]), structure=shape)
    for name in ("mass", "damping", "stiffness"):
        assert error(getattr(found, name), getattr(true, name)) < 1e-8
        assert found.verdict.checks[f"change_{name}"] < 1e-8
    assert found.projection.misfit < 1e-10 and not found.projection.definite_bound


def test_a_structure_that_does_not_hold_costs():
    """A spring that skips a mass is no chain: the change of K and the misfit say so."""
    true = structure()
    K = true.stiffness + 80 * np.array([[1.0, 0, -1], [0, 0, 0], [-1, 0, 1]])
    fit = structure_fit(Structure(true.mass, true.damping, K), "acceleration", ["f1"])
    found = mechanical_model(fit, structure="chain")
    assert found.stiffness[0, 2] == 0
    assert found.verdict.checks["change_stiffness"] > 0.01
    assert found.verdict.checks["poles"] > 1e-3
    allowed = np.ones((3, 3), dtype=bool)
    free = mechanical_model(fit, structure=Topology("diagonal", "chain", allowed))
    assert error(free.stiffness, K) < 1e-8


def test_known_and_total_mass():
    """A known mass stays as given; a total is kept exactly, scale and all."""
    true = structure()
    fit = structure_fit(true, "acceleration", ["f1"])
    np.testing.assert_array_equal(mechanical_model(fit, mass=[2.0, 1.5, 1.1]).mass[2, 2], 1.1)
    total = mechanical_model(fit, mass=5.0, structure="chain")
    np.testing.assert_allclose(total.mass.sum(), 5.0, rtol=1e-12)
    only = structure_fit(true, "acceleration", base=True)
    for mass in (true.mass, np.diag(true.mass), 4.5):
        found = mechanical_model(only, mass=mass, structure="chain")
        assert error(found.stiffness, true.stiffness) < 1e-8
        assert error(found.mass, true.mass) < 1e-8


def test_a_chain_is_told_from_fewer_modes():
    """With the structure known, two modes of three at all DOFs are enough."""
    true = structure()
    fit = structure_fit(true, "acceleration", ["f1"])
    found = mechanical_model(fit, structure="chain", frequencies_hz=true.frequencies_hz[:2])
    assert error(found.stiffness, true.stiffness) < 1e-7
    assert error(found.mass, true.mass) < 1e-7


def test_structure_halves_the_noise(rng):
    """Of noisy records, what is known to be a chain is better found as one."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.1, 4e-4))
    plain, helped = [], []
    for _ in range(8):
        record = true.simulate(white_noise(1200, rng=rng), 0.04, forces=["f1"], noise=0.05, rng=rng)
        fit = vb.identify(record, vb.N4SID(block_rows=15), 6)
        plain.append(error(mechanical_model(fit).damping, true.damping))
        chained = mechanical_model(fit, structure="chain")
        helped.append(error(chained.damping, true.damping))
        assert np.linalg.eigvalsh(chained.damping)[0] > -1e-8 * np.linalg.norm(chained.damping)
    assert np.median(helped) < 0.7 * np.median(plain)


def test_definiteness_is_forced_and_said(rng):
    """Damping that comes out indefinite becomes the best semidefinite one."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], dashpots=[1.0, 0.0, 0.0])
    fit = disturbed(structure_fit(true, "acceleration", ["f1"]), rng, 0.01)
    free = mechanical_model(fit, structure=Topology("diagonal", definite=False))
    assert np.linalg.eigvalsh(free.damping)[0] < -1e-3 * np.linalg.norm(free.damping)
    bound = mechanical_model(fit, structure="diagonal")
    assert np.linalg.eigvalsh(bound.damping)[0] > -1e-7 * np.linalg.norm(bound.damping)
    assert bound.projection.definite_bound and bound.projection.misfit > free.projection.misfit
    assert any(each.code == "definite" for each in bound.verdict.findings)
    # optimal: a step towards any other feasible point does not fit better
    for other in (np.zeros((3, 3)), true.damping, np.eye(3)):
        moved = bound.damping + 1e-3 * (other - bound.damping)
        assert misfit_of(fit, bound, moved) > bound.projection.misfit * (1 - 1e-9)


def misfit_of(fit, model, damping) -> float:
    """Return the projection's measure of another damping matrix, by plain loops."""
    plain = mechanical_model(fit)
    W = np.repeat(plain.shapes, 2, axis=1)
    poles = np.repeat(plain.poles, 2)
    W[:, 1::2], poles[1::2] = W[:, 1::2].conj(), poles[1::2].conj()
    left = []
    for i in range(6):
        for j in range(i, 6):
            one = float(i == j)
            m = W[:, i] @ model.mass @ W[:, j]
            r, k = W[:, i] @ damping @ W[:, j], W[:, i] @ model.stiffness @ W[:, j]
            li, lj = poles[i], poles[j]
            weight = 30.0 if j == i + 1 and i % 2 == 0 else 1.0
            left.append(weight * (r + m * (li + lj) - one))
            left.append(weight * (m * li * lj - k - one * li) / np.sqrt(abs(li * lj)))
    left = np.array(left)
    return float(np.sqrt(np.mean(np.concatenate([left.real, left.imag]) ** 2)))


def test_weights():
    """A mode of weight zero does not count: one with a wrong pole is left to the others."""
    true = structure()
    fit = structure_fit(true, "acceleration", ["f1"])
    values, vectors = np.linalg.eig(fit.model.A)
    values[np.abs(np.angle(values)) == np.abs(np.angle(values)).max()] *= 0.99
    A = (vectors * values) @ np.linalg.inv(vectors)
    model = vb.StateSpace(A.real, fit.model.B, fit.model.C, fit.model.D, 0.01)
    wrong = known_fit(model, fit.output_channels, fit.input_channels)
    assert error(mechanical_model(wrong, structure="chain").damping, true.damping) > 0.05
    topology = Topology("diagonal", "chain", "chain", weights=[1.0, 1.0, 0.0])
    assert error(mechanical_model(wrong, structure=topology).damping, true.damping) < 1e-6


def test_refusals():
    """No scale, wrong patterns and weights, more unknowns than the data have."""
    true = structure()
    fit = structure_fit(true, "acceleration", ["f1"])
    with pytest.raises(OptionError, match="structure must be one of"):
        mechanical_model(fit, structure="tree")
    with pytest.raises(OptionError, match="A structure needs a scale"):
        mechanical_model(structure_fit(true, "acceleration", base=True), structure="chain")
    with pytest.raises(OptionError, match="symmetric 3 × 3 array"):
        mechanical_model(fit, structure=Topology(np.eye(2, dtype=bool)))
    with pytest.raises(OptionError, match="weights must be 3 numbers"):
        mechanical_model(fit, structure=Topology(weights=[1.0]))
    with pytest.raises(OptionError, match="does not have the pattern"):
        mechanical_model(fit, mass=np.eye(3) + 0.1, structure="chain")
    with pytest.raises(DataError, match=r"6 of the 18 entries .* not M\[f1, f1\]"):
        mechanical_model(fit, structure="symmetric", frequencies_hz=true.frequencies_hz[:1])
    with pytest.raises(OptionError, match="no DOF is without mass"):
        mechanical_model(fit, structure=Topology(np.zeros((3, 3), dtype=bool)))


def test_entries_that_are_open_are_named():
    """A DOF apart from the others has its own scale: its entries are open, its coupling is not."""
    true = chain([1.0, 2.0, 1.5], [300.0, 0.0, 500.0, 200.0], dashpots=[0.1, 0.0, 0.2, 0.1])
    fit = structure_fit(true, "acceleration", base=True)
    with pytest.raises(DataError, match=r"11 of the 12 entries .* not M\[f1, f1\]") as problem:
        mechanical_model(fit, mass=4.5, structure="chain")
    assert "K[f1, f1]" in str(problem.value) and "K[f1, f2]" not in str(problem.value)


def test_what_contradicts_the_data_is_a_warning():
    """Ten times the mass, or no coupling at all: not accepted, and the cost is said."""
    fit = structure_fit(structure(), "acceleration", ["f1"])
    for given in (
        {"mass": [20.0, 15.0, 10.0]},
        {"structure": Topology("diagonal", *[np.eye(3, dtype=bool)] * 2)},
    ):
        found = mechanical_model(fit, **given)
        assert "contradicted" in [each.code for each in found.verdict.findings]
        assert not found.verdict.accepted
