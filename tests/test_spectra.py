"""Spectra, frequency responses and correlations: exact where that can be, blind to gaps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import linalg, signal

from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.files import read_record
from vibrid.record import Channel, Record
from vibrid.spectra import (
    correlations,
    frequency_responses,
    invert,
    next_correlations,
    power_spectrum,
)
from vibrid.structures import Structure, chain

DT = 0.02


def structure() -> Structure:
    """Return a chain with three modes below 7 Hz that forgets its start in 20 s."""
    return chain([1.0, 1.2, 1.1], [400.0, 500.0, 450.0], rayleigh=(0.8, 1e-3))


def periodic(rng: np.random.Generator, period: int, n_inputs: int) -> np.ndarray:
    """Return a period with power at every line but 0 Hz, of random phases."""
    phases = np.exp(2j * np.pi * rng.random((period // 2 + 1, n_inputs)))
    phases[0], phases[-1] = 0, rng.normal(size=n_inputs)
    return np.fft.irfft(phases, period, axis=0) * period


def test_equals_scipy_however_it_is_read(rng: np.random.Generator) -> None:
    """Stretches of 32 windows give the same average as one call over all."""
    x = rng.normal(size=(20_000, 3))
    record = Record(x[:, 1:], x[:, 0], dt=0.01)
    frequencies_hz, psd = power_spectrum(record, segment_seconds=1.28)
    expected = signal.welch(x, 100.0, nperseg=128, axis=0)
    np.testing.assert_allclose(frequencies_hz, expected[0])
    np.testing.assert_allclose(psd, expected[1], rtol=1e-12)


def test_gaps_are_left_out(rng: np.random.Generator) -> None:
    """Two pieces average by their number of windows; NaN never spreads."""
    x = rng.normal(size=3000)
    x[1000:1010] = np.nan
    _, psd = power_spectrum(Record(x, dt=1.0), segment_seconds=100)
    parts = [signal.welch(part, 1.0, nperseg=100)[1] for part in (x[:1000], x[1010:])]
    counts = [19, 38]  # windows of 100, half overlapping
    expected = (counts[0] * parts[0] + counts[1] * parts[1]) / sum(counts)
    np.testing.assert_allclose(psd[:, 0], expected, rtol=1e-12)


def test_energy_is_the_variance(rng: np.random.Generator) -> None:
    """The integral over frequency is the mean square (Parseval), whatever the length chosen."""
    x = rng.normal(size=50_000) * 3
    frequencies_hz, psd = power_spectrum(Record(x, dt=0.02))
    energy = psd[:, 0].sum() * frequencies_hz[1]
    assert energy == pytest.approx(9.0, rel=0.03)  # about 4 standard errors at 50,000 samples


def test_bad_lengths_are_refused() -> None:
    """Windows longer than record or pieces, too short or negative."""
    x = np.arange(200.0)
    with pytest.raises(OptionError, match="at most the record's 200"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=300)
    with pytest.raises(OptionError, match="at least 16"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=4)
    with pytest.raises(OptionError, match="must be positive"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=-1)
    x[::20] = np.nan
    with pytest.raises(DataError, match="the longest stretch has 19"):
        power_spectrum(Record(x, dt=1.0), segment_seconds=32)


# -- frequency responses


@pytest.mark.parametrize("estimator", ["H1", "H2"])
def test_periodic_input_gives_exact_frequency_responses(
    rng: np.random.Generator, estimator: str
) -> None:
    """In the steady state every line is that of the structure, to rounding."""
    period = 256
    u = np.tile(periodic(rng, period, 1), (16, 1))
    record = structure().simulate(u, DT, forces=["f2"]).slice(10 * period)
    found = frequency_responses(
        record,
        segment_seconds=period * DT,
        window="boxcar",
        estimator=estimator,  # type: ignore[arg-type]
    )
    model = structure().state_space("acceleration", ["f2"]).to_discrete(DT)
    expected = model.frequency_response(found.frequencies_hz)
    np.testing.assert_allclose(found.values, expected, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(found.coherence, 1, atol=1e-9)
    assert found.output_channels == record.output_channels
    assert found.input_channels == record.input_channels


def test_several_inputs_are_told_apart_across_a_gap(rng: np.random.Generator) -> None:
    """Two periodic runs with other phases, a missing sample between them: exact again."""
    period, forces = 256, ["f1", "f3"]
    runs = [
        structure()
        .simulate(np.tile(periodic(rng, period, 2), (12, 1)), DT, forces=forces)
        .slice(10 * period)
        for _ in range(3)
    ]
    gap = np.full((1, 3), np.nan)
    y = np.vstack([runs[0].outputs, gap, runs[1].outputs, gap, runs[2].outputs])
    u = np.vstack([runs[0].inputs, gap[:, :2], runs[1].inputs, gap[:, :2], runs[2].inputs])
    found = frequency_responses(Record(y, u, dt=DT), segment_seconds=5.12, window="boxcar")
    model = structure().state_space("acceleration", forces).to_discrete(DT)
    expected = model.frequency_response(found.frequencies_hz)
    np.testing.assert_allclose(found.values, expected, atol=1e-9 * np.abs(expected).max())
    assert found.coherence is not None and found.coherence.shape == found.values.shape
    with pytest.raises(DataError, match="move together"):
        frequency_responses(runs[0], segment_seconds=5.12, window="boxcar")


def test_noise_lowers_coherence_as_it_should(rng: np.random.Generator) -> None:
    """A tenth of the power is noise: coherence 0.9; H1 does not see noise on the output."""
    u = rng.normal(size=100_000)
    y = np.stack([2 * u, 2 * u]) + np.sqrt(4 / 9) * rng.normal(size=(2, len(u)))
    found = frequency_responses(Record(y.T, u, dt=DT), segment_seconds=128 * DT)
    assert found.coherence is not None
    assert found.coherence.mean() == pytest.approx(0.9, abs=4e-3)
    assert np.abs(found.values - 2).max() < 0.2
    noisy_input = Record(u, y[0], dt=DT)
    second = frequency_responses(noisy_input, segment_seconds=128 * DT, estimator="H2")
    first = frequency_responses(noisy_input, segment_seconds=128 * DT)
    assert second.values.mean().real == pytest.approx(0.5, abs=4e-3)
    assert first.values.mean().real == pytest.approx(0.45, abs=4e-3)


def test_frequency_responses_equal_scipys(rng: np.random.Generator) -> None:
    """Stretches of 32 windows give the same average as SciPy's spectra of the whole."""
    u = rng.normal(size=10_000)
    y = signal.lfilter([1.0, 0.5], [1.0, -0.8], u) + rng.normal(size=len(u))
    found = frequency_responses(Record(y, u, dt=0.01), segment_seconds=1.28)
    cross = signal.csd(u, y, 100.0, nperseg=128)[1]
    expected = (cross / signal.welch(u, 100.0, nperseg=128)[1])[1:]
    np.testing.assert_allclose(found.values[:, 0, 0], expected, rtol=1e-10)
    coherence = signal.coherence(u, y, 100.0, nperseg=128)[1][1:]
    assert found.coherence is not None
    np.testing.assert_allclose(found.coherence[:, 0, 0], coherence, rtol=1e-10)


