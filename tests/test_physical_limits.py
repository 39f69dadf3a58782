"""M, R, K where the layout does not tell them: refused by name, reduced, or said to be wrong."""

from __future__ import annotations

import numpy as np
import pytest
from known_fits import error, errors, general, known_fit, proportional, structure_fit

import vibrid as vb
from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.physical import mechanical_model
from vibrid.record import Channel
from vibrid.structures import Structure, chain

# -- wrong labels


def test_a_wrong_sign_is_seen():
    """A sensor against its force, not labelled so, makes M negative: a warning says it."""
    true = general(3)
    fit = structure_fit(true, "acceleration", ["f1"])
    wrong = [Channel(c.name, c.quantity, c.unit, c.dof, -1) for c in fit.output_channels]
    found = mechanical_model(fit, outputs=wrong)
    assert not found.verdict.accepted
    assert {"mass_indefinite", "stiffness_indefinite"} <= {e.code for e in found.verdict.findings}
    one = [*fit.output_channels[:2], wrong[2]]
    assert mechanical_model(fit, outputs=one).stiffness[1, 2] == pytest.approx(
        -true.stiffness[1, 2]
    )  # of a sensor without a force beside it, the data cannot tell


def test_sensors_at_one_dof_that_disagree():
    """A wrong DOF puts two sensors at one place: the mean is used, with a warning."""
    fit = structure_fit(general(3), "acceleration", ["f1"])
    wrong = [
        Channel(c.name, c.quantity, c.unit, dof)
        for c, dof in zip(fit.output_channels, ("f1", "f1", "f3"), strict=True)
    ]
    found = mechanical_model(fit, outputs=wrong)
    assert "unequal_sensors" in [each.code for each in found.verdict.findings]
    assert not found.verdict.accepted


# -- modes without a scale


def triangle() -> Structure:
    """Return three equal masses, each joined to both others: two modes coincide."""
    K = 100.0 * (4 * np.eye(3) - np.ones((3, 3)))
    return Structure(np.eye(3), 0.1 * np.eye(3) + 0.002 * K, K)


def test_coinciding_modes_need_as_many_pairs():
    """Two pairs scale two modes at one place exactly, one pair is refused by name."""
    true = triangle()
    for forces in (["f1", "f2"], list(true.dofs)):
        found = mechanical_model(structure_fit(true, "acceleration", forces))
        assert max(errors(found, true)) < 1e-9 and found.verdict.accepted
    with pytest.raises(DataError, match=r"2 modes coincide at 3\.183 Hz: .* there is f1"):
        mechanical_model(structure_fit(true, "acceleration", ["f1"]))


def test_noise_mixes_the_shapes_of_coinciding_modes(rng):
    """Of a noisy record the two are still scaled together: M within 2 %."""
    true = triangle()
    u = white_noise(2000, 3, rng=rng)
    record = true.simulate(u, 0.03, forces=true.dofs, noise=0.05, rng=rng)
    found = mechanical_model(vb.identify(record, vb.N4SID(block_rows=12), 6))
    assert error(found.mass, true.mass) < 0.02 and error(found.stiffness, true.stiffness) < 0.02


def test_a_node_at_the_only_pair_is_named():
    """Mode 2 does not move f2: without another pair its scale is unknown."""
    true = chain([2.0, 1.5, 1.0], [600.0, 600.0, 600.0], rayleigh=(0.1, 4e-4))
    with pytest.raises(DataError, match="has a node at f2"):
        mechanical_model(structure_fit(true, "acceleration", ["f2"]))
    near = chain([2.0, 1.5, 1.0], [600.0, 610.0, 600.0], rayleigh=(0.1, 4e-4))
    found = mechanical_model(structure_fit(near, "acceleration", ["f2"]))
    assert "near_node" in [each.code for each in found.verdict.findings]


# -- what is not there, by name


def test_refusals_name_what_is_missing():
    """No pair, no quantity, no channels, a StateSpace without labels, an unknown hold."""
    true = proportional(3)
    fit = structure_fit(true, [("acceleration", "f1"), ("acceleration", "f3")], ["f2"])
    with pytest.raises(OptionError, match="add a force at f1 or an accelerometer at f2"):
        mechanical_model(fit)
    fit = structure_fit(true, "acceleration", ["f1"])
    with pytest.raises(OptionError, match="'y1' has the quantity 'other'"):
        mechanical_model(fit, outputs=[Channel(f"y{k + 1}") for k in range(3)])
    with pytest.raises(OptionError, match=r"'a' .acceleration. has no dof"):
        mechanical_model(fit, outputs=[Channel(n, "acceleration") for n in "abc"])
    with pytest.raises(OptionError, match="give outputs="):
        mechanical_model(fit.model)
    with pytest.raises(OptionError, match="must be 3 channels"):
        mechanical_model(fit, outputs=list(fit.output_channels[:2]))
    with pytest.raises(OptionError, match="Did you mean"):
        mechanical_model(fit, outputs=["acceleration_f"])
    with pytest.raises(OptionError, match="hold must be one of"):
        mechanical_model(fit, hold="linear")
    with pytest.raises(OptionError, match="no mode at 99 Hz"):
        mechanical_model(fit, frequencies_hz=[99.0])
    for wrong in ([], 1.0, ["a"]):
        with pytest.raises(OptionError, match="list of frequencies"):
            mechanical_model(fit, frequencies_hz=wrong)
    with pytest.raises(OptionError, match="no mode at nan Hz"):
        mechanical_model(fit, frequencies_hz=[np.nan])
    with pytest.raises(OptionError, match="'acceleration_f1' twice"):
        mechanical_model(fit, outputs=["acceleration_f1", "acceleration_f1"])
    with pytest.raises(OptionError, match="delays must be True, False"):
        mechanical_model(fit, delays="yes")
    with pytest.raises(OptionError, match="of numbers"):
        mechanical_model(fit, mass={"f1": 1.0})


