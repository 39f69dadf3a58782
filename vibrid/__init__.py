"""vibrid: from vibration records to state-space models and modes, every choice explained."""

from .errors import DataError, FileError, OptionError, PathError, UnstableModelError, VibridError
from .files import load, read_record, save, write_record
from .fit import Diagnostics, Finding, Fit
from .identification import identify
from .methods import N4SID, SSI
from .modes import Modes, mac, match_modes, modes_of, mpc
from .record import Channel, FrequencyResponses, ImpulseResponses, Record
from .statespace import StateSpace

__all__ = [
    "N4SID",
    "SSI",
    "Channel",
    "DataError",
    "Diagnostics",
    "FileError",
    "Finding",
    "Fit",
    "FrequencyResponses",
    "ImpulseResponses",
    "Modes",
    "OptionError",
    "PathError",
    "Record",
    "StateSpace",
    "UnstableModelError",
    "VibridError",
    "identify",
    "load",
    "mac",
    "match_modes",
    "modes_of",
    "mpc",
    "read_record",
    "save",
    "write_record",
]