def test_unusable_inputs_are_refused(rng: np.random.Generator) -> None:
    """No input, a dead one, two that are one, too few windows, H2 with two."""
    x = rng.normal(size=(600, 3))
    with pytest.raises(OptionError, match="need measured inputs"):
        frequency_responses(Record(x, dt=DT))
    with pytest.raises(DataError, match="has no power at"):
        frequency_responses(Record(x, np.ones(600), dt=DT))
    with pytest.raises(DataError, match="more than 2 windows; the record has 1"):
        frequency_responses(Record(x[:, 0], x[:, 1:], dt=DT), segment_seconds=600 * DT)
    with pytest.raises(OptionError, match="H2 is defined here for one"):
        frequency_responses(Record(x[:, 0], x[:, 1:], dt=DT), estimator="H2")


def test_a_real_shaker_test_is_inverted(shared_data: Path) -> None:
    """Steel subframe, two shakers: pulse responses hold every line again, and are causal."""
    record = read_record(shared_data / "flexible_subframe.mat", dt=1 / 1024)
    assert isinstance(record, Record)
    record = record.select(record.output_names[2:6], inputs=record.output_names[:2])
    found = frequency_responses(record, segment_seconds=1.0)
    inverted = invert(found)
    spectrum = np.fft.rfft(inverted.responses.values, axis=0)[1:]
    np.testing.assert_allclose(spectrum, found.values, atol=1e-10 * np.abs(spectrum).max())
    assert inverted.figures["low_lines_missing"] == 1
    assert inverted.responses.dt == pytest.approx(1 / 1024)
    assert inverted.figures["noncausal_share"] < 0.01


