"""Simulate a discrete system by lifting: many samples per matrix product.

A block of T samples is one step of a "lifted" system,

    x(k+T) = Aᵀ-power x(k) + [A^(T−1) B … B] U,    Y = O x(k) + H U,

with O = [C; CA; …] and H the block Toeplitz matrix of Markov parameters, so that all blocks
together are one matrix product. What is left, the state from block to block, runs over √K
stretches of the K blocks side by side (see `block_states`). No eigenvalues are taken: unstable
and defective A are as good as any.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..record import Floats

CHUNK_ELEMENTS = 2**18  # per chunk and per block matrix; keeps the temporaries in the cache


class Lifting:
    """Prepare x(k+1) = A x + B u, y = C x + D u for long simulations.

    Parameters
    ----------
    A, B, C, D : arrays (n, n), (n, m), (p, n), (p, m)
        The discrete system; m may be 0.
    block : int, optional
        Samples per block; by default chosen from the sizes.

    Examples
    --------
    >>> import numpy as np
    >>> one = np.eye(1)
    >>> counter = Lifting(one, one, one, 0 * one)
    >>> first, state = counter.run(np.ones((3, 1)), np.zeros(1))
    >>> second, state = counter.run(np.ones((2, 1)), state)
    >>> first[:, 0], second[:, 0], state
    (array([0., 1., 2.]), array([3., 4.]), array([5.]))
    """

    def __init__(self, A: Floats, B: Floats, C: Floats, D: Floats, block: int | None = None):
        self.A, self.B, self.C, self.D = A, B, C, D
        self.n, self.m, self.p = A.shape[0], B.shape[1], C.shape[0]
        self.block = block or _block_length(self.n, self.m, self.p)
        self._build()

    def _build(self) -> None:
        """Make the matrices of one block: [U, x] @ `to_outputs`, U @ `to_state`, `power`."""
        T, n, m, p = self.block, self.n, self.m, self.p
        reach = np.empty((T, n, m))  # A^k B
        observe = np.empty((T, p, n))  # C A^k
        state, row = self.B, self.C
        for k in range(T):
            reach[k], observe[k] = state, row
            state, row = self.A @ state, row @ self.A
        markov = np.concatenate([np.zeros((1, p, m)), self.D[None], self.C @ reach[:-1]])
        lag = np.arange(T)[:, None] - np.arange(T)[None, :]
        toeplitz = markov[np.maximum(lag + 1, 0)]  # (T, T, p, m): output sample, input sample
        self.to_outputs = np.concatenate(
            [toeplitz.transpose(1, 3, 0, 2).reshape(T * m, T * p), observe.reshape(T * p, n).T]
        )
        self.to_state = reach[::-1].transpose(0, 2, 1).reshape(T * m, n)
        self.power = np.linalg.matrix_power(self.A, T)

    def run(self, inputs: Any, initial_state: Floats) -> tuple[Floats, Floats]:
        """Return the outputs (n_samples, p) and the state after the last sample (n,).

        `inputs` (n_samples, m) may stay on disk; it is read a chunk at a time. Feed the
        returned state to the next call to go on where this one stopped.
        """
        N = int(inputs.shape[0])
        outputs = np.empty((N, self.p))
        state = np.array(initial_state, dtype=np.float64)
        widest = max(self.n, self.m, self.p)
        rows = self.block * max(1, CHUNK_ELEMENTS // (widest * self.block))
        for start in range(0, N, rows):
            u = np.ascontiguousarray(inputs[start : start + rows], dtype=np.float64)
            state = self._run_chunk(u, state, outputs[start : start + rows])
        return outputs, state

    def _run_chunk(self, u: Floats, state: Floats, y: Floats) -> Floats:
        """Fill y; return the state after the chunk."""
        T, m, p = self.block, self.m, self.p
        K = len(u) // T
        rows = np.empty((K, T * m + self.n))
        rows[:, : T * m] = u[: K * T].reshape(K, T * m)
        drive = rows[:, : T * m] @ self.to_state
        state = block_states(self.power, drive[:, None], state[None], rows[:, None, T * m :])[0]
        np.matmul(rows, self.to_outputs, out=y[: K * T].reshape(K, T * p))
        return self._run_rest(u[K * T :], state, y[K * T :])

    def _run_rest(self, u: Floats, state: Floats, y: Floats) -> Floats:
        """Do the last samples, fewer than a block."""
        r = len(u)
        if r:
            y[:] = (
                u.ravel() @ self.to_outputs[: r * self.m, : r * self.p]
                + state @ self.to_outputs[self.block * self.m :, : r * self.p]
            ).reshape(r, self.p)
        for drive in u @ self.B.T:
            state = self.A @ state + drive
        return state


def block_states(power: Floats, drives: Floats, states: Floats, found: Floats) -> Floats:
    """Fill in the states before each step of x(k+1) = power x(k) + drive(k); return the last.

    Several systems with one transition run at once, and √K stretches of the K steps side by
    side: each from rest, then what its true start adds.

    Parameters
    ----------
    power : array (n, n)
    drives : array (K, systems, n)
    states : array (systems, n)
        At the first step.
    found : array (K, systems, n)
        Is filled; may be part of a larger array.

    Returns
    -------
    array (systems, n)
    """
    step, length = power.T, max(1, math.isqrt(len(drives)))
    count, (systems, n) = len(drives) // length, states.shape
    flat = (count, length, systems, n)
    stretches, inner = drives[: count * length].reshape(flat), found[: count * length].reshape(flat)
    local = np.zeros((count * systems, n))  # two axes: one product for all
    for k in range(length):
        inner[:, k] = local.reshape(count, systems, n)
        local = local @ step
        local.reshape(count, systems, n)[...] += stretches[:, k]
    long = np.linalg.matrix_power(step, length)
    starts = np.empty((count, systems, n))
    for k in range(count):
        starts[k] = states
        states = states @ long + local[k * systems : (k + 1) * systems]
    moved = starts.reshape(count * systems, n)
    for k in range(length):
        inner[:, k] += moved.reshape(count, systems, n)
        moved = moved @ step
    for k in range(count * length, len(drives)):
        found[k] = states
        states = states @ step + drives[k]
    return states


def simulate(
    A: Floats, B: Floats, C: Floats, D: Floats, inputs: Any, initial_state: Floats
) -> tuple[Floats, Floats]:
    """Simulate x(k+1) = A x + B u, y = C x + D u.

    Parameters
    ----------
    A, B, C, D : arrays (n, n), (n, m), (p, n), (p, m)
        m may be 0.
    inputs : array (n_samples, m)
        In memory or on disk.
    initial_state : array (n,)
        State at the first sample.

    Returns
    -------
    outputs : array (n_samples, p)
    final_state : array (n,)
        State at the sample after the last: the initial state of the next chunk.
    """
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    # A block beyond √N costs more to prepare than it saves.
    block = max(1, min(_block_length(n, m, p), math.isqrt(int(inputs.shape[0]))))
    return Lifting(A, B, C, D, block).run(inputs, initial_state)


def simulate_states(
    A: Floats, B: Floats, inputs: Any, initial_state: Floats
) -> tuple[Floats, Floats]:
    """Return the states (n_samples, n) of x(k+1) = A x + B u, and the state after the last."""
    n, m = B.shape
    return simulate(A, B, np.eye(n), np.zeros((n, m)), inputs, initial_state)


@np.errstate(over="ignore", invalid="ignore")  # of an unstable A: seen by what is not finite
def free_responses(A: Floats, C: Floats, count: int) -> Floats:
    """Return C Aᵏ for k < count, by doubling.

    Parameters
    ----------
    A, C : arrays (n, n), (p, n)
    count : int

    Returns
    -------
    array (count, p, n)
        Not finite where powers overflow.
    """
    free = np.empty((count, *C.shape))
    free[0], power, known = C, A, 1
    while known < count:
        more = free[known : 2 * known]
        more[...] = free[: len(more)] @ power
        known, power = 2 * known, power @ power
    return free


def _block_length(n: int, m: int, p: int) -> int:
    """Return 32 or 64 samples, fewer when inputs times outputs make the Toeplitz matrix dear."""
    T = 32 if n <= 20 else 64
    while T > 4 and T * m * p > 4 * (n + m) * (n + p):
        T //= 2
    return T
