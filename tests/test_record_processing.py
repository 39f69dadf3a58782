"""Records without trends, in a band or at a lower rate, without delays: known signals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from vibrid.errors import DataError, OptionError
from vibrid.excitation import multisine
from vibrid.record import Channel, Floats, Record
from vibrid.record.processing import SHIFT_HALF_WIDTH
from vibrid.structures import chain

DT = 0.01
EDGE = 200  # samples at each end that a filter's start may disturb


def sine(hertz: float, n: int = 4000, dt: float = DT) -> Floats:
    """Return a sine of amplitude 1."""
    return np.asarray(np.sin(2 * np.pi * hertz * dt * np.arange(n) + 0.3))


# -- trends and filters


def test_detrend_is_exact_on_a_line(rng: np.random.Generator) -> None:
    """A line vanishes to rounding beside a gap; "constant" leaves the slope and no mean."""
    t = np.arange(1000) * DT
    y = np.column_stack([3 + 2 * t, -1e3 + 0 * t])
    y[400:420] = np.nan
    record = Record(y, dt=DT)
    flat = record.detrend().outputs
    assert np.isnan(flat[400:420]).all()
    assert np.nanmax(np.abs(flat)) < 1e-9
    level = record.detrend("constant").outputs
    np.testing.assert_allclose(np.nanmean(level, axis=0), 0, atol=1e-10)
    np.testing.assert_allclose(np.diff(level[:400, 0]), 2 * DT, rtol=1e-9)
    with pytest.raises(OptionError, match="kind must be one of constant, linear"):
        record.detrend("quadratic")


@pytest.mark.parametrize("factor", [2, 5, 13, 24])
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.8])
def test_decimation_keeps_the_band(factor: int, share: float) -> None:
    """A sine up to 80 % of the new Nyquist frequency keeps amplitude and phase to 1e-3."""
    hertz = share * 0.5 / (factor * DT)
    x = sine(hertz, 1000 * factor)
    record = Record(np.column_stack([x, 1e3 * x]), x, dt=DT).decimate(factor)
    assert record.dt == pytest.approx(factor * DT)
    assert record.n_samples == 1000
    kept = slice(EDGE, -EDGE)
    np.testing.assert_allclose(record.outputs[kept, 1], 1e3 * x[::factor][kept], atol=1.0)
    np.testing.assert_allclose(record.inputs, record.outputs[:, :1], atol=1e-15)


@pytest.mark.parametrize("factor", [2, 5, 13, 24])
def test_decimation_suppresses_what_would_fold_into_the_band(factor: int) -> None:
    """Frequencies that alias below 80 % of the new Nyquist come out 60 dB down."""
    new_nyquist = 0.5 / (factor * DT)
    for share in np.linspace(1.2, factor, 7):
        x = sine(share * new_nyquist, 1000 * factor)
        folded = Record(x, dt=DT).decimate(factor).outputs[EDGE:-EDGE]
        assert np.abs(folded).max() < 1e-3


def test_decimation_keeps_the_relation_of_input_and_output() -> None:
    """Output over input of a decimated test is the structure's response at every line."""
    structure = chain([1.0, 1.0], [900.0, 900.0], damping_ratio=0.02)
    n, factor = 6000, 4
    u = multisine(n, DT, band_hz=(0.5, 9.0))
    record = structure.simulate(np.tile(u, (3, 1)), DT, forces=["f1"], hold="band_limited")
    coarse = record.decimate(factor).slice(n // factor, 2 * n // factor)  # the middle period
    U = np.fft.rfft(coarse.inputs[:, 0])
    lines = np.flatnonzero(np.abs(U) > 1e-3 * np.abs(U).max())
    hertz = lines / (n * DT)
    assert len(lines) > 400
    ratio = np.fft.rfft(coarse.outputs, axis=0)[lines] / U[lines, None]
    exact = structure.state_space(forces=["f1"]).frequency_response(hertz)[:, :, 0]
    np.testing.assert_allclose(ratio, exact, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("verb", ["decimate", "bandpass"])
def test_short_pieces_are_refused_by_length(rng: np.random.Generator, verb: str) -> None:
    """The shortest piece that a filter takes is the one its message names."""
    run = {"decimate": lambda r: r.decimate(2), "bandpass": lambda r: r.bandpass(1, 10)}[verb]
    record = Record(rng.standard_normal((200, 1)), dt=DT)
    with pytest.raises(DataError, match=r"more than \d+ are needed") as error:
        run(record.slice(0, 20))
    limit = int(str(error.value).split("more than ")[1].split()[0])
    run(record.slice(0, limit + 1))
    with pytest.raises(DataError, match=f"A piece of {limit} samples"):
        run(record.slice(0, limit))


def test_bandpass_is_zero_phase() -> None:
    """A sine in the band passes without delay, those outside are gone, and so is the mean."""
    record = Record(np.column_stack([sine(5), sine(0.2), sine(30), 2 + 0 * sine(1)]), dt=DT)
    middle = slice(1500, 2500)
    kept = record.bandpass(2, 12).outputs[middle]
    np.testing.assert_allclose(kept[:, 0], sine(5)[middle], atol=2e-3)
    assert np.abs(kept[:, 1:]).max() < 2e-3
    low = record.bandpass(0, 12).outputs[middle]
    np.testing.assert_allclose(low[:, 3], 2, atol=1e-9)
    high = record.bandpass(12, np.inf).outputs[middle]
    np.testing.assert_allclose(high[:, 2], sine(30)[middle], atol=2e-3)


@pytest.mark.parametrize(
    ("low", "high", "order", "message"),
    [
        (5, 2, 4, "0 ≤ low < high; got 5 to 2 Hz"),
        (-1, 2, 4, "0 ≤ low < high"),
        (60, 70, 4, "at or above the Nyquist frequency 50 Hz"),
        (0, 50, 4, "whole band"),
        (np.nan, 5, 4, "0 ≤ low < high"),
        (1, 5, 0, "filter_order must be from 1 to 12; got 0"),
    ],
)
def test_impossible_bands_are_refused(low: float, high: float, order: int, message: str) -> None:
    """A band must lie between 0 and Nyquist."""
    with pytest.raises(OptionError, match=message):
        Record(sine(1), dt=DT).bandpass(low, high, filter_order=order)


def test_pieces_between_gaps_are_filtered_apart(rng: np.random.Generator) -> None:
    """Each piece comes out as if it were a record of its own; gaps stay."""
    y = rng.standard_normal((600, 2))
    y[250:260, 1] = np.nan
    record = Record(y, y[:, :1], dt=DT)
    moved = record.relabel([Channel("y1", delay=0.003), Channel("y2", delay=-0.02)])
    for run, whole in (
        (lambda r: r.bandpass(2, 12), record),
        (lambda r: r.correct_delays(), moved),
    ):
        outputs = run(whole).outputs
        assert np.isnan(outputs[250:260]).all()
        np.testing.assert_array_equal(outputs[:250], run(whole.slice(0, 250)).outputs)
        np.testing.assert_array_equal(outputs[260:], run(whole.slice(260)).outputs)


def test_to_band_filters_and_decimates(rng: np.random.Generator) -> None:
    """The band fills at most 80 % of the new Nyquist, keeps its sine, and loses the others."""
    record = Record(np.column_stack([sine(3, 8000), sine(0.3, 8000), sine(20, 8000)]), dt=DT)
    band = record.to_band(1, 6)
    assert band.dt == pytest.approx(6 * DT)
    middle = slice(400, -400)
    np.testing.assert_allclose(band.outputs[middle, 0], sine(3, 8000)[::6][middle], atol=2e-3)
    assert np.abs(band.outputs[middle, 1:]).max() < 5e-3
    assert record.to_band(0, 100) is record
    assert record.to_band(0, 6).outputs[middle, 1] == pytest.approx(
        sine(0.3, 8000)[::6][middle], abs=1e-3
    )


# -- delays


@pytest.mark.parametrize("samples", [3.0, -7.0, 0.37, -12.6])
def test_delays_are_removed(samples: float) -> None:
    """A signal that lags comes back in time: exact for whole samples, 1e-3 for fractions."""
    t = np.arange(1500) * DT
    taper = signal.windows.tukey(1500, 0.4)

    def truth(when: Floats) -> Floats:
        return np.asarray(np.sin(2 * np.pi * 7 * when) + np.cos(2 * np.pi * 31 * when + 1))

    delay = samples * DT
    late = truth(t - delay)
    record = Record(
        np.column_stack([late, truth(t)]),
        taper,
        dt=DT,
        output_channels=[Channel("late", delay=delay), Channel("right")],
    )
    moved = record.correct_delays()
    inner = slice(SHIFT_HALF_WIDTH + 13, -SHIFT_HALF_WIDTH - 13)
    tolerance = 1e-12 if samples == int(samples) else 1e-3
    np.testing.assert_allclose(moved.outputs[inner, 0], truth(t)[inner], atol=tolerance)
    np.testing.assert_array_equal(moved.outputs[:, 1], record.outputs[:, 1])
    np.testing.assert_array_equal(moved.inputs, record.inputs)
    assert [channel.delay for channel in moved.output_channels] == [0, 0]
    assert moved.correct_delays().outputs == pytest.approx(moved.outputs)


def test_too_long_a_delay_is_refused() -> None:
    """A delay that a piece cannot hold is named in samples."""
    record = Record(sine(1, 60), dt=DT, output_channels=[Channel("y", delay=0.5)])
    with pytest.raises(DataError, match=r"delay of 50.0 samples needs pieces of more than 82"):
        record.correct_delays()
