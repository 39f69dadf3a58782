"""ImpulseResponses and FrequencyResponses: what they hold, and what they refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vibrid.errors import DataError, OptionError
from vibrid.record import Channel, FrequencyResponses, ImpulseResponses


def test_impulse_responses_hold_markov_parameters() -> None:
    """Values are kept as given, as float64, with labels for both sides."""
    values = np.arange(12, dtype=np.float32).reshape(3, 2, 2)
    responses = ImpulseResponses(values, dt=0.1, input_channels=["f", Channel("g", "force")])
    np.testing.assert_array_equal(responses.values, values)
    assert responses.values.dtype == np.float64
    assert [c.name for c in responses.output_channels] == ["y1", "y2"]
    assert responses.input_channels[1].quantity == "force"


def test_frequency_responses_hold_lines_and_coherence() -> None:
    """Real values become complex; the coherence keeps its shape."""
    responses = FrequencyResponses(np.ones((2, 1, 1)), [0, 1], coherence=np.full((2, 1, 1), 0.5))
    assert responses.values.dtype == np.complex128
    assert responses.frequencies_hz.tolist() == [0.0, 1.0]
    assert responses.coherence is not None
    assert responses.coherence.max() == 0.5
    assert FrequencyResponses(np.ones((2, 1, 1)), [0, 1]).coherence is None


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.ones((4, 2)), r"3 axes \(n_lags, n_outputs, n_inputs\); got shape \(4, 2\)"),
        (np.ones((4, 0, 1)), "3 axes"),
        (np.full((4, 1, 1), np.nan), "NaN or infinite"),
        (np.ones((4, 1, 1), complex), "must be real"),
        (np.full((4, 1, 1), "a"), "must be numbers; got dtype <U1"),
        ([[1.0], [1.0, 2.0]], "different length"),
    ],
)
def test_impossible_impulse_responses_are_refused(values: Any, message: str) -> None:
    """Wrong axes, missing numbers, complex, text and ragged values are named."""
    with pytest.raises(DataError, match=message):
        ImpulseResponses(values, dt=0.1)


@pytest.mark.parametrize(
    "lines", [[1, 0], [0, 0], [0], [0, 1, 2], [[0, 1]], [np.nan, 1], [0, np.inf]]
)
def test_lines_must_ascend(lines: Any) -> None:
    """Frequencies are finite, ascending and one a line."""
    with pytest.raises(DataError, match="must be 2 ascending numbers, one a line"):
        FrequencyResponses(np.ones((2, 1, 1)), lines)


def test_other_refusals() -> None:
    """Coherence of another shape, text, dt and names."""
    values = np.ones((2, 1, 1))
    with pytest.raises(DataError, match=r"coherence must have the shape \(2, 1, 1\)"):
        FrequencyResponses(values, [0, 1], coherence=np.ones(2))
    with pytest.raises(DataError, match="frequencies_hz must be real numbers"):
        FrequencyResponses(values, ["a", "b"])
    with pytest.raises(OptionError, match="dt must be positive; got 0 s"):
        ImpulseResponses(values, dt=0)
    with pytest.raises(DataError, match="Two channels are called 'x'"):
        ImpulseResponses(values, dt=1, output_channels="x", input_channels="x")
    with pytest.raises(OptionError, match="2 channel labels were given for 1 columns"):
        ImpulseResponses(values, dt=1, output_channels=["a", "b"])
