"""StateSpace: exact responses, exact changes of time domain, clear refusals."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from vibrid.errors import DataError, OptionError, UnstableModelError
from vibrid.statespace import (
    Lifting,
    StateSpace,
    free_responses,
    simulate,
    simulate_states,
    state_shift,
)

HOLDS = ("zoh", "foh", "band_limited")


def random_matrices(n, m, p, seed=0):
    """Return A (spectral radius 0.99), B, C, D."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n))
    A *= 0.99 / np.abs(np.linalg.eigvals(A)).max()
    return A, *(rng.standard_normal(shape) for shape in ((n, m), (p, n), (p, m)))


def oscillators(n_pairs=3, m=2, p=3, seed=1):
    """Return a continuous system of damped oscillators below 4 Hz, in a mixed basis."""
    rng = np.random.default_rng(seed)
    poles = -0.3 * rng.random(n_pairs) + 1j * 2 * np.pi * rng.uniform(0.5, 4, n_pairs)
    A = scipy.linalg.block_diag(*([[q.real, q.imag], [-q.imag, q.real]] for q in poles))
    n = 2 * n_pairs
    B, C, D = (rng.standard_normal(shape) for shape in ((n, m), (p, n), (p, m)))
    return StateSpace(A, B, C, D, None).transform(rng.standard_normal((n, n)))


def plain_loop(A, B, C, D, u, x):
    y = np.empty((len(u), len(C)))
    for k in range(len(u)):
        y[k] = C @ x + D @ u[k]
        x = A @ x + B @ u[k]
    return y, x


def largest(error, scale):
    return np.abs(error).max() / np.abs(scale).max()


@pytest.mark.parametrize("n_samples", [1, 31, 64, 5003])  # no, one, whole, many blocks
@pytest.mark.parametrize("sizes", [(10, 1, 3), (1, 1, 1), (3, 0, 2), (40, 6, 5), (300, 2, 1)])
def test_lifting_equals_the_plain_loop(sizes, n_samples):
    """Outputs and the final state are those of the sample-by-sample recursion."""
    n, m, p = sizes
    A, B, C, D = random_matrices(n, m, p)
    rng = np.random.default_rng(5)
    u, x0 = rng.standard_normal((n_samples, m)), rng.standard_normal(n)
    y, final = simulate(A, B, C, D, u, x0)
    expected, expected_final = plain_loop(A, B, C, D, u, x0)
    assert largest(y - expected, expected) < 1e-12
    assert np.linalg.norm(final - expected_final) < 1e-11 * np.linalg.norm(x0)


def test_lifted_twice_equals_the_plain_loop():
    """A record so long that the state from block to block is lifted as well."""
    A, B, C, D = random_matrices(4, 1, 1)
    u = np.random.default_rng(6).standard_normal((52001, 1))
    y, final = simulate(A, B, C, D, u, np.ones(4))
    expected, expected_final = plain_loop(A, B, C, D, u, np.ones(4))
    assert largest(y - expected, expected) < 1e-12
    np.testing.assert_allclose(final, expected_final, atol=1e-11)


@pytest.mark.parametrize("radius", [1.0, 1.01])
def test_lifting_of_defective_and_unstable_systems(radius):
    """A triple pole on or outside the unit circle is simulated as exactly as any other."""
    A = radius * np.eye(3) + np.diag([1.0, 1.0], 1)
    B, C, D = np.eye(3)[:, 2:], np.eye(3), np.zeros((3, 1))
    u = np.random.default_rng(2).standard_normal((3001, 1))
    y, _ = simulate(A, B, C, D, u, np.zeros(3))
    expected, _ = plain_loop(A, B, C, D, u, np.zeros(3))
    assert largest(y - expected, expected) < 1e-12


