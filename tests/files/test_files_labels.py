"""Choosing and describing channels: names, channel files, overrides, and paths."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from vibrid.errors import FileError, OptionError, PathError
from vibrid.files import read_record, write_record
from vibrid.record import Channel, Record


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """Return a headerless file of three columns."""
    path = tmp_path / "plain.dat"
    np.savetxt(path, np.random.default_rng(3).normal(size=(20, 3)))
    return path


@pytest.fixture
def named(tmp_path: Path) -> Path:
    """Return a CSV file of force, acc1 and acc2."""
    path = tmp_path / "named.csv"
    rows = np.random.default_rng(3).normal(size=(20, 3))
    np.savetxt(path, rows, delimiter=",", header="force,acc1,acc2", comments="")
    return path


def test_numbers_name_channels_without_names(plain: Path) -> None:
    """Names 1, col3 and ch2 all work, for roles and for labels."""
    record = read_record(plain, dt=1.0, inputs=["1"], outputs=["col3", "ch2"], dofs={"3": "roof"})
    assert isinstance(record, Record)
    assert (record.input_names, record.output_names) == (("ch1",), ("ch3", "ch2"))
    assert record.output_channels[0].dof == "roof"


@pytest.mark.parametrize("suffix", [".toml", ".csv"])
def test_channel_file_and_overrides(named: Path, tmp_path: Path, suffix: str) -> None:
    """The file describes and gives roles; the arguments go before it."""
    path = tmp_path / f"channels{suffix}"
    if suffix == ".toml":
        path.write_text(
            '[[channel]]\nname = "force"\nrole = "input"\nunit = "N"\n'
            '[[channel]]\nname = "acc2"\nquantity = "acceleration"\nsign = -1\ndelay = 0.001\n'
        )
    else:
        path.write_text(
            "name, role, unit, quantity, sign, delay\n"
            "force, input, N,,,\nacc2,,, acceleration, -1, 0.001\n"
        )
    record = read_record(named, dt=0.1, channels=path, units={"acc2": "g"}, dofs={"acc1": "a"})
    assert isinstance(record, Record)
    assert record.input_channels == (Channel("force", "force", unit="N"),)
    assert record.output_channels == (
        Channel("acc1", dof="a"),
        Channel("acc2", "acceleration", unit="g", sign=-1, delay=0.001),
    )
    again = read_record(named, dt=0.1, channels=path, quantities={"acc2": "velocity"})
    assert again.output_channels[1].quantity == "velocity"
    with pytest.raises(OptionError, match="quantity of channel 'acc2' must be one of"):
        read_record(named, dt=0.1, quantities={"acc2": "velocities"})
    other = read_record(named, dt=0.1, channels=path, inputs=["acc1"])
    assert isinstance(other, Record)
    assert other.output_names == ("force", "acc2")
    chosen = read_record(named, dt=0.1, channels=path, outputs=["acc1"])
    assert isinstance(chosen, Record)
    assert (chosen.input_names, chosen.output_names) == (("force",), ("acc1",))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[[channel]]\nname = "acc9"\n', "No channel is called 'acc9'.*'acc1'|'acc2'"),
        ('[[channel]]\nname = "acc1"\nunits = "g"\n', "'units'.*Did you mean 'unit'"),
        ('[[channel]]\nname = "acc1"\n[[channel]]\nname = "acc1"\n', "'acc1' twice"),
        ('[[channels]]\nname = "acc1"\n', "Did you mean 'channel'"),
        ('[[channel]]\nunit = "g"\n', "without a name"),
        ('[[channel]]\nname = "acc1"\nsign = 2\n', "must be 1 or -1; got 2"),
        ('[[channel]]\nname = "acc1"\nrole = "in"\n', "role of channel 'acc1'"),
        ('[[channel]]\nname = "acc1"\nquantity = "speed"\n', "quantity of channel 'acc1'"),
        ("", "describes no channel"),
        ("[[channel]\n", "not valid TOML"),
    ],
)
def test_bad_channel_files(named: Path, tmp_path: Path, text: str, message: str) -> None:
    """Unknown names, keys and values are errors that suggest the right one."""
    path = tmp_path / "channels.toml"
    path.write_text(text)
    with pytest.raises((OptionError, FileError), match=message):
        read_record(named, dt=0.1, channels=path)


def test_bad_options(named: Path, tmp_path: Path) -> None:
    """Unknown or repeated names and options that do not apply are refused."""
    with pytest.raises(OptionError, match="No channel is called 'hammer'"):
        read_record(named, dt=0.1, inputs=["hammer"])
    with pytest.raises(OptionError, match="named twice"):
        read_record(named, dt=0.1, inputs=["force", "force"])
    with pytest.raises(OptionError, match="input and output at once"):
        read_record(named, dt=0.1, inputs=["force"], outputs=["force"])
    with pytest.raises(OptionError, match="No output is left"):
        read_record(named, dt=0.1, inputs=["force", "acc1", "acc2"])
    with pytest.raises(OptionError, match=r"leave variable \(--variable\) out"):
        read_record(named, dt=0.1, variable="x")
    with pytest.raises(OptionError, match=r"transpose \(--transpose\) applies"):
        read_record(named, dt=0.1, transpose=True)
    with pytest.raises(OptionError, match="dt must be positive"):
        read_record(named, dt=-1.0)
    for dt in (1e-320, 1e308):
        with pytest.raises(OptionError, match="is no sampling interval; give seconds from"):
            read_record(named, dt=dt)
    text = tmp_path / "channels.txt"
    text.write_text("name")
    with pytest.raises(OptionError, match=r"is \.toml or \.csv"):
        read_record(named, dt=0.1, channels=text)


def test_bad_paths(named: Path, tmp_path: Path) -> None:
    """No file, a folder, an unknown extension, a wrong type: each is told apart."""
    with pytest.raises(PathError, match="There is no file"):
        read_record(tmp_path / "none.csv")
    with pytest.raises(PathError, match="is a folder"):
        read_record(tmp_path)
    odd = named.rename(tmp_path / "named.xyz")
    with pytest.raises(FileError, match=r"extension \.xyz .* supported are \.csv, "):
        read_record(odd)
    fake = odd.rename(tmp_path / "named.npy")
    with pytest.raises(FileError, match=r"is not the \.npy file"):
        read_record(fake)
    if os.geteuid() != 0:
        fake.chmod(0)
        with pytest.raises(PathError, match="cannot be read"):
            read_record(fake)


@pytest.mark.parametrize("name", ["a.npz", "a.csv"])
def test_a_written_record_comes_back(tmp_path: Path, name: str) -> None:
    """Values, gaps, labels, roles, name and dt survive exactly."""
    rng = np.random.default_rng(5)
    y = rng.normal(size=(30, 2))
    y[4:6, 1] = np.nan
    record = Record(
        y,
        rng.normal(size=30),
        dt=1 / 3,
        output_channels=[
            Channel('odd, "name"', "acceleration", unit="m/s2", dof="f1", sign=-1, delay=1e-3),
            Channel("t"),
        ],
        input_channels=[Channel("hammer", "force", unit="N", dof="f1")],
        name="run 3 #",
    )
    path = write_record(record, tmp_path / name)
    back = read_record(path)
    assert isinstance(back, Record)
    np.testing.assert_array_equal(back.outputs, record.outputs)
    np.testing.assert_array_equal(back.inputs, record.inputs)
    for field in ("dt", "output_channels", "input_channels", "name"):
        assert getattr(back, field) == getattr(record, field)
    assert list(tmp_path.iterdir()) == [path]


def test_a_cut_csv_of_ours_is_noticed(tmp_path: Path) -> None:
    """It announces its samples, so a lost row or half a number is found."""
    path = write_record(Record(np.arange(9.0) + 0.25, dt=0.5), tmp_path / "a.csv")
    content = path.read_bytes()
    for end in (content.rindex(b"\n", 0, -1) + 1, len(content) - 2):
        path.write_bytes(content[:end])
        with pytest.raises(FileError, match=r"of the 9 samples .* truncated"):
            read_record(path)


def test_writing_refuses_what_it_cannot(tmp_path: Path) -> None:
    """Another extension or a missing folder is an error before anything is written."""
    record = Record(np.ones((4, 1)), dt=1.0)
    with pytest.raises(OptionError, match=r"\.npz or \.csv"):
        write_record(record, tmp_path / "a.mat")
    with pytest.raises(PathError, match="There is no folder"):
        write_record(record, tmp_path / "none" / "a.npz")
    assert not list(tmp_path.iterdir())
