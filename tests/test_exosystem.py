"""Signal models against cosines, augmented models against simulation, observability by hand."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from vibrid.errors import DataError, OptionError
from vibrid.exosystem import (
    augmented_model,
    augmented_observability,
    finite_signal,
    harmonics,
    periodic_signal,
    phasor_signal,
    real_jordan_form,
    signal_basis,
)
from vibrid.statespace import StateSpace
from vibrid.structures import chain

FREQUENCIES = np.array([0.7, 1.9, 3.3])


def structure():
    return chain([2.0, 1.5, 1.0], [600.0, 400.0, 300.0], dashpots=[0.6, 0.5, 0.4])


def rank_of_observability(model):
    """Return the numerical rank of [C; CA; …], rows of every power of like size."""
    A = model.A / np.abs(model.poles).max() if model.dt is None else model.A
    rows = StateSpace(A, model.B, model.C, model.D, model.dt).observability_matrix()
    values = np.linalg.svd(rows / np.linalg.norm(rows, axis=0), compute_uv=False)
    return int(np.count_nonzero(values > 1e-10 * values[0]))


# -- signal models


def test_a_periodic_model_makes_cosines(rng):
    """Each block (a, b) gives a cos ωt + b sin ωt, and the offset its constant."""
    model = periodic_signal(FREQUENCIES, offset=True, dt=0.02)
    start = rng.standard_normal(7)
    t = 0.02 * np.arange(500)
    made = model.simulate(initial_state=start, n_samples=500)[:, 0]
    expected = start[0] + sum(
        a * np.cos(2 * np.pi * f * t) + b * np.sin(2 * np.pi * f * t)
        for f, a, b in zip(FREQUENCIES, start[1::2], start[2::2], strict=True)
    )
    np.testing.assert_allclose(made, expected, atol=1e-12)
    np.testing.assert_allclose(made, signal_basis(FREQUENCIES, t, offset=True) @ start, atol=1e-12)


def test_the_discrete_model_is_the_sampled_continuous_one():
    """exp(A_u dt) of the continuous blocks; ln of (14) would not be."""
    continuous, discrete = (periodic_signal(FREQUENCIES, offset=True, dt=dt) for dt in (None, 0.02))
    np.testing.assert_allclose(scipy.linalg.expm(0.02 * continuous.A), discrete.A, atol=1e-14)


def test_phasors_share_one_exosystem(rng):
    """u = C_u x_u with a full C_u: every signal has its own amplitude, phase and offset."""
    p = rng.standard_normal((2, 3)) + 1j * rng.standard_normal((2, 3))
    model, start = phasor_signal(FREQUENCIES, p, offset=[0.5, -2.0], dt=0.05)
    t = 0.05 * np.arange(200)
    turned = np.exp(2j * np.pi * t[:, None] * FREQUENCIES)
    np.testing.assert_allclose(
        model.simulate(initial_state=start, n_samples=200),
        (turned @ p.T).real + np.array([0.5, -2.0]),
        atol=1e-12,
    )


@pytest.mark.parametrize("stretch", [1.0, 1.3])
def test_a_finite_signal_reaches_any_band_limited_one(rng, stretch):
    """Least squares on (67) finds a multisine of 30 lines, also in a longer period."""
    N, dt = 400, 0.01
    lines = harmonics(1 / (stretch * N * dt), 7.0)
    p = rng.standard_normal((1, len(lines))) + 1j * rng.standard_normal((1, len(lines)))
    wanted_model, start = phasor_signal(lines, p, offset=[0.3], dt=dt)
    wanted = wanted_model.simulate(initial_state=start, n_samples=N)
    model = finite_signal(N, dt, 7.0, period=stretch * N * dt)
    reach = model.observability_matrix(N)
    left = wanted - reach @ np.linalg.lstsq(reach, wanted, rcond=None)[0]
    assert np.abs(left).max() < 1e-10 * np.abs(wanted).max()


def test_signals_of_their_own():
    """Two finite signals have two sets of states."""
    model = finite_signal(100, 0.1, 1.0, n_signals=2)
    assert (model.order, model.n_outputs) == (42, 2)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: periodic_signal([1.0, 1.0]), "different"),
        (lambda: periodic_signal([25.0], dt=0.02), "Nyquist frequency 25 Hz"),
        (lambda: periodic_signal([-1.0]), "positive"),
        (lambda: periodic_signal([]), "needs a frequency or an offset"),
        (lambda: periodic_signal([1.0], outputs=[[1.0]]), r"\(n_signals, 2\)"),
        (lambda: finite_signal(100, 0.1, 1.0, period=5.0), "shorter"),
        (lambda: harmonics(1.0, 0.5), "No multiple of 1 Hz"),
        (lambda: phasor_signal([1.0], [[1.0, 2.0]]), r"\(n_signals, 1\)"),
    ],
)
def test_bad_signals_are_refused(call, words):
    """The message names the number and the limit."""
    with pytest.raises(OptionError, match=words):
        call()


# -- real Jordan form


def test_real_jordan_form(rng):
    """A = T J T⁻¹ with blocks [σ ω; −ω σ] by |λ| and real eigenvalues last."""
    A = rng.standard_normal((7, 7))
    form = real_jordan_form(A)
    np.testing.assert_allclose(form.T @ form.J, A @ form.T, atol=1e-12)
    for k, pole in enumerate(form.pairs):
        block = form.J[2 * k : 2 * k + 2, 2 * k : 2 * k + 2]
        np.testing.assert_array_equal(block, [[pole.real, pole.imag], [-pole.imag, pole.real]])
    assert (np.diff(np.abs(form.pairs)) > 0).all() and len(form.reals) == 7 - 2 * len(form.pairs)


def test_repeated_poles_with_vectors_of_their_own(rng):
    """Two equal oscillators: appendix A's blocks twice, no ones above the diagonal."""
    T = rng.standard_normal((4, 4))
    A = T @ np.kron(np.eye(2), [[-1.0, 3.0], [-3.0, -1.0]]) @ np.linalg.inv(T)
    form = real_jordan_form(A)
    np.testing.assert_allclose(form.pairs, [-1 + 3j, -1 + 3j], atol=1e-6)
    np.testing.assert_allclose(form.T @ form.J @ np.linalg.inv(form.T), A, atol=1e-10)


