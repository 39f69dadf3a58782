"""The subspace family beyond the contract: weightings, gains, gaps, feedback, poor data."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg as sla
from numpy.typing import NDArray

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import white_noise
from vibrid.kalman import innovation_form, spectral_radius
from vibrid.methods.subspace.feedback import feedback_of
from vibrid.structures import chain

Floats = NDArray[np.float64]
DT = 0.05


def noisy_chain(rng: np.random.Generator, n_samples: int = 3000, noise: float = 0.05) -> vb.Record:
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    force = white_noise(n_samples, 2, rng=rng)
    return frame.simulate(force, DT, forces=["f1", "f3"], noise=noise, rng=rng)


def ambient(rng: np.random.Generator, n_samples: int) -> vb.Record:
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    force = white_noise(n_samples, 3, rng=rng)
    return frame.simulate(force, DT, forces=frame.dofs, noise=0.1, rng=rng).select(inputs=[])


def codes(fit: vb.Fit) -> list[str]:
    return [finding.code for finding in fit.diagnostics.findings]


# -- several pieces


def stacked_triangle(record: vb.Record, rows: int) -> Floats:
    """Return the triangle of [U_f; W_p; Y_f], every piece's columns written out."""
    columns = []
    for start, stop in record.segments():
        u, y = record.inputs[start:stop], record.outputs[start:stop]
        z = np.hstack([u, y])
        for t in range(stop - start - 2 * rows + 1):
            future = slice(t + rows, t + 2 * rows)
            columns.append(
                np.concatenate([u[future].ravel(), z[t : t + rows].ravel(), y[future].ravel()])
            )
    return np.asarray(sla.qr(np.array(columns), mode="r")[0])[: len(columns[0])]


def test_three_pieces_equal_an_explicit_stacked_regression(rng: np.random.Generator) -> None:
    """A record cut by gaps into unequal pieces: singular values and poles of stacked columns."""
    record, rows = noisy_chain(rng), 8
    y = record.outputs.copy()
    y[900:907] = np.nan
    y[2300] = np.nan
    cut = vb.Record(y, record.inputs, dt=DT)
    assert [stop - start for start, stop in cut.segments()] == [900, 1393, 699]

    m, p = 2, 3
    a, b = rows * m, rows * (2 * m + p)
    projected = stacked_triangle(cut, rows)[a:b, b:].T
    scale = np.tile(open_stream(cut, "none").output_deviation, rows)[:, None]
    U, s, _ = np.linalg.svd(projected / scale)
    gamma = U[:, :6]
    A = np.linalg.lstsq(gamma[:-p], gamma[p:], rcond=None)[0]

    method = vb.N4SID("moesp", block_rows=rows, transition="shift")
    shared = method.decompose(cut, offset="none")
    unit = open_stream(cut, "none").output_unit
    np.testing.assert_allclose(shared.singular_values[:6] / unit, s[:6], rtol=1e-9)
    poles = np.sort_complex(method.realize(shared, 6).model.poles)
    np.testing.assert_allclose(poles, np.sort_complex(np.linalg.eigvals(A)), rtol=1e-8)


# -- stochastic algorithm


def lowest_spectrum(A: Floats, C: Floats, G: Floats, L0: Floats) -> float:
    """Return the lowest eigenvalue of the spectrum of Λ(l) = C A^(l−1) G on a fine grid."""
    lowest = np.inf
    for angle in np.linspace(0, np.pi, 400):
        half = C @ np.linalg.solve(np.exp(1j * angle) * np.eye(len(A)) - A, G)
        lowest = min(lowest, float(np.linalg.eigvalsh(L0 + half + half.conj().T)[0]))
    return lowest


