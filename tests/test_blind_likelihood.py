"""Blind identification by maximum likelihood: exactness, statistics, options, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import vibrid as vb
from studies.blind_records import (
    REFERENCE,
    SINES_HZ,
    decay,
    off,
    reference,
    under_sines,
)
from vibrid.blind import blind_likelihood, forces, identify_blind
from vibrid.blind.forces import seen_band
from vibrid.blind.likelihood.components import Components, Signals, oscillations
from vibrid.blind.likelihood.modal import swinging
from vibrid.blind.likelihood.place import Place

HZ = REFERENCE.frequencies_hz


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


def test_every_record_has_its_own_force() -> None:
    """Phasors and history of each record are those of its own steady state."""
    cases = [reference(0, None), reference(1, None, n_samples=1000)]
    found = blind_likelihood([case.record for case in cases], 3)
    true = np.vstack([case.force for case in cases])
    assert off(found.normalized_force, true) < 1e-9
    for case, phasors in zip(cases, found.force_phasors, strict=True):
        turns = np.exp(2j * np.pi * np.outer(SINES_HZ, 0.02 * np.arange(len(case.force))))
        assert off((phasors @ turns).real.T, case.force) < 1e-9


def test_modes_are_those_of_the_matrices() -> None:
    """Eigenvalues of [𝒦 𝒟] and what its covariance makes of them: as the signals have them."""
    case = reference(2, 50)
    found = blind_likelihood(case.record, 3, shapes="free")
    assert found.parameter_covariance is not None
    P = np.hstack([found.normalized_stiffness, found.normalized_damping])
    poles, _, (hertz, ratios) = swinging(P, found.parameter_covariance)
    order = np.argsort(np.abs(poles))
    np.testing.assert_allclose(poles[order], found.modes.poles, rtol=1e-9)
    np.testing.assert_allclose(hertz[order], found.modes.frequencies_std, rtol=1e-6)
    np.testing.assert_allclose(ratios[order], found.modes.damping_std, rtol=1e-6)
    chained = blind_likelihood(case.record, 3, structure="chain", mass=np.diag(REFERENCE.mass))
    P = np.hstack([chained.normalized_stiffness, chained.normalized_damping])
    poles = swinging(P, np.zeros((18, 18)))[0]
    np.testing.assert_allclose(np.sort(np.abs(poles)), np.abs(chained.modes.poles), rtol=1e-9)


def test_units_of_the_sensors_change_nothing() -> None:
    """Sensors in wildly different units: 𝒦 is turned accordingly, and no rule is broken."""
    case = reference(1, 50)
    units = np.array([1.0, 1e6, 1e-6])
    plain = blind_likelihood(case.record, 3, shapes="free")
    odd = blind_likelihood(vb.Record(case.record.outputs * units, dt=0.02), 3, shapes="free")
    assert odd.accepted
    expected = plain.normalized_stiffness * units[:, None] / units
    np.testing.assert_allclose(odd.normalized_stiffness, expected, rtol=1e-6)
    assert odd.verdict.checks["condition"] < 10


def test_the_offset_is_told() -> None:
    """Each record has an offset of its own, in the direction of its DOF."""
    records = [reference(seed, 60, offset=offset).record for seed, offset in ((0, 3.0), (1, -1.0))]
    offsets = blind_likelihood(records, 3).diagnostics.figures["offsets"]
    np.testing.assert_allclose(offsets, [[3.0] * 3, [-1.0] * 3], atol=0.02)


def test_a_drift_is_neither_mode_nor_force() -> None:
    """Straight or fading drifts of the sensors leave matrices and force as they were, and said."""
    case = reference(3, 50)
    plain = blind_likelihood(case.record, 3)
    t, slope = 0.02 * np.arange(1500), np.array([1.0, -2.0, 0.5])
    for drift in (t, 10 * np.exp(-t / 5)):
        found = blind_likelihood(
            vb.Record(case.record.outputs + np.outer(drift, slope), dt=0.02), 3
        )
        assert found.accepted and any(each.code == "drift" for each in found.verdict.findings)
        np.testing.assert_allclose(found.input_frequencies_hz, SINES_HZ, rtol=1e-2)
        assert off(found.normalized_stiffness, plain.normalized_stiffness) < 1e-3
        assert off(found.normalized_force, plain.normalized_force) < 1e-2


def test_a_sine_that_may_hide_is_said() -> None:
    """At 30 dB the sine of 0.7 Hz is missed in some draws, and the answer says it might be."""
    found = blind_likelihood(reference(6, 30).record, 3)
    assert len(found.input_frequencies_hz) == 4
    said = next(each for each in found.verdict.findings if each.code == "hidden_sines")
    assert float(said.sentence.split("outside ")[1].split(" to")[0]) > 0.7


def test_sines_that_would_be_seen_nowhere_are_doubted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the band that is seen is empty, a doubt says so in words, not with NaN."""
    monkeypatch.setattr(forces, "seen_band", lambda *given, **options: (np.nan, np.nan))
    found = blind_likelihood(reference(6, 30).record, 3)
    said = next(each for each in found.verdict.findings if each.code == "hidden_sines")
    assert said.severity == "doubt" and "nowhere would one with 50 %" in said.sentence
    assert "nan" not in said.sentence


def test_the_seen_band_is_that_of_the_response() -> None:
    """One mass: a sine gains N (size |G|)² / s² of 2 log L, where it is seen."""
    k, d, noise, size = 400.0, 1.0, 0.5, 0.1
    hertz = np.geomspace(0.1, 20, 50)
    w = 2 * np.pi * hertz
    gains = 1000 * (size * np.abs(-(w**2) / (k - w**2 + 1j * w * d))) ** 2 / noise
    for gain in (1.0, 15.0, 30.0):
        band = seen_band(
            np.array([[k, d]]), np.array([2]), np.array([noise]), 1000, hertz, size=size, gain=gain
        )
        assert band == (hertz[gains > gain][0], hertz[gains > gain][-1])


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
    assert np.isfinite(found.diagnostics.figures["candidate_stiffness"]).all()
    assert not any(found.verdict.determined.values())
    assert found.verdict.checks["decay_certainty"] < 5


def test_noise_alone_is_refused(rng: np.random.Generator) -> None:
    """No oscillation at all: R1, nothing is determined, and no sum fails."""
    found = blind_likelihood(vb.Record(rng.standard_normal((1500, 3)), dt=0.02), 3)
    assert found.verdict.rule == "R1"
    assert not any(found.verdict.determined.values())


@pytest.mark.parametrize("options", [{}, {"shapes": "real"}, {"structure": "symmetric"}])
def test_sensors_that_repeat_each_other_are_refused(options: dict[str, str]) -> None:
    """One sensor that follows exactly from others: R7, whatever is asked, and nothing is known."""
    for seed in range(3):
        y = reference(seed, 50).record.outputs
        for extra in (y[:, 0], 2 * y[:, 0], y[:, 0] + y[:, 1]):
            record = vb.Record(np.column_stack([y[:, :2], extra]), dt=0.02)
            found = blind_likelihood(record, 3, **options)
            assert "R7" in {each.rule for each in found.verdict.refusals}
            assert not any(found.verdict.determined.values())


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
def test_free_decay_of_eight_masses() -> None:
    """40 dB, 60 s: M⁻¹K and M⁻¹D (real shapes) within 3e-3."""
    case = decay(8, 40, 1)
    found = identify_blind(case.record, 8, excitation="decay")
    assert found.accepted and found.verdict.kind == "decay"
    assert off(found.normalized_stiffness, case.stiffness) < 3e-3
    assert off(found.normalized_damping, case.damping) < 3e-3
