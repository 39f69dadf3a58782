"""OKID: naive least squares, exact answers, the combined Hankel matrix, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from okid_cases import DT, noisy_test, structure

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import white_noise
from vibrid.gram import reduce
from vibrid.identification.finishing import finish
from vibrid.methods.era import ERA, ERADC
from vibrid.methods.okid import OKID
from vibrid.methods.okid.decomposition import state_map
from vibrid.methods.okid.method import hankel_sizes
from vibrid.methods.okid.regression import regress
from vibrid.record import Floats

EXACT = 1e-8  # relative, promised for noise-free data; measured 2e-13


def clean_test(n_dof: int, rng: np.random.Generator, n_forces: int = 1) -> vb.Record:
    """Return a noise-free shaker test that starts mid-motion."""
    frame = structure(n_dof)
    force = white_noise(3000, n_forces, rng=rng)
    start = 0.1 * rng.standard_normal(2 * n_dof)
    return frame.simulate(force, DT, forces=frame.dofs[:n_forces], initial_state=start)


def explicit(record: vb.Record, order: int, dropped: int, mask: Floats) -> Floats:
    """Return the observer Markov parameters by least squares of the regressors laid out."""
    u, y = record.inputs, record.outputs
    z, N, m = np.hstack([u, y]), len(y), u.shape[1]
    past = [z[dropped - k : N - k] for k in range(1, order + 1)]
    found = np.zeros((order + 1, y.shape[1], z.shape[1]))
    for j in range(y.shape[1]):
        columns = np.hstack([*past, u[dropped:]] if mask[j] else past)
        weights = np.linalg.lstsq(columns, y[dropped:, j], rcond=None)[0]
        found[1:, j] = weights[: order * z.shape[1]].reshape(order, -1)
        if mask[j]:
            found[0, j, :m] = weights[order * z.shape[1] :]
    return found


# -- the regression


def test_observer_parameters_equal_explicit_least_squares(rng: np.random.Generator) -> None:
    """Every order nested in one factor equals a regression of its own over the same samples."""
    record = noisy_test(rng, 600)
    stream = open_stream(record, "none")
    mask = np.array([True, False, True])
    data = regress(stream, reduce(stream, 9), 8, mask)
    for order in (1, 5, 8):
        expected = explicit(record, order, 8, mask)
        expected *= stream.scale / stream.output_scale[:, None]
        np.testing.assert_allclose(data.observer(order), expected, atol=1e-10)
        z = np.hstack([record.inputs, record.outputs]) / stream.scale
        errors = z[8:, 2:] - sum(z[8 - k : len(z) - k] @ expected[k].T for k in range(order + 1))
        covariance = errors.T @ errors / len(errors)
        np.testing.assert_allclose(data.innovation(order), covariance, atol=1e-10)


def test_state_map_equals_the_best_start_found_naively(rng: np.random.Generator) -> None:
    """The state after n samples is that of a predictor started where it errs least."""
    A = np.array([[0.9, 0.3, 0.0], [-0.3, 0.9, 0.1], [0.0, 0.0, 0.5]])
    B, C = rng.standard_normal((3, 2)), rng.standard_normal((2, 3))
    D, K = rng.standard_normal((2, 2)), 0.2 * rng.standard_normal((3, 2))
    z, weights, n = rng.standard_normal((6, 4)), np.array([1.0, 3.0]), 6
    found = state_map((A, B, C, D), K, n, weights) @ z[::-1].ravel()

    def run(x: Floats) -> tuple[Floats, Floats]:
        errors = []
        for u, y in zip(z[:, :2], z[:, 2:], strict=True):
            e = y - C @ x - D @ u
            errors.append(weights * e)
            x = A @ x + B @ u + K @ e
        return np.concatenate(errors), x

    still = run(np.zeros(3))[0]
    slopes = np.stack([run(unit)[0] - still for unit in np.eye(3)], axis=1)
    start = np.linalg.lstsq(slopes, -still, rcond=None)[0]
    np.testing.assert_allclose(found, run(start)[1], atol=1e-12)


# -- exact answers


@pytest.mark.parametrize("realization", ["era", "eradc"])
@pytest.mark.parametrize(("n_dof", "observer_order"), [(1, 2), (3, 2), (3, 15), (5, None), (10, 8)])
def test_noise_free_recovery(
    n_dof: int, observer_order: int | None, realization: str, rng: np.random.Generator
) -> None:
    """Markov parameters are exact for observer orders from the least to far too many."""
    frame, record = structure(n_dof), clean_test(n_dof, rng)
    method = OKID(observer_order=observer_order, realization=realization)
    models = method.decompose(record)
    assert models.rank_limited
    assert models.largest_order == 2 * n_dof
    fit = method.realize(models, 2 * n_dof)
    exact = frame.state_space(forces=frame.dofs[:1]).to_discrete(DT).markov_parameters(60)
    np.testing.assert_allclose(
        fit.model.markov_parameters(60), exact, atol=EXACT * np.abs(exact).max()
    )
    assert not fit.kalman_gain.any()
    assert "no-gain" in [finding.code for finding in fit.diagnostics.findings]


def test_offsets_gaps_and_two_records_are_exact(rng: np.random.Generator) -> None:
    """Offsets are projected out, and each piece has its own initial state."""
    frame, first, second = structure(3), clean_test(3, rng), clean_test(3, rng)
    y = first.outputs + np.array([5.0, -300.0, 0.02])
    y[700] = np.nan
    records = [
        vb.Record(y, first.inputs + 7, dt=DT),
        vb.Record(second.outputs + 1.0, second.inputs - 2, dt=DT),
    ]
    stream = open_stream(records)
    method = OKID(observer_order=7)
    fit = finish(method, method.decompose(stream), 6, stream, "raise")
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=EXACT)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=EXACT)


def test_one_mass_of_the_realization_chapter(rng: np.random.Generator) -> None:
    """Mass 1, damping .1, stiffness 1 at 10 Hz: the chapter's eigenvalues to its digits."""
    states = vb.StateSpace([[0, 1], [-1, -0.1]], [[0], [1]], np.eye(2), np.zeros((2, 1)), None)
    u = rng.standard_normal((1000, 1))
    record = vb.Record(states.to_discrete(0.1).simulate(u), u, dt=0.1)
    method = OKID(observer_order=10, realization=ERA(rows=20, columns=20))
    fit = method.realize(method.decompose(record), 2)
    expected = [0.99005398 - 0.09921166j, 0.99005398 + 0.09921166j]
    np.testing.assert_allclose(np.sort_complex(fit.model.poles), expected, atol=1e-8)


