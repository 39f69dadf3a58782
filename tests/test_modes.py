"""Modes against structures with exact answers, and what must leave them unchanged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from known_fits import known_fit, structure_fit

from vibrid.errors import DataError, OptionError
from vibrid.fit import Fit
from vibrid.modes import Complexes, Modes, mac, match_modes, modes_of, mpc
from vibrid.record import Channel
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain

DOFS = ("f1", "f2", "f3")
MIXED = (
    Channel("s1", "displacement", dof="f1"),
    Channel("s2", "velocity", dof="f2", sign=-1),
    Channel("s3", "acceleration", dof="f3", sign=-1),
)
SENSORS: list[Any] = ["displacement", "velocity", "acceleration", MIXED]


def frame() -> Structure:
    """Return three masses, non-proportionally damped: complex shapes, 2 to 9 Hz."""
    return chain([2.0, 1.0, 1.5], [900.0, 700.0, 800.0], dashpots=[0.5, 3.0, 0.2])


def some_modes(hertz: Any, damping: Any = 0.01, shapes: Any = None) -> Modes:
    """Return modes of given frequencies and damping ratios, shapes all alike by default."""
    f = np.asarray(hertz, dtype=float)
    zeta = np.broadcast_to(np.asarray(damping, dtype=float), f.shape)
    poles = 2 * np.pi * f * (-zeta + 1j * np.sqrt(1 - zeta**2))
    phi = np.ones((2, len(f)), complex) if shapes is None else np.asarray(shapes, complex)
    nothing = np.full(len(f), np.nan)
    channels = (Channel("y1"), Channel("y2"))
    return Modes(poles, phi, np.zeros((len(f), 0)), np.zeros(0), channels, nothing, nothing)


def residues(modes: Modes) -> Complexes:
    """Return c_k b_k (n_modes, n_outputs, n_inputs): free of any scaling of shapes."""
    return np.asarray(np.einsum("ik,kj->kij", modes.shapes, modes.participation))


def expanded(modes: Modes, points: Complexes) -> Complexes:
    """Return the sum of c_k b_k / (s − λ_k) and its conjugate partner at the points s."""
    terms = residues(modes)
    below, mirror = points[:, None] - modes.poles, points[:, None] - modes.poles.conj()
    return np.asarray(
        np.einsum("sk,kij->sij", 1 / below, terms)
        + np.einsum("sk,kij->sij", 1 / mirror, terms.conj())
    )


# -- exact answers


@pytest.mark.parametrize("sensors", SENSORS)
def test_modes_of_every_kind_of_sensor(sensors: Any) -> None:
    """Frequencies, damping and displacement shapes are the structure's, whatever is measured."""
    structure = frame()
    modes = modes_of(structure_fit(structure, sensors, ["f1"]))
    np.testing.assert_allclose(modes.frequencies_hz, structure.frequencies_hz, rtol=1e-11)
    np.testing.assert_allclose(modes.damping_ratios, structure.damping_ratios, rtol=1e-10)
    np.testing.assert_allclose(modes.shapes, structure.shapes, atol=1e-10)
    assert modes.n_modes == 3
    assert modes.real_poles.size == 0
    assert np.isnan(modes.frequencies_std).all()


@pytest.mark.parametrize("sensors", SENSORS)
def test_participation_rebuilds_the_transfer_function(sensors: Any) -> None:
    """Poles, displacement shapes and participation are the whole receptance, to 1e-10."""
    structure = frame()
    points = 2j * np.pi * np.linspace(0.1, 20, 50)
    hertz = np.linspace(0.1, 20, 50)
    exact = structure.state_space("displacement", ["f1", "f3"]).frequency_response(hertz)
    modes = modes_of(structure_fit(structure, sensors, ["f1", "f3"]))
    np.testing.assert_allclose(expanded(modes, points), exact, atol=1e-10 * np.abs(exact).max())


