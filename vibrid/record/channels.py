"""Channels: what each column of a record measures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from ..errors import DataError, OptionError, check_choice

Quantity = Literal[
    "force", "displacement", "velocity", "acceleration", "base_acceleration", "other"
]
QUANTITIES: tuple[str, ...] = get_args(Quantity)


@dataclass(frozen=True)
class Channel:
    """Describe one sensor or actuator.

    Parameters
    ----------
    name : str
        Unique among the channels of a record.
    quantity : str
        One of force, displacement, velocity, acceleration, base_acceleration, other.
    unit : str
        As written in the file, such as ``m/s2``, ``g``, ``mm`` or ``N``; empty when unknown.
    dof : str or None
        The label that joins sensors and actuators at one degree of freedom.
    sign : 1 or -1
        −1 for a sensor mounted against its DOF. Data are never flipped; shapes are.
    delay : float
        How far the channel lags behind the others [s]; removed by `Record.correct_delays`.

    Examples
    --------
    >>> Channel("acc1", "acceleration", unit="m/s2", dof="f1").quantity
    'acceleration'
    """

    name: str
    quantity: Quantity = "other"
    unit: str = ""
    dof: str | None = None
    sign: int = 1
    delay: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise OptionError(f"A channel needs a name; got {self.name!r}.")
        check_choice(f"quantity of channel {self.name!r}", self.quantity, QUANTITIES)
        if self.sign not in (1, -1):
            raise OptionError(f"sign of channel {self.name!r} must be 1 or -1; got {self.sign!r}.")
        if not math.isfinite(self.delay):
            raise OptionError(
                f"delay of channel {self.name!r} must be finite, in seconds; got {self.delay!r}."
            )


Labels = Sequence[Channel | str] | None


def make_channels(labels: Labels, count: int, prefix: str) -> tuple[Channel, ...]:
    """Return `count` channels from Channels, names, or None (then prefix1, prefix2, …)."""
    if labels is None:
        return tuple(Channel(f"{prefix}{k + 1}") for k in range(count))
    if isinstance(labels, str | Channel):
        labels = [labels]
    channels = tuple(label if isinstance(label, Channel) else Channel(label) for label in labels)
    if len(channels) != count:
        raise OptionError(
            f"{len(channels)} channel labels were given for {count} columns; give one a column."
        )
    return channels


def check_unique(channels: Sequence[Channel]) -> None:
    """Raise `DataError` when two channels bear one name."""
    seen: set[str] = set()
    for channel in channels:
        if channel.name in seen:
            raise DataError(f"Two channels are called {channel.name!r}; names must differ.")
        seen.add(channel.name)
