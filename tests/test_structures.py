"""Structures: published frequencies, and records against independent solutions."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.record import Channel
from vibrid.structures import Structure, chain, shear_frame

HOLDS = ("zoh", "foh", "band_limited")


def two_masses():
    """Return a non-proportionally damped chain, 1 to 4 Hz."""
    return chain([2.0, 1.0], [300.0, 200.0], dashpots=[0.5, 3.0])


# -- published answers


def test_five_storey_shear_building():
    """Five equal storeys, 25.91 kg and 10 kN/m."""
    frame = shear_frame(5, 25.91, 1e4, damping_ratio=0.02)
    published = [0.88995, 2.59776, 4.09511, 5.26070, 6.00010]
    np.testing.assert_allclose(frame.frequencies_hz, published, atol=6e-6)
    np.testing.assert_allclose(frame.damping_ratios, 0.02, rtol=1e-10)


def test_four_masses_tuned_to_the_lanl_structure():
    """Four masses, one of them on a 1 N/m spring to the ground (nearly a rigid body)."""
    structure = chain(
        [6.20156, 7.50421, 8.22479, 7.65575],
        [1.0, 398933.2, 464357.1, 457672.5],
        damping_ratio=[0.0, 0.06, 0.02, 0.008],
    )
    np.testing.assert_allclose(structure.frequencies_hz[0], 0.029, atol=5e-4)
    np.testing.assert_allclose(structure.frequencies_hz[1:], [30.698, 54.308, 70.751], atol=6e-4)
    np.testing.assert_allclose(structure.damping_ratios[1:], [0.06, 0.02, 0.008], rtol=1e-8)


@pytest.mark.parametrize(
    ("scale", "share", "omega", "ratios"),
    [
        (1.0, 0.2, [1.38197, 2.62866, 3.61803, 4.25325], [0.13820, 0.26287, 0.36180, 0.42533]),
        (0.9, 0.1, [1.31105, 2.49376, 3.43237, 4.03499], [0.06555, 0.12469, 0.17162, 0.20175]),
    ],
)
def test_crassidis_and_junkins(scale, share, omega, ratios):
    """Optimal Estimation, examples 6.6 and 7.6: both ends held, damping ∝ stiffness."""
    structure = chain(np.ones(4), scale * np.full(5, 5.0), rayleigh=(0.0, share))
    np.testing.assert_allclose(2 * np.pi * structure.frequencies_hz, omega, atol=6e-6)
    np.testing.assert_allclose(structure.damping_ratios, ratios, atol=6e-6)


def test_cara_two_dof():
    """Two masses: ω 10.72016 and 20.85853 rad/s."""
    structure = chain([35.0, 17.5], [8750.0, 3500.0], damping_ratio=0.02)
    np.testing.assert_allclose(
        2 * np.pi * structure.frequencies_hz, [10.72016, 20.85853], atol=6e-6
    )


def test_iasc_asce_phase_one():
    """Twelve DOFs, three uncoupled directions of the four-storey benchmark frame."""
    masses, inertias = [3452.4, 2652.4, 2652.4, 1809.9], [3819.4, 2986.1, 2986.1, 2056.9]
    for m, k, published in (
        (masses, 67.90e6, [9.411, 25.544, 38.662, 48.006]),
        (masses, 106.60e6, [11.791, 32.006, 48.443, 60.151]),
        (inertias, 232.0e6, [16.382, 44.640, 67.475, 83.620]),
    ):
        hertz = shear_frame(4, m, k, damping_ratio=0.01).frequencies_hz
        np.testing.assert_allclose(hertz, published, atol=1e-3)


# -- exact answers


def test_modes_solve_the_quadratic_eigenproblem():
    """(λ² M + λ R + K) φ = 0, largest component 1, also for non-proportional damping."""
    structure = two_masses()
    for pole, shape in zip(structure.poles, structure.shapes.T, strict=True):
        residual = pole**2 * structure.mass + pole * structure.damping + structure.stiffness
        np.testing.assert_allclose(residual @ shape, 0, atol=1e-10)
        np.testing.assert_allclose(shape[np.abs(shape).argmax()], 1, rtol=1e-14)
    assert np.abs(structure.shapes.imag).max() > 1e-3


def test_rigid_body_and_overdamped_motion_do_not_count():
    """A free pair of masses has one mode; a heavily damped mass has none."""
    assert len(chain([1.0, 1.0], [0.0, 4.0]).poles) == 1
    assert len(chain([1.0], [1.0], dashpots=[10.0]).poles) == 0


# -- records


@pytest.mark.parametrize("hold", HOLDS)
def test_free_decay_of_one_mass(hold):
    """q(t) = e^{−ζωt} cos(ω_d t) + … from q(0) = 1, whatever the hold."""
    structure = chain([1.0], [(2 * np.pi) ** 2], damping_ratio=0.1)
    record = structure.simulate(
        None, 0.07, sensors="displacement", hold=hold, initial_state=[1.0, 0.0], n_samples=100
    )
    t, w, wd = 0.07 * np.arange(100), 2 * np.pi, 2 * np.pi * np.sqrt(0.99)
    exact = np.exp(-0.1 * w * t) * (np.cos(wd * t) + 0.1 * w / wd * np.sin(wd * t))
    np.testing.assert_allclose(record.outputs[:, 0], exact, atol=1e-12)


def trigonometric(u, factor):
    """Return the trigonometric polynomial through u on a grid `factor` times as fine."""
    spectrum = np.fft.rfft(u, axis=0)
    if len(u) % 2 == 0:
        spectrum[-1] /= 2  # the Nyquist line becomes an inner pair of lines: a cosine
    return factor * np.fft.irfft(spectrum, factor * len(u), axis=0)


@pytest.mark.parametrize("n_samples", [60, 61])
@pytest.mark.parametrize("base", [False, True])
def test_band_limited_equals_a_fine_grid(n_samples, base):
    """The band-limited record is the limit of held inputs on ever finer grids.

    Samples held around their instant (half a step early) converge with the square of the step.
    """
    structure = two_masses()
    where = {"forces": [] if base else ["f2"], "base": base, "sensors": "velocity"}
    u = white_noise(n_samples, rng=np.random.default_rng(1))
    start = [0.01, -0.02, 0.3, 0.1]
    record = structure.simulate(u, 0.1, hold="band_limited", initial_state=start, **where)
    errors = []
    for factor in (50, 100):
        fine = trigonometric(u, 2 * factor)[1::2]  # the value in the middle of every step
        held = structure.simulate(fine, 0.1 / factor, initial_state=start, **where)
        errors.append(np.abs(held.outputs[::factor] - record.outputs).max())
    assert errors[1] < 1e-4 * np.abs(record.outputs).max()
    assert errors[1] < errors[0] / 3.5


def test_band_limited_steady_state_of_a_cosine():
    """A structure that starts in its steady state stays in it."""
    structure = two_masses()
    model = structure.state_space("acceleration", ["f1"])
    f, dt, n = 1.5, 0.05, 40
    t = dt * np.arange(n)
    response = model.frequency_response([f])[0, :, 0]
    s = 2j * np.pi * f
    start = np.linalg.solve(s * np.eye(4) - model.A, model.B[:, 0]).real
    record = structure.simulate(
        np.cos(2 * np.pi * f * t), dt, forces=["f1"], hold="band_limited", initial_state=start
    )
    exact = (response * np.exp(s * t)[:, None]).real
    np.testing.assert_allclose(record.outputs, exact, atol=1e-11)


def test_holds_on_a_fine_grid_agree_with_the_matrix_exponential():
    """zoh and foh: integrate one step by a dense exponential of the augmented system."""
    structure, dt = two_masses(), 0.08
    model = structure.state_space("acceleration", ["f1"])
    u = np.random.default_rng(2).standard_normal(30)
    generator = np.zeros((6, 6))  # states, input, slope of the input
    generator[:4, :4], generator[:4, 4:5], generator[4, 5] = model.A, model.B, 1
    step = scipy.linalg.expm(generator * dt)
    for hold in ("zoh", "foh"):
        x, expected = np.zeros(4), []
        for now, after in zip(u, [*u[1:], 0.0], strict=True):
            expected.append(model.C @ x + model.D[:, 0] * now)
            slope = (after - now) / dt if hold == "foh" else 0.0
            x = (step @ np.concatenate([x, [now, slope]]))[:4]
        record = structure.simulate(u, dt, forces=["f1"], hold=hold)
        np.testing.assert_allclose(record.outputs, expected, atol=1e-11)


def test_physical_matrices_survive_the_logarithm():
    """M⁻¹K and M⁻¹R come back from the sampled model of 60 storeys to rounding."""
    frame = shear_frame(60, 1.0, 16000.0, damping_ratio=0.01)
    model = frame.state_space("displacement", ["f1"])
    back = model.to_discrete(0.005).to_continuous()
    np.testing.assert_allclose(back.A, model.A, atol=1e-13 * np.abs(model.A).max())


def test_band_limited_rigid_body():
    """A force without mean moves a free body exactly; one with a mean is refused."""
    body = chain([2.0], [0.0])
    dt, n, w = 0.1, 50, 2 * np.pi * 0.4
    t = dt * np.arange(n)
    record = body.simulate(
        np.cos(w * t), dt, sensors="displacement", forces=["f1"], hold="band_limited"
    )
    np.testing.assert_allclose(record.outputs[:, 0], (1 - np.cos(w * t)) / (2 * w**2), atol=1e-12)
    with pytest.raises(DataError, match=r"mean 1.*rigid-body"):
        body.simulate(1 + np.cos(w * t), dt, forces=["f1"], hold="band_limited")


def test_band_limited_resonance_is_refused():
    """An undamped pole on a line of the spectrum has no steady state."""
    structure = chain([1.0], [(2 * np.pi) ** 2])
    u = white_noise(40, rng=np.random.default_rng(0))
    with pytest.raises(DataError, match="1 Hz"):
        structure.simulate(u, 0.1, forces=["f1"], hold="band_limited")


def test_record_is_labelled():
    """Channels carry quantity, unit and DOF; the base is the last input."""
    frame = shear_frame(2, 1.0, 100.0, damping_ratio=0.01, dofs=["1x", "2x"])
    record = frame.simulate(
        np.zeros((10, 2)),
        0.1,
        sensors=[("velocity", "2x"), Channel("A7", "acceleration", "m/s2", "1x", sign=-1)],
        forces=["2x"],
        base=True,
        name="test",
    )
    assert record.output_names == ("velocity_2x", "A7")
    assert record.output_channels[0] == Channel("velocity_2x", "velocity", "m/s", "2x")
    assert record.input_channels[0] == Channel("force_2x", "force", "N", "2x")
    assert record.input_channels[1].quantity == "base_acceleration"
    assert (record.dt, record.name) == (0.1, "test")


def test_sign_of_a_channel_flips_the_data():
    """A sensor mounted against its DOF measures the negative."""
    u = np.random.default_rng(0).standard_normal(50)
    plain, turned = (
        two_masses().simulate(
            u, 0.1, forces=["f1"], sensors=[Channel("a", "acceleration", dof="f2", sign=sign)]
        )
        for sign in (1, -1)
    )
    np.testing.assert_array_equal(plain.outputs, -turned.outputs)


def test_noise_has_the_ratio_asked_for():
    """Noise is a share of each output's own standard deviation, and repeatable."""
    u = white_noise(20000, rng=np.random.default_rng(0))
    clean = two_masses().simulate(u, 0.1, forces=["f1"])
    noisy = two_masses().simulate(u, 0.1, forces=["f1"], noise=0.05, rng=np.random.default_rng(1))
    ratio = (noisy.outputs - clean.outputs).std(axis=0) / clean.outputs.std(axis=0)
    np.testing.assert_allclose(ratio, 0.05, rtol=0.03)


