"""Filter signals through 2 × 2 blocks, many samples a matrix product.

A stretch of T samples of a block is one product with its Toeplitz matrix, and the states at
the starts of the stretches follow by doubling: v(k) + P v(k − 1), then steps of 2, 4, …
"""

from __future__ import annotations

import numpy as np

from ..record import Floats

STRETCH = 32  # samples: flat optimum between 16 and 32


class BlockFilter:
    """Prepare x(t+1) = A x(t) + e f(t), e = (0, 1), for every block.

    Parameters
    ----------
    transition : array (n_blocks, 2, 2)

    Examples
    --------
    >>> delay = BlockFilter(np.zeros((1, 2, 2)))
    >>> signals = np.zeros((1, 2, STRETCH))
    >>> last = delay.run(np.ones((1, STRETCH)), np.zeros((1, 2)), signals)
    >>> signals[0, 1, :3], last[0]
    (array([0., 1., 1.]), array([0., 1.]))
    """

    def __init__(self, transition: Floats) -> None:
        count, T = len(transition), STRETCH
        powers = np.empty((T + 1, count, 2, 2))
        powers[0] = np.eye(2)
        for k in range(T):
            powers[k + 1] = transition @ powers[k]
        reach = powers[:T, :, :, 1]  # A^k e (T, n_blocks, 2)
        lag = np.arange(T)[None, :] - np.arange(T)[:, None] - 1  # input sample, output sample
        kernel = np.zeros((count, 2, T + 2, T))
        kernel[:, :, :T] = np.where(
            lag[..., None, None] >= 0, reach[np.maximum(lag, 0)], 0
        ).transpose(2, 3, 0, 1)
        kernel[:, :, T:] = powers[:T].transpose(1, 2, 3, 0)
        self._kernel = kernel
        self._to_state = np.ascontiguousarray(reach[::-1].transpose(1, 0, 2))  # (n_blocks, T, 2)
        self._power = powers[T]

    def run(self, drives: Floats, states: Floats, signals: Floats) -> Floats:
        """Fill the signals with the states at every sample, and return those after the last.

        Parameters
        ----------
        drives : array (..., n_blocks or 1, n_samples)
            n_samples is a multiple of the stretch; 1 drives all blocks alike.
        states : array (..., n_blocks, 2)
            At the first sample.
        signals : array (..., n_blocks, 2, n_samples)
            Filled.
        """
        T = STRETCH
        K = drives.shape[-1] // T
        stretches = drives.reshape(*drives.shape[:-1], K, T)
        walked = self._walk(stretches @ self._to_state, states)
        rows = np.empty((*states.shape[:-1], K, T + 2))
        rows[..., :T] = stretches
        rows[..., T:] = walked[..., :K, :]
        target = signals.reshape(*signals.shape[:-1], K, T)
        np.matmul(rows[..., None, :, :], self._kernel, out=target)
        return np.asarray(walked[..., K, :])

    def _walk(self, steps: Floats, states: Floats) -> Floats:
        """Return the states before every stretch and after the last (..., K + 1, 2)."""
        walked = np.concatenate([states[..., None, :], steps], axis=-2)
        power, step = self._power.transpose(0, 2, 1), 1
        while step < walked.shape[-2]:
            walked[..., step:, :] += walked[..., :-step, :] @ power
            power, step = power @ power, 2 * step
        return walked
