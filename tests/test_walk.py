"""Pieces reduced a block of samples at a time, against columns made sample by sample."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import vibrid as vb
from vibrid.chunks import Stream, open_stream
from vibrid.identification import walk
from vibrid.identification.equations import Equations, set_up
from vibrid.identification.modal_basis import modal_basis
from vibrid.identification.walk import Piece, make_filters, reduce_piece
from vibrid.record import Floats
from vibrid.statespace import block_states

A = np.array([[0.9, 0.3, 0.0], [-0.3, 0.9, 0.1], [0.0, 0.0, -0.4]])
C = np.array([[1.0, 0.2, 0.5], [0.0, 1.0, -1.0]])
GAIN = np.array([[0.1, 0.0], [0.2, 0.1], [0.0, 0.3]])


def stream_of(rng: np.random.Generator, n_samples: int) -> Stream:
    """Return noise of two inputs and two outputs."""
    z = rng.standard_normal((n_samples, 4))
    return open_stream(vb.Record(z[:, 2:], z[:, :2], dt=0.1))


def columns_by_loop(stream: Stream, gain: Floats) -> Floats:
    """Return [1, u, ξ, decay, target] of the first segment, one sample after the other."""
    transition = A - gain @ C
    basis = modal_basis(transition)
    assert basis is not None
    states, state, rows = [np.zeros(3), np.zeros(3), basis.start], np.zeros(3), []
    for sample in stream.read(stream.segments[0], 0, stream.segments[0].length):
        u, y = sample[:2], sample[2:]
        rows.append(np.concatenate([[1.0], u, *states, y - C @ state]))
        pushed = (u[0], u[1], 0.0)
        states = [basis.blocks @ x + basis.start * v for x, v in zip(states, pushed, strict=True)]
        state = transition @ state + gain @ y
    return np.array(rows)


@pytest.mark.parametrize("gain", [np.zeros_like(GAIN), GAIN], ids=["simulation", "prediction"])
@pytest.mark.parametrize("edges", [(0, 2000), (0, 703, 2000), (0, 5, 90)])
@pytest.mark.parametrize("path", ["cholesky", "qr"])
def test_triangles_have_the_gram_of_the_columns(
    rng: np.random.Generator,
    monkeypatch: pytest.MonkeyPatch,
    gain: Floats,
    edges: tuple[int, ...],
    path: str,
) -> None:
    """States go on from piece to piece, whatever the lengths; both paths give the same."""
    stream = stream_of(rng, edges[-1])
    if path == "qr":
        monkeypatch.setattr(walk, "scaled_cholesky", lambda gram: (None, 0.0))
    monkeypatch.setattr(walk, "CHUNK_ELEMENTS", 1)  # many chunks
    basis = modal_basis(A - gain @ C)
    assert basis is not None
    filters = make_filters(basis, A - gain @ C, C, gain, 2, 1)
    expected, states = columns_by_loop(stream, gain), filters.at_rest()
    for start, stop in pairwise(edges):
        triangle, states = reduce_piece(stream, Piece(0, 0, start, stop), filters, states)
        rows = expected[start:stop]
        np.testing.assert_allclose(triangle.T @ triangle, rows.T @ rows, rtol=1e-11, atol=1e-10)


def equations_of(rng: np.random.Generator) -> Equations:
    """Return equations whose weight is full and where one output has no D."""
    basis = modal_basis(A)
    assert basis is not None
    weight, direct = np.array([[1.0, 0.0], [0.5, 2.0]]), np.array([True, False])
    pieces = [Piece(0, 0, 0, 300), Piece(0, 0, 300, 700)]
    none = np.zeros_like(GAIN)
    return set_up(stream_of(rng, 700), pieces, A, C, basis, none, weight, direct)


def test_normal_matrix_is_that_of_the_rows(rng: np.random.Generator) -> None:
    """Products of columns times products of coefficients are the products of explicit rows."""
    equations = equations_of(rng)
    rows = np.vstack(list(equations._weighted_rows(1)))
    found = equations._normal(1)
    # the target's own square also holds what no column explains
    np.testing.assert_allclose(found[:, :-1], (rows.T @ rows)[:, :-1], rtol=1e-11, atol=1e-10)


def test_no_step_betters_the_solution(rng: np.random.Generator) -> None:
    """Moving any unknown raises the weighted squares, and `squares` counts them right."""
    equations = equations_of(rng)
    best = equations.solve()
    W = equations.weight

    def cost(shared: Floats) -> float:
        moved = equations.squares(type(best)(shared, best.states))
        return float(np.trace(W @ moved @ W.T))

    for k in range(len(best.shared)):
        step = np.zeros_like(best.shared)
        step[k] = 0.01
        assert min(cost(best.shared + step), cost(best.shared - step)) > cost(best.shared)


@pytest.mark.parametrize("count", [0, 1, 2, 50, 400])
def test_block_states_against_a_loop(rng: np.random.Generator, count: int) -> None:
    """Stretches side by side give the states of one recursion after the other."""
    drives, state = rng.standard_normal((count, 2, 3)), rng.standard_normal((2, 3))
    found, expected = np.empty((count, 2, 3)), []
    last = block_states(A, drives, state, found)
    for drive in drives:
        expected.append(state)
        state = state @ A.T + drive
    np.testing.assert_allclose(found, np.reshape(expected, drives.shape), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(last, state, rtol=1e-12, atol=1e-12)


def test_a_vanished_decay_leaves_zeros_and_no_warning(rng: np.random.Generator) -> None:
    """A second half that no initial state reaches has a zero decay, and is solved all the same."""
    basis = modal_basis(A)
    assert basis is not None
    pieces = [Piece(0, 0, 0, 30000), Piece(0, 0, 30000, 60000)]
    stream, some = stream_of(rng, 60000), np.array([True, True])
    found = set_up(stream, pieces, A, C, basis, np.zeros_like(GAIN), np.eye(2), some)
    decay = found.triangles[1][:, 3 + 2 * 3 : 3 + 3 * 3]
    assert not decay.any()
    assert np.isfinite(found.solve([1]).shared).all()
