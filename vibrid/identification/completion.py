"""Complete a fit: B, D, offset and initial states by one pass over the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..fit import Finding, Fit
from ..record import Floats
from ..scores import whitener
from ..statespace import StateSpace
from .equations import Equations, Unknowns, set_up
from .modal_basis import modal_basis
from .walk import Piece

OFFSET_SPREAD = 0.1  # of an output's standard deviation: smaller differences are not told
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
    feedthrough: NDArray[np.bool_]


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
        regression and finds offsets and initial states.

    Returns
    -------
    Fit
        With B, D (kept for "regression"), offsets, the initial state of every segment, and
        the covariance of the prediction errors of the completed model.
    """
    scaled = _scaled(fit, stream)
    pieces = _pieces(stream, len(scaled.A))
    forms = _forms(stream, scaled, pieces)
    if not forms:
        return _uncompleted(fit, stream)
    form, why = _choose(completion, scaled, forms, pieces)
    equations = forms[form]
    keep = completion == "regression"
    unknowns = _fixed(equations, scaled) if keep else equations.solve()
    return _finished(fit, stream, scaled, forms, form, unknowns, {"completion_reason": why})


def _forms(stream: Stream, scaled: _Scaled, pieces: Sequence[Piece]) -> dict[str, Equations]:
    """Return the equations of simulation and of prediction, as far as they say something.

    Without inputs a simulation is a free decay, which noise-driven data are not.
    """
    forms = {}
    if stream.n_inputs or not scaled.K.any():
        simulated = _equations(stream, scaled, pieces, np.zeros_like(scaled.K))
        if simulated is None:
            return {}
        forms["simulation"] = _reweighted(simulated)
    if scaled.K.any():
        predicted = _equations(stream, scaled, pieces, scaled.K)
        if predicted is not None:
            forms["prediction"] = predicted
    return forms


def _scaled(fit: Fit, stream: Stream) -> _Scaled:
    u, y = stream.input_scale, stream.output_scale
    return _Scaled(
        fit.model.A,
        fit.model.B * u,
        fit.model.C / y[:, None],
        fit.model.D * u / y[:, None],
        fit.kalman_gain * y,
        fit.innovation_covariance / np.outer(y, y),
        fit.feedthrough,
    )


def _pieces(stream: Stream, order: int) -> list[Piece]:
    """Cut every long segment in two halves, so that one can check the other."""
    pieces = []
    for owner, segment in enumerate(stream.segments):
        half = segment.length // 2
        if half < SPLIT_LENGTH * order:
            pieces.append(Piece(segment.record, owner, 0, segment.length))
        else:
            pieces += [
                Piece(segment.record, owner, 0, half),
                Piece(segment.record, owner, half, segment.length),
            ]
    return pieces


def _equations(
    stream: Stream, scaled: _Scaled, pieces: Sequence[Piece], gain: Floats
) -> Equations | None:
    A = scaled.A - gain @ scaled.C
    basis = modal_basis(A)
    if basis is None:
        return None
    weight = _weight(scaled.innovation)
    return set_up(stream, pieces, A, scaled.C, basis, gain, weight, scaled.feedthrough)


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
    completion: str, scaled: _Scaled, forms: dict[str, Equations], pieces: Sequence[Piece]
) -> tuple[str, str]:
    """Return "simulation" or "prediction", and why."""
    if len(forms) == 1:
        form = next(iter(forms))
        return form, "it is the only form that these data and the Kalman gain allow"
    if completion in forms:
        return completion, "as asked for"
    if completion == "regression":
        return "prediction", "only the initial states were left to find"
    if len({piece.owner for piece in pieces}) == len(pieces):
        return "simulation", "the record is too short to compare with prediction on unseen data"
    errors = _unseen_errors(scaled, forms["simulation"], forms["prediction"], pieces)
    best = min(errors, key=lambda name: errors[name])
    ratio = errors[best] / max(errors.values())
    return best, f"unseen halves simulate with {100 * ratio:.1f} % of the error of the other form"