@pytest.mark.parametrize("transition", ["regression", "shift"])
def test_stochastic_algorithm_always_has_a_gain(transition: str) -> None:
    """Short records, many orders: the covariances are positive real and the predictor stable."""
    for seed in range(8):
        record = ambient(np.random.default_rng(seed), 150)
        method = vb.SSI("stochastic", block_rows=6, transition=transition)
        shared = method.decompose(record)
        for order in (3, 6, 9):
            found = shared.realize(order, transition)
            if found.radius >= 1:
                continue
            assert found.gain == "Riccati"
            assert spectral_radius(found.A - found.K @ found.C) < 1
            P = sla.solve_discrete_lyapunov(found.A, found.K @ found.innovation @ found.K.T)
            G = found.A @ P @ found.C.T + found.K @ found.innovation
            L0 = found.C @ P @ found.C.T + found.innovation
            assert lowest_spectrum(found.A, found.C, G, L0) > 0


def test_stochastic_gain_solves_the_printed_equations(rng: np.random.Generator) -> None:
    """K is that of (22), (23) of Han, Bohn & Bauer (2021) for the model's own covariances."""
    method = vb.SSI("stochastic", block_rows=10, transition="regression")
    found = method.decompose(ambient(rng, 4000)).realize(6, "regression")
    P = sla.solve_discrete_lyapunov(found.A, found.K @ found.innovation @ found.K.T)
    G = found.A @ P @ found.C.T + found.K @ found.innovation
    form = innovation_form(found.A, found.C, G, found.C @ P @ found.C.T + found.innovation)
    assert form is not None
    np.testing.assert_allclose(form[0], found.K, atol=1e-6 * abs(found.K).max())
    np.testing.assert_allclose(form[1], found.innovation, rtol=1e-6)


@pytest.mark.parametrize("kind", ["covariance", "data", "cva", "stochastic"])
def test_every_kind_finds_the_modes(kind: str, rng: np.random.Generator) -> None:
    """Ambient data, one reference: frequencies within 1 %."""
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    record = ambient(rng, 20_000)
    fit = vb.identify(
        record,
        vb.SSI(kind, block_rows=20, references=("acceleration_f1", "acceleration_f3")),
        order=6,
    )
    np.testing.assert_allclose(vb.modes_of(fit).frequencies_hz, frame.frequencies_hz, rtol=0.01)


# -- ssarx


def test_ssarx_agrees_with_cva_in_open_loop(rng: np.random.Generator) -> None:
    """Without feedback both are consistent: damping within 2 % of the truth and each other."""
    record = noisy_chain(rng, 20_000)
    for transition in ("regression", "shift"):
        for weighting in ("ssarx", "cva"):
            method = vb.N4SID(weighting, block_rows=30, transition=transition)
            modes = vb.modes_of(vb.identify(record, method, order=6))
            np.testing.assert_allclose(modes.damping_ratios, 0.01, rtol=0.05)


def test_ssarx_records_what_it_is(rng: np.random.Generator) -> None:
    """The fit names its weighting; "auto" names the one that was taken."""
    record = noisy_chain(rng)
    assert vb.identify(record, vb.N4SID("ssarx", 10), order=6).method.weighting == "ssarx"
    assert vb.identify(record, vb.N4SID(block_rows=10), order=6).method.weighting == "cva"
    assert vb.identify(record, order=6).method.weighting in ("cva", "moesp")


# -- feedback


def test_feedback_is_rarely_seen_where_there_is_none() -> None:
    """Open loop with process noise, white and coloured forces: no alarm in 40 records."""
    smallest = 1.0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        frame = chain(np.ones(2), np.full(2, 600.0), damping_ratio=0.01)
        force = white_noise(1500, 2, rng=rng)
        if seed % 2:
            force[1:] += 0.9 * force[:-1]
        whole = frame.simulate(force, DT, forces=frame.dofs, noise=0.1, rng=rng)
        shared = vb.N4SID(block_rows=15).decompose(whole.select(inputs=["force_f1"]))
        feedback = feedback_of(shared.factor.triangle, shared.layout, shared.n_columns)
        assert feedback is not None and feedback.noise > 0.05
        assert not feedback.suspected
        smallest = min(smallest, feedback.probability)
    assert smallest > 1e-4