def test_chunk_after_chunk_is_the_whole():
    """The final state of one chunk is the initial state of the next."""
    A, B, C, D = random_matrices(6, 2, 2)
    u = np.random.default_rng(3).standard_normal((1000, 2))
    kernel, state, parts = Lifting(A, B, C, D), np.ones(6), []
    for start in (0, 137, 500):
        stop = {0: 137, 137: 500, 500: 1000}[start]
        part, state = kernel.run(u[start:stop], state)
        parts.append(part)
    whole, final = simulate(A, B, C, D, u, np.ones(6))
    np.testing.assert_allclose(np.vstack(parts), whole, atol=1e-12 * np.abs(whole).max())
    np.testing.assert_allclose(state, final, atol=1e-12 * np.abs(whole).max())


def test_states_give_the_outputs():
    """y = C x + D u with the simulated states."""
    A, B, C, D = random_matrices(4, 1, 2)
    u = np.random.default_rng(3).standard_normal(200)
    model = StateSpace(A, B, C, D, 0.1)
    x = model.simulate_states(u)
    np.testing.assert_allclose(x @ C.T + u[:, None] @ D.T, model.simulate(u), atol=1e-12)
    np.testing.assert_array_equal(x, simulate_states(A, B, u[:, None], np.zeros(4))[0])


def test_inputs_on_disk(tmp_path):
    """A memory-mapped input gives the same outputs."""
    np.save(tmp_path / "u.npy", np.random.default_rng(0).standard_normal((500, 2)))
    mapped = np.load(tmp_path / "u.npy", mmap_mode="r")
    model = StateSpace(*random_matrices(4, 2, 1), 0.1)
    np.testing.assert_array_equal(model.simulate(mapped), model.simulate(np.array(mapped)))


def test_markov_parameters_are_the_pulse_responses():
    """Lag k of input j is the simulated response to a unit sample at input j."""
    model = StateSpace(*random_matrices(5, 2, 3), 0.1)
    pulse = np.zeros((20, 2))
    pulse[0, 1] = 1
    responses = model.impulse_responses(20)
    np.testing.assert_allclose(responses.values[:, :, 1], model.simulate(pulse), atol=1e-12)
    assert responses.dt == 0.1


@pytest.mark.parametrize("dt", [None, 0.05])
def test_frequency_response_by_solving_each_line(dt):
    """The Schur sweep equals a dense solve at every line, in both time domains."""
    model = StateSpace(*random_matrices(9, 2, 3), dt)
    lines = np.linspace(0.01, 9.9, 37)
    got = model.frequency_response(lines)
    for f, G in zip(lines, got, strict=True):
        s = 2j * np.pi * f
        z = s if dt is None else np.exp(s * dt)
        direct = model.C @ np.linalg.solve(z * np.eye(9) - model.A, model.B) + model.D
        assert largest(G - direct, direct) < 1e-12


def test_frequency_response_on_a_pole_is_refused():
    """A line exactly on an undamped pole is infinite and says so."""
    with pytest.raises(DataError, match="pole"):
        StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]], None).frequency_response([0.0])


@pytest.mark.parametrize("hold", HOLDS)
def test_hold_round_trip(hold):
    """Continuous to discrete and back is the same system to 1e-12."""
    model = oscillators()
    back = model.to_discrete(0.1, hold).to_continuous(hold)
    for name in "ABCD":
        wanted = getattr(model, name)
        assert largest(getattr(back, name) - wanted, wanted) < 1e-12


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_hold_of_a_rigid_body(hold):
    """A double integrator (singular A) under a constant force moves as ½ t²."""
    body = StateSpace([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], None)
    start = -state_shift(body.A, body.B, 0.1, hold)[:, 0]
    y = body.to_discrete(0.1, hold).simulate(np.ones(50), start)[:, 0]
    np.testing.assert_allclose(y, 0.5 * (0.1 * np.arange(50)) ** 2, atol=1e-13)


def test_foh_is_exact_for_a_ramp():
    """One pole driven by t from rest: x = t − 1 + e^{−t}."""
    model = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]], None)
    t = 0.3 * np.arange(40)
    y = model.to_discrete(0.3, "foh").simulate(t)[:, 0]
    np.testing.assert_allclose(y, t - 1 + np.exp(-t), atol=1e-13)