def _unseen_errors(
    scaled: _Scaled, simulated: Equations, predicted: Equations, pieces: Sequence[Piece]
) -> dict[str, float]:
    """Fit B and D to first or second halves, simulate the others: total squared error."""
    split = {piece.owner for piece in pieces if piece.start}
    halves = [
        [k for k, piece in enumerate(pieces) if piece.owner in split and bool(piece.start) == last]
        for last in (False, True)
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
    """Return the solution of one form as unknowns of the other."""
    return _packed(scaled, target, *_physical(scaled, source, shared))


def _gain_of(scaled: _Scaled, equations: Equations) -> Floats:
    return scaled.K if equations.predicts else np.zeros_like(scaled.K)


def _physical(
    scaled: _Scaled, equations: Equations, shared: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return offsets (n_records, p), D and B of the model.

    The prediction form solves for B − K D, and its constant is what its filter leaves of
    the offset.
    """
    K = _gain_of(scaled, equations)
    constants, D, B = equations.unpack(shared)
    offsets = constants + _steady(scaled.A, constants @ K.T) @ scaled.C.T
    return offsets, D, equations.basis.vectors @ B + K @ D


def _packed(scaled: _Scaled, equations: Equations, offsets: Floats, D: Floats, B: Floats) -> Floats:
    K = _gain_of(scaled, equations)
    constants = offsets - _steady(scaled.A - K @ scaled.C, offsets @ K.T) @ scaled.C.T
    modal = np.linalg.solve(equations.basis.vectors, B - K @ D)
    return equations.pack(constants, D, np.asarray(modal))


def _steady(A: Floats, drives: Floats) -> Floats:
    """Return the states that constant drives hold, (I − A)⁻¹ drive, row by row."""
    if not drives.any():
        return drives
    return np.asarray(np.linalg.solve(np.eye(len(A)) - A, drives.T).T)


def _fixed(equations: Equations, scaled: _Scaled) -> Unknowns:
    """Return the unknowns with B and D of the state regression, offsets as they fit best."""
    free = equations.solve()
    offsets, _, _ = _physical(scaled, equations, free.shared)
    return equations.with_states(_packed(scaled, equations, offsets, scaled.D, scaled.B))


def _error_covariance(
    scaled: _Scaled, forms: dict[str, Equations], form: str, unknowns: Unknowns, wanted: str
) -> Floats | None:
    """Return the covariance of the simulation or prediction errors of a solution."""
    if wanted not in forms:
        return None
    target = forms[wanted]
    if wanted != form:
        shared = _translated(scaled, forms[form], target, unknowns.shared)
        unknowns = target.with_states(shared)
    return target.covariance(unknowns)


def _finished(
    fit: Fit,
    stream: Stream,
    scaled: _Scaled,
    forms: dict[str, Equations],
    form: str,
    unknowns: Unknowns,
    figures: dict[str, Any],
) -> Fit:
    u, y = stream.input_scale, stream.output_scale
    equations = forms[form]
    offsets, D, B = _physical(scaled, equations, unknowns.shared)
    if not len(offsets):
        offsets = np.zeros((len(stream.records), len(y)))
    # the filter started at rest on data that still held the offset
    K = _gain_of(scaled, equations)
    held = _steady(scaled.A - K @ scaled.C, offsets @ K.T)
    owners = [segment.record for segment in stream.segments]
    states = equations.states(unknowns) - held[owners]
    lengths = np.bincount(owners, [segment.length for segment in stream.segments], len(offsets))
    offsets[lengths == 0] = lengths @ offsets / lengths.sum()
    simulation = _error_covariance(scaled, forms, form, unknowns, "simulation")
    prediction = _error_covariance(scaled, forms, form, unknowns, "prediction")
    innovation = next(each for each in (prediction, simulation) if each is not None)
    figures = {
        "completion": form,
        **figures,
        "output_weights": equations.weight / y,
        "record_offsets": stream.centre[stream.n_inputs :] + y * offsets,
        "simulation_error": _relative_rms(simulation, y / stream.output_deviation),
    }
    model = fit.model
    return replace(
        fit,
        model=StateSpace(model.A, B / u, model.C, y[:, None] * D / u, model.dt),
        innovation_covariance=innovation * np.outer(y, y),
        initial_states=states,
        output_offset=stream.centre[stream.n_inputs :] + y * (lengths @ offsets / lengths.sum()),
        diagnostics=fit.diagnostics.joined(figures, _offset_findings(offsets, prediction)),
    )


def _relative_rms(covariance: Floats | None, per_deviation: Floats) -> float:
    """Return the rms over outputs of an error over the output's standard deviation."""
    if covariance is None:
        return np.nan
    return float(np.sqrt(np.mean(np.diag(covariance) * per_deviation**2)))


def _offset_findings(offsets: Floats, innovation: Floats | None) -> list[Finding]:
    """Say when records have different offsets: each was given its own."""
    spread = np.ptp(offsets, axis=0)
    noise = 0.0 if innovation is None else np.sqrt(np.diag(innovation))
    apart = int((spread > np.maximum(noise, OFFSET_SPREAD)).sum())
    if not apart:
        return []
    return [
        Finding(
            "record-offsets",
            "note",
            f"The offsets of {apart} of {len(spread)} outputs differ between the records: each "
            "has its own (figures record_offsets), and simulate() adds their mean.",
            "Give predict() and simulate_record() the record's output_offset.",
        )
    ]


def _uncompleted(fit: Fit, stream: Stream) -> Fit:
    means = np.tile(fit.output_offset, (len(stream.records), 1))
    figures = {"completion": "regression", "record_offsets": means}
    finding = Finding(
        "coinciding-poles",
        "doubt",
        "Poles coincide to working precision, so B and D are those of the state regression, "
        "offsets are means, and initial states were not estimated.",
        "Try a lower order.",
    )
    return replace(
        fit,
        diagnostics=fit.diagnostics.joined(figures, [finding]),
    )
