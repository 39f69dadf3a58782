"""M, R, K in physical coordinates: exact where the layout allows, known answers, noise."""

from __future__ import annotations

import numpy as np
import pytest
from known_fits import error, errors, general, proportional, structure_fit

import vibrid as vb
from vibrid.errors import OptionError
from vibrid.excitation import white_noise
from vibrid.mechanics import modal_damping
from vibrid.methods import ERA, ERADC, OKID
from vibrid.physical import mechanical_model
from vibrid.record import Channel
from vibrid.structures import Structure, chain

EXACT = 1e-8  # relative, promised for noise-free data; of known models 1e-12 is measured
SENSORS = ("displacement", "velocity", "acceleration")


# -- known models


@pytest.mark.parametrize("make", [proportional, general])
@pytest.mark.parametrize("quantity", SENSORS)
@pytest.mark.parametrize("n", [1, 2, 3, 8])
def test_known_models_give_their_matrices(make, quantity, n):
    """Each kind of sensor at every DOF and one force: M, R and K to rounding, checks at zero."""
    true = make(n)
    found = mechanical_model(structure_fit(true, quantity, ["f1"]))
    assert max(errors(found, true)) < 1e-9
    checks = found.verdict.checks
    assert checks["orthogonality"] < 1e-12 and checks["transfer"] < 1e-10
    assert checks["poles"] < 1e-10 and checks["asymmetry_damping"] < 1e-9
    assert found.verdict.kind == "full" and found.verdict.accepted
    assert all(found.verdict.determined.values())


@pytest.mark.parametrize(
    ("sensors", "forces"),
    [
        ([("displacement", "f1"), ("velocity", "f2"), ("acceleration", "f3")], ["f2"]),
        ([("acceleration", "f2")], ["f1", "f2", "f3"]),
        ([("velocity", "f1"), ("acceleration", "f3")], ["f2", "f3"]),
        ([("acceleration", "f1"), ("displacement", "f1"), ("velocity", "f2")], ["f3", "f1", "f2"]),
    ],
)
@pytest.mark.parametrize("make", [proportional, general])
def test_mixed_layouts(sensors, forces, make):
    """Sensors of several kinds, one sensor with all forces, two sensors at a DOF."""
    true = make(3)
    found = mechanical_model(structure_fit(true, sensors, forces))
    order = [found.dofs.index(dof) for dof in true.dofs]
    for name in ("mass", "damping", "stiffness"):
        matrix = getattr(found, name)[np.ix_(order, order)]
        assert error(matrix, getattr(true, name)) < 1e-10


@pytest.mark.parametrize("hold", ["zoh", "foh", "band_limited", None])
def test_every_hold_and_continuous_models(hold):
    """The inverse is exact for the hold that the input had; a wrong one is seen."""
    true = general(3)
    channels = structure_fit(true, "acceleration", ["f1"])
    model = true.state_space("acceleration", ["f1"])
    model = model if hold is None else model.to_discrete(0.01, hold)
    labels = {"outputs": channels.output_channels, "inputs": channels.input_channels}
    assert max(errors(mechanical_model(model, hold=hold, **labels), true)) < 1e-10
    if hold == "band_limited":
        wrong = mechanical_model(model, hold="zoh", **labels)
        assert wrong.verdict.checks["orthogonality"] > 1e-3


def test_signs_and_basis_do_not_matter(rng):
    """A sensor or shaker against its DOF, channels in another order, another state basis."""
    true = general(3)
    sensors = [Channel(f"a{k}", "acceleration", dof=f"f{k}", sign=s) for k, s in ((3, 1), (1, -1))]
    sensors.append(Channel("a2", "acceleration", dof="f2"))
    exact = true.state_space(sensors, ["f1"])
    turned = exact.transform(rng.standard_normal((6, 6)))
    model = vb.StateSpace(turned.A, -turned.B, turned.C, -turned.D, None).to_discrete(0.01)
    force = [Channel("shaker", "force", dof="f1", sign=-1)]
    found = mechanical_model(model, outputs=sensors, inputs=force)
    assert found.dofs == ("f3", "f1", "f2")
    order = [1, 2, 0]
    assert error(found.stiffness[np.ix_(order, order)], true.stiffness) < 1e-8
    assert error(found.mass[np.ix_(order, order)], true.mass) < 1e-8


