"""Force and exponential windows, and the exact correction of damping for the latter."""

from __future__ import annotations

from dataclasses import replace
from typing import overload

import numpy as np

from ..errors import OptionError, check_positive
from ..fit import Finding, Fit
from ..kalman import spectral_radius
from ..record import Floats, Record
from ..statespace import StateSpace
from .pulses import FOOT_FACTOR, NOISE_FACTOR, centred, groups

KEPT_SHARE = 0.02  # of the largest force: smaller ones are the hammer's own ringing


def force_window(record: Record) -> Record:
    """Return the record with every force zero outside its pulses.

    After a pulse the hammer is in the air: what its channel shows then is noise and offset. A
    pulse is every stretch above three times the noise floor (1.4826 times the median
    deviation) that exceeds ten times the floor and 2 % of the channel's largest force
    somewhere; there the median is subtracted. Outputs stay as they are.

    Parameters
    ----------
    record : Record
        A segment, or a whole record of hits, whose inputs all are forces of hammers.

    Raises
    ------
    OptionError
        No inputs, or a record on disk.

    Examples
    --------
    >>> force = np.full(100, 0.25)
    >>> force[10:13] += [1.0, 2.0, 1.0]
    >>> windowed = force_window(Record(np.zeros(100), force, dt=0.01))
    >>> windowed.inputs[9:14, 0]
    array([0., 1., 2., 1., 0.])
    """
    _check(record, "force_window")
    if record.n_inputs == 0:
        raise OptionError("force_window needs a force; the record has no inputs.")
    forces = [_pulses_only(column) for column in np.asarray(record.inputs).T]
    return _with(record, np.asarray(record.outputs), np.stack(forces, axis=1))


def exponential_window(record: Record, rate: float) -> Record:
    """Return the record with inputs and outputs multiplied by e^(−rate t), t from its start.

    For decays that the segment is too short for. Both sides are multiplied, so the data obey a
    system with every pole moved by exactly −rate, whatever the force: identify it with
    offset="none" (an offset would decay too: remove it first, `hit_segments` has
    `remove_baseline`), and give the result to `undo_exponential_window`.

    Parameters
    ----------
    record : Record
        In memory.
    rate : float
        [1/s]; ln(100) / T brings the end of T seconds to 1 %.

    Notes
    -----
    With g = e^(−rate dt) and x_w(k) = g^k x(k): x_w(k + 1) = g A x_w(k) + g B u_w(k) and
    y_w = C x_w + D u_w. For the practice see Fladung & Rost, Application and correction of
    the exponential window for frequency response functions, MSSP 11(1), 1997.

    Examples
    --------
    >>> exponential_window(Record([8.0, 8.0, 8.0], dt=1.0), np.log(2)).outputs[:, 0].round(12)
    array([8., 4., 2.])
    """
    _check(record, "exponential_window")
    check_positive("rate", rate, "1/s")
    weights = np.exp(-rate * record.dt * np.arange(record.n_samples))[:, None]
    return _with(record, weights * np.asarray(record.outputs), weights * np.asarray(record.inputs))


@overload
def undo_exponential_window(model: StateSpace, rate: float) -> StateSpace: ...
@overload
def undo_exponential_window(model: Fit, rate: float) -> Fit: ...
def undo_exponential_window(model: StateSpace | Fit, rate: float) -> StateSpace | Fit:
    """Return the model that belongs to the data before `exponential_window`.

    Every pole moves by +rate, exactly: A and B are divided by e^(−rate dt); C and D stay. Of a
    Fit the Kalman gain goes with B, set to zero where the predictor would then be unstable;
    covariances stay those of the windowed data, its Gram and the covariance of its parameters
    are left out.

    Parameters
    ----------
    model : StateSpace or Fit
        Identified from windowed data; a StateSpace may be continuous.
    rate : float
        As given to `exponential_window` [1/s].

    Examples
    --------
    >>> model = StateSpace([[0.25]], [[0.5]], [[1.0]], [[3.0]], 1.0)
    >>> undone = undo_exponential_window(model, np.log(2))
    >>> undone.A.round(12), undone.B.round(12), undone.D
    (array([[0.5]]), array([[1.]]), array([[3.]]))
    """
    check_positive("rate", rate, "1/s")
    return _undo_fit(model, rate) if isinstance(model, Fit) else _undo(model, rate)


def _undo(model: StateSpace, rate: float) -> StateSpace:
    if model.dt is None:
        shifted = model.A + rate * np.eye(model.order)
        return StateSpace(shifted, model.B, model.C, model.D, None)
    growth = np.exp(rate * model.dt)
    return StateSpace(growth * model.A, growth * model.B, model.C, model.D, model.dt)


def _undo_fit(fit: Fit, rate: float) -> Fit:
    model = _undo(fit.model, rate)
    gain = fit.kalman_gain
    if gain.size:
        gain = gain * np.exp(rate * (model.dt or 0.0))
        if spectral_radius(model.A - gain @ model.C) >= 1:
            gain = np.zeros_like(gain)
    found = Finding(
        "exponential window",
        "note",
        f"The exponential window of {rate:.4g} 1/s was undone: every pole moved by as much.",
    )
    return replace(
        fit,
        model=model,
        kalman_gain=gain,
        parameter_covariance=None,
        gram=None,
        diagnostics=fit.diagnostics.joined({"exponential_window_rate": rate}, [found]),
    )


def _pulses_only(column: Floats) -> Floats:
    force, floor = centred(column)
    level = max(KEPT_SHARE * float(np.abs(force).max()), NOISE_FACTOR * floor)
    kept = np.zeros(len(force), dtype=bool)
    if level > 0:
        foot = max(FOOT_FACTOR * floor, np.finfo(float).eps * float(np.abs(force).max()))
        for first, stop in groups(force, foot, 1):
            kept[first:stop] = np.abs(force[first:stop]).max() >= level
    return np.where(np.isnan(column), np.nan, np.where(kept, force, 0.0))


def _check(record: Record, what: str) -> None:
    if not record.is_in_memory:
        raise OptionError(
            f"{what} needs a record in memory; call in_memory() first, or use hit_segments()."
        )


def _with(record: Record, outputs: Floats, inputs: Floats) -> Record:
    return Record(
        outputs,
        inputs,
        dt=record.dt,
        output_channels=record.output_channels,
        input_channels=record.input_channels,
        name=record.name,
    )
