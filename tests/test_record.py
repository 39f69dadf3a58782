"""Record: labels, gaps, parts and data on disk; refusals by message."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from vibrid.errors import DataError, OptionError
from vibrid.record import Channel, Floats, Record

DT = 0.01


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
