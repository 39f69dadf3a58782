"""Without a force scale: normalized matrices, masses, base motion, delays."""

from __future__ import annotations

import numpy as np
import pytest
from known_fits import error, known_fit, structure_fit

import vibrid as vb
from vibrid import refine
from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.physical import (
    mass_change,
    mass_ratios,
    mechanical_model,
    sensor_delays,
    storey_stiffnesses,
)
from vibrid.record import Channel
from vibrid.structures import Structure, chain, shear_frame


def structure(dashpots=(0.3, 0.6, 0.1)) -> Structure:
    return chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], dashpots=list(dashpots))


def output_only(true: Structure, sensors="acceleration") -> vb.Fit:
    """Return the exact fit of a structure without inputs."""
    fit = structure_fit(true, sensors, [true.dofs[0]])
    m = fit.model
    model = vb.StateSpace(m.A, m.B[:, :0], m.C, m.D[:, :0], m.dt)
    return known_fit(model, fit.output_channels)


# -- output-only


@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_normalized_matrices_of_output_only_models(quantity):
    """M⁻¹K and M⁻¹R from poles and shapes; M, R, K are NaN and what is missing is named."""
    true = structure()
    found = mechanical_model(output_only(true, quantity))
    assert error(found.normalized_stiffness, np.linalg.solve(true.mass, true.stiffness)) < 1e-10
    assert error(found.normalized_damping, np.linalg.solve(true.mass, true.damping)) < 1e-9
    assert np.isnan(found.mass).all() and np.isnan(found.stiffness).all()
    assert found.verdict.kind == "normalized"
    assert found.verdict.missing == ("no co-located pair: add a force at f1",)
    assert not found.verdict.determined["mass"]
    assert found.verdict.determined["normalized_stiffness"]


def test_free_decays_through_ssi(rng):
    """A noise-free decay, by SSI: M⁻¹K to 1e-8."""
    true = structure()
    record = true.simulate(None, 0.04, n_samples=2000, initial_state=rng.standard_normal(6))
    fit = vb.identify(record, vb.SSI(kind="data", block_rows=10), 6)
    found = mechanical_model(fit)
    assert error(found.normalized_stiffness, np.linalg.solve(true.mass, true.stiffness)) < 1e-8


def test_masses_make_matrices():
    """One a DOF, the matrix, or the total, which the data share out."""
    true = structure()
    fit = output_only(true)
    for mass in (np.diag(true.mass), true.mass, 4.5):
        found = mechanical_model(fit, mass=mass)
        assert error(found.mass, true.mass) < 1e-9
        assert error(found.stiffness, true.stiffness) < 1e-9
        assert error(found.damping, true.damping) < 1e-8
        assert found.verdict.determined["stiffness"]
    np.testing.assert_allclose(found.mass_ratios, [1, 0.75, 0.5], rtol=1e-9)
    np.testing.assert_allclose(storey_stiffnesses(found.stiffness), [500, 700, 600], rtol=1e-9)


def test_wrong_masses_are_seen():
    """With masses that are not the structure's, K is not symmetric, and the verdict says it."""
    found = mechanical_model(output_only(structure()), mass=[2.0, 0.2, 4.0])
    assert found.verdict.checks["asymmetry_stiffness"] > 0.5
    assert not found.verdict.accepted
    with pytest.raises(OptionError, match=r"3 masses or a 3 × 3 matrix; got shape .2,."):
        mechanical_model(output_only(structure()), mass=[1.0, 1.0])
    with pytest.raises(OptionError, match="must be positive"):
        mechanical_model(output_only(structure()), mass=[1.0, -1.0, 1.0])
    with pytest.raises(OptionError, match="positive definite"):
        mechanical_model(output_only(structure()), mass=-np.eye(3))


def test_ratios_that_the_data_do_not_tell():
    """Two DOFs without coupling have no mass ratio, and a total is then not enough."""
    apart = chain([1.0, 2.0], [300.0, 0.0, 500.0], dashpots=[0.1, 0.0, 0.2])
    assert np.isnan(mass_ratios(np.diag([3.0, 2.0]))).all()
    with pytest.raises(OptionError, match="do not tell the ratios"):
        mechanical_model(output_only(apart), mass=3.0)


def added(true: Structure, more: np.ndarray) -> Structure:
    return Structure(true.mass + np.diag(more), true.damping, true.stiffness)


