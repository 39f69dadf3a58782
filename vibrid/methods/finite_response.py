"""Impulse responses straight from inputs and outputs: a finite impulse response (FIR) model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..chunks import Stream, open_stream
from ..errors import DataError, OptionError, check_whole
from ..fit import feedthrough_mask
from ..gram import factorize, reduce
from ..linalg import one_blas_thread, solve_upper
from ..record import Floats, ImpulseResponses, Record
from .preparation import LARGEST_MATRIX

LAST_SHARE = 0.1  # of the lags: their size tells what the truncation leaves out


def fir(
    data: Record | Sequence[Record] | Stream,
    n_lags: int,
    *,
    offset: str = "estimate",
    feedthrough: bool | Sequence[bool] | None = None,
) -> ImpulseResponses:
    """Estimate Markov parameters as the weights of the present and past inputs.

    Least squares of y(t) on u(t), …, u(t − n_lags + 1), the direct estimate that OKID was made
    to avoid: it takes no model, but the response must have died within `n_lags` samples.

    Parameters
    ----------
    data : Record, sequence of Record, or Stream
        With inputs that move at all frequencies of interest.
    n_lags : int
        How many Markov parameters, D included. The first n_lags − 1 samples of every piece
        serve as past only.
    offset : "estimate", "mean" or "none"
        As in `identify`.
    feedthrough : bool or one for each output, optional
        Whether D is estimated; None: not for displacements and velocities.

    Returns
    -------
    ImpulseResponses
        In the units of the data; `truncation` of it says whether the response had died.

    Raises
    ------
    DataError
        No inputs, too few samples, too many lags for memory.

    Notes
    -----
    ȳ = Ỹ Ũ, Ỹ = ȳ Ũ⁺ (realization chapter, eq. 1.45; Juang, Phan, Horta & Longman 1993), by
    the triangular factor of the Gram of `n_lags` block rows; of minimum norm where the inputs
    leave it open.
    Time and memory grow with (n_lags · channels)² and its factorization with the cube. What is
    left out is C A^(n_lags − 1) B and later, filtered by the input: a structure with damping
    ratio ζ needs about 7 / (2π ζ f dt) lags for .1 %. For light damping use OKID.

    Examples
    --------
    >>> u = np.random.default_rng(0).standard_normal(200)
    >>> y = u + 0.5 * np.concatenate([[0.0], u[:-1]])
    >>> fir(Record(y, u, dt=0.1), 3).values[:, 0, 0].round(9) + 0.0
    array([1. , 0.5, 0. ])
    """
    check_whole("n_lags", n_lags, 1)
    stream = data if isinstance(data, Stream) else open_stream(data, offset)
    _check(stream, n_lags)
    m, p = stream.n_inputs, stream.n_outputs
    mask = feedthrough_mask(feedthrough, stream.records[0].output_channels)
    # the oldest input leads, so that the present one, which some outputs do not see, is last
    lags = np.arange(n_lags)[:, None] * (m + p)
    rows = np.concatenate([(lags + np.arange(m)).ravel(), lags[-1] + m + np.arange(p)])
    R = factorize(reduce(stream, n_lags), stream, rows).triangle
    q = n_lags * m
    weights = np.zeros((q, p))
    with one_blas_thread():
        for direct, k in ((True, q), (False, q - m)):
            outputs = q + np.flatnonzero(mask == direct)
            if len(outputs):
                weights[:k, outputs - q] = solve_upper(R[:k, :k], R[:k, outputs])
    values = weights.reshape(n_lags, m, p)[::-1].transpose(0, 2, 1)
    record = stream.records[0]
    return ImpulseResponses(
        values * stream.output_scale[:, None] / stream.input_scale,
        dt=record.dt,
        output_channels=record.output_channels,
        input_channels=record.input_channels,
    )


def truncation(responses: ImpulseResponses) -> float:
    """Return how large the last tenth of the lags is, relative to the largest lag.

    Each output-input pair by its own largest magnitude; the worst pair counts. Where this is
    not small, the responses were cut off before they had died.

    Examples
    --------
    >>> truncation(ImpulseResponses(0.5 ** np.arange(20.0)[:, None, None], dt=1.0)) < 1e-5
    True
    """
    sizes = np.abs(responses.values)
    last: Floats = sizes[-max(1, int(LAST_SHARE * len(sizes))) :].max(axis=0)
    largest = sizes.max(axis=0)
    return float((last / np.where(largest > 0, largest, 1)).max())


def _check(stream: Stream, n_lags: int) -> None:
    m, p = stream.n_inputs, stream.n_outputs
    if m == 0:
        raise DataError(
            "A finite impulse response needs inputs; the record has none. Name them (select(), "
            "or --inputs)."
        )
    lengths = [segment.length for segment in stream.segments]
    columns = sum(max(0, length - n_lags + 1) for length in lengths)
    unknowns = n_lags * m + p
    if columns < unknowns:
        raise DataError(
            f"n_lags={n_lags} with {m} inputs needs at least {unknowns + n_lags - 1} samples in "
            f"one piece; the longest of {len(lengths)} has {max(lengths)}. Use at most "
            f"{max(0, (max(lengths) + 1 - p) // (m + 1))} lags or a longer record."
        )
    size = 8 * (n_lags * (m + p)) ** 2
    if size > LARGEST_MATRIX:
        raise OptionError(
            f"n_lags={n_lags} with {m + p} channels makes a matrix of {size / 2**30:.3g} GiB; at "
            f"most {LARGEST_MATRIX / 2**30:g} GiB are tried. Use at most "
            f"{int((LARGEST_MATRIX / 8) ** 0.5) // (m + p)} lags, or OKID."
        )