def test_band_limited_is_impulse_invariance():
    """The pulse response is dt times the continuous one, with half the jump at lag 0."""
    model = oscillators()
    pulses = model.to_discrete(0.05, "band_limited").markov_parameters(10)
    for k in range(1, 10):
        exact = 0.05 * model.C @ scipy.linalg.expm(0.05 * k * model.A) @ model.B
        np.testing.assert_allclose(pulses[k], exact, atol=1e-12)
    np.testing.assert_allclose(pulses[0], model.D + 0.025 * model.C @ model.B, atol=1e-13)


@pytest.mark.parametrize("hold", HOLDS)
def test_state_shift_accounts_for_the_feedthrough(hold):
    """x_d = x − S u leaves the output as it is: D_d = D + C S."""
    model = oscillators()
    shift = state_shift(model.A, model.B, 0.05, hold)
    discrete = model.to_discrete(0.05, hold)
    np.testing.assert_allclose(discrete.D, model.D + model.C @ shift, atol=1e-14)


@pytest.mark.parametrize("pole", [0.0, -0.5])
def test_no_principal_logarithm(pole):
    """A pole at zero or on the negative real axis has no continuous counterpart."""
    model = StateSpace(np.diag([0.9, pole]), np.ones((2, 1)), np.ones((1, 2)), [[0.0]], 0.1)
    with pytest.raises(DataError, match=r"pole .* no continuous model"):
        model.to_continuous()


def test_frequencies_and_damping_of_known_poles():
    """One of each pair, ascending; real poles do not count."""
    f, zeta = np.array([3.0, 1.0]), np.array([0.01, 0.2])
    w = 2 * np.pi * f
    blocks = [[[0, 1], [-(wk**2), -2 * z * wk]] for wk, z in zip(w, zeta, strict=True)]
    A = scipy.linalg.block_diag(*blocks, [[-1.0]])
    model = StateSpace(A, np.ones((5, 1)), np.ones((1, 5)), [[0.0]], None)
    for system in (model, model.to_discrete(0.02)):
        np.testing.assert_allclose(system.frequencies_hz, [1.0, 3.0], rtol=1e-12)
        np.testing.assert_allclose(system.damping_ratios, [0.2, 0.01], rtol=1e-9)
        assert system.is_stable


def test_transform_keeps_the_responses():
    """x = T x_new changes no Markov parameter."""
    model = StateSpace(*random_matrices(4, 2, 2), 0.1)
    other = model.transform(np.random.default_rng(8).standard_normal((4, 4)))
    np.testing.assert_allclose(other.markov_parameters(15), model.markov_parameters(15), atol=1e-11)
    product = model.observability_matrix(3) @ model.controllability_matrix(3)
    np.testing.assert_allclose(product[:2, :2], model.C @ model.B, atol=1e-12)
    np.testing.assert_allclose(product[2:4, 2:4], model.C @ model.A @ model.A @ model.B, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9])
def test_free_responses_are_those_of_a_plain_loop(count):
    """C Aᵏ for every number of steps, whole powers of two or not."""
    A, _, C, _ = random_matrices(4, 2, 2)
    expected = [C @ np.linalg.matrix_power(A, k) for k in range(count)]
    np.testing.assert_allclose(free_responses(A, C, count), expected, atol=1e-13)


def test_free_responses_that_overflow_are_not_finite():
    """No warning: what is not finite says it."""
    assert not np.isfinite(free_responses(1e200 * np.eye(2), np.eye(2), 4)).all()