def test_mass_change_is_exact():
    """One added mass, large or small, gives the mass matrix; mode by mode to first order."""
    true = structure()
    before = mechanical_model(output_only(true))
    for kilograms in (0.01, 1.0):
        changed = added(true, np.array([0.0, 0.0, kilograms]))
        after = mechanical_model(output_only(changed))
        found = mass_change(before, after, {"f3": kilograms})
        assert error(found.mass, true.mass) < 1e-7
        assert found.misfit < 1e-7
    again = mechanical_model(output_only(true), mass=found.mass)
    assert error(again.stiffness, true.stiffness) < 1e-7


def test_mass_change_of_single_modes():
    """A small mass: modal masses within the first order in it, sensors at some DOFs only."""
    true = structure()
    after = added(true, np.array([0.0, 0.0, 0.005]))
    sensors = [("acceleration", "f1"), ("acceleration", "f3")]
    models = [
        mechanical_model(output_only(each, sensors), frequencies_hz=true.frequencies_hz[:2])
        for each in (true, after)
    ]
    found = mass_change(*models, {"f3": 0.005})
    shapes = true.shapes[:, :2].real
    shapes = shapes / np.abs(shapes[[0, 2]]).max(axis=0)
    np.testing.assert_allclose(
        found.modal_masses, np.diag(shapes.T @ true.mass @ shapes), rtol=0.02
    )


def test_mass_change_refuses():
    """Masses elsewhere or negative, models that are swapped, and other DOFs."""
    true = structure()
    before = mechanical_model(output_only(true))
    after = mechanical_model(output_only(added(true, np.array([0.1, 0.0, 0.0]))))
    with pytest.raises(OptionError, match="No DOF is called 'f9'"):
        mass_change(before, after, {"f9": 0.1})
    with pytest.raises(OptionError, match="the mass added at f1 must be positive"):
        mass_change(before, after, {"f1": -0.1})
    with pytest.raises(DataError, match="does not sink"):
        mass_change(after, before, {"f1": 0.1})


# -- standard deviations


def test_deviations_are_those_of_the_modes(rng):
    """As many samples of independent modes give, by a plain loop; K's follow with the masses."""
    true = structure()
    record = true.simulate(white_noise(1000, rng=rng), 0.04, forces=["f3"], noise=0.02, rng=rng)
    fit = refine(vb.identify(record, vb.N4SID(block_rows=10), 6), record, noise="output_error")
    found = mechanical_model(fit, inputs=[], mass=true.mass)
    figures, modes = fit.diagnostics.figures, vb.modes_of(fit)
    stiffnesses = []
    for _ in range(1000):
        w = 2 * np.pi * modes.frequencies_hz
        w = w + 2 * np.pi * figures["frequencies_std"] * rng.standard_normal(3)
        ratios = modes.damping_ratios + figures["damping_std"] * rng.standard_normal(3)
        poles = w * (-ratios + 1j * np.sqrt(1 - ratios**2))
        turn = rng.standard_normal((3, 3)) + 1j * rng.standard_normal((3, 3))
        shapes = modes.shapes + figures["shapes_std"] * turn / np.sqrt(2)
        X = np.vstack([shapes, shapes * poles])
        N = -np.hstack([shapes * poles**2, (shapes * poles**2).conj()]) @ np.linalg.inv(
            np.hstack([X, X.conj()])
        )
        stiffnesses.append(N[:, :3].real)
    seen = np.std(stiffnesses, axis=0)
    np.testing.assert_allclose(found.normalized_stiffness_std, seen, rtol=0.15)
    product = np.array([true.mass @ each for each in stiffnesses])
    seen = np.std(0.5 * (product + product.transpose(0, 2, 1)), axis=0)
    np.testing.assert_allclose(found.stiffness_std, seen, rtol=0.15)
    assert np.isnan(mechanical_model(fit).stiffness_std).all()  # with a scale: not known


@pytest.mark.slow
def test_deviations_are_those_of_many_records():
    """Of 60 records, within 40 % for every entry of M⁻¹K and M⁻¹R."""
    true = chain([2.0, 1.5, 1.0], [900.0, 700.0, 600.0], rayleigh=(0.1, 4e-4))
    matrices, deviations = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        u = white_noise(3000, rng=rng)
        record = true.simulate(u, 0.02, forces=["f3"], noise=0.02, rng=rng)
        start = vb.identify(record, vb.N4SID(block_rows=15), 6)
        found = mechanical_model(refine(start, record, noise="output_error"), inputs=[])
        matrices.append([found.normalized_stiffness, found.normalized_damping])
        deviations.append([found.normalized_stiffness_std, found.normalized_damping_std])
    ratio = np.mean(deviations, axis=0) / np.std(matrices, axis=0)
    assert ratio.min() > 0.7 and ratio.max() < 1.4


