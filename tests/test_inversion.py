"""Impulse responses from frequency responses: exact for sampled systems, honest about the rest."""

from __future__ import annotations

import numpy as np
import pytest

from vibrid.errors import DataError, OptionError
from vibrid.record import Channel, FrequencyResponses
from vibrid.spectra import impulse_responses, invert, undo_wrap
from vibrid.statespace import StateSpace
from vibrid.structures import chain

DT = 0.02
FORCES = ["f1", "f3"]


def model_of(sensors: str = "acceleration") -> StateSpace:
    """Return a sampled chain with three modes below 7 Hz, two forces and three sensors."""
    frame = chain([1.0, 1.2, 1.1], [400.0, 500.0, 450.0], rayleigh=(0.3, 1e-4))
    return frame.state_space(sensors, FORCES).to_discrete(DT)


def measured(model: StateSpace, n_samples: int, first: int = 0) -> FrequencyResponses:
    """Return the exact responses at the lines of a discrete Fourier transform."""
    lines = np.arange(first, n_samples // 2 + 1) / (n_samples * DT)
    return FrequencyResponses(model.frequency_response(lines), lines)


def wrapped_sum(model: StateSpace, n_samples: int) -> np.ndarray:
    """Return D + Σ_j h(j N) and C A^(k−1) (I − A^N)⁻¹ B."""
    A = model.A
    start = np.linalg.solve(np.eye(len(A)) - np.linalg.matrix_power(A, n_samples), model.B)
    closed = StateSpace(A, start, model.C, np.zeros_like(model.D), DT)
    values = closed.markov_parameters(n_samples + 1)
    values[0] = model.D + values[n_samples]
    return np.asarray(values[:n_samples])


@pytest.mark.parametrize("n_samples", [64, 65, 1024])
def test_is_the_wrapped_sum_of_markov_parameters(n_samples: int) -> None:
    """Even and odd lengths, several inputs and outputs, to rounding."""
    model = model_of()
    found = impulse_responses(measured(model, n_samples))
    assert found.values.shape == (n_samples, 3, 2)
    assert found.dt == pytest.approx(DT, rel=1e-12)
    expected = wrapped_sum(model, n_samples)
    np.testing.assert_allclose(found.values, expected, atol=1e-12 * np.abs(expected).max())


def test_a_long_period_gives_the_markov_parameters_themselves() -> None:
    """When the response has died within the period there is nothing to report."""
    model = model_of()
    found = invert(measured(model, 8192))
    expected = model.markov_parameters(8192)
    np.testing.assert_allclose(found.responses.values, expected, atol=1e-9)
    assert found.findings == ()
    assert found.figures["late_ratio"] < 1e-8


def test_wrap_is_reported_and_undone() -> None:
    """A short period scales B and D only; the period gives the true ones back."""
    model = model_of()
    n_samples = 100
    found = invert(measured(model, n_samples))
    assert [remark.code for remark in found.findings] == ["circular wrap"]
    A_N = np.linalg.matrix_power(model.A, n_samples)
    B = np.linalg.solve(np.eye(len(A_N)) - A_N, model.B)
    D = found.responses.values[0]
    restored = undo_wrap(StateSpace(model.A, B, model.C, D, DT), n_samples)
    np.testing.assert_allclose(restored.B, model.B, atol=1e-13)
    np.testing.assert_allclose(restored.D, model.D, atol=1e-12)


@pytest.mark.parametrize("sensors", ["displacement", "velocity", "acceleration"])
def test_a_missing_zero_line_is_interpolated(sensors: str) -> None:
    """Receptance is not zero at 0 Hz: interpolating is a thousand times nearer than a zero."""
    model = model_of(sensors)
    whole = impulse_responses(measured(model, 1024)).values
    scale = np.abs(whole).max()
    for first, tolerance in ((1, 1e-6), (2, 1e-5)):
        found = invert(measured(model, 1024, first))
        np.testing.assert_allclose(found.responses.values, whole, atol=tolerance * scale)
        assert found.findings[0].code == "low lines"
        assert found.findings[0].severity == "note"
    if sensors == "displacement":
        zeros = invert(measured(model, 1024, 1), low_lines="zero").responses.values
        assert np.abs(zeros - whole).max() > 1e-3 * scale


def test_the_interpolation_knows_even_from_odd() -> None:
    """Exact for an even quartic real part and an odd quintic imaginary part."""
    k = np.arange(33.0)
    truth = 3 - 0.5 * k**2 + 0.01 * k**4 + 1j * (2 * k - 0.1 * k**3 + 1e-3 * k**5)
    found = impulse_responses(FrequencyResponses(truth[2:, None, None], k[2:]))
    np.testing.assert_allclose(np.fft.rfft(found.values[:, 0, 0])[:3], truth[:3], atol=1e-9)


def test_a_band_keeps_its_modes_and_says_what_is_missing() -> None:
    """Many missing lines are zeros, as of a band-pass, and a doubt."""
    found = invert(measured(model_of(), 1024, 20))
    assert found.findings[0].severity == "doubt"
    assert found.figures["low_lines_missing"] == 20
    spectrum = np.fft.rfft(found.responses.values, axis=0)
    assert np.abs(spectrum[:20]).max() < 1e-12
    np.testing.assert_allclose(spectrum[20:], measured(model_of(), 1024, 20).values, atol=1e-12)


def test_an_analysers_band_keeps_its_last_line() -> None:
    """400 of 512 lines: an odd number of samples, and every line as measured."""

    model = chain([1.0, 1.2], [4e4, 5e4], rayleigh=(2.0, 1e-5)).state_space("acceleration", ["f1"])

    lines = np.arange(401) * 0.25
    values = model.frequency_response(lines)
    values[0] = values[0].real
    found = invert(FrequencyResponses(values, lines))
    assert len(found.responses.values) == 801
    assert found.responses.dt == pytest.approx(1 / (801 * 0.25))
    np.testing.assert_allclose(
        np.fft.rfft(found.responses.values, axis=0), values, atol=1e-10 * np.abs(values).max()
    )


def test_a_cut_resonance_and_a_lead_are_reported() -> None:
    """Ending the lines on a resonance rings; outputs that lead fill negative times."""
    model = model_of()
    peak = model.frequencies_hz[-1]
    lines = np.arange(2049) * peak / 2048
    cut = invert(FrequencyResponses(model.frequency_response(lines), lines))
    assert "cut band" in [remark.code for remark in cut.findings]
    whole = measured(model, 4096)
    lead = np.exp(2j * np.pi * whole.frequencies_hz * 20 * DT)[:, None, None]
    moved = invert(FrequencyResponses(whole.values * lead, whole.frequencies_hz))
    assert [remark.code for remark in moved.findings] == ["not causal"]


def test_channels_are_kept() -> None:
    """Labels go from the frequency to the impulse responses."""
    whole = measured(model_of(), 64)
    outputs = [Channel(f"a{k}", "acceleration", "m/s2", dof=str(k)) for k in range(3)]
    responses = FrequencyResponses(
        whole.values, whole.frequencies_hz, output_channels=outputs, input_channels=["f", "g"]
    )
    found = impulse_responses(responses)
    assert found.output_channels == tuple(outputs)
    assert found.input_channels == responses.input_channels


def test_lines_off_the_grid_are_refused() -> None:
    """Unequal spacing, half-line offsets, too few lines; single precision passes."""
    values = np.ones((50, 1, 1))
    lines = np.arange(50.0) + 3
    moved = lines.copy()
    moved[17] += 0.25
    with pytest.raises(DataError, match=r"line at 20\.25 Hz is 0\.25 Hz off"):
        invert(FrequencyResponses(values, moved))
    with pytest.raises(DataError, match=r"first, 3\.5 Hz, is 0\.5 Hz off"):
        invert(FrequencyResponses(values, lines + 0.5))
    with pytest.raises(DataError, match="at least 4"):
        invert(FrequencyResponses(values[:3], lines[:3]))
    with pytest.raises(OptionError, match="low_lines"):
        invert(FrequencyResponses(values, lines), low_lines="none")  # type: ignore[arg-type]
    single = (np.arange(50) * np.float32(0.1953125e1 / 3)).astype(np.float32)
    assert invert(FrequencyResponses(values, single)).responses.values.shape == (98, 1, 1)