def test_a_defective_matrix_has_no_form_in_rounding():
    """A rigid-body motion is refused by name."""
    with pytest.raises(DataError, match="rigid-body"):
        real_jordan_form([[0.0, 1.0], [0.0, 0.0]])


@pytest.mark.parametrize("A", [[[1.0, 2.0, 3.0]], 5.0, np.zeros((0, 0)), [[np.nan]]])
def test_what_is_no_square_matrix_is_refused(A):
    """By name, before any decomposition."""
    with pytest.raises(OptionError, match=r"A (must be square|holds NaN)"):
        real_jordan_form(A)


# -- augmentation


def test_the_augmented_model_is_the_structure_under_its_input(rng):
    """Held forces: free response of (18) equals the simulation with u."""
    system = structure().state_space(forces=["f1", "f3"]).to_discrete(0.02)
    p = rng.standard_normal((2, 3)) + 1j * rng.standard_normal((2, 3))
    signal, start = phasor_signal(FREQUENCIES, p, dt=0.02)
    x = rng.standard_normal(6)
    u = signal.simulate(initial_state=start, n_samples=300)
    free = augmented_model(system, signal).simulate(initial_state=[*x, *start], n_samples=300)
    np.testing.assert_allclose(free, system.simulate(u, x), atol=1e-10)


def test_a_continuous_force_is_augmented_in_continuous_time(rng):
    """Sampling (17) differs from (18): the steady state is G(jω), not that of held forces."""
    system = structure().state_space(forces=["f2"])
    p = np.array([[1.0 - 2.0j]])
    signal, start = phasor_signal([1.9], p)
    x = np.linalg.solve(2j * np.pi * 1.9 * np.eye(6) - system.A, system.B @ p)[:, 0].real
    both = augmented_model(system, signal).to_discrete(0.02)
    expected = (
        system.frequency_response([1.9])[0] @ p @ np.exp([2j * np.pi * 1.9 * 0.02 * np.arange(100)])
    )
    made = both.simulate(initial_state=[*x, *start], n_samples=100)
    np.testing.assert_allclose(made, expected.real.T, atol=1e-10)


# -- observability


@pytest.mark.parametrize("dt", [None, 0.02])
@pytest.mark.parametrize("sensors", ["acceleration", "velocity"])
def test_sines_are_seen_and_constants_are_not(sensors, dt):
    """Shared sines are observable with more forces than sensors would allow."""
    continuous = structure().state_space(sensors, forces=["f1", "f2", "f3"])
    system = continuous if dt is None else continuous.to_discrete(dt)
    C_u = np.arange(1.0, 22.0).reshape(3, 7) % 5 - 2
    signal = periodic_signal(FREQUENCIES, offset=True, outputs=C_u, dt=dt)
    found = augmented_observability(system, signal)
    np.testing.assert_array_equal(found.unseen_hz, [0.0])
    assert not found.observable
    assert rank_of_observability(augmented_model(system, signal)) == 12
    shared = periodic_signal(FREQUENCIES, outputs=C_u[:, 1:], dt=dt)
    assert augmented_observability(system, shared).observable
    assert rank_of_observability(augmented_model(system, shared)) == 12


def test_displacements_see_a_constant():
    """G(0) is the flexibility."""
    system = structure().state_space("displacement", forces=["f1"])
    signal = periodic_signal([], offset=True)
    assert augmented_observability(system, signal).observable


def test_more_forces_than_sensors_of_their_own_are_not_seen():
    """Two signals of one frequency with states of their own, one sensor: case (3)."""
    system = structure().state_space([("acceleration", "f1")], forces=["f1", "f2"])
    signal = finite_signal(100, 0.02, 1.0, lowest_hz=0.4, n_signals=2)
    found = augmented_observability(system.to_discrete(0.02), signal)
    np.testing.assert_array_equal(found.gains, 0)
    np.testing.assert_allclose(found.frequencies_hz, [0.5, 1.0])


def test_a_blocked_frequency_is_named():
    """A force on mass 1 does not move mass 1 at its antiresonance."""
    system = chain([1.0, 1.0], [100.0, 50.0]).state_space([("acceleration", "f1")], forces=["f1"])
    antiresonance = np.sqrt(50.0) / (2 * np.pi)
    signal = periodic_signal([0.5, antiresonance])
    np.testing.assert_allclose(augmented_observability(system, signal).unseen_hz, antiresonance)


def test_a_mode_that_no_sensor_sees():
    """Two equal masses side by side: a sensor on one does not see the other."""
    system = chain([1.0, 1.0], [100.0, 0.0, 50.0]).state_space(
        [("acceleration", "f1")], forces=["f1"]
    )
    found = augmented_observability(system, periodic_signal([0.5]))
    assert found.structure < 1e-12 and not found.observable


def test_augmentation_checks_what_it_joins():
    """Time domains and numbers of signals must fit."""
    system = structure().state_space(forces=["f1", "f2"])
    with pytest.raises(OptionError, match="one time domain"):
        augmented_model(system, periodic_signal([1.0], dt=0.1))
    with pytest.raises(OptionError, match="needs 2 outputs"):
        augmented_model(system, periodic_signal([1.0]))