def test_participation_of_base_motion_and_of_continuous_models() -> None:
    """Band-limited base motion has the exact participation; so has a model in continuous time."""
    structure = frame()
    hertz = np.linspace(0.1, 20, 50)
    for forces, base in (([], True), (["f2"], False)):
        model = structure.state_space("displacement", forces, base)
        exact = model.frequency_response(hertz)
        for source in (structure_fit(structure, "displacement", forces, base=base), model):
            built = expanded(modes_of(source), 2j * np.pi * hertz)
            np.testing.assert_allclose(built, exact, atol=1e-10 * np.abs(exact).max())


def test_participation_multiplies_by_the_sign_of_the_input() -> None:
    """A force cell mounted backward turns its column."""
    fit = structure_fit(frame(), "velocity", ["f1", "f2"])
    first, second = fit.input_channels
    turned = replace(fit, input_channels=(first, replace(second, sign=-1)))
    expected = modes_of(fit).participation * [1, -1]
    np.testing.assert_array_equal(modes_of(turned).participation, expected)


def test_rigid_body_motion_does_not_spoil_the_others() -> None:
    """Two free masses: the double pole at zero has no eigenvector basis, the mode is exact."""
    free = chain([1.0, 1.0], [0.0, 100.0])
    model = free.state_space("displacement", ["f1"])
    for system in (model, model.to_discrete(0.01)):
        modes = modes_of(system)
        vibrating = modes.select([modes.n_modes - 1])
        assert vibrating.frequencies_hz[0] == pytest.approx(np.sqrt(200) / (2 * np.pi))
        # q = [1, −1] / 2 (f1), so the residue is ± 1 / (4 j ω)
        expected = np.array([[1], [-1]]) / (4j * np.sqrt(200))
        np.testing.assert_allclose(residues(vibrating)[0], expected, atol=1e-9)


def test_real_poles_are_kept_apart() -> None:
    """Poles on the real axis are no modes; a negative discrete one sits at Nyquist."""
    dt = 0.1
    A = np.zeros((5, 5))
    A[:2, :2] = [[0.5, 0.6], [-0.6, 0.5]]
    A[2:, 2:] = np.diag([0.5, -0.7, 0.9])
    modes = modes_of(StateSpace(A, np.ones((5, 1)), np.ones((1, 5)), [[0.0]], dt))
    np.testing.assert_allclose(modes.poles, [np.log(0.5 + 0.6j) / dt])
    expected = [np.log(0.5) / dt, (np.log(0.7) + 1j * np.pi) / dt, np.log(0.9) / dt]
    np.testing.assert_allclose(modes.real_poles, expected, rtol=1e-12)


def test_a_model_without_modes_has_none() -> None:
    """One real pole: no modes, arrays of length zero, and nothing to match."""
    modes = modes_of(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1))
    assert (modes.n_modes, modes.shapes.shape, modes.participation.shape) == (0, (1, 0), (0, 1))
    assert modes.phase_collinearity.shape == (0,)
    assert match_modes(modes, modes).shape == (0, 2)


def test_unstable_and_delayed_models() -> None:
    """Negative damping is shown as such; a pole at zero is refused with a cure."""
    growing = StateSpace([[0, 1], [-100, 0.4]], [[0], [1]], [[1, 0]], [[0]], None)
    assert modes_of(growing).damping_ratios[0] == pytest.approx(-0.02)
    with pytest.raises(DataError, match=r"pole at zero.*lower order"):
        modes_of(StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], 0.1))


# -- what must change nothing


def test_the_state_basis_changes_nothing(rng: np.random.Generator) -> None:
    """Shapes and participation belong to the model, not to its states."""
    fit = structure_fit(frame(), "acceleration", ["f1", "f2"])
    other = replace(fit, model=fit.model.transform(rng.standard_normal((6, 6))))
    first, second = modes_of(fit), modes_of(other)
    np.testing.assert_allclose(second.poles, first.poles, rtol=1e-9)
    np.testing.assert_allclose(second.shapes, first.shapes, atol=1e-9)
    np.testing.assert_allclose(second.participation, first.participation, atol=1e-9)


