"""Frequency responses of records with measured inputs: H1 and H2, with coherence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..errors import DataError, OptionError, check_choice
from ..record import Channel, Floats, FrequencyResponses, Record
from .power import segment_length, stretches

Complexes = NDArray[np.complex128]
WINDOWS = ("hann", "hamming", "blackman", "flattop", "boxcar")
TOGETHER = 4  # windows transformed at once: copies of all channels
NO_POWER = 1e-26  # of the strongest line: rounding of an input that does not move there
DEPENDENT = 1e-12  # smallest eigenvalue of the inputs' spectral correlation matrix


def frequency_responses(
    record: Record,
    *,
    segment_seconds: float | None = None,
    window: str = "hann",
    estimator: Literal["H1", "H2"] = "H1",
) -> FrequencyResponses:
    """Return averaged frequency responses of outputs to inputs, with coherence (Welch, 1967).

    Half overlapping windows, each less its mean; those that touch a missing sample are left
    out. The record is read a stretch at a time. H1 = S_yu S_uu⁻¹ is right for noise on the
    outputs, H2 = S_yy / S_uy for noise on the input (Bendat & Piersol, Random Data, 2010).
    Windows broaden lightly damped resonances: their damping is right only where a window is
    several times as long as the decay. For hammer tests see `hammer_responses`.

    Parameters
    ----------
    record : Record
        With inputs, in memory or on disk.
    segment_seconds : float, optional
        Length of a window [s]; by default a power of two of samples, at most 8192 and an
        eighth of the record.
    window : str
        One of hann, hamming, blackman, flattop, boxcar (for periodic signals whose period is
        the window: then exact).
    estimator : "H1" or "H2"
        H2 for a single input only.

    Returns
    -------
    FrequencyResponses
        From the first line above 0 Hz, where subtracting means leaves nothing, to Nyquist.
        `coherence` is the ordinary one for one input; for several the multiple coherence of
        each output with all inputs, repeated along the inputs.

    Raises
    ------
    OptionError
        No inputs, unknown window or estimator, H2 with several inputs.
    DataError
        No more windows than inputs, inputs without power or moving together at a line.

    Examples
    --------
    >>> u = np.random.default_rng(1).normal(size=2048)
    >>> found = frequency_responses(Record(3 * u, u, dt=0.01))
    >>> found.values[:2, 0, 0].round(9).real, found.coherence.min().round(9)
    (array([3., 3.]), np.float64(1.0))
    """
    check_choice("window", window, WINDOWS)
    check_estimator(estimator, record.n_inputs)
    pieces = record.segments()
    length = segment_length(record, pieces, segment_seconds)
    spectra = _transforms(record, pieces, length, window)
    lines = np.arange(1, length // 2 + 1) / (length * record.dt)
    return averaged_responses(
        spectra, lines, record.output_channels, record.input_channels, estimator
    )


def check_estimator(estimator: str, n_inputs: int) -> None:
    """Raise `OptionError` for an unknown estimator, no inputs, or H2 with several."""
    check_choice("estimator", estimator, ("H1", "H2"))
    if n_inputs == 0:
        raise OptionError(
            "Frequency responses need measured inputs; the record has none. Name them when "
            "reading, or use next_correlations() on an ambient record."
        )
    if estimator == "H2" and n_inputs > 1:
        raise OptionError(
            f"H2 is defined here for one input; the record has {n_inputs}. Use H1, or select() "
            "one input that was driven alone."
        )


def averaged_responses(
    spectra: Iterable[tuple[Complexes, Complexes]],
    lines: Floats,
    outputs: tuple[Channel, ...],
    inputs: tuple[Channel, ...],
    estimator: str,
) -> FrequencyResponses:
    """Average the transforms (n_windows, n_lines, channels) of inputs and outputs to responses.

    Coherence is None where windows are not more than inputs: it would be 1 whatever the data.
    """
    n_lines, m, p = len(lines), len(inputs), len(outputs)
    S_uu = np.zeros((n_lines, m, m), np.complex128)
    S_yu = np.zeros((n_lines, p, m), np.complex128)
    S_yy = np.zeros((n_lines, p))
    count = 0
    for U, Y in spectra:
        by_line = U.conj().transpose(1, 0, 2)
        S_uu += U.transpose(1, 2, 0) @ by_line
        S_yu += Y.transpose(1, 2, 0) @ by_line
        S_yy += (np.abs(Y) ** 2).sum(axis=0)
        count += len(U)
    _check_inputs(S_uu, lines, inputs)
    H1 = np.linalg.solve(S_uu.transpose(0, 2, 1), S_yu.transpose(0, 2, 1)).transpose(0, 2, 1)
    explained = (H1 * S_yu.conj()).sum(axis=2).real
    coherence = np.clip(np.divide(explained, S_yy, out=np.zeros_like(S_yy), where=S_yy > 0), 0, 1)
    return FrequencyResponses(
        H1 if estimator == "H1" else _h2(S_yy, S_yu),
        lines,
        output_channels=outputs,
        input_channels=inputs,
        coherence=np.repeat(coherence[:, :, None], m, axis=2) if count > m else None,
    )


def _transforms(
    record: Record, pieces: tuple[tuple[int, int], ...], length: int, window: str
) -> Iterator[tuple[Complexes, Complexes]]:
    """Yield the Fourier transforms of the windows of each stretch, without line 0."""
    from scipy.signal import get_window

    weights = get_window(window, length)[:, None]
    m = record.n_inputs
    n_windows = sum(
        (stop - start - length) // (length // 2) + 1
        for start, stop in pieces
        if stop - start >= length
    )
    if n_windows <= m:
        raise DataError(
            f"{m} inputs need more than {m} windows; the record has {n_windows} of "
            f"{length * record.dt:g} s. Use shorter segments or a longer record."
        )
    for start, stop in pieces:
        for first, last in stretches(start, stop, length):
            rows = sliding_window_view(record.read(first, last), length, axis=0)
            windows = rows[:: length // 2].transpose(0, 2, 1)
            for k in range(0, len(windows), TOGETHER):
                x = windows[k : k + TOGETHER]
                Z = np.fft.rfft((x - x.mean(axis=1, keepdims=True)) * weights, axis=1)[:, 1:]
                yield Z[:, :, :m], Z[:, :, m:]


def _check_inputs(S_uu: Complexes, lines: Floats, inputs: tuple[Channel, ...]) -> None:
    """Refuse lines where an input has no power or the inputs cannot be told apart."""
    power = np.einsum("kii->ki", S_uu).real
    dead = power <= NO_POWER * power.max(axis=0)
    if dead.any():
        k, channel = np.argwhere(dead)[0]
        raise DataError(
            f"Input {inputs[channel].name!r} has no power at {lines[k]:g} Hz (and at "
            f"{int(dead.any(axis=1).sum())} of {len(lines)} lines); no frequency response can be "
            "found there. Drive the structure over the whole band, or leave the input out."
        )
    root = np.sqrt(power)
    smallest = np.linalg.eigvalsh(S_uu / (root[:, :, None] * root[:, None, :]))[:, 0]
    k = int(smallest.argmin())
    if smallest[k] <= DEPENDENT:
        names = ", ".join(channel.name for channel in inputs)
        raise DataError(
            f"Inputs {names} move together at {lines[k]:g} Hz: their spectral matrix is singular "
            f"({smallest[k]:.1e} of 1). Drive them by independent signals, or make one run for "
            "each."
        )


def _h2(S_yy: Floats, S_yu: Complexes) -> Complexes:
    """Return S_yy / S_uy of a single input; where the two are unrelated it has no bound."""
    cross = S_yu[:, :, 0].conj()
    if (cross == 0).any():
        raise DataError(
            "H2 is infinite where an output is unrelated to the input; use H1, or leave constant "
            "outputs out."
        )
    return np.asarray((S_yy / cross)[:, :, None], dtype=np.complex128)