def test_units_become_si():
    """g and kN come out as kg and N/m; no units are called consistent; half of them refuses."""
    true = proportional(2)
    fit = structure_fit(true, "acceleration", ["f1"])
    per_g = vb.StateSpace(
        fit.model.A, fit.model.B * 1e3, fit.model.C / 9.80665, fit.model.D * 1e3 / 9.80665, 0.01
    )
    outputs = [Channel(f"a{k}", "acceleration", "g", f"f{k}") for k in (1, 2)]
    found = mechanical_model(
        per_g, outputs=outputs, inputs=[Channel("shaker", "force", "kN", "f1")]
    )
    assert max(errors(found, true)) < 1e-10 and found.units == "SI"
    bare = [Channel(c.name, c.quantity, dof=c.dof) for c in fit.channels]
    found = mechanical_model(fit, outputs=bare[1:], inputs=bare[:1])
    assert found.units == "consistent units"
    assert "consistent units" in str([str(each) for each in found.verdict.findings])
    with pytest.raises(OptionError, match=r"'force_f1' .* no unit"):
        mechanical_model(fit, inputs=bare[:1])


def test_twenty_masses():
    """Many close modes and one pair: M, R and K to 1e-9."""
    true = general(20)
    assert max(errors(mechanical_model(structure_fit(true, "acceleration", ["f20"])), true)) < 1e-9


def test_no_damping_is_no_finding():
    """Of a structure without damping R is rounding, which nobody should worry about."""
    true = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0])
    found = mechanical_model(structure_fit(true, "acceleration", ["f1"]))
    assert found.verdict.findings == () and all(found.verdict.determined.values())


def test_overdamped_pairs_count_as_modes():
    """Two real poles are one overdamped mode: still M, R and K exactly."""
    true = chain([1.0, 2.0], [100.0, 300.0], damping=[[60.0, -10.0], [-10.0, 12.0]])
    assert len(true.poles) == 1
    found = mechanical_model(structure_fit(true, "velocity", ["f1"]))
    assert max(errors(found, true)) < 1e-8
    assert found.verdict.kind == "full"


# -- through methods


METHODS = {
    "cva": lambda n: vb.N4SID(weighting="cva", block_rows=2 * n + 4),
    "moesp": lambda n: vb.N4SID(weighting="moesp", block_rows=2 * n + 4),
    "n4sid": lambda n: vb.N4SID(weighting="n4sid", block_rows=2 * n + 4),
    "ssarx": lambda n: vb.N4SID(weighting="ssarx", block_rows=2 * n + 4),
    "okid": lambda n: OKID(observer_order=2 * n + 2),
    "okid-dc": lambda n: OKID(observer_order=2 * n + 2, realization=ERADC(lag=1)),
}


@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("name", METHODS)
def test_noise_free_records_give_their_matrices(n, name, rng):
    """Chains of 1 to 8 masses, either kind of damping, through every method, to 1e-8.

    Pushed at the free end, which all modes move; near the ground the last modes are almost at
    a node, and two or three digits are lost.
    """
    true = (proportional, general)[n % 2](n)
    u = white_noise(800 + 400 * n, rng=rng)
    record = true.simulate(u, 0.05, forces=[f"f{n}"])
    fit = vb.identify(record, METHODS[name](n), 2 * n, stability="ignore")
    assert max(errors(mechanical_model(fit), true)) < EXACT


@pytest.mark.slow
@pytest.mark.parametrize("n", range(1, 9))
@pytest.mark.parametrize("make", [proportional, general])
@pytest.mark.parametrize("quantity", [*SENSORS, "mixed"])
def test_every_sensor_through_every_method(n, make, quantity, rng):
    """All kinds of sensors and damping, 1 to 8 masses, six methods on records, two on pulses."""
    true = make(n)
    mixed = [(SENSORS[k % 3], f"f{k + 1}") for k in range(n)]
    sensors = mixed if quantity == "mixed" else quantity
    known = structure_fit(true, sensors, [f"f{n}"])
    labels = {"output_channels": known.output_channels, "input_channels": known.input_channels}
    u = white_noise(800 + 400 * n, rng=rng)
    record = true.simulate(u, 0.05, sensors=sensors, forces=[f"f{n}"])
    pulses = true.state_space(sensors, [f"f{n}"]).to_discrete(0.05).markov_parameters(400)
    responses = vb.ImpulseResponses(pulses, dt=0.05, **labels)
    trials = [(record, make_method(n)) for make_method in METHODS.values()]
    for data, method in [*trials, (responses, ERA()), (responses, ERADC(lag=1))]:
        fit = vb.identify(data, method, 2 * n, stability="ignore")
        assert max(errors(mechanical_model(fit), true)) < EXACT


@pytest.mark.parametrize("quantity", SENSORS)
def test_every_sensor_through_a_method(quantity, rng):
    """Displacements and velocities too, from a record that starts mid-motion."""
    true = general(3)
    start = 0.1 * rng.standard_normal(6)
    u = white_noise(3000, rng=rng)
    record = true.simulate(u, 0.05, sensors=quantity, forces=["f2"], initial_state=start)
    fit = vb.identify(record, vb.N4SID(block_rows=10), 6, stability="ignore")
    assert max(errors(mechanical_model(fit), true)) < EXACT


