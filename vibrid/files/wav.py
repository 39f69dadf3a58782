"""WAV: sound recorders and simple front ends."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import wavfile

from ..errors import FileError
from .labels import channel_of
from .tables import Columns, Part, Table, reading


def read_wav(path: Path, **_: Any) -> Table:
    """Read the channels ch1, ch2, … of a WAV file.

    Whole-number samples stay raw counts (24-bit ones as SciPy reads them, in the upper bytes
    of 32), without unit: the file does not state the sensitivity.
    """
    with reading(path, "a WAV file"), warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        rate, samples = _load(path)
        cut = [str(warning.message) for warning in said if "EOF" in str(warning.message)]
    if cut or samples.size == 0 or rate <= 0:
        reason = cut[0].split(";")[0] if cut else f"{samples.size} samples at {rate} Hz"
        raise FileError(f"{path} is a damaged or truncated WAV file ({reason}); copy it again.")
    part = Part(samples)
    channels = tuple(channel_of(f"ch{k + 1}") for k in range(part.n_columns))
    signal = Columns((part,), path)
    return Table(signal, channels, dt=1.0 / rate, name=path.name, numbered=True)


def _load(path: Path) -> tuple[int, np.ndarray[Any, Any]]:
    """Map the samples into memory; 24-bit ones cannot be mapped and are read."""
    try:
        rate, samples = wavfile.read(path, mmap=True)
    except ValueError as problem:
        if "not compatible" not in str(problem):
            raise
        rate, samples = wavfile.read(path)
    return int(rate), samples
