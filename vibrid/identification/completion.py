"""Complete a fit: B, D, offset and initial states by one pass over the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
LEAST_ENERGY = 0.1  # of the outputs' energy in each half, to judge by what it has not seen
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
    return Completion(fit, stream, compare=completion == "auto").complete(completion)


class Completion:
    """What completes a fit on a stream; each form's equations are set up when asked for.

    Parameters
    ----------
    compare : bool
        Whether simulation and prediction may have to be compared on unseen halves.
    """

    def __init__(self, fit: Fit, stream: Stream, *, compare: bool = True) -> None:
        self.fit, self.stream = fit, stream
        self._scaled = _scaled(fit, stream)
        self._pieces = _pieces(stream, len(self._scaled.A), split=compare)

    @cached_property
    def simulated(self) -> Equations | None:
        """The equations of the simulation, or None where poles coincide."""
        scaled = self._scaled
        found = _equations(self.stream, scaled, self._pieces, np.zeros_like(scaled.K))
        return None if found is None else _reweighted(found)

    @cached_property
    def forms(self) -> dict[str, Equations]:
        """The equations of simulation and of prediction, as far as they say something.

        Without inputs a simulation is a free decay, which noise-driven data are not.
        """
        forms, noisy = {}, bool(self._scaled.K.any())
        if self.stream.n_inputs or not noisy:
            if self.simulated is None:
                return {}
            forms["simulation"] = self.simulated
        if noisy:
            predicted = _equations(self.stream, self._scaled, self._pieces, self._scaled.K)
            if predicted is not None:
                forms["prediction"] = predicted
        return forms

    @cached_property
    def simulation_error(self) -> float:
        """Relative rms error of the least-squares simulation; infinite where there is none."""
        if self.simulated is None:
            return np.inf
        covariance = self.simulated.covariance(self.simulated.solve())
        return _relative_rms(covariance, self.stream.output_balance)

    def choose(self, completion: str = "auto") -> tuple[str, str]:
        """Return "simulation" or "prediction", and why."""
        if not self.forms:
            return "regression", "poles coincide"
        return _choose(completion, self._scaled, self.forms, self._pieces)

    def complete(self, completion: str = "auto", why: str = "") -> Fit:
        """Return the completed fit; `why` says how its form was chosen, where it was."""
        if not self.forms:
            return _uncompleted(self.fit, self.stream)
        form, reason = self.choose(completion)
        equations = self.forms[form]
        keep = completion == "regression"
        unknowns = _fixed(equations, self._scaled) if keep else equations.solve()
        figures = {"completion_reason": why or reason}
        return _finished(self.fit, self.stream, self._scaled, self.forms, form, unknowns, figures)


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


def _pieces(stream: Stream, order: int, *, split: bool) -> list[Piece]:
    """Return the segments, with `split` every long one in halves: one can check the other."""
    pieces = []
    for owner, segment in enumerate(stream.segments):
        half = segment.length // 2
        if not split or half < SPLIT_LENGTH * order:
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
    # scaled outputs have a standard deviation near 1; of a model that is far off, under inputs
    # that excite too little, errors may be larger by orders of magnitude, and singular
    largest = max(1.0, float(np.diag(covariance).max()))
    return whitener(covariance, np.full((1, len(covariance)), np.sqrt(largest)))


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
        return completion, "as the method has it"
    if completion == "regression":
        return "prediction", "only the initial states were left to find"
    if len({piece.owner for piece in pieces}) == len(pieces):
        return "simulation", "the record is too short to compare with prediction on unseen data"
    halves = _halves(pieces)
    if min(_energies(forms["simulation"], halves)) < LEAST_ENERGY:
        return "simulation", "one half of the record hardly moves and cannot judge the other"
    errors = _unseen_errors(scaled, forms["simulation"], forms["prediction"], halves)
    best = min(errors, key=lambda name: errors[name])
    ratio = errors[best] / max(errors.values())
    return best, f"unseen halves simulate with {100 * ratio:.1f} % of the error of the other form"


def _halves(pieces: Sequence[Piece]) -> tuple[list[int], list[int]]:
    """Return the first halves and the second halves of the pieces that were cut."""
    split = {piece.owner for piece in pieces if piece.start}
    cut = [k for k, piece in enumerate(pieces) if piece.owner in split]
    return [k for k in cut if not pieces[k].start], [k for k in cut if pieces[k].start]


def _energies(simulated: Equations, halves: Sequence[Sequence[int]]) -> list[float]:
    """Return the share of the outputs' energy in each half, mean over the outputs."""
    each = np.array([sum(simulated.energies(k) for k in half) for half in halves])
    return [float(share.mean()) for share in each / np.maximum(each.sum(axis=0), 1e-300)]


def _unseen_errors(
    scaled: _Scaled,
    simulated: Equations,
    predicted: Equations,
    halves: tuple[Sequence[int], Sequence[int]],
) -> dict[str, float]:
    """Fit B and D to first or second halves, simulate the others: total squared error."""
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
        "simulation_error": _relative_rms(simulation, stream.output_balance),
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