@pytest.mark.parametrize("realization", [ERA(), ERADC(lag=1)])
def test_pulse_responses_give_their_matrices(realization):
    """ERA and ERA/DC from exact pulse responses."""
    true = general(4)
    fit = structure_fit(true, "acceleration", ["f1"])
    pulses = true.state_space("acceleration", ["f1"]).to_discrete(0.05).markov_parameters(200)
    responses = vb.ImpulseResponses(
        pulses, dt=0.05, output_channels=fit.output_channels, input_channels=fit.input_channels
    )
    found = mechanical_model(vb.identify(responses, realization, 8, stability="ignore"))
    assert max(errors(found, true)) < EXACT


def test_several_pairs_share_the_noise(rng):
    """Of noisy records, all co-located pairs together beat the first one alone."""
    true = proportional(3)
    together, alone = [], []
    for _ in range(8):
        u = white_noise(1000, 3, rng=rng)
        record = true.simulate(u, 0.04, forces=true.dofs, noise=0.05, rng=rng)
        fit = vb.identify(record, vb.N4SID(block_rows=15), 6)
        together.append(error(mechanical_model(fit).mass, true.mass))
        alone.append(error(mechanical_model(fit, inputs=["force_f1"]).mass, true.mass))
    assert np.median(together) < 0.9 * np.median(alone)


# -- known answers


def test_crassidis_and_junkins():
    """M, R, K of Crassidis & Junkins, example 6.6, from its own model and back."""
    K = 5.0 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    true = Structure(np.eye(4), K / 5, K)
    fit = structure_fit(true, "displacement", true.dofs)
    found = mechanical_model(fit)
    assert max(errors(found, true)) < 1e-10
    np.testing.assert_allclose(
        2 * np.pi * found.frequencies_hz, [1.38197, 2.62866, 3.61803, 4.25325], atol=6e-6
    )


@pytest.mark.parametrize(("noise", "limit"), [(0.0, 1e-8), (0.05, 0.1)])
def test_crassidis_and_junkins_by_era(noise, limit, rng):
    """Example 7.6: 4 pulses, 4 positions, 50 s, 5 % of each channel's largest as noise.

    Exact without noise; with it M and K within 10 % in the median, modes 1 and 2 within 2 %.
    """
    K = 4.5 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    true = Structure(np.eye(4), K / 10, K)
    known = structure_fit(true, "displacement", true.dofs)
    exact = true.state_space("displacement", true.dofs).to_discrete(0.1).markov_parameters(500)
    labels = {"output_channels": known.output_channels, "input_channels": known.input_channels}
    rows = []
    for _ in range(5 if noise else 1):
        pulses = exact + noise * np.abs(exact).max(axis=0) * rng.standard_normal(exact.shape)
        pulses[0] = exact[0]
        responses = vb.ImpulseResponses(pulses, dt=0.1, **labels)
        found = mechanical_model(vb.identify(responses, ERA(), 8, stability="ignore"))
        rows.append([error(found.mass, true.mass), error(found.stiffness, true.stiffness)])
        seen = 2 * np.pi * found.frequencies_hz
        np.testing.assert_allclose(seen[:2], [1.31105, 2.49376], rtol=0.4 * noise + 4e-6)
    assert np.median(rows, axis=0).max() < limit
    if not noise:
        np.testing.assert_allclose(seen, [1.31105, 2.49376, 3.43237, 4.03499], atol=6e-6)
        assert error(found.damping, true.damping) < EXACT


@pytest.mark.parametrize("method", [OKID(observer_order=10), vb.N4SID(block_rows=10)])
def test_modal_masses_of_cara(method, rng):
    """Two DOFs: ω 10.72016 and 20.85853 rad/s, modal masses 23.8335 and 47.667."""
    M, K = np.diag([35.0, 17.5]), np.array([[12250.0, -3500.0], [-3500.0, 3500.0]])
    true = Structure(M, modal_damping(M, K, [0.02, 0.02]), K)
    record = true.simulate(white_noise(2000, rng=rng), 0.02, forces=["f2"])
    fit = vb.identify(record, method, 4, stability="ignore")
    found = mechanical_model(fit)
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, 0.02, rtol=1e-8)
    np.testing.assert_allclose(2 * np.pi * found.frequencies_hz, [10.72016, 20.85853], atol=5e-6)
    shapes = (found.shapes / found.shapes[np.abs(found.shapes).argmax(axis=0), [0, 1]]).real
    masses = np.diag(shapes.T @ found.mass @ shapes)
    np.testing.assert_allclose(masses, [23.8335, 47.667], atol=5e-4)