def test_displacements_have_no_feedthrough(rng: np.random.Generator) -> None:
    """With displacement sensors D is zero, and B and C are exact all the same."""
    frame = structure(3)
    record = frame.simulate(
        white_noise(2000, 1, rng=rng), DT, sensors="displacement", forces=frame.dofs[:1]
    )
    method = OKID(observer_order=6)
    fit = method.realize(method.decompose(record), 6)
    exact = frame.state_space(forces=frame.dofs[:1], sensors="displacement").to_discrete(DT)
    markov = exact.markov_parameters(40)
    np.testing.assert_allclose(
        fit.model.markov_parameters(40), markov, atol=EXACT * np.abs(markov).max()
    )
    assert not fit.model.D.any()


def test_factors_belong_to_the_model(rng: np.random.Generator) -> None:
    """Observability starts with C, C A, …, controllability with B, A B, …, Hankel or combined."""
    record = clean_test(3, rng, 3)
    for hankel in ("system", "combined"):
        models = OKID(observer_order=2, hankel=hankel).decompose(record)
        found = models.realize(6)
        observability, controllability = models.factors(6)
        np.testing.assert_allclose(observability[:6], np.vstack([found.C, found.C @ found.A]))
        np.testing.assert_allclose(controllability[:, :6], np.hstack([found.B, found.A @ found.B]))


def test_correlations_get_fewer_rows() -> None:
    """ERA/DC stacks its rows; sizes that were asked for stay."""
    assert hankel_sizes(OKID(observer_order=40), 10, 3) == (120, 120)
    assert hankel_sizes(OKID(observer_order=40, realization="eradc"), 10, 3) == (20, 120)
    asked = ERADC(rows=50, columns=70)
    assert hankel_sizes(OKID(observer_order=40, realization=asked), 10, 3) == (50, 70)


# -- the combined Hankel matrix


def test_the_combined_hankel_needs_the_least_observer(rng: np.random.Generator) -> None:
    """[Y, Y°] is exact where observer_order · outputs is the order, and spoilt beyond, said."""
    frame, record = structure(3), clean_test(3, rng, 3)
    exact = np.exp(np.concatenate([frame.poles, frame.poles.conj()]) * DT)
    errors, codes = [], []
    for observer_order in (2, 6):
        method = OKID(observer_order=observer_order, hankel="combined")
        fit = method.realize(method.decompose(record), 6)
        errors.append(np.abs(np.sort_complex(fit.model.poles) - np.sort_complex(exact)).max())
        codes.append([finding.code for finding in fit.diagnostics.findings])
    assert errors[0] < EXACT
    assert errors[1] > 1e-6
    assert "combined-hankel" not in codes[0]
    assert "combined-hankel" in codes[1]