def reordered(fit: Fit, order: list[int]) -> Fit:
    """Return the fit with its outputs in another order."""
    model = fit.model
    return known_fit(
        StateSpace(model.A, model.B, model.C[order], model.D[order], model.dt),
        [fit.output_channels[k] for k in order],
        fit.input_channels,
    )


def test_the_order_of_channels_changes_only_rows() -> None:
    """Shapes follow their channels."""
    fit, order = structure_fit(frame(), MIXED, ["f1"]), [2, 0, 1]
    first, second = modes_of(fit), modes_of(reordered(fit, order))
    np.testing.assert_allclose(second.shapes, first.shapes[order], atol=1e-12)
    np.testing.assert_allclose(second.participation, first.participation, atol=1e-12)
    assert [channel.name for channel in second.output_channels] == ["s3", "s1", "s2"]


def test_units_change_only_the_participation() -> None:
    """Outputs in mm and forces in kN leave poles and shapes, and scale the residues by 1e6."""
    fit = structure_fit(frame(), "displacement", ["f1"])
    model = fit.model
    other = StateSpace(model.A, 1e3 * model.B, 1e3 * model.C, 1e6 * model.D, model.dt)
    first, second = modes_of(fit), modes_of(replace(fit, model=other))
    np.testing.assert_allclose(second.shapes, first.shapes, atol=1e-12)
    np.testing.assert_allclose(residues(second), 1e6 * residues(first), rtol=1e-9)


def test_plain_models_give_sensor_amplitudes() -> None:
    """Without channels nothing is divided by λ: shapes are C v."""
    fit = structure_fit(frame(), MIXED, ["f1"])
    modes = modes_of(fit.model)
    powers = modes.poles[None, :] ** np.array([[0], [1], [2]])
    measured = frame().shapes * powers * np.array([[1], [-1], [-1]])
    np.testing.assert_allclose(np.diag(mac(modes.shapes, measured)), 1, atol=1e-12)
    assert np.abs(modes.shapes).max(axis=0) == pytest.approx(1)


def test_select_keeps_modes_together() -> None:
    """Poles, shapes and participation of the chosen modes, in the order given."""
    modes = modes_of(structure_fit(frame(), "displacement", ["f1"]))
    chosen = modes.select([2, 0])
    np.testing.assert_array_equal(chosen.poles, modes.poles[[2, 0]])
    np.testing.assert_array_equal(residues(chosen), residues(modes)[[2, 0]])


# -- indicators


def test_mac_by_hand(rng: np.random.Generator) -> None:
    """cos² of the angle; a complex factor changes nothing; a zero shape agrees with none."""
    first = np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    second = np.array([[1.0], [np.sqrt(3.0)]])
    expected = [[0.25], [(1 + np.sqrt(3)) ** 2 / 8], [0.0]]
    np.testing.assert_allclose(mac(first, second), expected, atol=1e-14)
    shapes = rng.standard_normal((4, 3)) + 1j * rng.standard_normal((4, 3))
    turned = shapes * np.exp(1j * np.array([0.3, 2.0, -1.0])) * [1, 5, 0.1]
    np.testing.assert_allclose(np.diag(mac(shapes, turned)), 1, rtol=1e-13)
    np.testing.assert_allclose(mac(shapes, turned), mac(turned, shapes).T, rtol=1e-13)
    with pytest.raises(OptionError, match="2 and 4 components"):
        mac(first, shapes)


def test_mpc_by_hand(rng: np.random.Generator) -> None:
    """1 for in-phase motion, 0 for a circle, 5/9 for [1, 1 + j]; no rotation changes it."""
    shapes = np.array([[1.0, 1, 1, 0], [-2.0, 1j, 1 + 1j, 0]])
    np.testing.assert_allclose(mpc(shapes), [1, 0, 5 / 9, 1], atol=1e-14)
    random = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    np.testing.assert_allclose(mpc(random * np.exp(0.7j)), mpc(random), rtol=1e-12)


