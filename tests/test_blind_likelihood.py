"""Blind identification by maximum likelihood: exactness, statistics, options, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from blind_records import (
    REFERENCE,
    SINES_HZ,
    Case,
    off,
    reference,
    under_sines,
    uniform_chain,
)

import vibrid as vb
from vibrid.blind import blind_likelihood, identify_blind
from vibrid.blind.likelihood import blind_measured
from vibrid.blind.likelihood.components import Components, Signals, oscillations
from vibrid.blind.likelihood.place import Place

HZ = REFERENCE.frequencies_hz


def decay(n_dof: int, snr_db: float, seed: int) -> Case:
    """Return a free decay after velocity impulses, 60 s at 100 Hz."""
    rng = np.random.default_rng(seed)
    start = np.concatenate([np.zeros(n_dof), rng.standard_normal(n_dof)])
    nothing = np.zeros((n_dof, 1), dtype=np.complex128)
    return under_sines(
        uniform_chain(n_dof),
        np.array([1.0]),
        nothing,
        dt=0.01,
        n_samples=6000,
        start=start,
        snr_db=snr_db,
        rng=rng,
    )


def place_of(rng: np.random.Generator) -> Place:
    """Return two oscillations near noisy data, one of real shape."""
    y = rng.standard_normal((300, 2)) + np.sin(np.arange(300) * 0.3)[:, None]
    yes, no = np.array([True, True]), np.array([False, True])
    c = Components(np.array([2.9, 6.0]), np.array([0.1, 0.4]), yes, no, np.array([[0.0, 0.3]]))
    return Place(c, Signals((y,), 0.1, np.array([11.0])))


def test_oscillations_are_products_of_short_runs(rng: np.random.Generator) -> None:
    """The lifted exponentials equal the plain ones."""
    place = place_of(rng)
    t = 0.1 * np.arange(300)
    plain = np.exp(place.components.poles[:, None] * t + 1j * place.components.phases[0][:, None])
    np.testing.assert_allclose(oscillations(place.components, 0, 300, 0.1), plain, atol=1e-13)


def test_the_slope_is_that_of_the_cost(rng: np.random.Generator) -> None:
    """Kaufman's gradient equals differences of −2 log L, for ω, σ and φ."""
    place = place_of(rng)
    h = 1e-5
    for k in (0, 1, 2, 3, 5):
        step = h * (np.arange(6) == k)
        slope = (place.moved(step).cost - place.moved(-step).cost) / (2 * h)
        assert slope == pytest.approx(2 * place.gradient[k], rel=1e-5, abs=1e-6)


def test_the_errors_are_those_of_plain_least_squares(rng: np.random.Generator) -> None:
    """Amplitudes and Σ e² from the factor equal a direct fit."""
    place = place_of(rng)
    y = place.signals.samples[0]
    t = 0.1 * np.arange(300)
    z = oscillations(place.components, 0, 300, 0.1)
    columns = [z[0].real, z[1].real, z[0].imag, np.cos(11 * t), np.sin(11 * t), np.ones(300)]
    table = np.column_stack(columns)
    left = y - table @ np.linalg.lstsq(table, y, rcond=None)[0]
    np.testing.assert_allclose(place.residual(0), left, atol=1e-11)
    np.testing.assert_allclose(place.parts[0].squares, (left**2).sum(axis=0), rtol=1e-11)


@pytest.mark.parametrize(
    ("snr_db", "stiffness", "damping", "force"),
    [(None, 1e-10, 1e-10, 1e-10), (200, 1e-10, 1e-8, 1e-8), (120, 5e-7, 1e-4, 2e-5)],
)
def test_reference_example_to_rounding(
    snr_db: float | None, stiffness: float, damping: float, force: float
) -> None:
    """Order, frequencies and offset unknown: all is found to what the noise allows."""
    case = reference(0, snr_db, offset=3.0)
    found = identify_blind(case.record, 3)
    assert found.accepted and found.verdict.kind == "periodic"
    np.testing.assert_allclose(found.input_frequencies_hz, SINES_HZ, rtol=1e-6)
    assert off(found.normalized_stiffness, case.stiffness) < stiffness
    assert off(found.normalized_damping, case.damping) < damping
    assert off(found.normalized_force, case.force) < force


def test_known_frequencies_and_modes(rng: np.random.Generator) -> None:
    """Given frequencies are kept, and modes carry deviations that fit their errors."""
    case = reference(1, 40)
    found = blind_likelihood(case.record, 3, input_frequencies_hz=SINES_HZ)
    assert found.accepted
    assert found.input_frequencies_hz.tolist() == list(SINES_HZ)
    z = (found.modes.frequencies_hz - HZ) / found.modes.frequencies_std
    assert np.abs(z).max() < 4
    assert off(found.normalized_stiffness, case.stiffness) < 5e-3


