"""From records to signals: sensors that go together, enough samples, frequencies that fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ...errors import DataError, OptionError
from ...record import Floats, Record
from ..result import Setting
from ..sensors import Sensors, sensors_of
from .components import Signals

MOST_PER_MODE, MOST = 3, 12  # oscillations looked for: so many per sensor, and so many more
SAMPLES_EACH = 8  # samples of a record for each oscillation at least


def records_of(data: Record | Sequence[Record]) -> list[Record]:
    """Return one record or several as a list, which is not empty."""
    records = [data] if isinstance(data, Record) else list(data)
    if not records:
        raise OptionError("data is empty; give a Record or several.")
    return records


def signals_of(
    data: Record | Sequence[Record], n_dof: int, input_frequencies_hz: Sequence[float] | None
) -> tuple[Sensors, Signals]:
    """Return the sensors and the signals of records that go together."""
    records = records_of(data)
    each = [sensors_of(record, n_dof) for record in records]
    first = each[0]
    for record, other in zip(records, each, strict=True):
        if other.setting.dofs != first.setting.dofs or (other.powers != first.powers).any():
            raise DataError("The records differ in their sensors; select the same ones from each.")
        if record.dt != records[0].dt:
            raise DataError(
                f"The records have sampling intervals of {records[0].dt:g} and {record.dt:g} s; "
                "bring them to one with decimate()."
            )
    hertz = frequencies_of(input_frequencies_hz, records[0].dt)
    samples = tuple(s.outputs(record) for s, record in zip(each, records, strict=True))
    shortest = min(len(y) for y in samples)
    least = SAMPLES_EACH * (n_dof + len(hertz) + 1)
    if shortest < least:
        raise DataError(
            f"A record has {shortest} samples; {n_dof} degrees of freedom and {len(hertz)} given "
            f"frequencies need at least {least}."
        )
    for y in samples:
        _check_motion(y, first.setting)
    setting = replace(first.setting, n_samples=sum(len(y) for y in samples))
    return replace(first, setting=setting), Signals(samples, records[0].dt, 2 * np.pi * hertz)


def frequencies_of(given: Sequence[float] | None, dt: float) -> Floats:
    """Return input_frequencies_hz as an array, none of it twice or beyond Nyquist."""
    hertz = np.asarray([] if given is None else given, dtype=np.float64)
    if hertz.ndim != 1:
        raise OptionError("input_frequencies_hz must be a list of numbers, in hertz.")
    wrong = hertz[~((hertz > 0) & (hertz < 0.5 / dt))]
    if len(wrong):
        raise OptionError(
            f"input_frequencies_hz must lie between 0 and the Nyquist frequency {0.5 / dt:g} Hz; "
            f"got {wrong[0]:g}."
        )
    if len(np.unique(hertz)) < len(hertz):
        raise OptionError(f"input_frequencies_hz names a frequency twice: {hertz.tolist()}.")
    return hertz


def _check_motion(y: Floats, setting: Setting) -> None:
    for label, each in zip(setting.dofs, y.T, strict=True):
        if np.ptp(each) == 0:
            raise DataError(f"The sensor at {label} is constant; leave it out, or repair it.")


def most_oscillations(signals: Signals) -> int:
    """Return how many oscillations are looked for at most."""
    n = signals.n_channels
    room = min(signals.lengths) // SAMPLES_EACH - len(signals.known)
    return max(n, min(MOST_PER_MODE * n + MOST, room))
