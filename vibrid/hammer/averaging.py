"""Frequency responses averaged over hits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..chunks import as_records
from ..errors import DataError, check_whole
from ..record import FrequencyResponses, Record
from ..spectra import averaged_responses, check_estimator

Complexes = NDArray[np.complex128]


def hammer_responses(
    segments: Record | Sequence[Record],
    *,
    n_samples: int | None = None,
    estimator: Literal["H1", "H2"] = "H1",
) -> FrequencyResponses:
    """Return the frequency responses averaged over hits, one transform a hit, no window.

    Exact where each response has died by the end of its segment and began at rest: shorter
    segments are continued by zeros. Otherwise apply `exponential_window` first; the responses
    are then those of the system with its poles moved, to be undone after realization. Remove
    offsets before (`hit_segments(…, remove_baseline=True)`), and noise after the pulse by
    `force_window`.

    Parameters
    ----------
    segments : Record or sequence of Record
        From `hit_segments`; several hammers need at least one hit of each.
    n_samples : int, optional
        Length of the transform, at least that of the longest segment, the default.
    estimator : "H1" or "H2"
        H1 for noise on the outputs, H2 (one hammer) for noise on the force.

    Returns
    -------
    FrequencyResponses
        Lines from 0 Hz to Nyquist, spaced 1/(n_samples dt). `coherence` is that over hits, the
        multiple one with several hammers; None with no more hits than hammers.

    Raises
    ------
    DataError
        Missing samples, fewer hits than hammers, a hammer without a hit.
    OptionError
        No inputs, n_samples too small, H2 with several hammers.

    Examples
    --------
    >>> force, response = np.zeros(64), np.zeros(64)
    >>> force[4], response[4:6] = 2.0, [6.0, 2.0]
    >>> found = hammer_responses(Record(response, force, dt=0.01))
    >>> found.values[[0, 32], 0, 0].real.round(12)
    array([4., 2.])
    """
    records = as_records(segments)
    first = records[0]
    check_estimator(estimator, first.n_inputs)
    longest = max(record.n_samples for record in records)
    if n_samples is None:
        n_samples = longest
    check_whole("n_samples", n_samples, longest)
    if len(records) < first.n_inputs:
        raise DataError(
            f"{first.n_inputs} hammers need at least as many hits; there are {len(records)}. "
            "Select one input, or give more segments."
        )
    lines = np.arange(n_samples // 2 + 1) / (n_samples * first.dt)
    spectra = _transforms(records, n_samples)
    return averaged_responses(
        spectra, lines, first.output_channels, first.input_channels, estimator
    )


def _transforms(records: Sequence[Record], n_samples: int) -> Iterator[tuple[Complexes, Complexes]]:
    for number, record in enumerate(records, start=1):
        rows = record.read(0, record.n_samples)
        if not np.isfinite(rows).all():
            raise DataError(
                f"Segment {number} of {len(records)} has missing or infinite samples; leave it out."
            )
        Z = np.fft.rfft(rows, n_samples, axis=0)[None]
        yield Z[:, :, : record.n_inputs], Z[:, :, record.n_inputs :]
