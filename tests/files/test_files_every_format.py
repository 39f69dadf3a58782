"""Every format: the same numbers come back, and no damage gets past as a record."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from vibrid.errors import FileError, VibridError
from vibrid.files import read_record
from vibrid.record import Record

DT = 1 / 64
NO_INTERVAL = ("a.dat", "a.npy")  # these cannot say how far samples are apart
# text may be cut in the last line's last number; rows of text and numbers stay readable
CUT_MAY_PASS = ("a.dat", "a.csv")


def read(path: Path, **options: object) -> Record:
    dt = DT if path.name in NO_INTERVAL else None
    record = read_record(path, dt=dt, **options)  # type: ignore[arg-type]
    assert isinstance(record, Record)
    return record


def test_the_same_numbers_come_back(sample: Path, signals: NDArray[np.float64]) -> None:
    """Outputs, inputs and sampling interval are those that were written."""
    record = read(sample)
    together = np.hstack([record.outputs, record.inputs])
    np.testing.assert_array_equal(together, signals)
    assert record.dt == pytest.approx(DT, rel=1e-5)
    assert record.is_in_memory


def test_signals_can_stay_on_disk(sample: Path, signals: NDArray[np.float64]) -> None:
    """A record that is not read into memory gives the same rows, a stretch at a time."""
    record = read(sample, to_memory=False)
    rows = record.slice(30, 70).read(0, 40)
    order = [2, 0, 1] if record.n_inputs else [0, 1, 2]  # read() puts inputs first
    np.testing.assert_array_equal(rows, signals[30:70, order])


def test_a_channel_becomes_an_input_by_name(sample: Path) -> None:
    """With `inputs` alone, all other channels are outputs."""
    every = read(sample)
    names = every.output_names + every.input_names
    record = read(sample, inputs=[names[0]])
    assert record.input_names == names[:1]
    assert record.output_names == names[1:]


def test_a_cut_file_is_refused(sample: Path, tmp_path: Path) -> None:
    """A file cut at any of twenty places gives one VibridError and never a partial record."""
    content = sample.read_bytes()
    for part in range(20):
        cut = tmp_path / f"cut_{sample.name}"
        cut.write_bytes(content[: len(content) * part // 20])
        try:
            record = read_record(cut, dt=DT, to_memory=True)
        except VibridError as problem:
            assert str(cut) in str(problem)
            continue
        assert sample.name in CUT_MAY_PASS, f"cut at {part}/20 gave {record}"


def test_flipped_bytes_raise_nothing_else(
    sample: Path, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Bytes changed at random are either harmless or a VibridError, nothing else."""
    content = sample.read_bytes()
    damaged = tmp_path / f"flipped_{sample.name}"
    for _ in range(60):
        changed = bytearray(content)
        for place in rng.integers(0, len(content), 3):
            changed[place] = rng.integers(256)
        damaged.write_bytes(bytes(changed))
        try:
            read_record(damaged, to_memory=True)
        except VibridError as problem:
            assert str(problem).endswith((".", "?", ")"))


def test_an_empty_file_is_refused(sample: Path) -> None:
    """A file without a byte is called empty."""
    sample.write_bytes(b"")
    with pytest.raises(FileError, match="is empty"):
        read_record(sample)


def test_content_goes_before_the_extension(sample: Path, tmp_path: Path) -> None:
    """Binary formats and UFF are recognized under any name; text under a text name."""
    other = tmp_path / "renamed.txt"
    shutil.copy(sample, other)
    dt = DT if sample.name in NO_INTERVAL else None
    assert isinstance(read_record(other, dt=dt), Record)
