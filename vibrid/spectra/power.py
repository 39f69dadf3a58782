"""Power spectra of records, by SciPy's Welch averages."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import DataError, OptionError, check_positive
from ..record import Floats, Record

SMALLEST_SEGMENT = 16  # samples: fewer lines say nothing
LARGEST_SEGMENT = 8192  # unless more is asked for
SEGMENTS_WANTED = 8  # averages that the default length allows at least
SEGMENTS_PER_READ = 32  # how much of a record is in memory at once


def power_spectrum(
    record: Record, *, segment_seconds: float | None = None
) -> tuple[Floats, Floats]:
    """Return the one-sided power spectral density of every channel (Welch, 1967).

    Hann windows, half overlapping, each less its mean. Windows that touch a missing sample
    are left out, so gaps neither count nor are filled. The record is read a stretch at a time.

    Parameters
    ----------
    record : Record
        Inputs and outputs, in memory or on disk.
    segment_seconds : float, optional
        Length of a window [s]; by default a power of two of samples, at most 8192 and an
        eighth of the record.

    Returns
    -------
    frequencies_hz : array (n_lines,)
        From 0 to the Nyquist frequency [Hz].
    psd : array (n_lines, n_inputs + n_outputs)
        Density [unit²/Hz], inputs first, as `Record.read` gives them; line 0 holds what the
        subtracted mean leaves.

    Raises
    ------
    DataError
        No stretch between gaps is as long as a window; infinite values.
    OptionError
        `segment_seconds` is shorter than 16 samples or longer than the record.

    Examples
    --------
    >>> t = np.arange(4096) / 64
    >>> frequencies_hz, psd = power_spectrum(Record(np.sin(2 * np.pi * 8 * t), dt=1 / 64))
    >>> float(frequencies_hz[np.argmax(psd[:, 0])])
    8.0
    """
    from scipy import signal

    pieces = record.segments()
    length = segment_length(record, pieces, segment_seconds)
    total = np.zeros((length // 2 + 1, record.n_inputs + record.n_outputs))
    count = 0
    for start, stop in pieces:
        for first, last in stretches(start, stop, length):
            n_windows = (last - first - length) // (length // 2) + 1
            _, psd = signal.welch(record.read(first, last), 1 / record.dt, nperseg=length, axis=0)
            total += n_windows * psd
            count += n_windows
    lines: Floats = np.arange(length // 2 + 1) / (length * record.dt)
    return lines, np.asarray(total / count)


def segment_length(record: Record, pieces: Sequence[tuple[int, int]], seconds: float | None) -> int:
    """Return the even number of samples in a window that fits a piece of the record."""
    longest = max((stop - start for start, stop in pieces), default=0)
    if seconds is not None:
        check_positive("segment_seconds", seconds, "s")
        length = 2 * round(seconds / record.dt / 2)
        if not SMALLEST_SEGMENT <= length <= record.n_samples:
            raise OptionError(
                f"segment_seconds = {seconds:g} s is {length} samples; it must be at least "
                f"{SMALLEST_SEGMENT} and at most the record's {record.n_samples}."
            )
    else:
        wanted = max(SMALLEST_SEGMENT, record.n_samples // SEGMENTS_WANTED, 1)
        wanted = min(wanted, LARGEST_SEGMENT, max(longest, SMALLEST_SEGMENT))
        length = 1 << (wanted.bit_length() - 1)
    if longest < length:
        raise DataError(
            f"A spectrum needs {length} samples without a gap; the longest stretch has {longest}. "
            "Use shorter segments or a record with fewer gaps."
        )
    return length


def stretches(start: int, stop: int, length: int) -> list[tuple[int, int]]:
    """Cut a piece into stretches that share no window and lose none."""
    step = length // 2
    n_windows = (stop - start - length) // step + 1
    return [
        (start + k * step, start + (min(k + SEGMENTS_PER_READ, n_windows) - 1) * step + length)
        for k in range(0, n_windows, SEGMENTS_PER_READ)
    ]