def test_rigid_body_modes_are_refused_by_name():
    """A free structure seen by displacement sensors has a double pole at zero."""
    free = chain([1.0, 2.0, 1.0], [0.0, 300.0, 200.0], dashpots=[0.0, 0.3, 0.2])
    fit = structure_fit(free, "displacement", ["f1"])
    with pytest.raises(DataError, match="rigid-body"):
        mechanical_model(fit)


def test_a_free_structure_seen_by_accelerometers(rng):
    """They do not see the rigid-body mode: the others are the subspace, and the cure says why."""
    free = chain([1.0, 2.0, 1.0], [0.0, 300.0, 200.0], dashpots=[0.0, 0.3, 0.2])
    record = free.simulate(white_noise(2000, rng=rng), 0.04, forces=["f1"])
    found = mechanical_model(vb.identify(record, vb.N4SID(block_rows=8), 4, stability="ignore"))
    assert found.verdict.kind == "subspace"
    assert any("rigid-body" in each.cure for each in found.verdict.findings)
    np.testing.assert_allclose(found.frequencies_hz, free.frequencies_hz, rtol=1e-8)


# -- spurious poles, too few sensors, too few modes


def with_spurious(fit: vb.Fit, pole: complex, size: float = 1e-4) -> vb.Fit:
    """Return the fit with a weak pair of discrete poles, or a real pole, beside the others."""
    m = fit.model
    block = np.array([[pole.real, pole.imag], [-pole.imag, pole.real]])[: 1 + bool(pole.imag)]
    block = block[:, : len(block)]
    k = len(block)
    A = np.block([[m.A, np.zeros((m.order, k))], [np.zeros((k, m.order)), block]])
    B = np.vstack([m.B, np.full((k, m.n_inputs), size)])
    C = np.hstack([m.C, np.full((m.n_outputs, k), size)])
    return known_fit(vb.StateSpace(A, B, C, m.D, m.dt), fit.output_channels, fit.input_channels)


@pytest.mark.parametrize("pole", [0.3 + 0.8j, -0.9 + 0j, 0.5 + 0j, 0.9 + 0.5j])
def test_spurious_poles_are_dropped_and_named(pole):
    """A weak pair, a pole at Nyquist, a real and an unstable one change nothing."""
    true = proportional(3)
    fit = with_spurious(structure_fit(true, "acceleration", ["f1"]), pole)
    found = mechanical_model(fit)
    assert max(errors(found, true)) < 1e-10
    assert found.verdict.kind == "full"
    assert "Left out" in str(found.verdict.findings)


def test_output_only_models_need_a_drive_to_choose_modes():
    """Innovations tell strong modes from weak ones; where there are none, the user must."""
    true = proportional(3)
    fit = with_spurious(structure_fit(true, "acceleration", ["f1"]), 0.3 + 0.8j)
    m = fit.model
    bare = vb.StateSpace(m.A, m.B[:, :0], m.C, m.D[:, :0], m.dt)
    with pytest.raises(OptionError, match=r"4 modes for 3 DOFs .* frequencies_hz"):
        mechanical_model(known_fit(bare, fit.output_channels))
    driven = known_fit(bare, fit.output_channels, kalman_gain=np.repeat(m.B, 3, axis=1))
    found = mechanical_model(driven)
    np.testing.assert_allclose(found.frequencies_hz, true.frequencies_hz, rtol=1e-10)


def test_more_modes_than_sensors_make_a_reduced_model():
    """Labelled as such; the flexibility of all modes at the sensors is exact."""
    true = proportional(5)
    sensors = [("acceleration", "f2"), ("acceleration", "f5")]
    found = mechanical_model(structure_fit(true, sensors, ["f5"]))
    assert found.verdict.kind == "reduced"
    assert "Luş et al. 2003" in str(found.verdict.findings[0])
    flexibility = np.linalg.inv(true.stiffness)[np.ix_([1, 4], [1, 4])]
    assert error(found.flexibility, flexibility) < 1e-10
    kept = mechanical_model(
        structure_fit(true, sensors, ["f5"]), frequencies_hz=true.frequencies_hz[:2]
    )
    np.testing.assert_allclose(kept.frequencies_hz, true.frequencies_hz[:2], rtol=1e-10)
    assert kept.verdict.kind == "reduced"
    assert error(kept.flexibility, flexibility) < 1e-10
    assert kept.verdict.checks["poles"] < 1e-8  # a reduced model keeps its modes


def test_fewer_modes_than_sensors_give_the_subspace():
    """Labelled; on the shapes it has the flexibility and the modes are its own."""
    true = proportional(4)
    fit = structure_fit(true, "acceleration", ["f4"])
    found = mechanical_model(fit, frequencies_hz=true.frequencies_hz[:2])
    assert found.verdict.kind == "subspace"
    assert not any(found.verdict.determined.values())
    shapes = true.shapes[:, :2].real
    wanted = shapes.T @ true.stiffness @ shapes
    assert error(shapes.T @ found.stiffness @ shapes, wanted) < 1e-8
    assert np.linalg.matrix_rank(found.stiffness, tol=1e-6 * np.abs(found.stiffness).max()) == 2