# -- base excitation


@pytest.mark.parametrize("absolute", [True, False])
@pytest.mark.parametrize(("hold", "limit"), [("zoh", 1e-8), ("band_limited", 1e-2)])
def test_base_motion_through_n4sid(absolute, hold, limit, rng):
    """Absolute or relative accelerations, all but the scale: to rounding for a held motion.

    White noise up to the Nyquist frequency is the hardest band-limited motion there is: no
    model of finite order follows it exactly between the samples.
    """
    true = shear_frame(3, [2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.3, 4e-4))
    u = white_noise(4000, rng=rng)
    record = true.simulate(u - u.mean(), 0.04, base=True, absolute=absolute, hold=hold)
    fit = vb.identify(record, vb.N4SID(block_rows=12), 6, feedthrough=True)
    found = mechanical_model(fit, mass=4.5, hold=hold)
    assert error(found.normalized_stiffness, np.linalg.solve(true.mass, true.stiffness)) < limit
    assert error(storey_stiffnesses(found.stiffness), np.array([500.0, 700.0, 600.0])) < limit
    assert found.verdict.checks["transfer"] < 10 * limit
    motion = "absolute" if absolute else "relative"
    assert any(motion in each.sentence for each in found.verdict.findings)


def late(fit: vb.Fit, seconds: np.ndarray) -> vb.Fit:
    """Return the fit with outputs that lag: each mode's row times e^{−λτ}."""
    values, vectors = np.linalg.eig(fit.model.A)
    poles = np.log(values) / fit.model.dt
    C = (fit.model.C @ vectors) * np.exp(-np.outer(seconds, poles)) @ np.linalg.inv(vectors)
    m = fit.model
    model = vb.StateSpace(m.A, m.B, C.real, m.D, m.dt)
    return known_fit(model, fit.output_channels, fit.input_channels)


def test_delays_are_found_reported_and_set_right():
    """Sensors 2 ms late and 1 ms early are found to a microsecond and set right on request."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.05, 1e-4))
    seconds = np.array([0.0, 2e-3, -1e-3])
    fit = late(structure_fit(true, "acceleration", base=True), seconds)
    exact = np.linalg.solve(true.mass, true.stiffness)
    plain = mechanical_model(fit)
    np.testing.assert_allclose(plain.delays.seconds, seconds, atol=1e-6)
    assert any(
        each.code == "delays" and "delays=True" in each.cure for each in plain.verdict.findings
    )
    assert plain.delays.phase_collinearity.min() < 0.999
    right = mechanical_model(fit, delays=True)
    assert error(right.normalized_stiffness, exact) < 1e-4
    assert vb.mpc(right.shapes).min() > 0.999999
    named = mechanical_model(fit, delays={"acceleration_f2": 2e-3, "acceleration_f3": -1e-3})
    assert any("2 ms were taken off as given" in str(each) for each in named.verdict.findings)
    assert error(named.normalized_stiffness, exact) < 1e-9
    with pytest.raises(OptionError, match="No output is called"):
        mechanical_model(fit, delays={"a2": 1e-3})


def test_a_common_lag_behind_the_base():
    """All floors 1 ms late against the table: seen in the participations, not in the shapes."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.05, 1e-4))
    fit = late(structure_fit(true, "acceleration", base=True), np.full(3, 1e-3))
    found = mechanical_model(fit)
    delays = found.delays
    assert any(each.code == "common_delay" for each in found.verdict.findings)
    np.testing.assert_allclose(delays.common, 1e-3, rtol=0.02)
    assert delays.imaginary > 3 * delays.corrected_imaginary
    np.testing.assert_allclose(delays.seconds, 0, atol=1e-6)


