"""Saved fits: the same to the last bit, and nothing lost or half read."""

from __future__ import annotations

import dataclasses
import errno
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from known_fits import known_fit

from vibrid.errors import FileError, OptionError, PathError
from vibrid.excitation import white_noise
from vibrid.files import fits, load, save
from vibrid.fit import Diagnostics, Finding, Fit
from vibrid.identification import identify
from vibrid.methods import N4SID, SSI
from vibrid.record import Channel, Record
from vibrid.statespace import StateSpace
from vibrid.structures import chain


def noisy_record() -> Record:
    """Return a shaker test of two masses with 2 % noise, an offset and a gap."""
    rng = np.random.default_rng(5)
    structure = chain([1.0, 1.0], [400.0, 400.0], damping_ratio=0.02)
    force = white_noise(1500, rng=rng)
    record = structure.simulate(force, 0.05, forces=["f1"], noise=0.02, rng=rng)
    record.outputs[:] += 3
    record.outputs[700:705] = np.nan
    return record


def fitted(kind: str) -> Fit:
    """Return a fit of the record by N4SID, of its outputs by SSI, or with every field set."""
    record = noisy_record()
    if kind == "n4sid":
        return identify(record, N4SID(weighting="moesp"))
    if kind == "ssi":
        references = ("acceleration_f2",)
        return identify(record.select(inputs=[]), SSI(block_rows=12, references=references), 4)
    return known_fit(
        StateSpace([[0.1 + 0.2]], [[np.pi]], [[1e-300]], [[-0.0]], 1 / 3),
        [Channel("Ä [m/s²]", "acceleration", "m/s2", "top", -1, 1e-4)],
        ["f"],
        initial_states=np.array([[np.nan]]),
        parameter_covariance=np.array([[2.0]]),
        diagnostics=Diagnostics(
            {"reasons": ("one", "two"), "best": 0.1, "none": np.nan, "curve": np.arange(3)},
            (Finding("c", "warning", "Schwankt.", "Länger messen."),),
        ),
    )


def plain(value: Any) -> Any:
    """Return a float without NumPy's name around it, anything else as it is."""
    return float(value) if isinstance(value, float) else value


def assert_same(first: Any, second: Any, where: str = "fit") -> None:
    """Compare two values field by field, bit by bit and type by type."""
    if isinstance(first, np.ndarray):
        assert first.dtype == second.dtype, where
        assert first.shape == second.shape, where
        assert first.tobytes() == second.tobytes(), where
    elif dataclasses.is_dataclass(first):
        assert type(first) is type(second), where
        for field in dataclasses.fields(first):
            name = field.name
            assert_same(getattr(first, name), getattr(second, name), f"{where}.{name}")
    elif isinstance(first, dict):
        assert first.keys() == second.keys(), where
        for key in first:
            assert_same(first[key], second[key], f"{where}[{key}]")
    elif isinstance(first, tuple):
        assert len(first) == len(second), where
        for k, (one, other) in enumerate(zip(first, second, strict=True)):
            assert_same(one, other, f"{where}[{k}]")
    else:
        assert isinstance(first, type(second)), where  # a NumPy float is a float
        assert repr(plain(first)) == repr(plain(second)), where  # NaN and -0.0 included


@pytest.mark.parametrize("kind", ["n4sid", "ssi", "by hand"])
def test_a_loaded_fit_is_the_saved_one(tmp_path: Path, kind: str) -> None:
    """Every field, the Gram, options, figures and findings included, is bit-identical."""
    fit = fitted(kind)
    path = save(fit, str(tmp_path / "fit.h5"))
    assert path == tmp_path / "fit.h5"
    loaded = load(path)
    assert_same(fit, loaded)
    assert [each.name for each in tmp_path.iterdir()] == ["fit.h5"]


def test_a_loaded_fit_predicts_the_same(tmp_path: Path) -> None:
    """Simulation and prediction of a loaded fit are bit-identical."""
    fit, record = fitted("n4sid"), noisy_record()
    loaded = load(save(fit, tmp_path / "fit.h5"))
    np.testing.assert_array_equal(loaded.predict(record), fit.predict(record))
    np.testing.assert_array_equal(loaded.simulate_record(record), fit.simulate_record(record))


def test_other_programs_can_read_it(tmp_path: Path) -> None:
    """Matrices are plain datasets by name, with the sampling interval beside them."""
    fit = fitted("by hand")
    with h5py.File(save(fit, tmp_path / "fit.h5")) as file:
        assert file.attrs["format"] == "vibrid-fit"
        np.testing.assert_array_equal(file["model/A"], fit.model.A)
        np.testing.assert_array_equal(file["kalman_gain"], fit.kalman_gain)
        assert file["model"].attrs["dt"] == fit.model.dt


