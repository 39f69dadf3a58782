"""Complete a fit: B, D, offset and initial states by one pass over the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..fit import Finding, Fit
from ..record import Floats
from ..scores import whitener
from ..statespace import StateSpace
from .equations import Equations, Piece, Unknowns, set_up
from .modal_basis import modal_basis

SPLIT_LENGTH = 10  # in states: pieces shorter than twice this are not split for the check


@dataclass(frozen=True, eq=False)
class _Scaled:
    """The fit's matrices in the stream's units."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    K: Floats
    innovation: Floats


def complete(fit: Fit, stream: Stream, completion: str = "auto") -> Fit:
    """Return the fit with B, D, offsets and initial states by least squares on the data.

    Parameters
    ----------
    fit : Fit
        Stable, from `realize`.
    stream : Stream
        The identification data.
    completion : "auto", "simulation", "prediction" or "regression"
        "auto" compares both on data they were not fitted to: B and D from one half of every
        piece, scored by simulation of the other. "regression" keeps B and D of the state
        regression and only finds the initial states.

    Returns
    -------
    Fit
        With B, D (kept for "regression"), offsets, the initial state of every segment, and
        the covariance of the prediction errors of the completed model.
    """
    scaled = _scaled(fit, stream)
    pieces = _pieces(stream, len(scaled.A))
    simulated = _equations(stream, scaled, pieces, np.zeros_like(scaled.K))
    if simulated is None:
        return _uncompleted(fit)
    simulated = _reweighted(simulated)
    predicted = _equations(stream, scaled, pieces, scaled.K) if scaled.K.any() else None
    form, why = _choose(completion, scaled, simulated, predicted, pieces)
    equations = simulated if form == "simulation" or predicted is None else predicted
    gain = np.zeros_like(scaled.K) if equations is simulated else scaled.K
    keep = completion == "regression"
    unknowns = _fixed(equations, scaled) if keep else equations.solve()
    innovation = equations.covariance(unknowns)
    if predicted is not None and equations is simulated:
        innovation = _innovation(scaled, simulated, predicted, unknowns)
    figures = {
        "completion": form,
        "completion_reason": why,
        "output_weights": equations.weight / stream.output_scale,
        "simulation_error": _simulation_error(scaled, equations, simulated, unknowns),
    }
    return _finished(fit, stream, scaled, equations, unknowns, gain, innovation, figures)


def _scaled(fit: Fit, stream: Stream) -> _Scaled:
    u, y = stream.input_scale, stream.output_scale
    return _Scaled(
        fit.model.A,
        fit.model.B * u,
        fit.model.C / y[:, None],
        fit.model.D * u / y[:, None],
        fit.kalman_gain * y,
        fit.innovation_covariance / np.outer(y, y),
    )


def _pieces(stream: Stream, order: int) -> list[Piece]:
    """Cut every long segment in two halves, so that one can check the other."""
    pieces = []
    for owner, segment in enumerate(stream.segments):
        half = segment.length // 2
        if half < SPLIT_LENGTH * order:
            pieces.append(Piece(owner, 0, segment.length))
        else:
            pieces += [Piece(owner, 0, half), Piece(owner, half, segment.length)]
    return pieces


def _equations(
    stream: Stream, scaled: _Scaled, pieces: Sequence[Piece], gain: Floats
) -> Equations | None:
    A = scaled.A - gain @ scaled.C
    basis = modal_basis(A)
    if basis is None:
        return None
    mask = np.asarray(scaled.D.any(axis=1))
    return set_up(stream, pieces, A, scaled.C, basis, gain, _weight(scaled.innovation), mask)


def _weight(covariance: Floats) -> Floats:
    # scaled outputs have a standard deviation near 1
    return whitener(covariance, np.ones((1, len(covariance))))


def _reweighted(simulated: Equations) -> Equations:
    """Return the equations with outputs weighted by the errors of a first solution.

    Simulation errors are not innovations: they hold what process noise adds up to.
    """
    even = replace(simulated, weight=np.eye(len(simulated.weight)))
    errors = np.diag(even.covariance(even.solve()))
    return replace(simulated, weight=_weight(np.diag(errors)))


def _choose(
    completion: str,
    scaled: _Scaled,
    simulated: Equations,
    predicted: Equations | None,
    pieces: Sequence[Piece],
) -> tuple[str, str]:
    """Return "simulation" or "prediction", and why."""
    if predicted is None:
        return "simulation", "there is no Kalman gain to predict with"
    if completion in ("simulation", "prediction"):
        return completion, "as asked for"
    if completion == "regression" or scaled.B.shape[1] == 0:
        return "prediction", "there are no B and D to find, only initial states"
    if len({piece.owner for piece in pieces}) == len(pieces):
        return "simulation", "the record is too short to compare with prediction on unseen data"
    errors = _unseen_errors(scaled, simulated, predicted, pieces)
    best = min(errors, key=lambda name: errors[name])
    other = max(errors, key=lambda name: errors[name])
    ratio = errors[best] / errors[other]
    return best, f"unseen halves simulate with {100 * ratio:.1f} % of the error of the other form"