def test_states_of_the_observer_alone_are_said(rng: np.random.Generator) -> None:
    """Six states: two past samples of 3 outputs are their number, four make it twelve."""
    clean = clean_test(3, rng, 3)
    chosen = OKID(hankel="combined").decompose(clean)
    assert chosen.method.observer_order == 2
    assert chosen.largest_order == 6
    assert not chosen.remarks
    longer = OKID(observer_order=4, hankel="combined").decompose(clean)
    assert longer.largest_order == 12
    assert [finding.code for finding in longer.remarks] == ["combined-hankel"]
    assert "has 12 states; the inputs reach 6" in longer.remarks[0].sentence


def test_dependent_inputs_are_said(rng: np.random.Generator) -> None:
    """A force given twice shares its response arbitrarily, and a finding says so."""
    record = clean_test(3, rng)
    twice = vb.Record(record.outputs, np.asarray(record.inputs)[:, [0, 0]], dt=DT)
    for method in (OKID(), ERA(rows=20, columns=20)):
        codes = [finding.code for finding in method.decompose(twice).findings]
        assert "collinear-inputs" in codes


def test_the_combined_hankel_gives_the_same_gain(rng: np.random.Generator) -> None:
    """At the least observer order both Hankel matrices give one predictor, noise or not."""
    clean = clean_test(3, rng, 3)
    noise = 0.05 * clean.outputs.std() * rng.standard_normal(clean.outputs.shape)
    record = vb.Record(clean.outputs + noise, clean.inputs, dt=DT)
    predictors = []
    for hankel in ("system", "combined"):
        method = OKID(observer_order=2, hankel=hankel)
        fit = method.realize(method.decompose(record), 6)
        predictors.append(fit.predictor().markov_parameters(20))
    np.testing.assert_allclose(predictors[0], predictors[1], atol=1e-8)


# -- refusals


def test_errors_name_the_number_and_the_cure(rng: np.random.Generator) -> None:
    """Wrong options and unusable data are refused by message."""
    record = noisy_test(rng, 200)
    with pytest.raises(vb.OptionError, match="Did you mean 'era'"):
        OKID(realization="erra")
    with pytest.raises(vb.OptionError, match="realization must be ERA"):
        OKID(realization=7)
    with pytest.raises(vb.OptionError, match="hankel must be one of system, combined"):
        OKID(hankel="both")
    with pytest.raises(vb.OptionError, match="observer_order must be at least 1"):
        OKID(observer_order=0)
    with pytest.raises(vb.OptionError, match="whitening must be at least 0"):
        OKID(whitening=-1)
    with pytest.raises(vb.DataError, match="OKID needs inputs"):
        OKID().decompose(record.select(inputs=[]))
    with pytest.raises(vb.DataError, match=r"observer_order=40 and 5 channels needs at least 246"):
        OKID(observer_order=40).decompose(record)
    assert OKID(observer_order=32).decompose(record).largest_order > 10
    with pytest.raises(vb.DataError, match="Use at most 32, or a longer record"):
        OKID(observer_order=33).decompose(record)
    with pytest.raises(vb.DataError, match=r"grow .*-fold over .* Use about 5 iterations"):
        OKID(observer_order=5, whitening=1).decompose(noisy_test(np.random.default_rng(1)))


def test_a_short_observer_limits_the_order(rng: np.random.Generator) -> None:
    """Noisy data give observer_order · outputs states, which is no rank of the data."""
    method = OKID(observer_order=3)
    models = method.decompose(noisy_test(rng))
    assert models.largest_order == 9
    assert not models.rank_limited
    with pytest.raises(vb.OptionError, match="more than observer_order=3 with 3 outputs allow"):
        method.realize(models, 10)


def test_exploding_responses_are_refused(rng: np.random.Generator) -> None:
    """Inputs that are no inputs, but hold the outputs' future, make an observer that explodes."""
    y = rng.standard_normal((3000, 1))
    y = y[1:] + 3 * y[:-1]  # a moving average whose inverse, run as a system, grows threefold
    record = vb.Record(y[:-1], y[1:] - 3 * y[:-1] + 0.01 * rng.standard_normal((2998, 1)), dt=DT)
    with pytest.raises(vb.DataError, match=r"the responses grow .* Use N4SID"):
        OKID(observer_order=10).decompose(record)