def test_feedback_switches_to_regression(rng: np.random.Generator) -> None:
    """A force that follows the outputs is found, and said; explicit options stay."""
    frame = chain([1.0], [600.0], damping_ratio=0.02)
    model = frame.state_space(sensors="velocity", forces=["f1"]).to_discrete(DT)
    A, B, C, x, seen = model.A, model.B, model.C, np.zeros(2), 0.0
    u, y, e = np.zeros((6000, 1)), np.zeros((6000, 1)), rng.standard_normal((6000, 2))
    for t in range(len(u)):
        u[t] = 0.5 * e[t, 0] - 2 * seen
        y[t] = seen = (C @ x).item() + 1e-4 * e[t, 1]
        x = A @ x + B[:, 0] * (u[t] + e[t, 1])
    record = vb.Record(y, u, dt=DT)
    fit = vb.identify(record, vb.N4SID(block_rows=15), order=2)
    assert "feedback" in codes(fit)
    assert (fit.method.transition, fit.method.completion) == ("regression", "prediction")
    assert "feedback" in fit.diagnostics.figures["choices"][-1]
    kept = vb.identify(record, vb.N4SID(block_rows=15, transition="shift"), order=2)
    assert kept.method.transition == "shift" and "feedback" in codes(kept)


# -- poor data are named


def with_inputs(record: vb.Record, inputs: Any) -> vb.Record:
    return vb.Record(record.outputs, inputs, dt=record.dt)


def test_a_clean_test_has_no_findings(rng: np.random.Generator) -> None:
    """White independent forces, living sensors: nothing to say about the data."""
    fit = vb.identify(noisy_chain(rng), vb.N4SID(block_rows=15), order=6)
    said = set(codes(fit))
    assert not said & {"excitation", "collinear-inputs", "clipping", "dead-channel", "feedback"}
    assert "near-nyquist" not in said


def test_too_few_sines_are_said(rng: np.random.Generator) -> None:
    """Three sines excite order 6 of the 20 block rows; the finding holds both numbers."""
    frame = chain([1.0, 1.0], [600.0, 600.0], damping_ratio=0.01)
    t = np.arange(3000) * DT
    force = np.sum([np.sin(2 * np.pi * f * t + f) for f in (1.1, 2.3, 4.7)], axis=0)[:, None]
    record = frame.simulate(force, DT, forces=["f1"], noise=0.05, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=10), order=4, stability="project")
    finding = next(each for each in fit.diagnostics.findings if each.code == "excitation")
    assert "rank 6 of the 20" in finding.sentence


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_collinear_inputs_are_named(noise: float, rng: np.random.Generator) -> None:
    """Two of three inputs that (nearly) follow from each other, even by a filter."""
    record = noisy_chain(rng)
    u = record.inputs
    echo = np.convolve(u[:, 0], [1.0, 0.4])[: len(u)] + noise * rng.standard_normal(len(u))
    fit = vb.identify(
        with_inputs(record, np.c_[u, echo]), vb.N4SID(block_rows=10), order=6, stability="project"
    )
    finding = next(each for each in fit.diagnostics.findings if each.code == "collinear-inputs")
    assert "u1" in finding.sentence and "u3" in finding.sentence
    assert "u2" not in finding.sentence


def test_clipped_dead_and_folded_channels_are_named(rng: np.random.Generator) -> None:
    """Each defect is found in the channel that has it, and in no other."""
    record = noisy_chain(rng, 6000)
    y = record.outputs / record.outputs.std(axis=0)
    y[:, 0] = np.clip(y[:, 0], -1.2, 1.2)
    stuck = np.repeat(rng.standard_normal(300), 20)
    nyquist = np.cumprod(np.full(6000, -1.0)) * (1 + 0.1 * rng.standard_normal(6000))
    table = np.c_[y, stuck, nyquist + 0.1 * rng.standard_normal(6000)]
    names = ["clipped", "good", "fine", "stuck", "fast"]
    broken = vb.Record(table, record.inputs, dt=DT, output_channels=names)
    fit = vb.identify(broken, vb.N4SID(block_rows=10), order=8, stability="project")
    said = {finding.code: finding.sentence for finding in fit.diagnostics.findings}
    assert said["clipping"].startswith("clipped rest")  # and not what is stuck
    assert said["dead-channel"].startswith("stuck hardly")
    assert said["near-nyquist"].startswith("fast:")


