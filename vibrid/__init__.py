"""vibrid: from vibration records to state-space models and modes, every choice explained."""

from .blind import BlindFit, estimate_input, identify_blind
from .errors import DataError, FileError, OptionError, PathError, UnstableModelError, VibridError
from .files import load, read_record, save, write_record
from .fit import Diagnostics, Finding, Fit
from .hammer import (
    exponential_window,
    find_hits,
    force_window,
    hammer_responses,
    hit_segments,
    undo_exponential_window,
)
from .identification import identify
from .identification.refining import refine
from .methods import ERA, ERADC, N4SID, OKID, SSI, fir
from .modes import (
    ModeQuality,
    Modes,
    mac,
    match_modes,
    mode_quality,
    modes_of,
    mpc,
    quality_of,
)
from .physical import MechanicalModel, fit_rayleigh, mechanical_model
from .record import Channel, FrequencyResponses, ImpulseResponses, Record
from .spectra import frequency_responses, impulse_responses, next_correlations
from .statespace import StateSpace

__all__ = [
    "ERA",
    "ERADC",
    "N4SID",
    "OKID",
    "SSI",
    "BlindFit",
    "Channel",
    "DataError",
    "Diagnostics",
    "FileError",
    "Finding",
    "Fit",
    "FrequencyResponses",
    "ImpulseResponses",
    "MechanicalModel",
    "ModeQuality",
    "Modes",
    "OptionError",
    "PathError",
    "Record",
    "StateSpace",
    "UnstableModelError",
    "VibridError",
    "estimate_input",
    "exponential_window",
    "find_hits",
    "fir",
    "fit_rayleigh",
    "force_window",
    "frequency_responses",
    "hammer_responses",
    "hit_segments",
    "identify",
    "identify_blind",
    "impulse_responses",
    "load",
    "mac",
    "match_modes",
    "mechanical_model",
    "mode_quality",
    "modes_of",
    "mpc",
    "next_correlations",
    "quality_of",
    "read_record",
    "refine",
    "save",
    "undo_exponential_window",
    "write_record",
]
