"""refine(), and what identify() does with refine=True."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..chunks import Stream, open_stream
from ..errors import DataError, OptionError, check_choice
from ..fit import Finding, Fit
from ..modes import match_modes, modes_of
from ..record import Record
from .eliminating import refined_order
from .finishing import LIGHT_DAMPING
from .noise_forms import FORMS, Progress, best_of_starts, by_folds, explained

__all__ = ["refine", "refined", "refined_order"]

NOISES = ("auto", *FORMS)
TIMES = 2.0  # damping that changes by more is another mode's
LOST = 0.5  # share of the lightly damped modes that may be


def refine(
    fit: Fit,
    data: Record | Sequence[Record],
    *,
    noise: str = "auto",
    progress: Progress | None = None,
) -> Fit:
    """Improve a fit by minimizing its errors on the data: maximum likelihood.

    The output-error form takes all noise as noise on the sensors and finds the model whose
    simulation comes nearest to the data; the innovations form lets noise drive the structure
    too and finds the model, with its Kalman gain, whose one-step predictions are most likely.
    Both are local searches that never end worse than they began.

    Parameters
    ----------
    fit : Fit
        Any start with the channels of the data; poles outside the unit circle are reflected.
    data : Record or sequence of Record
        Those identified, or others.
    noise : "auto", "innovations" or "output_error"
        "auto" refines both on halves of the data and keeps the form that simulates the other
        halves better (predicts better, where both simulate alike), or the start where it
        simulates clearly better than both. Outputs alone that noise drives need innovations.
    progress : callable (what, done, total), optional
        Called before every step of a search.

    Returns
    -------
    Fit
        `diagnostics.figures` hold "refinement" ("output_error", "innovations" or "none"),
        "refinement_reason", "iterations", "converged"; unless that is "none" also "start_cost",
        "cost" (mean squares of the simulation errors over the variances found, or ln det of
        the prediction errors' covariance over the outputs' variances) and the standard
        deviations "frequencies_std"
        [Hz], "damping_std" (n_modes,) and "shapes_std" (n_outputs, n_modes) in the order of
        `modes_of`. `parameter_covariance` is that of the coefficients of each pair's
        q² + a₁ q + a₂ (q + a₁ for a real pole).

    Raises
    ------
    OptionError
        Other channels or rate than the fit's; the output-error form of outputs that noise
        drives, for which a simulation says nothing.

    Notes
    -----
    Variable projection (Golub & Pereyra 1973; Kaufman 1975) with the transition matrix, of the
    model or of its predictor, in real 2 × 2 companion blocks, see `varpro`. Standard
    deviations take the errors as white; where the model is too small they are too small.

    Examples
    --------
    >>> import numpy as np
    >>> from vibrid import N4SID, identify, modes_of
    >>> from vibrid.excitation import white_noise
    >>> from vibrid.structures import chain
    >>> frame, rng = chain([1.0], [400.0], damping_ratio=0.01), np.random.default_rng(0)
    >>> force = white_noise(2000, rng=rng)
    >>> record = frame.simulate(force, 0.05, forces=["f1"], noise=0.1, rng=rng)
    >>> better = refine(identify(record, N4SID(block_rows=10), order=2), record)
    >>> modes_of(better).damping_ratios.round(3).tolist()
    [0.01]
    """
    stream = open_stream(data, fit.gram.offset if fit.gram is not None else "estimate")
    for record in stream.records:
        fit.check_channels(record)
    return refined(fit, stream, noise=noise, progress=progress)


def refined(
    fit: Fit, stream: Stream, *, noise: str = "auto", progress: Progress | None = None
) -> Fit:
    """Return the fit refined on a stream; see `refine`."""
    check_choice("noise", noise, NOISES)
    ambient = not stream.n_inputs and bool(fit.kalman_gain.any())
    if ambient and noise == "output_error":
        raise OptionError(
            f"noise={noise!r}: without inputs the output-error form fits a free decay, and this "
            "model's Kalman gain says that noise drives the structure. Give the inputs, a model "
            'of a free decay, or noise="innovations".'
        )
    if noise != "auto":
        better = best_of_starts(noise, fit, stream, progress)
        return explained(better if stream.n_inputs else _compared(fit, better), "as asked for")
    if not stream.n_inputs:
        form = "innovations" if ambient else "output_error"
        why = "noise drives these outputs" if ambient else "these outputs are free decays"
        return explained(_compared(fit, best_of_starts(form, fit, stream, progress)), why)
    return by_folds(fit, stream, progress)


def _compared(start: Fit, fit: Fit) -> Fit:
    """Return the refined fit, with a warning where most lightly damped modes are gone.

    Drifts and coloured noise that the model has too few states for take over its poles: they
    hold more of what can be predicted than the modes do.
    """
    try:
        first, second = modes_of(start), modes_of(fit)
    except DataError:  # a pole at zero has no frequency
        return fit
    light = first.damping_ratios < LIGHT_DAMPING
    pairs = match_modes(first, second)
    ratio = second.damping_ratios[pairs[:, 1]] / first.damping_ratios[pairs[:, 0]]
    kept = pairs[(ratio > 1 / TIMES) & (ratio < TIMES), 0]
    gone = int(light.sum() - light[np.unique(kept)].sum())
    if gone <= LOST * light.sum():
        return fit
    finding = Finding(
        "modes-lost",
        "warning",
        f"{gone} of {int(light.sum())} lightly damped modes of the start are gone, or their "
        f"damping has changed {TIMES:g} times: the predictions gained more from poles of drifts "
        "or coloured noise.",
        "Believe the model before refinement, or filter the record to the modes' band, or give "
        "a larger order.",
    )
    return replace(fit, diagnostics=fit.diagnostics.joined({}, [finding]))