# -- pairs


def test_each_mode_is_paired_once_with_its_nearest() -> None:
    """Of two candidates the nearer is taken; a mode without partner stays alone."""
    first, second = some_modes([1.0, 3.0, 5.0]), some_modes([0.99, 1.001, 5.05, 9.0])
    assert match_modes(first, second).tolist() == [[0, 1], [2, 2]]
    assert match_modes(second, first).tolist() == [[1, 0], [2, 2]]


def test_close_modes_are_told_apart_by_shape() -> None:
    """Two modes of almost one frequency are paired by their shapes, not by frequency."""
    across = [[1.0, 1.0], [1.0, -1.0]]
    first, second = some_modes([2.0, 2.01], shapes=across), some_modes([1.999, 2.011])
    turned = replace(second, shapes=first.shapes[:, ::-1])
    assert match_modes(first, turned).tolist() == [[0, 1], [1, 0]]


def test_pairs_come_before_closeness() -> None:
    """Both modes find a partner where the limits allow it, not only the closest pair."""
    first, second = some_modes([1.0, 1.010]), some_modes([1.009, 1.029])
    assert match_modes(first, second).tolist() == [[0, 0], [1, 1]]


@pytest.mark.parametrize(
    ("limits", "pairs"),
    [
        ({}, 1),
        ({"frequency_limit": 0.011}, 1),
        ({"frequency_limit": 0.0095}, 0),
        ({"damping_limit": 0.51}, 1),
        ({"damping_limit": 0.49}, 0),
        ({"mac_limit": 0.89}, 1),
        ({"mac_limit": 0.91}, 0),
    ],
)
def test_limits_of_a_pair(limits: dict[str, float], pairs: int) -> None:
    """Frequencies 1 % apart, damping a half, MAC 0.9: just inside and just outside."""
    first = some_modes([1.0], 0.01, [[1.0], [0.0]])
    second = some_modes([1 / 0.99], 0.02, [[3.0], [1.0]])
    assert mac(first.shapes, second.shapes)[0, 0] == pytest.approx(0.9)
    assert len(match_modes(first, second, **limits)) == pairs


def test_a_limit_of_zero_is_refused() -> None:
    """No two frequencies agree that well."""
    with pytest.raises(OptionError, match="frequency_limit must be positive; got 0"):
        match_modes(some_modes([1.0]), some_modes([1.0]), frequency_limit=0)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_participation_of_coinciding_poles_is_exact(seed: int) -> None:
    """Two equal oscillators, in any basis: residues still add up to the transfer function."""
    rng = np.random.default_rng(seed)
    one = np.array([[0.0, 1.0], [-100.0, -0.2]])
    A = np.kron(np.eye(2), one)
    B = np.kron(np.array([[1.0, 0.3], [0.2, 1.0]]), [[0.0], [1.0]])
    C = np.kron(np.eye(2), [[1.0, 0.0]])
    T = rng.standard_normal((4, 4))
    system = StateSpace(
        np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, np.zeros((2, 2)), None
    )
    modes = modes_of(system)
    frequency = 1.3
    s = 2j * np.pi * frequency
    found = sum(
        np.outer(c, b) / (s - pole) + np.outer(c, b).conj() / (s - pole.conjugate())
        for c, b, pole in zip(modes.shapes.T, modes.participation, modes.poles, strict=True)
    )
    exact = system.frequency_response(np.array([frequency]))[0]
    np.testing.assert_allclose(found, exact, atol=1e-10 * np.abs(exact).max())


def test_defective_poles_have_no_participation() -> None:
    """A pair of poles with one eigenvector between them has no rows of V⁻¹ B: NaN."""
    one = np.array([[0.0, 1.0], [-100.0, -0.2]])
    A = np.block([[one, np.eye(2)], [np.zeros((2, 2)), one]])
    system = StateSpace(A, np.ones((4, 1)), np.eye(4), np.zeros((4, 1)), None)
    assert np.isnan(modes_of(system).participation).all()
