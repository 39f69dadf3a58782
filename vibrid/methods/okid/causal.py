"""Causal responses where those of the observer explode: outputs that precede their inputs.

An observer answers at lags 0, 1, 2, … by construction. Where measured outputs lead measured
inputs by a part of a sample (other filters, another clock), least squares puts poles outside the
unit circle, mostly near Nyquist: read backwards in time they are the decaying answer at
negative lags. Evaluated on a circle between them and the structure's poles, the responses
split into both parts (Laurent series).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...fit import Finding
from ...markov import joint_markov
from ...record import Floats

GROWN = 10.0  # over the lags used; in a whole record it would have outgrown all bounds
EXPLODED = 1e6  # over the lags used: beyond it nothing else is seen
RADII = (1.002, 1.003, 1.005, 1.01, 1.02, 1.03, 1.05)  # of the circle; noise moves true poles less
SEPARATED = 1e-3  # of the largest, left midway between both parts
LONGEST_PERIOD = 8192  # samples of the transforms
LARGEST_TRANSFORM = 2**24  # elements, where fewer samples do
NONCAUSAL_LIMIT = 0.5  # of the energy: beyond it inputs are no causes


@dataclass(frozen=True, eq=False)
class Responses:
    """[Y_k, Y°_k] of lags 0, 1, …, and the share of energy left out at negative lags."""

    joint: Floats
    left_out: float = 0.0

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What to know of responses at negative lags; nothing without any."""
        if not self.left_out:
            return ()
        return (
            Finding(
                "outputs-precede-inputs",
                "doubt",
                f"{100 * self.left_out:.2g} % of the energy of the responses lies before the "
                "inputs come, as if filters or clocks differed, and was left out; kept, it makes "
                "responses explode. A structure that feedback alone keeps stable looks the same.",
                "Give inputs and outputs the same anti-aliasing filters and one clock.",
            ),
        )


def causal_responses(
    observer: Floats, n_lags: int, residual_weights: Floats | None = None
) -> Responses | None:
    """Return the responses that follow from an observer; None where they explode.

    By recursion, unless they grow: then what the Laurent series has at lags ≥ 0.
    """
    joint = joint_markov(observer, n_lags, residual_weights)
    grown = growth(joint)
    if grown <= GROWN:
        return Responses(joint)
    return _split(observer, n_lags, residual_weights) or (
        Responses(joint) if grown <= EXPLODED else None
    )


def growth(joint: Floats) -> float:
    """Return the size of the last quarter of the Markov parameters over that of the first."""
    quarter = max(1, len(joint) // 4)
    if not np.isfinite(joint).all():
        return np.inf
    first, last = np.abs(joint[:quarter]).max(), np.abs(joint[-quarter:]).max()
    return float(last / first) if first else 0.0


def _split(observer: Floats, n_lags: int, residual_weights: Floats | None) -> Responses | None:
    """Return the part at lags ≥ 0 of the smallest circle that separates it from the other."""
    m = observer.shape[2] - observer.shape[1]
    for radius in RADII:
        series = _laurent(observer, residual_weights, radius, _period(observer, n_lags))
        middle, width = len(series) // 2, max(1, len(series) // 16)
        between = np.abs(series[middle - width : middle + width])
        if not between.max() <= SEPARATED * np.abs(series).max():
            continue
        powers = radius ** np.arange(-middle, middle)[:, None, None]
        causal = series[:n_lags] * powers[middle : middle + n_lags]
        inputs = np.square(series[middle:, :, :m] * powers[:middle]).sum()
        left_out = float(inputs / (inputs + np.square(causal[1:, :, :m]).sum()))
        causal[0, :, m:] = 0
        return Responses(causal, left_out) if left_out <= NONCAUSAL_LIMIT else None
    return None


def _laurent(
    observer: Floats, residual_weights: Floats | None, radius: float, period: int
) -> Floats:
    """Return M_k radius^−k of Σ M_k z^−k = (I − Σ h̄_k² z^−k)⁻¹ [Σ h̄_k¹ z^−k, −I − Σ C_k z^−k].

    On the circle |z| = radius; lags below 0 stand at the end, as in a discrete transform.
    """
    p = observer.shape[1]
    m = observer.shape[2] - p
    powers = radius ** -np.arange(float(len(observer)))[:, None, None]
    own, driven = -observer[:, :, m:], observer.copy()
    own[0], driven[0, :, m:] = np.eye(p), -np.eye(p)
    driven[1:, :, m:] = 0 if residual_weights is None else -residual_weights
    left, right = (np.fft.rfft(each * powers, period, axis=0) for each in (own, driven))
    return np.asarray(np.fft.irfft(np.linalg.solve(left, right), period, axis=0))


def _period(observer: Floats, n_lags: int) -> int:
    """Return samples of the transforms: a power of two, of which lags fill at most a half."""
    room = int(LARGEST_TRANSFORM // observer[0].size).bit_length() - 1
    needed = (2 * max(n_lags, len(observer)) - 1).bit_length()
    return 1 << max(needed, min(room, LONGEST_PERIOD.bit_length() - 1))
