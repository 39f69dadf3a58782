"""Measured periodic forces: the transient and the steady state in one fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vibrid as vb
from studies.blind_records import (
    REFERENCE,
    SINES_HZ,
    Case,
    off,
    under_measured_force,
    under_sines,
)
from vibrid.blind import identify_blind
from vibrid.blind.coordinates import check_independent
from vibrid.blind.likelihood import blind_measured

HZ = np.array(SINES_HZ)


def driven(seed: int, snr_db: float) -> Case:
    """Return the reference structure from rest under five measured sines on every DOF."""
    rng = np.random.default_rng(seed)
    phasors = np.exp(1j * rng.uniform(0, 6, (3, 5)))
    return under_sines(
        REFERENCE,
        HZ,
        phasors,
        dt=0.02,
        n_samples=1500,
        start=np.zeros(6),
        snr_db=snr_db,
        rng=rng,
        inputs=True,
    )


def test_measured_forces_join_transient_and_steady_state(rng: np.random.Generator) -> None:
    """n = 5, one force, 40 dB: M⁻¹K within 1e-3 and ℬ within 1.5e-3 (medians of 3)."""
    errors = []
    for _ in range(3):
        case, hertz = under_measured_force(5, 40, rng)
        found = blind_measured(case.record, 5, input_frequencies_hz=hertz.tolist())
        assert found.accepted
        errors.append(
            [
                off(found.normalized_stiffness, case.stiffness),
                off(found.normalized_input, np.eye(5)[:, :1]),
            ]
        )
    assert (np.median(errors, axis=0) < [1e-3, 1.5e-3]).all()


def test_measured_forces_without_a_transient(rng: np.random.Generator) -> None:
    """The steady state alone is enough with n + r / 2 frequencies, and refused with fewer."""
    for hertz, accepted in (
        (np.array([0.5, 1.3, 2.2, 3.1, 4.2, 5.0]), True),
        (np.array([1.3, 2.2]), False),
    ):
        phasors = np.zeros((3, len(hertz)), dtype=np.complex128)
        phasors[2] = np.exp(1j * rng.uniform(0, 6, len(hertz)))
        case = under_sines(
            REFERENCE, hertz, phasors, dt=0.02, n_samples=1500, snr_db=60, rng=rng, inputs=True
        )
        found = identify_blind(case.record.select(inputs=["u3"]), 3)
        assert found.accepted is accepted
        if accepted:
            assert off(found.normalized_stiffness, case.stiffness) < 1e-2


def test_everything_carries_its_deviation() -> None:
    """40 dB, 10 runs: matrices, ℬ, modes and force miss by what is predicted."""
    ratios = []
    true = np.linalg.inv(REFERENCE.mass)
    for seed in range(10):
        case = driven(seed, 40)
        found = blind_measured(case.record, 3, input_frequencies_hz=SINES_HZ)
        spread = found.diagnostics.figures["normalized_input_std"]
        hertz = found.modes.frequencies_hz - REFERENCE.frequencies_hz
        ratios.append(
            [
                np.mean(
                    ((found.normalized_stiffness - case.stiffness) / found.normalized_stiffness_std)
                    ** 2
                ),
                np.mean(((found.normalized_input - true) / spread) ** 2),
                np.mean((hertz / found.modes.frequencies_std) ** 2),
                np.mean((found.normalized_force - case.force) ** 2 / found.normalized_force_std**2),
            ]
        )
    size = np.sqrt(np.mean(ratios, axis=0))
    assert ((size > 0.6) & (size < 1.5)).all(), size


def test_forces_are_taken_in_newtons() -> None:
    """Kilonewtons of the opposite sign give the same ℬ [1/kg], and the same force per mass."""
    case = driven(0, 60)
    newtons = [replace(c, unit="N") for c in case.record.input_channels]
    kilo = [replace(c, unit="kN", sign=-1) for c in case.record.input_channels]
    outputs = [replace(c, unit="m/s^2") for c in case.record.output_channels]
    found = [
        blind_measured(
            vb.Record(
                case.record.outputs,
                case.record.inputs * factor,
                dt=case.record.dt,
                output_channels=outputs,
                input_channels=channels,
            ),
            3,
            input_frequencies_hz=SINES_HZ,
        )
        for factor, channels in ((1.0, newtons), (-1e-3, kilo))
    ]
    assert found[0].units == "SI"
    np.testing.assert_allclose(
        found[1].normalized_input, found[0].normalized_input, rtol=1e-6, atol=1e-8
    )
    assert off(found[1].normalized_force, case.force) < 1e-2
    assert off(found[0].normalized_input, np.linalg.inv(REFERENCE.mass)) < 1e-2


def test_records_of_measured_forces_go_together() -> None:
    """Two records sharpen the answer; different inputs, bases and nothing are refused by name."""
    one, two = driven(0, 50), driven(1, 50)
    alone = blind_measured(one.record, 3, input_frequencies_hz=SINES_HZ)
    both = blind_measured([one.record, two.record], 3, input_frequencies_hz=SINES_HZ)
    assert both.accepted and both.force_phasors.shape == (2, 3, 5)
    assert np.linalg.norm(both.normalized_stiffness_std) < np.linalg.norm(
        alone.normalized_stiffness_std
    )
    with pytest.raises(vb.DataError, match="inputs"):
        blind_measured([one.record, two.record.select(inputs=["u1"])], 3)
    with pytest.raises(vb.OptionError, match="empty"):
        blind_measured([], 3)
    based = [replace(c, quantity="base_acceleration") for c in one.record.input_channels]
    moved = vb.Record(one.record.outputs, one.record.inputs, dt=0.02, input_channels=based)
    with pytest.raises(vb.OptionError, match="no force"):
        blind_measured(moved, 3, input_frequencies_hz=SINES_HZ)


def test_one_shaker_at_a_time() -> None:
    """Two records, each under one of two forces, tell both columns of ℬ without a transient."""
    rng = np.random.default_rng(3)
    hertz = np.array([0.5, 1.3, 2.2, 3.1, 4.2, 5.0])
    records = []
    for dof in (0, 2):
        phasors = np.zeros((3, 6), dtype=np.complex128)
        phasors[dof] = np.exp(1j * rng.uniform(0, 6, 6))
        case = under_sines(
            REFERENCE, hertz, phasors, dt=0.02, n_samples=1500, snr_db=60, rng=rng, inputs=True
        )
        records.append(case.record.select(inputs=["u1", "u3"]))
    found = blind_measured(records, 3, input_frequencies_hz=hertz.tolist())
    assert off(found.normalized_stiffness, case.stiffness) < 2e-3
    assert off(found.normalized_input, np.linalg.inv(REFERENCE.mass)[:, [0, 2]]) < 5e-3


def test_inputs_and_sensors_that_tell_nothing_are_refused_by_name() -> None:
    """Dependent, constant and missing inputs are errors; sensors that repeat each other R7."""
    record = driven(0, 50).record
    y, u = record.outputs, record.inputs
    twice = vb.Record(y, np.column_stack([u, u[:, 0]]), dt=0.02)
    with pytest.raises(vb.OptionError, match="not independent"):
        blind_measured(twice, 3)
    with pytest.raises(vb.DataError, match="no sine"):
        blind_measured(vb.Record(y, np.ones((1500, 1)), dt=0.02), 3)
    gap = u.copy()
    gap[7] = np.nan
    with pytest.raises(vb.DataError, match="missing samples"):
        blind_measured(vb.Record(y, gap, dt=0.02), 3)
    found = blind_measured(vb.Record(y[:, [0, 1, 0]], u, dt=0.02), 3)
    assert found.verdict.rule == "R7" and not any(found.verdict.determined.values())


def test_a_response_that_sines_do_not_explain_is_refused(rng: np.random.Generator) -> None:
    """A second, random force that was not measured: R4, not a number."""
    case = driven(0, 60)
    hertz = rng.uniform(0.3, 8.0, 400)
    phasors = rng.standard_normal((3, 400)) + 1j * rng.standard_normal((3, 400))
    other = under_sines(REFERENCE, hertz, phasors / 20, dt=0.02, n_samples=1500, start=np.zeros(6))
    record = vb.Record(case.record.outputs + other.record.outputs, case.record.inputs, dt=0.02)
    found = blind_measured(record, 3, input_frequencies_hz=SINES_HZ)
    assert not found.accepted and found.verdict.rule == "R4"
    assert np.isnan(found.normalized_stiffness).all()


def test_growth_is_refused_without_a_transient_too() -> None:
    """The steady state alone is enough; an oscillation that grows in it still breaks R3."""
    rng = np.random.default_rng(3)
    hertz = np.array([0.5, 1.3, 2.2, 3.1, 4.2, 5.0])
    phasors = np.zeros((3, 6), dtype=np.complex128)
    phasors[2] = np.exp(1j * rng.uniform(0, 6, 6))
    case = under_sines(
        REFERENCE, hertz, phasors, dt=0.02, n_samples=1500, snr_db=60, rng=rng, inputs=True
    )
    steady = case.record.select(inputs=["u3"])
    assert blind_measured(steady, 3, input_frequencies_hz=hertz).accepted
    t = 0.02 * np.arange(1500)
    growing = 0.01 * (np.exp(0.03 * t) * np.sin(2 * np.pi * 3.7 * t))[:, None]
    record = vb.Record(steady.outputs + growing, steady.inputs, dt=0.02)
    found = blind_measured(record, 3, input_frequencies_hz=hertz)
    assert [each.rule for each in found.verdict.refusals] == ["R3"]


def test_dependent_inputs_with_every_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """matrix_rank has no rtol before NumPy 2.0; the check of inputs does without it."""

    def rank_of_1_26(A: np.ndarray, tol: float | None = None, hermitian: bool = False) -> int:
        raise AssertionError("not needed")

    monkeypatch.setattr(np.linalg, "matrix_rank", rank_of_1_26)
    check_independent(np.eye(4)[:, :2])
    for inputs in (np.ones((4, 2)), np.zeros((4, 1))):
        with pytest.raises(vb.OptionError, match="not independent"):
            check_independent(inputs)
