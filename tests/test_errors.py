"""Errors: the tree and its exit meaning, and checks that name number, limit and cure."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vibrid.errors import (
    DataError,
    FileError,
    OptionError,
    PathError,
    UnstableModelError,
    VibridError,
    check_choice,
    check_names,
    check_positive,
    check_readable,
    check_whole,
    check_writable,
)


def test_the_tree() -> None:
    """Wrong use and unusable data are apart; both are ValueErrors for callers who catch those."""
    assert issubclass(PathError, OptionError)
    assert issubclass(FileError, DataError)
    assert issubclass(UnstableModelError, DataError)
    assert not issubclass(DataError, OptionError)
    assert not issubclass(OptionError, DataError)
    for kind in (OptionError, DataError):
        assert issubclass(kind, VibridError)
        assert issubclass(kind, ValueError)


@pytest.mark.parametrize(
    ("value", "hint"),
    [
        ("n4sdi", "Did you mean 'n4sid'"),
        ("moe", "Did you mean 'moesp'"),
        (3, "got 3"),
        (None, "No"),
    ],
)
def test_a_choice_names_the_choices(value: Any, hint: str) -> None:
    """An unknown choice lists what there is and suggests the nearest."""
    with pytest.raises(OptionError, match=f"weighting must be one of cva, moesp, n4sid; .*{hint}"):
        check_choice("weighting", value, ("cva", "moesp", "n4sid"))
    check_choice("weighting", "cva", ("cva", "moesp", "n4sid"))


def test_an_unknown_name_lists_the_known() -> None:
    """Twelve names are shown at most, and the nearest is suggested."""
    known = [f"acc{k}" for k in range(20)]
    check_names("channel", known, known)
    with pytest.raises(OptionError) as error:
        check_names("channel", ["acc3", "ac19"], known)
    message = str(error.value)
    assert "No channel is called 'ac19'" in message
    assert "acc11 …" in message
    assert "acc12" not in message
    assert "Did you mean 'acc19'?" in message


@pytest.mark.parametrize("value", [0, -1, np.nan, np.inf, -np.inf])
def test_positive_refuses_numbers_with_their_unit(value: float) -> None:
    """A number that is not positive is shown with its unit."""
    with pytest.raises(OptionError, match=f"dt must be positive; got {value:g} s"):
        check_positive("dt", value, "s")


@pytest.mark.parametrize("value", ["1", None, True, [1], 1j])
def test_positive_refuses_what_is_no_number(value: Any) -> None:
    """Text, booleans and complex numbers are no positive numbers."""
    with pytest.raises(OptionError, match="must be a positive number; got"):
        check_positive("dt", value)


@pytest.mark.parametrize("value", [1, 0.5, np.float32(2), np.int64(3)])
def test_positive_takes_any_number(value: Any) -> None:
    """Python and NumPy numbers pass."""
    check_positive("dt", value)


def test_whole_numbers_have_limits() -> None:
    """Limits are inclusive and named; a float is no whole number."""
    for good in (1, 8, np.int32(5)):
        check_whole("order", good, 1, 8)
    with pytest.raises(OptionError, match="order must be from 1 to 8; got 9"):
        check_whole("order", 9, 1, 8)
    with pytest.raises(OptionError, match="order must be at least 1; got 0"):
        check_whole("order", 0, 1)
    for bad in (2.0, "2", True, None):
        with pytest.raises(OptionError, match="order must be a whole number, from 1 to 8; got"):
            check_whole("order", bad, 1, 8)


def test_readable_paths(tmp_path: Path) -> None:
    """Folders and missing files are told apart; a file comes back as Path."""
    file = tmp_path / "run.csv"
    with pytest.raises(PathError, match=r"There is no file .*run.csv"):
        check_readable(file)
    with pytest.raises(PathError, match="is a folder"):
        check_readable(tmp_path)
    file.write_text("1\n")
    assert check_readable(str(file)) == file


def test_writable_paths(tmp_path: Path) -> None:
    """A folder that does not exist and a folder as target are refused; nothing is made."""
    file = tmp_path / "fit.h5"
    assert check_writable(str(file)) == file
    assert not file.exists()
    with pytest.raises(PathError, match=r"There is no folder .*missing; make it first"):
        check_writable(tmp_path / "missing" / "fit.h5")
    with pytest.raises(PathError, match="is a folder"):
        check_writable(tmp_path)
    file.write_text("kept")
    assert check_writable(file).read_text() == "kept"
    assert list(tmp_path.iterdir()) == [file]


def test_pipes_and_devices_are_refused(tmp_path: Path) -> None:
    """A pipe is neither waited for nor replaced by a file."""
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    for check in (check_readable, check_writable):
        with pytest.raises(PathError, match="is a pipe or device"):
            check(pipe)
    assert pipe.is_fifo()


def test_odd_places_and_names_are_refused_before_the_work(tmp_path: Path) -> None:
    """Where no file can be made, or none of this name, it is said at once, also to root."""
    with pytest.raises(PathError, match="cannot be written: File name too long; write elsewhere"):
        check_writable(tmp_path / ("x" * 250))
    with pytest.raises(PathError, match="cannot be read: File name too long"):
        check_readable(tmp_path / ("x" * 5000))
    if Path("/proc/self").is_dir():
        with pytest.raises(PathError, match=r"/proc/x\.h5 cannot be written"):
            check_writable("/proc/x.h5")


def test_a_folder_without_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder that the system says is not writable is named, as is a file that cannot be read."""
    file = tmp_path / "fit.h5"
    file.write_text("1")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(PathError, match="is not writable; write elsewhere"):
        check_writable(file)
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(PathError, match="cannot be read: Permission denied"):
        check_readable(file)