def test_a_weak_channel_among_its_kind_is_named(rng: np.random.Generator) -> None:
    """An accelerometer that gives a millionth of what the others give is dead."""
    record = noisy_chain(rng)
    channels = [vb.Channel(f"a{k}", "acceleration", "m/s²") for k in range(3)]
    weak = vb.Record(record.outputs * [1, 1e-6, 1], record.inputs, dt=DT, output_channels=channels)
    fit = vb.identify(weak, vb.N4SID(block_rows=10), order=6)
    said = {finding.code: finding.sentence for finding in fit.diagnostics.findings}
    assert said["dead-channel"].startswith("a1 hardly")


# -- large orders, wide systems


def test_order_above_block_rows(rng: np.random.Generator) -> None:
    """Order 20 with 12 block rows of 10 outputs: every mode exact."""
    frame = chain(np.linspace(1.0, 1.5, 10), np.full(10, 800.0), rayleigh=(0.1, 2e-4))
    record = frame.simulate(white_noise(3000, 1, rng=rng), DT, forces=["f1"])
    fit = vb.identify(record, vb.N4SID(block_rows=12), order=20)
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, frame.damping_ratios, rtol=1e-8)


def test_sixty_channels_and_order_200(rng: np.random.Generator) -> None:
    """A hundred modes, 60 noisy channels, 6 block rows: 200 states, the low modes right."""
    frame = chain(np.linspace(1, 2, 100), np.full(100, 3600.0), damping_ratio=0.01)
    force = white_noise(4000, 100, rng=rng)
    record = frame.simulate(force, 0.02, forces=frame.dofs, noise=0.01, rng=rng)
    names = list(record.output_names)
    wide = record.select(inputs=[], outputs=names[:60])
    fit = vb.identify(wide, vb.SSI("data", block_rows=6), order=200, stability="project")
    assert fit.order == 200 and np.isfinite(fit.model.A).all() and fit.model.is_stable
    found = vb.modes_of(fit).frequencies_hz
    nearest = np.abs(found[:, None] - frame.frequencies_hz).min(axis=0) / frame.frequencies_hz
    assert np.median(nearest) < 0.02
    with pytest.raises(vb.OptionError, match=r"order=301 .* 6 future rows of 60 outputs .* 300"):
        vb.identify(wide, vb.SSI("data", block_rows=6), order=301)


def test_more_outputs_than_samples_says_what_is_missing(rng: np.random.Generator) -> None:
    """The message holds the samples that there are and those that it takes."""
    record = vb.Record(rng.standard_normal((70, 60)), dt=DT)
    with pytest.raises(vb.DataError, match=r"at least 243 samples; the record has 70"):
        vb.identify(record, vb.SSI())
    with pytest.raises(vb.DataError, match="at least as many samples as channels"):
        vb.Record(rng.standard_normal((50, 60)), dt=DT)


# -- stability


def growing(rng: np.random.Generator) -> vb.Record:
    """Return a forced motion that grows: every model of it is unstable."""
    u = rng.standard_normal((800, 1))
    y, x = np.zeros((800, 1)), 0.0
    for t in range(800):
        y[t] = x + 0.01 * rng.standard_normal()
        x = 1.01 * x + u[t, 0]
    return vb.Record(y, u, dt=DT)


def test_automatic_order_can_be_projected(rng: np.random.Generator) -> None:
    """Where every order is unstable, "raise" names the pole and "project" gives a model."""
    record = growing(rng)
    for method in (None, vb.N4SID(block_rows=4)):
        with pytest.raises(vb.UnstableModelError, match=r"magnitude .* Hz"):
            vb.identify(record, method, offset="none")
        fit = vb.identify(record, method, offset="none", stability="project")
        assert fit.model.is_stable and "projected" in codes(fit)
