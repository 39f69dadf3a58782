"""refine(): models as good as the data allow."""

from __future__ import annotations

from collections.abc import Sequence

from ..chunks import open_stream
from ..errors import OptionError, check_choice
from ..fit import Fit
from ..record import Record
from .elimination import Elimination, eliminate, held_out_curve
from .output_error import Search, refine_output_error

__all__ = [
    "Elimination",
    "Search",
    "eliminate",
    "held_out_curve",
    "refine",
    "refine_output_error",
]

NOISES = ("auto", "output_error")


def refine(fit: Fit, data: Record | Sequence[Record], *, noise: str = "auto") -> Fit:
    """Improve a fit by minimizing its errors on the data.

    The output-error form takes all noise as noise on the sensors and finds the model whose
    simulation comes nearest to the data, each output weighed by its errors: maximum likelihood
    for a shaker test or a free decay. It is a local search that never ends worse than it began.

    Parameters
    ----------
    fit : Fit
        Any start with the channels of the data; poles outside the unit circle are reflected.
    data : Record or sequence of Record
        Those identified, or others.
    noise : "auto" or "output_error"

    Returns
    -------
    Fit
        Kalman gain zero. `diagnostics.figures` hold "iterations", "converged", "start_cost",
        "cost" (mean squares of the outputs' errors, over the variances found), and
        "frequencies_std" [Hz] and "damping_std" of the modes, by ascending frequency.
        `parameter_covariance` is that of the coefficients of each block's polynomial
        q² + a₁ q + a₂ (q + a₁ for a single real pole), in the order of the blocks in A.

    Raises
    ------
    OptionError
        Other channels or rate than the fit's; outputs alone that noise drives, for which a
        simulation says nothing.

    Notes
    -----
    Variable projection (Golub & Pereyra 1973; Kaufman 1975) with A in real 2 × 2 companion
    blocks, see `varpro`. Standard deviations take the errors as white and independent between
    outputs; where the model is too small or noise drives the structure they are too small.

    Examples
    --------
    >>> import numpy as np
    >>> from vibrid import N4SID, identify, modes_of
    >>> from vibrid.excitation import white_noise
    >>> from vibrid.structures import chain
    >>> frame, rng = chain([1.0], [400.0], damping_ratio=0.01), np.random.default_rng(0)
    >>> force = white_noise(2000, rng=rng)
    >>> record = frame.simulate(force, 0.05, forces=["f1"], noise=0.1, rng=rng)
    >>> refined = refine(identify(record, N4SID(block_rows=10), order=2), record)
    >>> modes_of(refined).damping_ratios.round(3).tolist()
    [0.01]
    """
    check_choice("noise", noise, NOISES)
    stream = open_stream(data, fit.gram.offset if fit.gram is not None else "estimate")
    for record in stream.records:
        fit.check_channels(record)
    if not stream.n_inputs and fit.kalman_gain.any():
        raise OptionError(
            f"noise={noise!r}: without inputs the output-error form fits a free decay, and this "
            "model's Kalman gain says that noise drives the structure. Give the inputs, or a "
            "model of a free decay."
        )
    return refine_output_error(fit, stream)
