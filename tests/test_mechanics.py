"""M, R, K to state space, modes and damping: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from vibrid.errors import OptionError
from vibrid.mechanics import (
    mechanical_state_space,
    modal_damping,
    rayleigh_damping,
    undamped_modes,
)

M = np.diag([2.0, 1.0, 3.0])
K = 100.0 * np.array([[3.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
R = 0.01 * K + 0.1 * np.diag([1.0, 0.0, 2.0])
LINES = np.linspace(0.1, 5, 23)


def dynamic_stiffness(f):
    s = 2j * np.pi * f
    return s, s**2 * M + s * R + K


@pytest.mark.parametrize(
    ("power", "quantity"), [(0, "displacement"), (1, "velocity"), (2, "acceleration")]
)
def test_frequency_responses_to_forces(power, quantity):
    """Sensor i over force j is sᵏ [(s² M + s R + K)⁻¹]ᵢⱼ, with the sensor's sign."""
    model = mechanical_state_space(M, R, K, sensors=[(quantity, 2), (quantity, 0, -1)], forces=[1])
    for f, G in zip(LINES, model.frequency_response(LINES), strict=True):
        s, Z = dynamic_stiffness(f)
        column = s**power * np.linalg.inv(Z)[:, 1]
        np.testing.assert_allclose(G[:, 0], [column[2], -column[0]], rtol=1e-10)


@pytest.mark.parametrize("absolute", [True, False])
def test_frequency_responses_to_the_base(absolute):
    """Base motion drives −M ι a; absolute accelerations add ι a and have D = 0."""
    influence = np.array([1.0, 1.0, 0.5])
    sensors = [("acceleration", k) for k in range(3)]
    model = mechanical_state_space(
        M, R, K, sensors=sensors, forces=[0], base=influence, absolute=absolute
    )
    for f, G in zip(LINES, model.frequency_response(LINES), strict=True):
        s, Z = dynamic_stiffness(f)
        relative = -(s**2) * np.linalg.solve(Z, M @ influence)
        np.testing.assert_allclose(G[:, 1], relative + absolute * influence, rtol=1e-10)
    assert (model.D[:, 1] == 0).all() == absolute
    np.testing.assert_allclose(model.D[:, 0], [0.5, 0, 0])


def test_a_base_that_moves_slowly_carries_the_structure():
    """With base=True every absolute acceleration follows the base at 0 Hz."""
    model = mechanical_state_space(M, R, K, sensors=[("acceleration", 2)], base=True)
    np.testing.assert_allclose(model.frequency_response([0.0])[0, 0, 0], 1, rtol=1e-12)


def test_undamped_modes():
    """K Φ = M Φ Ω², Φᵀ M Φ = I, frequencies ascend; a free body has one at zero."""
    hertz, shapes = undamped_modes(M, K)
    np.testing.assert_allclose(K @ shapes, M @ shapes * (2 * np.pi * hertz) ** 2, atol=1e-10)
    np.testing.assert_allclose(shapes.T @ M @ shapes, np.eye(3), atol=1e-12)
    assert (np.diff(hertz) > 0).all()
    free = undamped_modes(np.eye(2), [[1.0, -1.0], [-1.0, 1.0]])[0]
    np.testing.assert_allclose(free, [0, np.sqrt(2) / (2 * np.pi)], atol=1e-7)


def test_modal_damping_gives_the_ratios():
    """The damped model has the damping ratios asked for, mode by mode."""
    ratios = np.array([0.01, 0.03, 0.02])
    model = mechanical_state_space(M, modal_damping(M, K, ratios), K, sensors=[("displacement", 0)])
    np.testing.assert_allclose(model.damping_ratios, ratios, rtol=1e-10)
    np.testing.assert_allclose(model.frequencies_hz, undamped_modes(M, K)[0], rtol=1e-12)


def test_rayleigh_damping_gives_its_ratios():
    """ζ = alpha / 2ω + beta ω / 2."""
    model = mechanical_state_space(
        M, rayleigh_damping(M, K, 0.2, 0.003), K, sensors=[("displacement", 0)]
    )
    w = 2 * np.pi * undamped_modes(M, K)[0]
    np.testing.assert_allclose(model.damping_ratios, 0.1 / w + 0.0015 * w, rtol=1e-10)


def test_modal_masses_of_a_two_dof_structure():
    """Cara's example: ω 10.72016, 20.85853 rad/s; modal masses 23.8335, 47.667."""
    mass, stiffness = np.diag([35.0, 17.5]), [[12250.0, -3500.0], [-3500.0, 3500.0]]
    hertz, shapes = undamped_modes(mass, stiffness)
    np.testing.assert_allclose(2 * np.pi * hertz, [10.72016, 20.85853], atol=5e-6)
    masses = 1 / np.abs(shapes).max(axis=0) ** 2
    np.testing.assert_allclose(masses, [23.8335, 47.667], atol=5e-4)


def test_refusals():
    """Unknown quantities, DOFs that are not there and singular masses are named."""
    with pytest.raises(OptionError, match="Did you mean 'velocity'"):
        mechanical_state_space(M, R, K, sensors=[("velosity", 0)])
    with pytest.raises(OptionError, match="from 0 to 2; got 3"):
        mechanical_state_space(M, R, K, sensors=[("velocity", 3)])
    with pytest.raises(OptionError, match="DOF of a force"):
        mechanical_state_space(M, R, K, sensors=[("velocity", 0)], forces=[-1])
    with pytest.raises(OptionError, match="At least one sensor"):
        mechanical_state_space(M, R, K, sensors=[])
    with pytest.raises(OptionError, match="base must be"):
        mechanical_state_space(M, R, K, sensors=[("velocity", 0)], base=[1.0])
    with pytest.raises(OptionError, match="singular"):
        mechanical_state_space(0 * M, R, K, sensors=[("velocity", 0)])
    with pytest.raises(OptionError, match="positive definite"):
        undamped_modes(-M, K)
    with pytest.raises(OptionError, match="must not be negative"):
        undamped_modes(M, -K)
    with pytest.raises(OptionError, match="one number or 3"):
        modal_damping(M, K, [0.1, 0.1])
    with pytest.raises(OptionError, match="one size"):
        undamped_modes(M, K[:2, :2])
