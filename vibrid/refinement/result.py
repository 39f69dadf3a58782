"""From a place of the search to a Fit in the units of the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.linalg as sla

from ..chunks import Stream
from ..errors import DataError
from ..fit import Diagnostics, Fit
from ..modes import modes_of
from ..record import Floats
from ..statespace import StateSpace
from .place import Place, errors_of

# what was said of the start and no longer holds
OUTDATED = ("damping-doubt", "short-horizon", "projected", "unstable", "coinciding-poles")
OUTDATED_FIGURES = ("predictor_memory", "transition", "gain", "feedback_gain")
OF_MODES = "mode_"  # figures of the start's modes
COLLINEARITY = "mode_phase_collinearity"  # which needs the model alone
OF_POLES = ("frequencies_std", "damping_std", "shapes_std")


def fit_of(fit: Fit, place: Place, figures: Mapping[str, Any]) -> Fit:
    """Return the model of a place, with what else the fit that it came from says.

    Parameters
    ----------
    fit : Fit
        Gives method, channels and findings.
    figures : mapping
        To be added to the diagnostics.
    """
    found = _predicting if place.projected.indirect else _simulating
    return found(fit, place, figures)


def _simulating(fit: Fit, place: Place, figures: Mapping[str, Any]) -> Fit:
    stream, blocks, linear = place.stream, place.projected.blocks, place.projected.linear
    u, y = stream.input_scale, stream.output_scale
    A, B, states = blocks.matrices()
    C, D = linear.states[blocks.used].T, linear.direct.T
    offsets, mean = _offsets(stream, linear.constants)
    error = np.sqrt(np.mean(place.variance * stream.output_balance**2))
    weights = np.diag(np.sqrt(place.projected.weights) / y)
    known = _figures("simulation", offsets, float(error), weights)
    return replace(
        fit,
        model=StateSpace(A, B / u, y[:, None] * C, y[:, None] * D / u, fit.model.dt),
        kalman_gain=np.zeros((len(A), len(y))),
        innovation_covariance=covariance_of(place) * np.outer(y, y),
        initial_states=states,
        segments=stream.segments,
        input_offset=stream.centre[: stream.n_inputs],
        output_offset=mean,
        order=len(A),
        state_covariance=place.projected.state_squares / stream.n_samples,
        parameter_covariance=None,
        diagnostics=_updated(fit.diagnostics).joined({**known, **figures}),
    )


def _predicting(fit: Fit, place: Place, figures: Mapping[str, Any]) -> Fit:
    """Return the innovations model A = F + K C, B = G + K D of a predictor.

    The predictor ran on data that still held the offsets d, so its states hold what these
    drive, h = (I − F)⁻¹ K d, and its constants are c = d − C h.
    """
    stream, linear = place.stream, place.projected.linear
    u, y, m = stream.input_scale, stream.output_scale, stream.n_inputs
    A, B, C, D, K, states = innovations_of(place)
    constants = linear.constants + _steady(A, linear.constants @ K.T) @ C.T
    held = _steady(A - K @ C, constants @ K.T)
    if len(held):
        states = states - held[[segment.record for segment in stream.segments]]
    offsets, mean = _offsets(stream, constants)
    S = covariance_of(place)
    whitening = sla.solve_triangular(
        np.linalg.cholesky(_held_off(S, stream)), np.eye(len(S)), lower=True
    )
    found = replace(
        fit,
        model=StateSpace(A, B / u, y[:, None] * C, y[:, None] * D / u, fit.model.dt),
        kalman_gain=K / y,
        innovation_covariance=S * np.outer(y, y),
        initial_states=states,
        segments=stream.segments,
        input_offset=stream.centre[:m],
        output_offset=mean,
        order=len(A),
        state_covariance=_centred_squares(place, held) / stream.n_samples,
        parameter_covariance=None,
        diagnostics=_updated(fit.diagnostics).joined({"record_offsets": offsets}),
    )
    simulated = errors_of(found, stream, states) if m else None
    error = np.nan
    if simulated is not None:
        error = float(np.sqrt(np.mean(simulated.variance * stream.output_balance**2)))
    known = _figures("prediction", offsets, error, whitening / y)
    return replace(found, diagnostics=found.diagnostics.joined({**known, **figures}))


def innovations_of(place: Place) -> tuple[Floats, Floats, Floats, Floats, Floats, Floats]:
    """Return A, B, C, D, K in the stream's units and the predictor's initial states."""
    blocks, linear, m = place.projected.blocks, place.projected.linear, place.stream.n_inputs
    F, drives, states = blocks.matrices()
    C, D = linear.states[blocks.used].T, linear.direct[:m].T
    K = drives[:, m:]
    return F + K @ C, drives[:, :m] + K @ D, C, D, K, states


def covariance_of(place: Place) -> Floats:
    """Return the covariance of the errors (p, p), degrees of freedom taken off."""
    linear, blocks = place.projected.linear, place.projected.blocks
    direct = len(linear.direct) - place.projected.indirect
    each = blocks.order + direct + len(linear.constants)
    shared = blocks.order * (len(blocks.inputs) + len(blocks.starts))
    free = place.stream.n_samples - each - shared / place.stream.n_outputs
    return np.asarray(place.projected.errors / max(1.0, free))


def _figures(form: str, offsets: Floats, error: float, weights: Floats) -> dict[str, Any]:
    return {
        "completion": form,
        "completion_reason": "B, D and initial states are part of the refinement",
        "simulation_error": error,
        "output_weights": weights,
        "record_offsets": offsets,
    }


def _updated(found: Diagnostics) -> Diagnostics:
    """Return the diagnostics without what was said of other poles."""
    kept = tuple(each for each in found.findings if each.code not in OUTDATED)
    figures = {
        name: value
        for name, value in found.figures.items()
        if not name.startswith(OF_MODES) and name not in (*OUTDATED_FIGURES, *OF_POLES)
    }
    return Diagnostics(figures, kept)


def with_collinearity(fit: Fit) -> Fit:
    """Return the fit with the phase collinearity of its modes among the figures."""
    try:
        known = {COLLINEARITY: modes_of(fit).phase_collinearity}
    except DataError:  # a pole at zero has no frequency
        return fit
    return replace(fit, diagnostics=fit.diagnostics.joined(known))


def _steady(A: Floats, drives: Floats) -> Floats:
    """Return the states that constant drives hold, (I − A)⁻¹ drive, row by row."""
    if not drives.any():
        return np.zeros((len(drives), len(A)))
    return np.asarray(np.linalg.solve(np.eye(len(A)) - A, drives.T).T)


def _centred_squares(place: Place, held: Floats) -> Floats:
    """Return Σ x xᵀ without what offsets hold of the states."""
    squares = place.projected.state_squares
    if not len(held):
        return squares
    sums, lengths = place.projected.state_sums, lengths_of(place.stream)
    cross = sums.T @ held
    return np.asarray(squares - cross - cross.T + (held.T * lengths) @ held)


def _held_off(S: Floats, stream: Stream) -> Floats:
    return np.asarray(S + np.diag(1e-14 / stream.output_balance**2))


def lengths_of(stream: Stream) -> Floats:
    """Return the number of samples of each record."""
    lengths = np.zeros(len(stream.records))
    for segment in stream.segments:
        lengths[segment.record] += segment.length
    return lengths


def _offsets(stream: Stream, constants: Floats) -> tuple[Floats, Floats]:
    """Return the offset of each record, and their mean over the samples."""
    lengths = lengths_of(stream)
    if not len(constants):
        constants = np.zeros((len(lengths), stream.n_outputs))
    mean = lengths @ constants / lengths.sum()
    constants = np.where(lengths[:, None] > 0, constants, mean)
    centre = stream.centre[stream.n_inputs :]
    return centre + stream.output_scale * constants, centre + stream.output_scale * mean
