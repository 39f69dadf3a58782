"""WAV and TDMS: counts, intervals, groups, and a package that is not there."""

from __future__ import annotations

import struct
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import wavfile

from vibrid.errors import FileError, OptionError, VibridError
from vibrid.files import read_record
from vibrid.record import Record


def test_wav_keeps_raw_counts(tmp_path: Path) -> None:
    """Whole-number samples stay as they are, one column a channel, at the file's rate."""
    counts = np.array([[1, -2], [30000, 4], [5, -32768]], np.int16)
    wavfile.write(tmp_path / "a.wav", 8000, counts)
    record = read_record(tmp_path / "a.wav")
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.outputs, counts)
    assert (record.dt, record.output_channels[0].unit) == (1 / 8000, "")


def test_wav_of_24_bits(tmp_path: Path) -> None:
    """Samples of three bytes cannot be mapped; they arrive in the upper bytes of 32 bits."""
    data = b"".join(value.to_bytes(3, "little", signed=True) for value in (1, -1, 8388607, 0))
    head = struct.pack(
        "<4sI4s4sIHHIIHH", b"RIFF", 36 + 12, b"WAVE", b"fmt ", 16, 1, 1, 100, 300, 3, 24
    )
    (tmp_path / "a.wav").write_bytes(head + struct.pack("<4sI", b"data", 12) + data)
    record = read_record(tmp_path / "a.wav")
    assert isinstance(record, Record)
    assert record.outputs[:, 0].tolist() == [256, -256, 8388607 * 256, 0]


def write_tdms(path: Path, *channels: tuple[str, str, Any, float | None]) -> Path:
    """Write (group, name, data, interval) channels."""
    nptdms = pytest.importorskip("nptdms")
    made = [
        nptdms.ChannelObject(group, name, data, properties={"wf_increment": dt} if dt else {})
        for group, name, data, dt in channels
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(made)
    return path


def test_tdms_groups_are_asked_for(tmp_path: Path) -> None:
    """One group is read; `variable` chooses it among several."""
    x = np.arange(10.0)
    path = write_tdms(tmp_path / "a.tdms", ("slow", "a", x[:5], 0.2), ("fast", "b", x, 0.1))
    with pytest.raises(OptionError, match=r"several groups: .*slow.*; give variable"):
        read_record(path)
    record = read_record(path, variable="fast")
    assert isinstance(record, Record)
    assert (record.dt, record.output_names, record.n_samples) == (0.1, ("b",), 10)


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        ([("g", "a", np.ones(5), 0.1), ("g", "b", np.ones(4), 0.1)], "different length: 'a' has 5"),
        ([("g", "a", np.ones(5), 0.1), ("g", "b", np.ones(5), 0.2)], "different sampling interval"),
        ([("g", "a", np.ones(5), None)], "cannot be known"),
        ([("g", "a", ["x", "y"], 0.1)], "real numbers"),
        ([("g", "a", np.ones(5, complex), 0.1)], "real numbers"),
    ],
)
def test_bad_tdms_is_refused(tmp_path: Path, channels: list[Any], message: str) -> None:
    """Unequal channels, no interval, text and complex numbers."""
    with pytest.raises(VibridError, match=message):
        read_record(write_tdms(tmp_path / "a.tdms", *channels))


def test_tdms_without_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error says what to install."""
    (tmp_path / "a.tdms").write_bytes(b"TDSm" + bytes(30))
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(OptionError, match=r"pip install 'vibrid\[tdms\]'"):
        read_record(tmp_path / "a.tdms")


def test_empty_sound_is_refused(tmp_path: Path) -> None:
    """A WAV file without samples is no record."""
    wavfile.write(tmp_path / "a.wav", 100, np.zeros((0, 1), np.int16))
    with pytest.raises(FileError, match=r"a\.wav"):
        read_record(tmp_path / "a.wav")