def test_a_common_lag_behind_the_forces():
    """It spoils the scale, R most of all; it is found, reported and set right on request."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.05, 1e-4))
    fit = late(structure_fit(true, "acceleration", ["f1"]), np.array([1e-3, 1e-3, 3e-3]))
    plain, right = mechanical_model(fit), mechanical_model(fit, delays=True)
    assert error(plain.damping, true.damping) > 0.5
    assert [e.severity for e in plain.verdict.findings if e.code == "common_delay"] == ["doubt"]
    np.testing.assert_allclose(right.delays.common, 1e-3, rtol=1e-6)
    assert error(right.damping, true.damping) < 1e-6
    assert error(right.stiffness, true.stiffness) < 1e-8


def test_damping_is_not_set_right_for_delays_unseen():
    """Phases of damping that is not proportional, taken off on request, are a doubt."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], dashpots=[0.8, 0.5, 0.4])
    found = mechanical_model(structure_fit(true, "acceleration", ["f1"]), delays=True)
    assert [each.code for each in found.verdict.findings] == ["delays_unclear"]
    assert error(found.damping, true.damping) > 0.05


def test_a_wrong_hold_looks_like_half_a_sample():
    """Band-limited forces taken as held: half a sample of lead behind the forces."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.05, 1e-4))
    channels = structure_fit(true, "acceleration", ["f1"])
    model = true.state_space("acceleration", ["f1"]).to_discrete(0.01, "band_limited")
    found = mechanical_model(
        model, outputs=channels.output_channels, inputs=channels.input_channels
    )
    np.testing.assert_allclose(found.delays.common, -0.005, rtol=0.01)
    assert any("another hold" in each.cure for each in found.verdict.findings)


def test_no_delay_is_claimed_where_there_is_none():
    """Proportional damping: nothing found. One mode: nothing estimated, asking for it refused."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.05, 1e-4))
    found = mechanical_model(output_only(true))
    assert not any(each.code == "delays" for each in found.verdict.findings)
    shapes, poles = true.shapes, true.poles
    channels = [Channel(f"a{k}") for k in range(3)]
    np.testing.assert_allclose(sensor_delays(shapes, poles, channels).seconds, 0, atol=1e-8)
    one = chain([1.0], [100.0], damping_ratio=0.01)
    with pytest.raises(OptionError, match="at least two sensors and two modes"):
        mechanical_model(output_only(one), delays=True)


# -- the shake table


def table_record(shared_data) -> vb.Record:
    data = np.load(shared_data / "three_story_frame.npz")
    motion = data["acc"][:, :, 0]
    motion = motion - motion.mean(axis=0)
    floors = [Channel(f"floor{k}", "acceleration", "m/s2", f"floor{k}") for k in (1, 2, 3)]
    table = [Channel("table", "base_acceleration", "m/s2")]
    return vb.Record(
        motion[:, 1:], motion[:, 0], dt=1 / 120, output_channels=floors, input_channels=table
    )


@pytest.mark.parametrize(
    ("noise", "limit"), [(None, 0.02), ("innovations", 0.02), ("output_error", 0.005)]
)
def test_three_storey_frame_on_a_shake_table(shared_data, noise, limit):
    """Delays, M⁻¹K, storey stiffnesses and the verdict on damping, from the real record."""
    record = table_record(shared_data)
    method = vb.N4SID(weighting="moesp", block_rows=60, transition="shift")
    fit = vb.identify(record, method, 6)
    wall = 0.036  # kg per storey, shape of a beam with both ends held
    mass = np.diag([0.124 + 26 * wall / 35] * 2 + [0.124 + 13 * wall / 35])
    mass += 9 * wall / 70 * (np.eye(3, k=1) + np.eye(3, k=-1))
    if noise is not None:
        fit = refine(fit, record, noise=noise)
    found = mechanical_model(fit, mass=mass, delays=True)
    reference = [[6303.0, -3315, 222], [-3283, 6522, -3446], [325, -3801, 3475]]
    assert error(found.normalized_stiffness, np.array(reference)) < limit
    springs = storey_stiffnesses(found.stiffness)
    np.testing.assert_allclose(springs, [466, 467, 497], rtol=limit + 0.01)
    assert found.verdict.checks["asymmetry_stiffness"] < 0.02
    np.testing.assert_allclose(found.delays.seconds[2], 2.0e-3, atol=0.15e-3)
    assert vb.mpc(found.shapes).min() > 0.999
    assert not found.verdict.determined["normalized_damping"]
    assert any("M⁻¹R is not determined" in str(each) for each in found.verdict.findings)
    assert 0.85 < found.mass_ratios[2] < 0.95
    if noise == "output_error":
        np.testing.assert_allclose(found.delays.common, 1.15e-3, atol=0.1e-3)
        assert found.delays.imaginary > 0.03 and found.delays.corrected_imaginary < 0.01
