"""Sensors: which channel stands at which degree of freedom, and the data in SI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, check_whole
from ..fit import Finding
from ..mechanics import MOTIONS
from ..physical.units import si_factors
from ..record import Channel, Floats, Quantity, Record
from .result import Setting

TAKEN = "other"  # the quantity of a channel that nobody has labelled


@dataclass(frozen=True, eq=False)
class Sensors:
    """One sensor at each degree of freedom, in the order of the record's outputs.

    Attributes
    ----------
    setting : Setting
    powers : int array (n_dof,)
        0, 1, 2 for displacement, velocity, acceleration.
    factors : array (n_dof,)
        Sign times the factor into SI.
    findings : tuple of Finding
        What was assumed.
    """

    setting: Setting
    powers: NDArray[np.int64]
    factors: Floats
    findings: tuple[Finding, ...]

    @property
    def only_accelerations(self) -> bool:
        return bool((self.powers == 2).all())

    def outputs(self, record: Record) -> Floats:
        """Return the outputs (n_samples, n_dof) in SI, in the direction of their DOFs."""
        return np.asarray(record.outputs[:], dtype=np.float64) * self.factors


def sensors_of(record: Record, n_dof: int) -> Sensors:
    """Return what the record's outputs measure, as many as there are degrees of freedom.

    Channels of quantity "other" are taken as accelerations, and a finding says so; a channel
    without a DOF stands at a DOF of its own, called by the channel's name.

    Raises
    ------
    OptionError
        n_dof other than the number of sensors; outputs that measure no motion; units that do
        not go together.
    DataError
        Missing samples.
    """
    check_whole("n_dof", n_dof, 1)
    channels = record.output_channels
    if len(channels) != n_dof:
        raise OptionError(
            f"n_dof={n_dof} needs one sensor at each of {n_dof} degrees of freedom; the record "
            f"has {len(channels)} outputs ({', '.join(record.output_names)}). Give n_dof="
            f"{len(channels)}, or choose the outputs with select(outputs=[…])."
        )
    known = _taken_as(channels, "acceleration")
    _check_motions(known)
    labels = tuple(channel.dof or channel.name for channel in known)
    if len(set(labels)) != n_dof:
        raise OptionError(
            f"Each degree of freedom needs a sensor of its own; the DOFs are {', '.join(labels)}."
        )
    _check_gaps(record)
    factors, units = si_factors(known)
    signs = np.array([channel.sign for channel in known])
    setting = Setting(known, labels, record.dt, record.n_samples, units)
    powers = np.array([MOTIONS.index(channel.quantity) for channel in known], dtype=np.int64)
    return Sensors(setting, powers, factors * signs, _assumed(channels))


def forces_of(record: Record) -> Floats:
    """Return the inputs (n_samples, n_inputs) in SI and in the direction of their DOFs.

    Inputs of quantity "other" are taken as forces.

    Raises
    ------
    OptionError
        Inputs that are no forces; units that do not go with those of the outputs.
    DataError
        Missing samples.
    """
    _check_gaps(record)
    channels = _taken_as(record.input_channels, "force")
    for channel in channels:
        if channel.quantity != "force":
            raise OptionError(
                f"Input {channel.name!r} is a {channel.quantity}, no force. Leave it out with "
                "select(inputs=[…])."
            )
    sensors = _taken_as(record.output_channels, "acceleration")
    factors = si_factors((*channels, *sensors))[0][: len(channels)]
    signs = np.array([channel.sign for channel in channels])
    return np.asarray(np.asarray(record.inputs[:], dtype=np.float64) * factors * signs)


def _check_gaps(record: Record) -> None:
    segments = record.segments()
    if segments != ((0, record.n_samples),):
        raise DataError(
            "The record has missing samples; take a piece without gaps with slice(start, stop): "
            + ", ".join(f"{start} to {stop}" for start, stop in segments[:5])
            + "."
        )


def _taken_as(channels: Sequence[Channel], quantity: Quantity) -> tuple[Channel, ...]:
    """Return the channels, those that nobody has labelled as of a quantity."""
    return tuple(replace(c, quantity=quantity) if c.quantity == TAKEN else c for c in channels)


def _check_motions(channels: Sequence[Channel]) -> None:
    for channel in channels:
        if channel.quantity not in MOTIONS:
            raise OptionError(
                f"Output {channel.name!r} is a {channel.quantity}; blind identification needs "
                f"{', '.join(MOTIONS)}. Leave it out with select(outputs=[…])."
            )


def _assumed(channels: Sequence[Channel]) -> tuple[Finding, ...]:
    taken = [channel.name for channel in channels if channel.quantity == TAKEN]
    if not taken:
        return ()
    return (
        Finding(
            "taken_as_acceleration",
            "note",
            f"Channels without a quantity were taken as accelerations: {', '.join(taken)}.",
            "Label them where they measure displacement or velocity.",
        ),
    )
