"""The subspace family beyond the contract: gaps, gains, weightings, transitions, large orders."""

from __future__ import annotations

import re

import numpy as np
import pytest
import scipy.linalg as sla
from subspace_cases import DT, codes, coloured, noisy_chain

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import white_noise
from vibrid.kalman import innovation_form, spectral_radius
from vibrid.record import Floats
from vibrid.structures import chain

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


def ambient(rng: np.random.Generator, n_samples: int) -> vb.Record:
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.01)
    force = white_noise(n_samples, 3, rng=rng)
    return frame.simulate(force, DT, forces=frame.dofs, noise=0.1, rng=rng).select(inputs=[])


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


# -- weightings


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


def test_weightings_of_one_factor_equal_decompositions_of_their_own(
    rng: np.random.Generator,
) -> None:
    """What an automatic choice compares is what each weighting gives when asked for."""
    stream = open_stream(noisy_chain(rng))
    method = vb.N4SID(block_rows=10)
    for found in method.alternatives(method.decompose(stream)):
        alone = vb.N4SID(found.method.weighting, block_rows=10).decompose(stream)
        np.testing.assert_allclose(found.singular_values, alone.singular_values, rtol=1e-12)
        np.testing.assert_allclose(found.realize(6).A, alone.realize(6).A, rtol=1e-12)


# -- the choice of the transition


def test_free_responses_rank_transitions_whatever_the_input() -> None:
    """Under a coloured force, where B is badly known, the Gram still prefers shift invariance.

    Its regression misses several times the damping; what is projected out is what it hides in.
    """
    for seed in range(4):
        subspace = vb.N4SID(block_rows=20).decompose(coloured(seed))
        costs = [subspace.free_cost(subspace.realize(6, name)) for name in ("regression", "shift")]
        assert costs[1] < costs[0] - 1


def test_free_cost_is_that_of_explicit_projections(rng: np.random.Generator) -> None:
    """The same as from explicit Hankel columns, future inputs projected out by least squares."""
    record, rows = noisy_chain(rng, 600), 8
    subspace = vb.N4SID("moesp", block_rows=rows).decompose(record, offset="none")
    model = subspace.realize(6, "shift")
    stream = open_stream(record, "none")
    z = stream.read(stream.segments[0], 0, 600)
    count = 600 - 2 * rows + 1
    windows = np.array([z[t : t + 2 * rows] for t in range(count)])
    inputs = windows[:, rows:, :2].reshape(count, -1)
    states = windows[:, :rows].reshape(count, -1) @ subspace.state_map[:6].T
    costs = []
    for step in (1, 3, 5, 7):
        missed = windows[:, rows + step, 2:] - states @ np.linalg.matrix_power(model.A.T, step) @ (
            model.C.T
        )
        missed -= inputs @ np.linalg.lstsq(inputs, missed, rcond=None)[0]
        costs.append(np.linalg.slogdet(missed.T @ missed / count)[1])
    np.testing.assert_allclose(subspace.free_cost(model), np.mean(costs), rtol=1e-9)


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


def test_undamped_decays_can_be_projected() -> None:
    """Noise puts half of the undamped poles outside the circle: projected, no mode is lost."""
    rng = np.random.default_rng(1)
    frame = chain(np.ones(3), np.full(3, 600.0), damping_ratio=0.0)
    start = np.array([1.0, 0.3, -0.5, 0.0, 0.0, 0.0])
    record = frame.simulate(None, 0.02, n_samples=2000, initial_state=start, noise=0.02, rng=rng)
    method = vb.ERA(responses="decay")
    cautious = vb.identify(record, method)
    assert re.search(
        r"(\d+) of 36 orders were unstable and skipped, \1 of them by growth of less than e.*"
        'stability="project" keeps these',
        cautious.diagnostics.figures["choices"][-1],
    )
    fit = vb.identify(record, method, stability="project")
    assert fit.order == 6 and "projected" in codes(fit)
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=1e-3)
    assert (np.abs(modes.damping_ratios) < 1e-4).all()
