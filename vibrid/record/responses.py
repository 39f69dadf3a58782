"""Impulse and frequency responses, labelled like records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, check_positive
from .channels import Channel, Labels, check_unique, make_channels
from .signals import Floats, array_of


@dataclass(frozen=True, eq=False, init=False)
class ImpulseResponses:
    """Hold discrete pulse responses: `values[0]` is D, `values[k]` is C A^(k−1) B.

    Parameters
    ----------
    values : array (n_lags, n_outputs, n_inputs)
        Response to a unit sample, never scaled by dt; a response per N s is multiplied by dt.
    dt : float
        Sampling interval [s].
    output_channels, input_channels : sequence of Channel or str, optional
        Labels; by default y1, … and u1, ….
    """

    values: Floats
    dt: float
    output_channels: tuple[Channel, ...]
    input_channels: tuple[Channel, ...]

    def __init__(
        self,
        values: Any,
        *,
        dt: float,
        output_channels: Labels = None,
        input_channels: Labels = None,
    ) -> None:
        check_positive("dt", dt, "s")
        array = array_of(values, "Responses")
        _check_responses(array, "n_lags")
        if array.dtype.kind == "c":
            raise DataError("Impulse responses must be real; got complex numbers.")
        _label(self, array.astype(np.float64), output_channels, input_channels)
        object.__setattr__(self, "dt", float(dt))


@dataclass(frozen=True, eq=False, init=False)
class FrequencyResponses:
    """Hold measured frequency responses, outputs over inputs.

    Parameters
    ----------
    values : complex array (n_lines, n_outputs, n_inputs)
        Output per input unit at each line.
    frequencies_hz : array (n_lines,)
        Ascending [Hz].
    output_channels, input_channels : sequence of Channel or str, optional
        Labels; by default y1, … and u1, ….
    coherence : array (n_lines, n_outputs, n_inputs), optional
        Between 0 and 1, when known.
    """

    values: NDArray[np.complex128]
    frequencies_hz: Floats
    output_channels: tuple[Channel, ...]
    input_channels: tuple[Channel, ...]
    coherence: Floats | None

    def __init__(
        self,
        values: Any,
        frequencies_hz: Any,
        *,
        output_channels: Labels = None,
        input_channels: Labels = None,
        coherence: Any = None,
    ) -> None:
        array = array_of(values, "Responses")
        _check_responses(array, "n_lines")
        lines = _numbers(frequencies_hz, "frequencies_hz")
        ascending = bool((np.diff(lines) > 0).all()) and bool(np.isfinite(lines).all())
        if lines.shape != array.shape[:1] or not ascending:
            raise DataError(
                f"frequencies_hz must be {array.shape[0]} ascending numbers, one a line; got "
                f"shape {lines.shape}."
            )
        if coherence is not None and np.shape(coherence) != array.shape:
            raise DataError(
                f"coherence must have the shape {array.shape} of values; got {np.shape(coherence)}."
            )
        _label(self, array.astype(np.complex128), output_channels, input_channels)
        object.__setattr__(self, "frequencies_hz", lines)
        object.__setattr__(
            self, "coherence", None if coherence is None else _numbers(coherence, "coherence")
        )


def _numbers(values: Any, what: str) -> Floats:
    array = array_of(values, what)
    if array.dtype.kind not in "iuf":
        raise DataError(f"{what} must be real numbers; got dtype {array.dtype}.")
    return array.astype(np.float64)


def _check_responses(array: NDArray[Any], first_axis: str) -> None:
    if array.dtype.kind not in "iufc":
        raise DataError(f"Responses must be numbers; got dtype {array.dtype}.")
    if array.ndim != 3 or 0 in array.shape:
        raise DataError(
            f"Responses must have 3 axes ({first_axis}, n_outputs, n_inputs); got shape "
            f"{array.shape}."
        )
    if not np.isfinite(array).all():
        raise DataError("Responses must be finite; NaN or infinite values found.")


def _label(target: Any, array: NDArray[Any], outputs: Labels, inputs: Labels) -> None:
    output_labels = make_channels(outputs, array.shape[1], "y")
    input_labels = make_channels(inputs, array.shape[2], "u")
    check_unique(input_labels + output_labels)
    object.__setattr__(target, "values", array)
    object.__setattr__(target, "output_channels", output_labels)
    object.__setattr__(target, "input_channels", input_labels)
