"""Block Hankel matrices of Markov parameters: strided views, balanced channels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.sparse.linalg import LinearOperator

from ...record import Floats

LARGEST_COPY = 2**24  # elements of a Hankel matrix that is laid out for BLAS; 128 MiB
BALANCING_STEPS = 200
BALANCED = 1e-13


def block_rows(markov: Floats, count: int, columns: int) -> Floats:
    """Return block rows [h(1+i) … h(columns+i)], i < count, as a view (count, p, columns · m).

    Parameters
    ----------
    markov : array (n_lags, p, m)
        `markov[0]` is D and takes no part; at least count + columns lags.
    count, columns : int
    """
    n_lags, p, m = markov.shape
    # a lag's columns side by side, so that each block row is a window of one array
    lags = np.ascontiguousarray(markov[1:].transpose(1, 0, 2)).reshape(p, (n_lags - 1) * m)
    step, item = lags.strides
    return as_strided(lags, (count, p, columns * m), (m * item, step, item), writeable=False)


def hankel_pair(blocks: Floats) -> tuple[Any, Any]:
    """Return H(0) and H(1), all but the last and all but the first block row.

    Both are views of one matrix; of a large one, operators that multiply without laying it
    out.
    """
    count, p, width = blocks.shape
    if blocks.size <= LARGEST_COPY:
        matrix = blocks.reshape(count * p, width)
        return matrix[:-p], matrix[p:]
    return _operator(blocks[:-1]), _operator(blocks[1:])


def _operator(blocks: Floats) -> LinearOperator:
    count, p, width = blocks.shape

    def times(x: Floats) -> Floats:
        return np.asarray(np.matmul(blocks, x).reshape(count * p, -1))

    def transposed(y: Floats) -> Floats:
        total = np.zeros((width, y.shape[1]))
        for block, rows in zip(blocks, y.reshape(count, p, -1), strict=True):
            total += block.T @ rows
        return total

    return LinearOperator(
        (count * p, width),
        matvec=lambda x: times(x.reshape(-1, 1)),
        rmatvec=lambda y: transposed(y.reshape(-1, 1)),
        matmat=times,
        rmatmat=transposed,
        dtype=np.float64,
    )


def squared_norm(blocks: Floats) -> float:
    """Return the sum of squares of a matrix given as block rows, laid out or not."""
    return float(sum(np.einsum("aw,aw", block, block) for block in blocks))


def balancing_weights(markov: Floats) -> tuple[Floats, Floats]:
    """Return what outputs and inputs are multiplied by, so that units do not matter.

    Afterwards the responses of every output, and to every input, have the same mean square
    (Sinkhorn & Knopp 1967); a channel without any response keeps weight 1.

    Parameters
    ----------
    markov : array (n_lags, p, m)

    Returns
    -------
    output_weights : array (p,)
    input_weights : array (m,)
    """
    largest = np.abs(markov).max(initial=0.0) or 1.0
    energy = np.square(markov / largest).sum(axis=0)
    outputs, inputs = np.ones(energy.shape[0]), np.ones(energy.shape[1])
    aspect = len(outputs) / len(inputs)  # sums of rows and of columns must agree
    for _ in range(BALANCING_STEPS):
        before = outputs
        outputs = _inverse(energy @ inputs)
        inputs = aspect * _inverse(outputs @ energy)
        if np.abs(outputs / before - 1).max() < BALANCED:
            break
    outputs, inputs = np.sqrt(outputs), np.sqrt(inputs)
    # what is common to all outputs goes to the inputs: the outputs' weights have mean 1
    common = float(np.exp(np.log(outputs).mean()))
    return outputs / common, inputs * common / largest


def _inverse(values: Floats) -> Floats:
    return np.divide(1.0, values, out=np.ones_like(values), where=values > 0)