def test_held_forces() -> None:
    """A force held between samples is found with hold='zoh' only; matrices do not feel it."""
    case = reference(0, None)
    model = REFERENCE.state_space(forces=REFERENCE.dofs)
    held = model.to_discrete(0.02).simulate(
        case.force @ REFERENCE.mass, np.array([0.1, -0.1, 0.05, 0, 0, 0])
    )
    record = vb.Record(held, dt=0.02)
    found = {hold: blind_likelihood(record, 3, hold=hold) for hold in ("zoh", "band_limited")}
    assert off(found["zoh"].normalized_stiffness, case.stiffness) < 1e-10
    assert off(found["zoh"].normalized_force, case.force) < 1e-8
    assert off(found["band_limited"].normalized_force, case.force) > 0.1


def test_mixed_sensors() -> None:
    """Displacement, velocity and acceleration together give the same matrices."""
    structure, n = REFERENCE, 3
    start = np.array([0.1, 0.0, -0.1, 0.3, 0.2, 0.1])
    sensors = [("displacement", "f1"), ("velocity", "f2"), ("acceleration", "f3")]
    record = structure.simulate(None, 0.02, sensors=sensors, initial_state=start, n_samples=1500)
    found = blind_likelihood(record, n)
    K = np.linalg.solve(structure.mass, structure.stiffness)
    assert found.accepted and found.verdict.kind == "decay"
    assert off(found.normalized_stiffness, K) < 1e-9
    with pytest.raises(vb.OptionError, match="one quantity"):
        blind_likelihood(record, n, shapes="real")


def test_several_records_share_the_structure() -> None:
    """Four records give half the error of one, and their forces stand in a row."""
    cases = [reference(seed, 40) for seed in range(4)]
    alone = [blind_likelihood(case.record, 3, shapes="free") for case in cases]
    together = blind_likelihood([case.record for case in cases], 3, shapes="free")
    stds = [np.linalg.norm(each.normalized_stiffness_std) for each in alone]
    expected = 1 / np.sqrt(np.sum(1 / np.square(stds)))
    assert np.linalg.norm(together.normalized_stiffness_std) < 1.3 * expected
    assert off(together.normalized_stiffness, cases[0].stiffness) < 4 * expected / np.linalg.norm(
        cases[0].stiffness
    )
    assert together.normalized_force.shape == (6000, 3)


def test_known_masses_and_topology_sharpen() -> None:
    """Masses and a chain lower the deviations; a structure that is wrong is doubted."""
    case = reference(2, 40)
    free = blind_likelihood(case.record, 3, shapes="free")
    masses = np.diag(REFERENCE.mass)
    known = blind_likelihood(case.record, 3, structure="chain", mass=masses)
    ratios = blind_likelihood(case.record, 3, structure="symmetric")
    sizes = [np.linalg.norm(each.normalized_stiffness_std) for each in (known, ratios, free)]
    assert sizes[0] < sizes[1] < sizes[2]
    assert known.stiffness is not None
    assert off(known.stiffness, REFERENCE.stiffness) < 2e-3
    assert abs(known.stiffness[0, 2]) == 0
    assert not any(each.code == "structure_doubt" for each in known.verdict.findings)
    wrong = vb.physical.Topology(damping="diagonal", stiffness="diagonal")
    doubted = blind_likelihood(case.record, 3, structure=wrong, mass=masses)
    assert any(each.code == "structure_doubt" for each in doubted.verdict.findings)


def test_measured_forces_join_transient_and_steady_state(rng: np.random.Generator) -> None:
    """n = 5, one force, 40 dB: M⁻¹K within 1e-3 and ℬ within 1.5e-3 (medians of 3)."""
    structure, errors = uniform_chain(5), []
    hertz = 0.5 * np.arange(1, 17)
    for _ in range(3):
        phasors = np.zeros((5, 16), dtype=np.complex128)
        phasors[0] = np.exp(1j * rng.uniform(0, 2 * np.pi, 16))
        case = under_sines(
            structure,
            hertz,
            phasors,
            dt=0.01,
            n_samples=6000,
            start=np.zeros(10),
            snr_db=40,
            rng=rng,
            inputs=True,
        )
        found = blind_measured(
            case.record.select(inputs=["u1"]), 5, input_frequencies_hz=hertz.tolist()
        )
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


def test_no_transient_is_refused(rng: np.random.Generator) -> None:
    """A steady state says nothing of the structure: R1, NaN matrices, the figures kept."""
    phasors = np.exp(1j * rng.uniform(0, 6, (3, 5)))
    case = under_sines(
        REFERENCE, np.array(SINES_HZ), phasors, dt=0.02, n_samples=1500, snr_db=50, rng=rng
    )
    found = identify_blind(case.record, 3)
    assert not found.accepted and found.verdict.rule == "R1"
    assert np.isnan(found.normalized_stiffness).all()
    assert np.isnan(found.normalized_force).all()
    assert found.verdict.checks["decay_certainty"] < 5


