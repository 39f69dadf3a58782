"""Filters on arrays (samples, channels); NaN rows are gaps, and pieces are filtered apart.

scipy.signal takes a second to import, so the functions that filter import it themselves.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..errors import DataError, OptionError, check_whole
from .signals import Floats

SHIFT_HALF_WIDTH = 32  # taps on each side of the fractional delay
SHIFT_KAISER_BETA = 8.0  # about 80 dB
LOWEST_EDGE = 1e-6  # of the Nyquist frequency: below, rounding makes the filter singular
PASSED_SHARE = 0.8  # of the new Nyquist frequency that decimation leaves untouched
LARGEST_STAGE = 12  # SciPy advises to decimate by more than this in stages
# odd, so that a constant passes exactly; 65 dB (both ways) where aliases reach the passed band
DECIMATION_ORDER = 9
DECIMATION_RIPPLE_DB = 0.001  # both ways 2.3e-4


def detrend(x: Floats, kind: str) -> Floats:
    """Subtract a constant or a straight line from each column, leaving NaN where it is."""
    good = ~np.isnan(x).any(axis=1)
    degree = 0 if kind == "constant" else 1
    # centred and scaled time: well conditioned for any length
    time = np.linspace(-1.0, 1.0, len(x))
    basis = np.vander(time, degree + 1)
    if good.sum() <= degree:
        raise DataError(
            f"A {kind} trend needs at least {degree + 1} samples; there are {good.sum()}."
        )
    trend, *_ = np.linalg.lstsq(basis[good], x[good], rcond=None)
    return np.asarray(x - basis @ trend)


def check_band(low_hz: float, high_hz: float, nyquist: float) -> None:
    """Raise `OptionError` unless 0 ≤ low < high and low is below Nyquist."""
    if not 0 <= low_hz < high_hz:
        raise OptionError(
            f"A band needs 0 ≤ low < high; got {low_hz:g} to {high_hz:g} Hz (Nyquist is "
            f"{nyquist:g} Hz)."
        )
    if low_hz >= nyquist:
        raise OptionError(
            f"The band begins at {low_hz:g} Hz, at or above the Nyquist frequency {nyquist:g} Hz."
        )


def butterworth(low_hz: float, high_hz: float, dt: float, order: int) -> Floats:
    """Return second-order sections of the band [low_hz, high_hz]."""
    from scipy import signal

    check_whole("filter_order", order, 1, 12)
    nyquist = 0.5 / dt
    check_band(low_hz, high_hz, nyquist)
    if low_hz == 0 and high_hz >= nyquist:
        raise OptionError(f"0 to {high_hz:g} Hz is the whole band to Nyquist; nothing to filter.")
    if 0 < low_hz < LOWEST_EDGE * nyquist:
        raise OptionError(
            f"The band begins at {low_hz:g} Hz; it must begin at 0 or at least at "
            f"{LOWEST_EDGE * nyquist:g} Hz, {LOWEST_EDGE:g} of the Nyquist frequency."
        )
    if high_hz >= nyquist:
        return np.asarray(signal.butter(order, low_hz, "highpass", fs=1 / dt, output="sos"))
    if low_hz == 0:
        return np.asarray(signal.butter(order, high_hz, "lowpass", fs=1 / dt, output="sos"))
    edges = [low_hz, high_hz]
    return np.asarray(signal.butter(order, edges, "bandpass", fs=1 / dt, output="sos"))


def zero_phase(x: Floats, sections: Floats) -> Floats:
    """Filter forward and backward, each piece between gaps apart."""
    from scipy import signal

    shortest = 3 * (2 * len(sections) + 1)

    def run(piece: Floats) -> Floats:
        if len(piece) <= shortest:
            raise DataError(
                f"A piece of {len(piece)} samples is too short to filter: more than {shortest} "
                "are needed. Use a longer record, or one with fewer gaps."
            )
        return np.asarray(signal.sosfiltfilt(sections, piece, axis=0))

    return _by_piece(x, run)


def decimate(x: Floats, factor: int) -> Floats:
    """Low-pass (Chebyshev, zero phase) and keep rows 0, factor, 2 factor, …"""
    from scipy import signal

    for stage in _stages(factor):
        # the filter's own padding is 30 samples
        shortest = max(30, 9 * stage)

        def run(piece: Floats, stage: int = stage, shortest: int = shortest) -> Floats:
            if len(piece) <= shortest:
                raise DataError(
                    f"A piece of {len(piece)} samples is too short to decimate by {stage}: more "
                    f"than {shortest} are needed. Use a smaller factor (a --band that ends "
                    "higher), or a longer record."
                )
            edge = PASSED_SHARE / stage
            sections = signal.cheby1(DECIMATION_ORDER, DECIMATION_RIPPLE_DB, edge, output="sos")
            return np.asarray(signal.sosfiltfilt(sections, piece, axis=0))

        x = _by_piece(x, run)[::stage]
    return x


def shift(x: Floats, lags: Floats) -> Floats:
    """Advance column k by lags[k] samples (a fraction is interpolated by a windowed sinc)."""
    half = SHIFT_HALF_WIDTH

    def run(piece: Floats) -> Floats:
        moved = piece.copy()
        for k, lag in enumerate(lags):
            if lag == 0:
                continue
            taps = np.arange(-half, half + 1)
            whole = int(np.round(lag))
            kernel = np.sinc(taps + (lag - whole)) * np.kaiser(2 * half + 1, SHIFT_KAISER_BETA)
            margin = half + abs(whole)
            if len(piece) <= margin:
                raise DataError(
                    f"A delay of {lag:.1f} samples needs pieces of more than {margin} samples; "
                    f"one has {len(piece)}."
                )
            padded = _odd_extension(piece[:, k], margin)
            smooth = np.convolve(padded, kernel / kernel.sum(), mode="valid")
            first = abs(whole) + whole
            moved[:, k] = smooth[first : first + len(piece)]
        return moved

    return _by_piece(x, run)


def _odd_extension(x: Floats, margin: int) -> Floats:
    front = 2 * x[0] - x[margin:0:-1]
    back = 2 * x[-1] - x[-2 : -margin - 2 : -1]
    return np.concatenate([front, x, back])


def _stages(factor: int) -> list[int]:
    stages = []
    rest = factor
    for divisor in range(LARGEST_STAGE, 1, -1):
        while rest % divisor == 0:
            stages.append(divisor)
            rest //= divisor
    if rest > 1:
        stages.append(rest)
    return stages


def _by_piece(x: Floats, run: Callable[[Floats], Floats]) -> Floats:
    if x.shape[1] == 0:
        return x
    bad = np.isnan(x).any(axis=1)
    if not bad.any():
        return run(x)
    result = np.full_like(x, np.nan)
    edges = np.flatnonzero(np.diff(np.concatenate([[True], bad, [True]]).astype(np.int8)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        result[start:stop] = run(x[start:stop])
    return result
