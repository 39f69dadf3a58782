"""Impulse responses from frequency responses, by the inverse discrete Fourier transform.

Of a sampled system, N lines spaced 1/(N dt) hold the pulse responses wrapped around once a
period T = N dt,

    h̃(k) = Σ_j h(k + j N) = C A^(k−1) (I − A^N)⁻¹ B,  k = 1 … N − 1,
    h̃(0) = D + C A^(N−1) (I − A^N)⁻¹ B,

so the poles stay exact however short the period is, and only B and D change: `undo_wrap` gives
them back. Of a structure measured in continuous time up to a last line, the result is the
response to a pulse that holds this band alone: modes above the band add a nearly constant real
part to the frequency responses and so go into lag 0, and what is imaginary at the last line is
a jump in the periodic spectrum, which rings at all lags, negative ones (the end of the period)
too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError, check_choice, check_whole
from ..record import Floats, FrequencyResponses, ImpulseResponses
from ..statespace import StateSpace

Complexes = NDArray[np.complex128]

FEWEST_LINES = 4
SPACING_LIMIT = 1e-3  # deviation of a line from the grid, in line spacings: single precision fits
REAL_LIMIT = 1e-6  # |imaginary| over |value|: what single precision leaves of a real line
INTERPOLATED = 2  # missing low lines that three lines on each side of zero can bridge
NODES = 3
LATE = (0.8, 0.9)  # of the period: late enough for the decay, too early for negative times
SECOND = 0.5  # of the period: from here to the late end, a decay is above what it ends with
GROWTH = 2.0  # energy at negative times over that level: beats alone stay below
LATE_LIMIT = 0.02  # late amplitude over early amplitude
END = 0.95  # of the period: what comes after counts as negative time
NONCAUSAL_LIMIT = 0.01  # of the energy
EDGE_LIMIT = 0.05  # imaginary part at the last line over the largest response


class Remark(NamedTuple):
    """One thing that a user should know: code, severity, sentence, cure."""

    code: str
    severity: Literal["note", "doubt", "warning"]
    sentence: str
    cure: str = ""


@dataclass(frozen=True, eq=False)
class Inversion:
    """Impulse responses with what was seen while they were made.

    Attributes
    ----------
    responses : ImpulseResponses
        One period: `n_lags` is N, the number of samples of the discrete Fourier transform.
    figures : dict
        `late_ratio` (amplitude late in the period over that at its start), `noncausal_share`
        (energy at negative times), `edge_ratio` (imaginary part at the last line over the
        largest response), `low_lines_missing`, `period_seconds`; ratios are those of the worst
        pair of output and input.
    findings : tuple of Remark
    """

    responses: ImpulseResponses
    figures: dict[str, float]
    findings: tuple[Remark, ...]


def impulse_responses(
    responses: FrequencyResponses,
    *,
    low_lines: Literal["auto", "interpolate", "zero"] = "auto",
) -> ImpulseResponses:
    """Return the discrete pulse responses of frequency responses; see `invert`."""
    return invert(responses, low_lines=low_lines).responses


def invert(
    responses: FrequencyResponses,
    *,
    low_lines: Literal["auto", "interpolate", "zero"] = "auto",
) -> Inversion:
    """Turn frequency responses into discrete pulse responses and say what this cost.

    The inverse real discrete Fourier transform (Juang & Pappa, 1985, realize such responses;
    Ewins, Modal Testing, 2000). The result is real, holds one period, and `values[0]` is D.

    Parameters
    ----------
    responses : FrequencyResponses
        At equally spaced lines that are whole multiples of their spacing. They may begin above
        0 Hz and end at or below the Nyquist frequency.
    low_lines : "auto", "interpolate" or "zero"
        What stands for the lines missing below the first. Negative frequencies are known too,
        H(−f) = conj H(f), so a short gap is interpolated between both sides: real parts by an
        even, imaginary parts by an odd polynomial through three lines. Right for receptance,
        mobility and accelerance as long as no resonance lies in or beside the gap. "auto"
        interpolates up to 2 lines and sets zeros for more, where the result is that of a band.

    Returns
    -------
    Inversion
        Of all lines. When the last line is real it is the Nyquist line: N = 2 K samples with
        K the number of the last line, dt = 1/(2 f_last). Otherwise N = 2 K + 1 and dt =
        1/(N df), which keeps the complex last line as it is (an odd N, or the band of an
        analyser that ends at fs/2.56).

    Raises
    ------
    DataError
        Fewer than 4 lines, or lines off an equally spaced grid through zero.
    OptionError
        Unknown `low_lines`.

    Examples
    --------
    >>> model = StateSpace([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.1)
    >>> lines = np.arange(33) / 6.4  # 64 samples of 0.1 s
    >>> found = invert(FrequencyResponses(model.frequency_response(lines), lines))
    >>> found.responses.values[:4, 0, 0].round(12), found.responses.dt
    (array([0. , 2. , 1. , 0.5]), 0.1)
    """
    check_choice("low_lines", low_lines, ("auto", "interpolate", "zero"))
    spacing, first = _grid(responses.frequencies_hz)
    values = responses.values
    interpolate = low_lines == "interpolate" or (low_lines == "auto" and first <= INTERPOLATED)
    if first:
        values = np.concatenate([_low_lines(values, first, interpolate), values])
    last = len(values) - 1
    n_samples = 2 * last + (not _is_real(values[-1], values[-1]))
    pulses = np.fft.irfft(values, n_samples, axis=0)
    inverted = ImpulseResponses(
        pulses,
        dt=1 / (n_samples * spacing),
        output_channels=responses.output_channels,
        input_channels=responses.input_channels,
    )
    figures = {
        "period_seconds": 1 / spacing,
        "low_lines_missing": float(first),
        **_figures(pulses, values),
    }
    remarks = (*_line_remarks(responses, spacing, first, interpolate), *_remarks(figures))
    return Inversion(inverted, figures, remarks)


def undo_wrap(model: StateSpace, period: int) -> StateSpace:
    """Return the model of a system whose pulse responses were wrapped around a period.

    A model (A, B̃, C, D̃) that reproduces the inverse DFT of exact frequency responses has the
    right A and C; B = (I − A^N) B̃ and D = D̃ − C A^(N−1) B̃ are the system's own.

    Parameters
    ----------
    model : StateSpace
        Realized from `impulse_responses`.
    period : int
        N, the number of samples of the discrete Fourier transform: all lags of the inversion.

    Returns
    -------
    StateSpace
        Of the same A, C and dt.

    Examples
    --------
    >>> wrapped = StateSpace([[0.5]], [[1 / (1 - 0.5**4)]], [[1.0]], [[0.5**3 / (1 - 0.5**4)]], 1.0)
    >>> system = undo_wrap(wrapped, 4)
    >>> float(system.B[0, 0]), float(system.D[0, 0])
    (1.0, 0.0)
    """
    check_whole("period", period, 1)
    if model.dt is None:
        raise OptionError("undo_wrap needs a discrete model; got a continuous one.")
    reached = np.linalg.matrix_power(model.A, period - 1) @ model.B
    return StateSpace(
        model.A, model.B - model.A @ reached, model.C, model.D - model.C @ reached, model.dt
    )


# -- lines


def _grid(lines: Floats) -> tuple[float, int]:
    """Return line spacing [Hz] and number of the first line; refuse what is not on the grid."""
    if len(lines) < FEWEST_LINES:
        raise DataError(
            f"Impulse responses need at least {FEWEST_LINES} frequency lines; got {len(lines)}."
        )
    spacing = float(lines[-1] - lines[0]) / (len(lines) - 1)
    deviation = np.abs(lines - lines[0] - spacing * np.arange(len(lines)))
    worst = int(deviation.argmax())
    if deviation[worst] > SPACING_LIMIT * spacing:
        raise DataError(
            f"Frequency lines must be equally spaced; the line at {lines[worst]:g} Hz is "
            f"{deviation[worst]:.3g} Hz off a spacing of {spacing:.6g} Hz (allowed: "
            f"{SPACING_LIMIT * spacing:.3g} Hz). Export equally spaced lines."
        )
    first = round(float(lines[0]) / spacing)
    off = abs(float(lines[0]) - first * spacing)
    if first < 0 or off > 0.01 * spacing:  # looser: the spacing's rounding counts many times
        raise DataError(
            f"Frequency lines must be whole multiples of their spacing, {spacing:.6g} Hz; the "
            f"first, {lines[0]:g} Hz, is {off:.3g} Hz off. Export lines from 0 Hz, or from a "
            "multiple of the spacing."
        )
    return spacing, first


def _low_lines(values: Complexes, first: int, interpolate: bool) -> Complexes:
    """Return what stands for lines 0 … first − 1."""
    if not interpolate:
        return np.zeros((first, *values.shape[1:]), dtype=np.complex128)
    known = np.arange(first, first + NODES, dtype=np.float64)
    wanted = np.arange(first, dtype=np.float64)
    even = _lagrange(known**2, wanted**2)
    odd = even * wanted[:, None] / known
    nodes = values[:NODES]
    return np.asarray(
        np.tensordot(even, nodes.real, 1) + 1j * np.tensordot(odd, nodes.imag, 1), np.complex128
    )


def _lagrange(nodes: Floats, points: Floats) -> Floats:
    """Return the weights (n_points, n_nodes) of polynomial interpolation."""
    others = [np.delete(nodes, k) for k in range(len(nodes))]
    return np.stack(
        [
            ((points[:, None] - rest) / (node - rest)).prod(axis=1)
            for node, rest in zip(nodes, others, strict=True)
        ],
        axis=1,
    )


def _is_real(line: Complexes, scale: Complexes) -> bool:
    return bool(np.abs(line.imag).max() <= REAL_LIMIT * np.abs(scale).max())


# -- what was seen


def _figures(pulses: Floats, values: Complexes) -> dict[str, float]:
    """Return the ratios of the worst pair of output and input."""
    n = len(pulses)
    energy = pulses**2
    total = np.maximum(energy.sum(axis=0), np.finfo(float).tiny)
    start, stop, end = int(LATE[0] * n), int(LATE[1] * n), int(END * n)
    late = energy[start : max(stop, start + 1)].mean(axis=0)
    level = GROWTH * energy[int(SECOND * n) : max(stop, start + 1)].mean(axis=0)
    early = np.maximum(energy[: max(1, n // 10)].mean(axis=0), np.finfo(float).tiny)
    negative = np.maximum(energy[end:].mean(axis=0) - level, 0) * (n - end) / total
    largest = np.maximum(np.abs(values).max(axis=0), np.finfo(float).tiny)
    return {
        "late_ratio": float(np.sqrt(late / early).max()),
        "noncausal_share": float(negative.max()),
        "edge_ratio": float((np.abs(values[-1].imag) / largest).max()),
    }


def _line_remarks(
    responses: FrequencyResponses, spacing: float, first: int, interpolate: bool
) -> list[Remark]:
    """Say what was put for lines that are missing or cannot be as they are."""
    if first:
        how = "interpolated between negative and positive frequencies" if interpolate else "zero"
        return [
            Remark(
                "low lines",
                "note" if interpolate and first <= INTERPOLATED else "doubt",
                f"The frequency responses begin at {responses.frequencies_hz[0]:g} Hz: "
                f"{first} line{'s' * (first > 1)} below, spaced {spacing:.4g} Hz, "
                f"{'were' if first > 1 else 'was'} {how}.",
                "Trust no mode near or below the first line.",
            )
        ]
    if not _is_real(responses.values[0], responses.values):
        return [
            Remark(
                "complex at 0 Hz",
                "note",
                "The frequency responses are complex at 0 Hz; only the real part was used.",
                "Trust no mode within a few lines of 0 Hz.",
            )
        ]
    return []


def _remarks(figures: dict[str, float]) -> list[Remark]:
    """Say where the responses are not those of one pulse at lag 0."""
    found = []
    if figures["late_ratio"] > LATE_LIMIT:
        found.append(
            Remark(
                "circular wrap",
                "doubt",
                f"Late in the period of {figures['period_seconds']:.4g} s the impulse responses "
                f"still have {100 * figures['late_ratio']:.3g} % of their first amplitude (limit "
                f"{100 * LATE_LIMIT:g} %): they wrap around (which leaves poles and shapes right "
                "and changes B and D), were cut when measured, or are noise.",
                "Measure with finer lines, or window the decays exponentially; undo_wrap() gives "
                "B and D back where it is wrapping alone.",
            )
        )
    if figures["noncausal_share"] > NONCAUSAL_LIMIT:
        found.append(
            Remark(
                "not causal",
                "doubt",
                f"{100 * figures['noncausal_share']:.3g} % of the energy of the impulse responses "
                f"lies before the pulse (limit {100 * NONCAUSAL_LIMIT:g} %): the band is cut, the "
                "outputs lead the inputs, or the spectra leaked.",
                "Look at the last lines and the channels' delays; window decays less steeply.",
            )
        )
    if figures["edge_ratio"] > EDGE_LIMIT:
        found.append(
            Remark(
                "cut band",
                "doubt",
                f"At the last line the imaginary part is {100 * figures['edge_ratio']:.3g} % of "
                f"the largest response (limit {100 * EDGE_LIMIT:g} %): a resonance is cut and "
                "rings at all lags.",
                "End the lines between resonances.",
            )
        )
    return found
