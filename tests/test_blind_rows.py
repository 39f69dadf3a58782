"""Rows of M⁻¹K and M⁻¹D under forces at some DOFs, closure, and the force's history."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from blind_records import Case, off, under_noise, uniform_chain

import vibrid as vb
from vibrid.blind import blind_rows, identify_blind
from vibrid.blind.closure import close_rows
from vibrid.blind.weak_rows import regress_rows
from vibrid.blind.windowed import ramp_window, spectra_of, windowed_motions

BAND = (0.3, 8.0)


def two_forces(snr_db: float | None, rng: np.random.Generator) -> Case:
    """Return five masses, forces on the second and the last, 20 s."""
    return under_noise(uniform_chain(5), [1, 4], duration=20.0, snr_db=snr_db, rng=rng)


def test_window_and_its_derivatives() -> None:
    """Flat in the middle, zero with four derivatives at both ends of each ramp."""
    w = [ramp_window(1001, 0.1, k) for k in range(4)]
    assert w[0][0] == w[0][-1] == 0 and (w[0][101:-101] == 1).all()
    for derivative, lower in zip(w[1:], w[:-1], strict=True):
        np.testing.assert_allclose(derivative[2:-2], np.gradient(lower)[2:-2], atol=3e-4)
        assert np.abs(derivative[[0, -1, 100, -101]]).max() < 1e-12


def test_weak_derivatives_are_those_of_the_signal() -> None:
    """Spectra by parts equal spectra of the differentiated sine, without its edges."""
    t = 0.01 * np.arange(2001)
    w0 = 2 * np.pi * 1.7
    y = np.sin(w0 * t)[:, None]
    low, middle, high = windowed_motions(y, 0.01, np.zeros(1, dtype=np.int64), 0.5, 4.0).motions
    cosine = w0 * np.cos(w0 * t)[:, None]
    direct = windowed_motions(cosine, 0.01, np.zeros(1, dtype=np.int64), 0.5, 4.0).motions[0]
    scale = np.abs(low).max()
    np.testing.assert_allclose(middle, direct, atol=1e-9 * w0 * scale)
    np.testing.assert_allclose(high, -(w0**2) * low, atol=1e-9 * w0**2 * scale)


def test_two_forces_without_noise(rng: np.random.Generator) -> None:
    """Free rows to 1e-6, forced rows found and left NaN."""
    case = two_forces(None, rng)
    found = blind_rows(case.record, 5, force_band=BAND)
    assert found.accepted and found.forced_dofs == ("f2", "f5")
    free = [0, 2, 3]
    assert off(found.normalized_stiffness[free], case.stiffness[free]) < 1e-6
    assert np.isnan(found.normalized_stiffness[[1, 4]]).all()
    assert "f2, f5" in found.verdict.missing[0]


@pytest.mark.parametrize(("snr_db", "limit"), [(40, 1e-3), (20, 1e-2)])
def test_two_forces_in_noise(snr_db: float, limit: float, rng: np.random.Generator) -> None:
    """Three runs: the forced DOFs are found in all, deviations fit, the median error is small."""
    errors = []
    for _ in range(3):
        case = two_forces(snr_db, rng)
        found = blind_rows(case.record, 5)
        assert found.forced_dofs == ("f2", "f5")
        free = [0, 2, 3]
        errors.append(off(found.normalized_stiffness[free], case.stiffness[free]))
        z = (found.normalized_stiffness - case.stiffness)[free] / found.normalized_stiffness_std[
            free
        ]
        assert 0.3 < np.median(np.abs(z)) < 1.2
    assert np.median(errors) < limit


def test_the_mean_of_a_transient_is_no_force(rng: np.random.Generator) -> None:
    """At 60 dB the lines near zero hold what was lost with the mean; free rows stay free."""
    case = two_forces(60, rng)
    found = blind_rows(case.record, 5)
    assert found.forced_dofs == ("f2", "f5")
    assert found.diagnostics.figures["row_misfits"][[0, 2, 3]].max() < 1.25


def test_reweighting_beats_plain_least_squares(rng: np.random.Generator) -> None:
    """At 20 dB the errors-in-variables fit leaves χ² near 1 in free rows, far more in forced."""
    case = two_forces(20, rng)
    rows = regress_rows(spectra_of((np.asarray(case.record.outputs),), 0.01, np.full(5, 2), BAND))
    assert (rows.misfits[[0, 2, 3]] > 0.7).all() and (rows.misfits[[0, 2, 3]] < 1.35).all()
    assert (rows.misfits[[1, 4]] > 6).all()


def test_closure_and_force_at_the_top(rng: np.random.Generator) -> None:
    """Masses, symmetry, no ground spring at the top: all of M⁻¹K, M⁻¹D and the force."""
    case = under_noise(uniform_chain(3), [2], duration=60.0, snr_db=60, rng=rng)
    found = identify_blind(case.record, 3, excitation="point", mass=np.ones(3), ungrounded=["f3"])
    assert off(found.normalized_stiffness, case.stiffness) < 1e-4
    assert off(found.normalized_damping, case.damping) < 1e-2
    middle = slice(700, -700)
    assert off(found.normalized_force[middle, 2], case.force[middle, 2]) < 0.1
    assert (found.normalized_force[:, :2] == 0).all()
    assert sum(each.code == "closure" for each in found.verdict.findings) == 3
    assert len(found.modes.poles) == 3


def test_closure_takes_what_is_allowed_only() -> None:
    """Without masses nothing is closed; without a word on the ground the diagonal stays open."""
    structure = uniform_chain(3)
    P = np.hstack([structure.stiffness, structure.damping])
    free, none = np.array([True, True, False]), np.zeros(3, dtype=bool)
    bare = close_rows(P, 1e-6 * np.ones((3, 6)), free, None, none)
    assert np.isnan(bare.P[2]).all() and not bare.said
    known = close_rows(P, 1e-6 * np.ones((3, 6)), free, np.eye(3), none)
    np.testing.assert_allclose(known.P[2, :2], P[2, :2])
    assert np.isnan(known.P[2, 2]) and np.isnan(known.P[2, 3:]).all()


def test_a_band_below_the_modes_is_not_believed(rng: np.random.Generator) -> None:
    """Eight masses, a force that leaves two modes out: several relations fit, so none is given."""
    case = under_noise(uniform_chain(8), [7], duration=30.0, snr_db=40, rng=rng)
    found = blind_rows(case.record, 8, force_band=BAND)
    assert not found.accepted and np.isnan(found.normalized_stiffness).all()


def test_forces_everywhere_are_refused(rng: np.random.Generator) -> None:
    """A random force in the band on every DOF explains any matrices: the reason is told."""
    case = under_noise(uniform_chain(3), [0, 1, 2], duration=30.0, snr_db=50, rng=rng)
    for excitation in ("auto", "periodic", "point", "base"):
        found = identify_blind(case.record, 3, excitation=excitation)
        assert not found.accepted
        assert np.isnan(found.normalized_stiffness).all()
        assert np.isnan(found.normalized_damping).all()
    assert "explains the record for any" in str(found.verdict)
    assert found.verdict.rule == "in_band"


def test_ground_spring_under_base_motion_is_never_a_number(rng: np.random.Generator) -> None:
    """Storeys above the first are found; the first row is NaN, whatever is said of it."""
    case = under_noise(uniform_chain(3), [0], duration=60.0, snr_db=50, rng=rng)
    found = identify_blind(
        case.record, 3, excitation="base", mass=np.ones(3), ungrounded=["f1", "f2", "f3"]
    )
    assert found.accepted and found.forced_dofs == ("f1",)
    assert np.isnan(found.normalized_stiffness[0, 0])
    assert off(found.normalized_stiffness[1:], case.stiffness[1:]) < 1e-3
    assert "k₁" in found.verdict.missing[0]


def test_automatic_choice_finds_a_point_force(rng: np.random.Generator) -> None:
    """auto tries sines first, says so, and answers by rows."""
    case = under_noise(uniform_chain(3), [2], duration=40.0, snr_db=50, rng=rng)
    found = identify_blind(case.record, 3)
    assert found.accepted and found.verdict.kind == "point"
    assert any(each.code == "tried_periodic" for each in found.verdict.findings)


def test_bands_that_do_not_fit(rng: np.random.Generator) -> None:
    """A band up to Nyquist leaves no lines for the noise; a reversed one is no band."""
    record = two_forces(40, rng).record
    with pytest.raises(vb.OptionError, match="noise is read"):
        blind_rows(record, 5, force_band=(1.0, 49.0))
    with pytest.raises(vb.OptionError, match="force_band"):
        blind_rows(record, 5, force_band=(8.0, 1.0))


def test_frame_with_the_table_hidden(shared_data: Path) -> None:
    """Storeys 2 and 3 agree with the input-output result within 5 %, the first is refused."""
    acceleration = np.load(shared_data / "three_story_frame.npz")["acc"][:, :, 0]
    floors = [vb.Channel(f"floor{k}", "acceleration", "m/s2", f"floor{k}") for k in (1, 2, 3)]
    table = [vb.Channel("table", "base_acceleration", "m/s2")]
    motion = acceleration - acceleration.mean(axis=0)
    record = vb.Record(
        motion[:, 1:], motion[:, 0], dt=1 / 120, output_channels=floors, input_channels=table
    )
    method = vb.N4SID(weighting="moesp", block_rows=60, transition="shift")
    known = vb.mechanical_model(vb.refine(vb.identify(record, method, order=6), record))
    found = identify_blind(record.select(inputs=[]), 3, excitation="base")
    assert found.accepted and found.forced_dofs == ("floor1",)
    assert np.isnan(found.normalized_stiffness[0]).all()
    for row in (1, 2):
        assert off(found.normalized_stiffness[row], known.normalized_stiffness[row]) < 0.05
    np.testing.assert_allclose(
        found.normalized_stiffness[1:], known.normalized_stiffness[1:], rtol=0.05
    )
    assert "floor1" in found.verdict.missing[0]