# -- correlations


def naive(y: np.ndarray, reference: int, n_lags: int) -> np.ndarray:
    """Return Σ y(t + l) y_ref(t) / count by loops, pairs with a NaN left out."""
    z = y - np.nanmean(y[~np.isnan(y).any(axis=1)], axis=0)
    good = ~np.isnan(y).any(axis=1)
    rows = []
    for lag in range(1, n_lags + 1):
        pairs = [t for t in range(len(y) - lag) if good[t : t + lag + 1].all()]
        rows.append((z[np.add(pairs, lag)] * z[pairs, reference][:, None]).mean(axis=0))
    return np.array(rows)


def test_correlations_equal_the_plain_loop(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Several blocks, gaps, an offset, two of three references."""
    y = np.cumsum(rng.normal(size=(1500, 3)), axis=0) * 0.01 + rng.normal(size=(1500, 3)) + 5
    y[1300] = np.nan
    y[1340, 1] = np.nan
    labels = [Channel(f"a{k}", "acceleration", "m/s2", dof=str(k), sign=-1) for k in range(3)]
    record = Record(y, dt=DT, output_channels=labels, name="bridge")
    found = next_correlations(record, ["a2", "a0"], n_lags=50)
    assert [decay.name for decay in found] == [
        "bridge: correlations with a2",
        "bridge: correlations with a0",
    ]
    monkeypatch.setattr(correlations, "SPECTRA_BYTES", 1)  # a pass over the data for each
    for one, other in zip(next_correlations(record, ["a2", "a0"], n_lags=50), found, strict=True):
        np.testing.assert_allclose(one.outputs, other.outputs, atol=1e-13)
    for decay, reference in zip(found, (2, 0), strict=True):
        np.testing.assert_allclose(decay.outputs, naive(y, reference, 50), atol=1e-12)
        assert decay.output_channels == tuple(labels)
        assert (decay.n_inputs, decay.dt) == (0, DT)


def test_correlations_are_the_decays_of_the_structure(rng: np.random.Generator) -> None:
    """Within sampling error C A^l P Cᵀ, measurement noise notwithstanding, as far as chosen."""
    frame = structure()
    model = frame.state_space("acceleration", frame.dofs).to_discrete(DT)
    u = white_noise(400_000, 3, rng=rng)
    y = frame.simulate(u, DT, forces=frame.dofs).outputs
    y = y + y.std(axis=0) * rng.normal(size=y.shape)
    found = next_correlations(Record(y, dt=DT), "y2")[0].outputs
    P = linalg.solve_discrete_lyapunov(model.A, model.B @ model.B.T)
    start = (model.A @ P @ model.C.T + model.B @ model.D.T)[:, 1]
    expected = model.simulate(np.zeros((len(found), 3)), start)
    assert 64 <= len(found) <= 500  # they die in 20 s = 1000 samples and drown before
    largest = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=0.05 * largest)  # about 5 standard errors


def test_correlations_refuse_what_cannot_be() -> None:
    """Unknown or repeated references, more lags than samples, fewer than outputs."""
    record = Record(np.random.default_rng(0).normal(size=(50, 3)), dt=DT)
    with pytest.raises(OptionError, match="No output is called 'y9'"):
        next_correlations(record, "y9")
    with pytest.raises(OptionError, match="each reference once"):
        next_correlations(record, ["y1", "y1"])
    with pytest.raises(DataError, match="60 lags need more than 60"):
        next_correlations(record, n_lags=60)
    with pytest.raises(OptionError, match="at least 3"):
        next_correlations(record, n_lags=2)
