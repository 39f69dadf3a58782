"""Record: labels, parts, filters and delays against known signals; refusals by message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
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


class Counted:
    """An array on disk, as a record sees it: counts the rows that are read."""

    def __init__(self, values: Floats) -> None:
        self.values, self.rows_read = values, 0

    @property
    def shape(self) -> tuple[int, ...]:
        return self.values.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        return self.values.dtype

    def __getitem__(self, key: Any) -> Floats:
        rows = self.values[key]
        self.rows_read += len(rows)
        return rows


def three_by_two(rng: np.random.Generator, n: int = 100) -> Record:
    """Return a record of outputs a, b, c and inputs p, q."""
    return Record(
        rng.standard_normal((n, 3)),
        rng.standard_normal((n, 2)),
        dt=DT,
        output_channels=["a", Channel("b", "velocity", sign=-1), "c"],
        input_channels=["p", "q"],
        name="run",
    )


def sine(hertz: float, n: int = 4000, dt: float = DT) -> Floats:
    """Return a sine of amplitude 1."""
    return np.asarray(np.sin(2 * np.pi * hertz * dt * np.arange(n) + 0.3))


# -- what it holds


def test_defaults_and_labels() -> None:
    """No inputs are zero inputs; channels are y1, y2, … of quantity "other"."""
    record = Record(np.ones((5, 2)), dt=0.5)
    assert (record.n_samples, record.n_outputs, record.n_inputs) == (5, 2, 0)
    assert record.duration == 2.5
    assert record.output_names == ("y1", "y2")
    assert {channel.quantity for channel in record.output_channels} == {"other"}


@pytest.mark.parametrize("kind", [np.float32, np.int16, np.uint8, np.float64])
def test_number_kinds_become_double(kind: type) -> None:
    """Single precision and integers are kept exactly, as float64; one axis is one channel."""
    record = Record(np.array([1, 2, 3], dtype=kind), [4, 5, 6], dt=1)
    assert record.outputs.dtype == record.inputs.dtype == np.float64
    assert record.outputs.tolist() == [[1.0], [2.0], [3.0]]
    assert record.read(1, 3).tolist() == [[5.0, 2.0], [6.0, 3.0]]


@pytest.mark.parametrize(
    ("outputs", "message"),
    [
        (np.ones((4, 1), complex), "complex"),
        (np.array([["a"], ["b"]]), "text"),
        (np.array([[True], [False]]), "booleans"),
        ([[1.0, 2.0], [3.0]], "different length"),
        (np.ones((2, 3, 2)), r"2 axes .* \(2, 3, 2\)"),
        (np.ones((3, 50)), "3 samples of 50 channels.*too short, or .* transposed"),
        (np.ones((0, 2)), "empty"),
        (np.ones((5, 0)), "empty"),
        (np.ma.array([1.0, 2.0], mask=[0, 1]), "masked array.*NaN"),
    ],
)
def test_unusable_arrays_are_refused(outputs: Any, message: str) -> None:
    """Complex, text, boolean, ragged, transposed, empty and masked data are named."""
    with pytest.raises(DataError, match=message):
        Record(outputs, dt=DT)


@pytest.mark.parametrize("dt", [0.0, -0.1, np.nan, np.inf, "0.1", True])
def test_sampling_interval_must_be_positive(dt: Any) -> None:
    """A sampling interval that is no positive number is refused by its name."""
    with pytest.raises(OptionError, match="dt must be"):
        Record([1.0, 2.0], dt=dt)


def test_unequal_lengths_and_labels_are_refused() -> None:
    """The message gives both lengths, or the repeated name, or both counts."""
    with pytest.raises(DataError, match="8 samples and inputs 7"):
        Record(np.ones((8, 2)), np.ones(7), dt=1)
    with pytest.raises(DataError, match="Two channels are called 'x'"):
        Record(np.ones((8, 1)), np.ones(8), dt=1, output_channels="x", input_channels="x")
    with pytest.raises(OptionError, match="1 channel labels were given for 2 columns"):
        Record(np.ones((8, 2)), dt=1, output_channels=["x"])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"name": ""}, "needs a name"),
        ({"quantity": "accel"}, "Did you mean 'acceleration'"),
        ({"sign": 2}, "must be 1 or -1; got 2"),
        ({"delay": np.inf}, "delay .* must be finite"),
    ],
)
def test_impossible_channels_are_refused(wrong: dict[str, Any], message: str) -> None:
    """A channel says which of its fields cannot be."""
    with pytest.raises(OptionError, match=message):
        Channel(**{"name": "x", **wrong})


def test_gaps_divide_into_segments(rng: np.random.Generator) -> None:
    """A NaN in any channel is a gap, also where reading in chunks cuts a piece."""
    record = three_by_two(rng, 3000)
    record.outputs[0, 1] = record.inputs[10, 0] = record.outputs[2999, 2] = np.nan
    record.outputs[1500:1600] = np.nan
    assert record.segments() == ((1, 10), (11, 1500), (1600, 2999))


def test_segments_join_over_chunks(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A piece that crosses from one chunk into the next is one piece."""
    monkeypatch.setattr("vibrid.record.signals.CHUNK_BYTES", 1)
    record = Record(rng.standard_normal((5000, 2)), dt=DT)
    assert len(list(record.chunks())) == 5
    assert record.segments() == ((0, 5000),)


def test_infinite_values_are_refused(rng: np.random.Generator) -> None:
    """Infinity is no gap; the message names the sample and the record."""
    record = three_by_two(rng)
    record.outputs[42, 1] = -np.inf
    with pytest.raises(DataError, match="Sample 42 of run is infinite"):
        record.segments()


