"""Labelled signals: Channel, Record, ImpulseResponses, FrequencyResponses."""

from .channels import QUANTITIES, Channel, Quantity, make_channels
from .record import Record, joined
from .responses import FrequencyResponses, ImpulseResponses
from .signals import Floats, Signal, in_memory, rows_per_chunk

__all__ = [
    "QUANTITIES",
    "Channel",
    "Floats",
    "FrequencyResponses",
    "ImpulseResponses",
    "Quantity",
    "Record",
    "Signal",
    "in_memory",
    "joined",
    "make_channels",
    "rows_per_chunk",
]