# -- writing


def test_paths_that_cannot_be_written(tmp_path: Path) -> None:
    """A missing folder and a folder as target are refused before any work."""
    fit = fitted("by hand")
    with pytest.raises(PathError, match="There is no folder"):
        save(fit, tmp_path / "missing" / "fit.h5")
    with pytest.raises(PathError, match="is a folder"):
        save(fit, tmp_path)
    with pytest.raises(PathError, match="cannot be written"):
        save(fit, tmp_path / ("x" * 254))  # no room for the partial file's longer name
    with pytest.raises(OptionError, match="save takes a Fit; got StateSpace"):
        save(fit.model, tmp_path / "fit.h5")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_survives_a_failed_save(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """When the disk is full halfway, the old file is whole and no partial one is left."""
    path = save(fitted("by hand"), tmp_path / "fit.h5")
    before = path.read_bytes()

    def full(file: Any, fit: Fit) -> None:
        file["kalman_gain"] = fit.kalman_gain
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(fits, "_write", full)
    with pytest.raises(PathError, match=r"fit.h5 cannot be written: .*No space left"):
        save(fitted("by hand"), path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == ["fit.h5"]


def test_saving_again_replaces(tmp_path: Path) -> None:
    """A second save to one path leaves the second fit."""
    first = fitted("by hand")
    second = dataclasses.replace(first, output_offset=np.array([9.0]))
    save(first, tmp_path / "fit.h5")
    assert load(save(second, tmp_path / "fit.h5")).output_offset.tolist() == [9.0]


# -- reading


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.9, 0.999])
def test_truncated_files_are_refused(tmp_path: Path, share: float) -> None:
    """A file cut anywhere is no fit."""
    path = save(fitted("by hand"), tmp_path / "fit.h5")
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(FileError, match=r"fit.h5 is not a (complete )?saved fit"):
        load(path)


def test_damaged_files_never_end_in_a_traceback(tmp_path: Path) -> None:
    """Bytes overwritten anywhere in the structure give a FileError, or a fit all the same."""
    path = save(fitted("by hand"), tmp_path / "fit.h5")
    whole, rng, refused = path.read_bytes(), np.random.default_rng(0), 0
    for place in rng.integers(0, len(whole) - 8, 150):
        path.write_bytes(whole[:place] + rng.bytes(8) + whole[place + 8 :])
        try:
            load(path)
        except FileError:
            refused += 1
    assert refused > 10


def test_what_is_no_saved_fit_is_refused(tmp_path: Path) -> None:
    """Text, another HDF5 file, a folder and nothing at all are told apart."""
    text, other = tmp_path / "run.csv", tmp_path / "data.h5"
    text.write_text("time,acc\n0,1\n")
    with h5py.File(other, "w") as file:
        file["acc"] = np.ones(5)
    with pytest.raises(FileError, match=r"run.csv is not a"):
        load(text)
    with pytest.raises(FileError, match=r"data.h5 is not a saved fit; read records with"):
        load(other)
    with pytest.raises(PathError, match="There is no file"):
        load(tmp_path / "none.h5")
    with pytest.raises(PathError, match="is a folder"):
        load(tmp_path)


@pytest.mark.parametrize("name", ["model/C", "kalman_gain", "figures", "state_covariance", "model"])
def test_missing_parts_are_refused(tmp_path: Path, name: str) -> None:
    """A fit without one of its parts is refused whole."""
    path = save(fitted("by hand"), tmp_path / "fit.h5")
    with h5py.File(path, "a") as file:
        del file[name]
    with pytest.raises(FileError, match="not a complete saved fit"):
        load(path)


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [
        ("version", 2, "has version 2; this vibrid reads up to 1. Install a newer one"),
        ("version", "x", "not a complete saved fit"),
        ("method", "era", "not a complete saved fit"),
        ("options", '{"weighting": "best"}', "weighting must be one of"),
        ("options", '{"horizon": 3}', "not a complete saved fit.*horizon"),
        ("outputs", '[{"name": 3}]', "not a complete saved fit"),
        ("findings", "[1, 2]", "not a complete saved fit"),
        ("segments", "[[1, 2", "not a complete saved fit"),
        ("figures", "[]", "not a complete saved fit"),
    ],
)
def test_attributes_that_do_not_fit_are_refused(
    tmp_path: Path, attribute: str, value: Any, message: str
) -> None:
    """A newer version, an unknown method or option, and broken text are errors, not guesses."""
    path = save(fitted("by hand"), tmp_path / "fit.h5")
    with h5py.File(path, "a") as file:
        file.attrs[attribute] = value
    with pytest.raises(FileError, match=message):
        load(path)