def test_refusals():
    """Unknown DOFs, two dampings, missing rng, skew matrices, unplaced inputs are named."""
    structure, u = two_masses(), np.zeros(10)
    with pytest.raises(OptionError, match="No DOF is called 'f3'"):
        structure.simulate(u, 0.1, forces=["f3"])
    with pytest.raises(OptionError, match="name DOFs in forces"):
        structure.simulate(u, 0.1)
    with pytest.raises(OptionError, match="list of DOF labels"):
        structure.simulate(u, 0.1, forces="f1")
    with pytest.raises(OptionError, match="Noise needs rng"):
        structure.simulate(u, 0.1, forces=["f1"], noise=0.1)
    with pytest.raises(OptionError, match="must be one of zoh"):
        structure.simulate(u, 0.1, forces=["f1"], hold="linear")
    with pytest.raises(OptionError, match="damping_ratio and dashpots"):
        chain([1.0], [1.0], damping_ratio=0.1, dashpots=[1.0])
    with pytest.raises(OptionError, match="springs must be 2"):
        chain([1.0, 1.0], [1.0])
    with pytest.raises(OptionError, match="mass must be one number or 3"):
        shear_frame(3, [1.0, 1.0], 1.0)
    with pytest.raises(OptionError, match="symmetric"):
        Structure(np.eye(2), np.eye(2), [[1.0, 0.5], [0.0, 1.0]])
    with pytest.raises(OptionError, match="2 different labels"):
        Structure(np.eye(2), np.eye(2), np.eye(2), ["a", "a"])
