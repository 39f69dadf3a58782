"""Real shapes: taken where damping is proportional, and said where that is an assumption."""

from __future__ import annotations

import numpy as np
import pytest

from studies.blind_records import (
    REFERENCE,
    SINES_HZ,
    Case,
    off,
    reference,
    under_random_sines,
    under_sines,
)
from vibrid.blind import BlindFit, blind_likelihood, identify_blind
from vibrid.structures import Structure, chain

M, K = REFERENCE.mass, REFERENCE.stiffness
PROPORTIONAL = chain([2.0, 1.5, 1.0], [600.0, 400.0, 300.0], rayleigh=(0.15, 0.0008))


def displaced(structure: Structure, seed: int, snr_db: float) -> Case:
    """Return the reference forces and one start, with seeded noise."""
    phasors = np.exp(1j * np.random.default_rng(9).uniform(0, 6, (3, 5)))
    return under_sines(
        structure,
        np.array(SINES_HZ),
        phasors,
        dt=0.02,
        n_samples=1500,
        start=np.array([0.1, -0.05, 0.08, 0, 0, 0]),
        snr_db=snr_db,
        rng=np.random.default_rng(seed),
    )


def codes(found: BlindFit) -> set[str]:
    return {each.code for each in found.verdict.findings}


def test_an_assumption_that_the_data_cannot_test_is_said() -> None:
    """At 25 dB M⁻¹D rests on real shapes, and the verdict says so; at 80 dB they are seen."""
    weak = blind_likelihood(displaced(PROPORTIONAL, 0, 25).record, 3)
    assert weak.accepted and weak.diagnostics.figures["shapes"] == "real"
    assert "real_shapes_assumed" in codes(weak)
    assert weak.verdict.assumed and weak.verdict.assumed[0] in str(weak.verdict)
    assert weak.verdict.checks["free_damping_deviation"] > weak.verdict.checks["damping_deviation"]
    clear = blind_likelihood(displaced(PROPORTIONAL, 0, 80).record, 3)
    assert "real_shapes" in codes(clear) and not clear.verdict.assumed
    assert clear.verdict.checks["hidden_damping"] < 0.05


def test_damping_that_is_not_proportional_is_never_silently_taken_as_such() -> None:
    """The reference at 20 dB: where real shapes pass, the answer says what it rests on."""
    taken = [blind_likelihood(reference(seed, 20).record, 3) for seed in range(6)]
    taken = [f for f in taken if f.accepted and f.diagnostics.figures["shapes"] == "real"]
    assert taken
    for found in taken:
        assert found.verdict.assumed and "real_shapes_assumed" in codes(found)


def test_real_shapes_that_the_data_reject_are_doubted() -> None:
    """Asked for all the same: the nearest proportional damping, with a doubt."""
    found = blind_likelihood(reference(1, 50).record, 3, shapes="real")
    assert found.diagnostics.figures["shapes"] == "real"
    assert "real_shapes_rejected" in codes(found) and found.verdict.assumed


def test_real_shapes_of_several_records() -> None:
    """Records share them, with a phase of their own each; M⁻¹D is within per cents."""
    records = [displaced(PROPORTIONAL, seed, 40).record for seed in range(3)]
    found = blind_likelihood(records, 3, shapes="real")
    assert found.accepted and "real_shapes_rejected" not in codes(found)
    assert off(found.normalized_damping, np.linalg.solve(M, PROPORTIONAL.damping)) < 0.03
    assert np.abs(found.modes.shapes.imag).max() == 0


@pytest.mark.slow
@pytest.mark.parametrize("n_dof", [3, 5, 8])
def test_real_shapes_make_damping_practical(n_dof: int) -> None:
    """Proportional chains at 40 dB: M⁻¹D and M⁻¹K within 2e-2, and real shapes are taken."""
    case, _ = under_random_sines(n_dof, 40, 0)
    found = identify_blind(case.record, n_dof)
    assert found.accepted and found.diagnostics.figures["shapes"] == "real"
    assert off(found.normalized_stiffness, case.stiffness) < 2e-2
    assert off(found.normalized_damping, case.damping) < 2e-2


@pytest.mark.slow
def test_real_shapes_are_rejected_where_damping_is_not_proportional() -> None:
    """The reference system at 40 dB: rejected in at least 11 of 12 (measured 98 %)."""
    kinds = [
        blind_likelihood(reference(seed, 40).record, 3).diagnostics.figures["shapes"]
        for seed in range(12)
    ]
    assert kinds.count("free") >= 11


@pytest.mark.slow
def test_a_departure_larger_than_hidden_is_noticed() -> None:
    """60 dB: coupling of the size that is told is seen in 9 of 10 runs, half of it seldom."""
    damping = np.linalg.solve(M, PROPORTIONAL.damping)
    first = blind_likelihood(displaced(PROPORTIONAL, 0, 60).record, 3)
    assert first.diagnostics.figures["shapes"] == "real"
    size = first.verdict.checks["hidden_damping"] * np.linalg.norm(damping)
    worst = least_seen(displaced(PROPORTIONAL, 0, 60))
    seen = []
    for share in (0.5, 1.0):
        changed = chain(
            [2.0, 1.5, 1.0], [600.0, 400.0, 300.0], damping=M @ (damping + share * size * worst)
        )
        runs = [blind_likelihood(displaced(changed, 1 + seed, 60).record, 3) for seed in range(30)]
        seen.append(sum(run.diagnostics.figures["shapes"] == "free" for run in runs))
    assert seen[0] < 15 and seen[1] >= 23


def least_seen(case: Case) -> np.ndarray:
    """Return the change of 𝒟, of unit size, that couples modes and is known worst."""
    found = blind_likelihood(case.record, 3, shapes="free")
    assert found.parameter_covariance is not None
    shapes = np.linalg.eigh(
        np.diag(1 / np.sqrt(np.diag(M))) @ K @ np.diag(1 / np.sqrt(np.diag(M)))
    )[1]
    shapes = shapes / np.sqrt(np.diag(M))[:, None]
    inverse = np.linalg.inv(shapes)

    def coupling(vector: np.ndarray) -> np.ndarray:
        modal = inverse @ vector.reshape(3, 3).T @ shapes
        return np.asarray((shapes @ (modal - np.diag(np.diag(modal))) @ inverse).ravel(order="F"))

    keep = np.column_stack([coupling(unit) for unit in np.eye(9)])
    vectors = np.linalg.eigh(keep @ found.parameter_covariance[9:, 9:] @ keep.T)[1]
    return np.asarray(vectors[:, -1].reshape(3, 3).T)