def _unseen_errors(
    scaled: _Scaled, simulated: Equations, predicted: Equations, pieces: Sequence[Piece]
) -> dict[str, float]:
    """Fit B and D to first or second halves, simulate the others: total squared error."""
    halves = [
        [k for k, piece in enumerate(pieces) if (piece.start == 0) == first]
        for first in (True, False)
    ]
    errors = {"simulation": 0.0, "prediction": 0.0}
    for seen, unseen in (halves, halves[::-1]):
        by_form = {
            "simulation": simulated.solve(seen).shared,
            "prediction": _translated(scaled, predicted, simulated, predicted.solve(seen).shared),
        }
        for form, shared in by_form.items():
            tried = simulated.with_states(shared, unseen)
            errors[form] += float(np.trace(simulated.squares(tried, unseen)))
    return errors


def _translated(scaled: _Scaled, source: Equations, target: Equations, shared: Floats) -> Floats:
    """Return the prediction form's solution as unknowns of the simulation form, or back."""
    offset, D, B = _physical(scaled, source, shared)
    return _packed(scaled, target, offset, D, B)


def _gain_of(scaled: _Scaled, equations: Equations) -> Floats:
    return scaled.K if equations.predicts else np.zeros_like(scaled.K)


def _physical(
    scaled: _Scaled, equations: Equations, shared: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return output offset, D and B of the model; the prediction form solves for B − K D."""
    K = _gain_of(scaled, equations)
    constant, D, B = equations.unpack(shared)
    return (
        constant + scaled.C @ _steady(scaled.A, K @ constant),
        D,
        equations.basis.vectors @ B + K @ D,
    )


def _packed(scaled: _Scaled, equations: Equations, offset: Floats, D: Floats, B: Floats) -> Floats:
    K = _gain_of(scaled, equations)
    constant = offset - scaled.C @ _steady(scaled.A - K @ scaled.C, K @ offset)
    modal = np.linalg.solve(equations.basis.vectors, B - K @ D)
    return equations.pack(constant, D, np.asarray(modal))


def _steady(A: Floats, drive: Floats) -> Floats:
    """Return the state that a constant drive holds: (I − A)⁻¹ drive."""
    return np.asarray(np.linalg.solve(np.eye(len(A)) - A, drive)) if drive.any() else drive


def _fixed(equations: Equations, scaled: _Scaled) -> Unknowns:
    shared = _packed(scaled, equations, np.zeros(len(scaled.C)), scaled.D, scaled.B)
    return equations.with_states(shared)


def _simulation_error(
    scaled: _Scaled, equations: Equations, simulated: Equations, unknowns: Unknowns
) -> float:
    """Return the rms error of the simulated outputs over their standard deviation."""
    if equations is not simulated:
        shared = _translated(scaled, equations, simulated, unknowns.shared)
        unknowns = simulated.with_states(shared)
    return float(np.sqrt(np.trace(simulated.covariance(unknowns)) / len(scaled.C)))


def _innovation(
    scaled: _Scaled, simulated: Equations, predicted: Equations, unknowns: Unknowns
) -> Floats:
    """Return the prediction errors' covariance of a model completed by simulation."""
    shared = _translated(scaled, simulated, predicted, unknowns.shared)
    return predicted.covariance(predicted.with_states(shared))


def _finished(
    fit: Fit,
    stream: Stream,
    scaled: _Scaled,
    equations: Equations,
    unknowns: Unknowns,
    gain: Floats,
    innovation: Floats,
    figures: dict[str, Any],
) -> Fit:
    u, y = stream.input_scale, stream.output_scale
    offset, D, B = _physical(scaled, equations, unknowns.shared)
    # the filter started at rest on data that still held the offset
    held = _steady(scaled.A - gain @ scaled.C, gain @ offset)
    states = unknowns.states @ equations.basis.vectors.T - held
    model = fit.model
    return replace(
        fit,
        model=StateSpace(model.A, B / u, model.C, y[:, None] * D / u, model.dt),
        innovation_covariance=innovation * np.outer(y, y),
        initial_states=states,
        output_offset=stream.centre[stream.n_inputs :] + y * offset,
        diagnostics=fit.diagnostics.joined(figures),
    )


def _uncompleted(fit: Fit) -> Fit:
    finding = Finding(
        "coinciding-poles",
        "doubt",
        "Poles coincide to working precision, so B, D and initial states are those of the state "
        "regression.",
        "Try a lower order.",
    )
    return replace(
        fit,
        initial_states=np.zeros_like(fit.initial_states),
        diagnostics=fit.diagnostics.joined({"completion": "regression"}, [finding]),
    )