def test_damping_is_left_out_where_it_is_not_determined() -> None:
    """At 30 dB and free shapes M⁻¹K stands and M⁻¹D is NaN, with the reason."""
    case = reference(1, 30)
    found = blind_likelihood(case.record, 3, shapes="free")
    assert found.accepted
    assert np.isnan(found.normalized_damping).all()
    assert off(found.normalized_stiffness, case.stiffness) < 0.02
    assert not found.verdict.determined["normalized_damping"]
    assert any("M⁻¹D" in each for each in found.verdict.missing)


def test_options_that_do_not_fit_are_refused_by_name() -> None:
    """Counts, names and frequencies are checked before any work."""
    record = reference(0, 60).record
    with pytest.raises(vb.OptionError, match="n_dof=2"):
        identify_blind(record, 2)
    with pytest.raises(vb.OptionError, match="periodic"):
        identify_blind(record, 3, excitation="periodical")
    with pytest.raises(vb.OptionError, match="25 Hz"):
        identify_blind(record, 3, input_frequencies_hz=[30.0])
    for options in ({"method": "subspace"}, {"excitation": "base"}, {"excitation": "ambient"}):
        with pytest.raises(vb.OptionError, match="structure= is not used"):
            identify_blind(record, 3, structure="chain", **options)
    with pytest.raises(vb.OptionError, match="shapes='real' is not used"):
        identify_blind(record, 3, shapes="real", excitation="point")
    moved = vb.Record(
        record.outputs,
        record.outputs[:, 0],
        dt=record.dt,
        input_channels=[vb.Channel("table", "base_acceleration")],
    )
    with pytest.raises(vb.OptionError, match="no force"):
        identify_blind(moved, 3)
    with pytest.raises(vb.DataError, match="samples"):
        identify_blind(record.slice(0, 30), 3)


def test_progress_is_told() -> None:
    """The callback hears of every oscillation."""
    heard: list[tuple[str, int, int]] = []
    identify_blind(reference(0, 60).record, 3, progress=lambda *call: heard.append(call))
    assert [done for what, done, _ in heard if what == "oscillations"][:3] == [0, 1, 2]


def within(structure_hz: np.ndarray, found: vb.Modes) -> bool:
    """Tell whether all frequencies are within 2 %."""
    return len(found.poles) == 3 and bool(
        np.abs(np.sort(found.frequencies_hz) / structure_hz - 1).max() < 0.02
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("snr_db", "limit", "right"), [(60, 2e-4, 12), (40, 2e-3, 12), (30, 6e-3, 11), (20, 2e-2, 10)]
)
def test_reference_example_in_noise(snr_db: float, limit: float, right: int) -> None:
    """Order not given, 12 of the 30 runs: medians and right poles (binomial band of 27/30)."""
    cases = [reference(seed, snr_db) for seed in range(12)]
    runs = [blind_likelihood(case.record, 3, shapes="free") for case in cases]
    candidates = [
        run.diagnostics.figures.get("candidate_stiffness", run.normalized_stiffness) for run in runs
    ]
    errors = [off(K, case.stiffness) for K, case in zip(candidates, cases, strict=True)]
    assert np.nanmedian(errors) < limit
    assert sum(within(HZ, run.modes) for run in runs) >= right


@pytest.mark.slow
def test_deviations_are_calibrated() -> None:
    """40 dB, 12 runs: errors are as large as predicted."""
    ratios, parts = [], []
    for seed in range(12):
        case = reference(seed, 40)
        found = blind_likelihood(case.record, 3, shapes="free")
        error = np.abs(found.normalized_stiffness - case.stiffness)
        ratios.append(np.sum(error**2) / np.sum(found.normalized_stiffness_std**2))
        parts += (error / found.normalized_stiffness_std).ravel().tolist()
    assert 0.6 < np.sqrt(np.mean(ratios)) < 1.5
    assert 0.45 < np.median(parts) < 0.95


@pytest.mark.slow
@pytest.mark.parametrize("n_dof", [3, 5, 8])
def test_real_shapes_make_damping_practical(n_dof: int) -> None:
    """Proportional chains at 40 dB: M⁻¹D and M⁻¹K within 2e-2, and real shapes are taken."""
    rng = np.random.default_rng(n_dof)
    phasors = np.exp(1j * rng.uniform(0, 6, (n_dof, n_dof + 2)))
    case = under_sines(
        uniform_chain(n_dof),
        np.sort(rng.uniform(0.4, 12, n_dof + 2)),
        phasors,
        dt=0.01,
        n_samples=6000,
        start=np.zeros(2 * n_dof),
        snr_db=40,
        rng=rng,
    )
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
def test_free_decay_of_eight_masses() -> None:
    """40 dB, 60 s: M⁻¹K and M⁻¹D (real shapes) within 3e-3."""
    case = decay(8, 40, 1)
    found = identify_blind(case.record, 8, excitation="decay")
    assert found.accepted and found.verdict.kind == "decay"
    assert off(found.normalized_stiffness, case.stiffness) < 3e-3
    assert off(found.normalized_damping, case.damping) < 3e-3