# -- parts


def test_slice_and_between(rng: np.random.Generator) -> None:
    """Samples [start, stop), times start ≤ t < stop, both sides alike."""
    record = three_by_two(rng)
    np.testing.assert_array_equal(record.slice(10, 20).read(0, 10), record.read(10, 20))
    np.testing.assert_array_equal(record.slice(-5).outputs, record.outputs[-5:])
    np.testing.assert_array_equal(record.between(0.3, 0.5).inputs, record.inputs[30:50])
    np.testing.assert_array_equal(record.between(0.295, 0.5).inputs, record.inputs[30:50])
    np.testing.assert_array_equal(record.between(0.9, np.inf).inputs, record.inputs[90:])
    assert record.between(-1, 0.07).n_samples == 7  # 0.07 / 0.01 is not 7 in binary


@pytest.mark.parametrize(("start", "stop"), [(1.0, 2.0), (0.5, 0.5), (0.5, 0.2), (np.nan, 1)])
def test_empty_stretches_are_refused(rng: np.random.Generator, start: float, stop: float) -> None:
    """A stretch without samples says how long the record is."""
    with pytest.raises(OptionError, match=r"0 to 1 s"):
        three_by_two(rng).between(start, stop)
    with pytest.raises(OptionError, match="has 100 samples"):
        three_by_two(rng).slice(100)


def test_select_by_name(rng: np.random.Generator) -> None:
    """Any channel may become input or output; the rest stays where it was."""
    record = three_by_two(rng)
    chosen = record.select(["c", "a"], ["b", "q"])
    assert (chosen.output_names, chosen.input_names) == (("c", "a"), ("b", "q"))
    np.testing.assert_array_equal(chosen.outputs, record.outputs[:, [2, 0]])
    np.testing.assert_array_equal(chosen.inputs[:, 0], record.outputs[:, 1])
    np.testing.assert_array_equal(chosen.inputs[:, 1], record.inputs[:, 1])
    assert chosen.input_channels[0].sign == -1
    rest = record.select(inputs="b")
    assert (rest.output_names, rest.input_names) == (("a", "c"), ("b",))
    assert record.select(inputs=[]).n_inputs == 0
    assert record.select("p").input_names == ("q",)


@pytest.mark.parametrize(
    ("outputs", "inputs", "message"),
    [
        (["d"], None, "No channel is called 'd'; there are p, q, a, b, c"),
        (["a"], ["a"], "'a' cannot be input and output at once"),
        (["a", "a"], None, "named twice"),
        ([], None, "No output is left"),
        (None, ["a", "b", "c"], "No output is left"),
    ],
)
def test_impossible_selections_are_refused(
    rng: np.random.Generator, outputs: Any, inputs: Any, message: str
) -> None:
    """Unknown, doubled and missing names are said."""
    with pytest.raises(OptionError, match=message):
        three_by_two(rng).select(outputs, inputs)


def test_relabel_keeps_the_data(rng: np.random.Generator) -> None:
    """New labels replace those of one side only, and must fit."""
    record = three_by_two(rng)
    named = record.relabel(output_channels=["x", "y", "z"])
    assert (named.output_names, named.input_names) == (("x", "y", "z"), ("p", "q"))
    assert (named.dt, named.name) == (DT, "run")
    np.testing.assert_array_equal(named.outputs, record.outputs)
    with pytest.raises(OptionError, match="2 channel labels were given for 3"):
        record.relabel(["x", "y"])


# -- on disk


def test_construction_reads_nothing(rng: np.random.Generator) -> None:
    """Making, slicing and selecting a record on disk read no row; reading reads only its own."""
    source = Counted(rng.standard_normal((1000, 4)))
    part = Record(source, dt=DT).slice(100, 900).select(["y3", "y1"]).between(1.0, 3.0)
    assert source.rows_read == 0
    assert not part.is_in_memory
    np.testing.assert_array_equal(part.read(5, 9), source.values[205:209, [2, 0]])
    assert source.rows_read == 4


def test_one_column_on_disk_is_not_read_either(rng: np.random.Generator) -> None:
    """A 1-D array on disk is one channel and stays there."""
    source = Counted(rng.standard_normal(1000))
    record = Record(source, source, dt=DT, input_channels="u").slice(10)
    assert source.rows_read == 0
    np.testing.assert_array_equal(record.read(0, 3), np.tile(source.values[10:13, None], 2))


@pytest.mark.parametrize("kind", ["memmap", "hdf5"])
def test_records_on_disk_equal_those_in_memory(
    rng: np.random.Generator, tmp_path: Path, kind: str
) -> None:
    """Memory-mapped and HDF5 arrays give the same segments and parts, and load when asked."""
    y = rng.standard_normal((2000, 3)).astype(np.float32)
    y[700] = np.nan
    if kind == "memmap":
        np.save(tmp_path / "y.npy", y)
        source: Any = np.load(tmp_path / "y.npy", mmap_mode="r")
    else:
        source = h5py.File(tmp_path / "y.h5", "w").create_dataset("y", data=y)
    record = Record(source, dt=DT)
    assert not record.is_in_memory
    assert record.segments() == ((0, 700), (701, 2000))
    loaded = record.select(["y2"]).slice(5, 50).in_memory()
    assert loaded.is_in_memory
    np.testing.assert_array_equal(loaded.outputs, y[5:50, [1]].astype(float))
    for verb in (record.detrend, lambda: record.decimate(2), record.correct_delays):
        with pytest.raises(OptionError, match=r"in memory; call in_memory\(\)"):
            verb()


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