@pytest.mark.parametrize("dt", [None, 0.1])
def test_gramians_and_balancing(dt):
    """Gramians solve their Lyapunov equations; balanced they are equal and diagonal."""
    model = oscillators() if dt is None else oscillators().to_discrete(dt)
    P, A, B = model.controllability_gramian(), model.A, model.B
    residual = A @ P + P @ A.T if dt is None else A @ P @ A.T - P
    assert largest(residual + B @ B.T, P) < 1e-12
    balanced, values = model.balanced()
    wanted = np.diag(values)
    assert largest(balanced.controllability_gramian() - wanted, wanted) < 1e-9
    assert largest(balanced.observability_gramian() - wanted, wanted) < 1e-9
    assert (np.diff(values) <= 0).all()


def test_gramian_of_an_unstable_system_names_the_pole():
    """The refusal gives the pole and a cure."""
    model = StateSpace([[1.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    assert not model.is_stable
    with pytest.raises(UnstableModelError, match=r"1\.5.*Remove it"):
        model.controllability_gramian()


def test_unreachable_state_cannot_be_balanced():
    """Balancing refuses a non-minimal system."""
    model = StateSpace(np.diag([0.5, 0.2]), [[1.0], [0.0]], [[1.0, 1.0]], [[0.0]], 0.1)
    with pytest.raises(DataError, match="unreachable or unobservable"):
        model.balanced()


@pytest.mark.parametrize("dt", [None, 0.1])
def test_to_scipy_and_back(dt):
    """SciPy's systems keep matrices and dt."""
    model = StateSpace(*random_matrices(3, 2, 2), dt)
    back = StateSpace.from_scipy(model.to_scipy())
    assert back.dt == dt
    np.testing.assert_array_equal(back.A, model.A)
    np.testing.assert_array_equal(back.D, model.D)


@pytest.mark.parametrize("dt", [None, 0.1])
def test_to_control_and_back(dt):
    """python-control's systems keep matrices and dt."""
    pytest.importorskip("control", reason="python-control is an extra")
    model = StateSpace(*random_matrices(3, 2, 2), dt)
    back = StateSpace.from_control(model.to_control())
    assert back.dt == dt
    np.testing.assert_array_equal(back.B, model.B)


def test_unspecified_dt_of_another_package_is_refused():
    """A discrete system whose interval is unknown cannot be a StateSpace."""
    from scipy.signal import dlti

    with pytest.raises(OptionError, match="sampling interval is not known"):
        StateSpace.from_scipy(dlti([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=True))


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        (([[1.0, 2.0]], [[1.0]], [[1.0]], [[0.0]]), "A must be 1 × 1"),
        (([[1.0]], [[1.0], [2.0]], [[1.0]], [[0.0]]), "B must be 1 × 1"),
        (([[1.0]], [[1.0]], [[1.0]], [[0.0, 1.0]]), "D must be 1 × 1"),
        (([[np.nan]], [[1.0]], [[1.0]], [[0.0]]), "NaN"),
        ((1.0, [[1.0]], [[1.0]], [[0.0]]), "matrix"),
        (([[1j]], [[1.0]], [[1.0]], [[0.0]]), "real"),
        ((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[0.0]]), "needs a state"),
    ],
)
def test_matrices_that_do_not_fit(matrices, message):
    """Every refusal names the matrix."""
    with pytest.raises(OptionError, match=message):
        StateSpace(*matrices, 0.1)


def test_wrong_simulations_are_refused():
    """Continuous systems, transposed or NaN inputs and wrong states are named."""
    model = StateSpace(*random_matrices(3, 2, 1), 0.1)
    with pytest.raises(OptionError, match="to_discrete"):
        StateSpace(model.A, model.B, model.C, model.D, None).simulate(np.zeros((5, 2)))
    with pytest.raises(OptionError, match=r"\(n_samples, 2\)"):
        model.simulate(np.zeros((2, 5)))
    with pytest.raises(DataError, match="sample 3 is NaN"):
        model.simulate(np.where(np.arange(10)[:, None] == 3, np.nan, np.zeros((10, 2))))
    with pytest.raises(OptionError, match="initial_state must be 3"):
        model.simulate(np.zeros((5, 2)), [1.0])
    with pytest.raises(OptionError, match="n_samples"):
        model.simulate()
