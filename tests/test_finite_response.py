"""Finite impulse responses: naive least squares, exact answers, refusals."""

from __future__ import annotations

import numpy as np
import pytest

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.methods.finite_response import fir, truncation
from vibrid.structures import chain

EXACT = 1e-8  # relative, promised for noise-free data
DT = 0.05


def noisy_test(rng: np.random.Generator, n_samples: int) -> vb.Record:
    """Return 2 forces and 3 accelerations of 5 DOF, with noise."""
    frame = chain(np.ones(5), np.full(5, 800.0), damping_ratio=0.01)
    forces = rng.standard_normal((n_samples, 2))
    full = frame.simulate(forces, DT, forces=["f1", "f3"], noise=0.05, rng=rng)
    return vb.Record(full.outputs[:, [0, 2, 4]], forces, dt=DT)


def test_fir_equals_explicit_least_squares(rng: np.random.Generator) -> None:
    """The Gram gives what the regressors laid out give; masked outputs have no D."""
    record = noisy_test(rng, 500)
    n_lags = 12
    found = fir(record, n_lags, offset="none", feedthrough=[True, False, True]).values
    u, N = record.inputs, record.n_samples
    shifted = np.stack([u[n_lags - 1 - k : N - k] for k in range(n_lags)], axis=1)
    for j, first in enumerate((0, 1, 0)):
        columns = shifted[:, first:].reshape(len(shifted), -1)
        weights = np.linalg.lstsq(columns, record.outputs[n_lags - 1 :, j], rcond=None)[0]
        np.testing.assert_allclose(found[first:, j], weights.reshape(-1, 2), atol=1e-10)
    assert not found[0, 1].any()


def test_fir_is_exact_where_the_response_has_died(rng: np.random.Generator) -> None:
    """A heavily damped structure's Markov parameters come back, a lightly damped one's not."""
    shares, errors = [], []
    for ratio in (0.3, 0.003):
        frame = chain(np.ones(2), np.full(2, 800.0), damping_ratio=ratio)
        record = frame.simulate(white_noise(4000, 1, rng=rng), DT, forces=frame.dofs[:1])
        found = fir(record, 150)
        exact = frame.state_space(forces=frame.dofs[:1]).to_discrete(DT).markov_parameters(150)
        errors.append(np.abs(found.values - exact).max() / np.abs(exact).max())
        shares.append(truncation(found))
    assert errors[0] < EXACT
    assert shares[0] < EXACT
    assert errors[1] > 1e-3
    assert shares[1] > 0.05


def test_fir_takes_the_smallest_of_equal_answers(rng: np.random.Generator) -> None:
    """An input given twice shares its response evenly."""
    u = rng.standard_normal(400)
    y = np.convolve(u, [1.0, 0.5, -0.25])[:400]
    values = fir(vb.Record(y[2:], np.c_[u, u][2:], dt=0.1), 4).values
    expected = np.array([0.5, 0.25, -0.125, 0.0])
    np.testing.assert_allclose(values[:, 0], np.c_[expected, expected], atol=1e-10)


def test_fir_refuses_what_cannot_be_solved(rng: np.random.Generator) -> None:
    """No inputs, too few samples."""
    record = noisy_test(rng, 200)
    with pytest.raises(vb.DataError, match="needs inputs"):
        fir(record.select(inputs=[]), 5)
    with pytest.raises(vb.DataError, match=r"n_lags=80 with 2 inputs needs at least 242 samples"):
        fir(record, 80)
    assert fir(record, 66).values.shape == (66, 3, 2)
    with pytest.raises(vb.OptionError, match="n_lags must be at least 1"):
        fir(record, 0)
