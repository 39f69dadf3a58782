"""NPY, NPZ, MAT and HDF5: which arrays are signals, what names them, what is asked for."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from vibrid.errors import FileError, OptionError, VibridError
from vibrid.files import read_record
from vibrid.record import Record


def npz(path: Path, **arrays: Any) -> Path:
    np.savez(path, **arrays)
    return path


def test_labels_beside_an_array_name_its_axes(tmp_path: Path) -> None:
    """Text of a fitting length names an axis; without it columns are counted."""
    data = np.arange(60.0).reshape(10, 3, 2)
    path = npz(tmp_path / "a.npz", acc=data, floors=["1st", "2nd", "3rd"], fs=120.0)
    record = read_record(path)
    assert isinstance(record, Record)
    assert record.output_names[:3] == ("acc/1st/1", "acc/1st/2", "acc/2nd/1")
    np.testing.assert_array_equal(record.outputs, data.reshape(10, 6))
    assert record.dt == pytest.approx(1 / 120)


def test_repeated_or_rival_labels_name_nothing(tmp_path: Path) -> None:
    """Labels that repeat, or two fitting sets of text, leave numbers."""
    data = np.arange(20.0).reshape(10, 2)
    rivals = npz(tmp_path / "a.npz", x=data, dt=1.0, p=["a", "b"], q=["c", "d"])
    repeated = npz(tmp_path / "b.npz", x=data, dt=1.0, p=["a", "a"], chan=[7, 4])
    assert read_record(rivals).output_channels[0].name == "ch1"
    assert [c.name for c in read_record(repeated).output_channels] == ["ch7", "ch4"]


def test_one_dimensional_arrays_of_one_length_are_channels(tmp_path: Path) -> None:
    """Their names are the channels; a time array gives dt."""
    t = np.arange(50) * 0.02
    path = npz(tmp_path / "a.npz", t=t, roof=np.sin(t), base=np.cos(t))
    record = read_record(path, inputs=["base"])
    assert isinstance(record, Record)
    assert (record.output_names, record.input_names) == (("roof",), ("base",))
    assert record.dt == pytest.approx(0.02)


def test_several_candidates_are_asked_for(tmp_path: Path) -> None:
    """The error lists the arrays; `variable` takes one or several of one length."""
    path = npz(tmp_path / "a.npz", raw=np.ones((9, 2)), f=np.ones(9), long=np.ones((12, 2)), dt=1.0)
    with pytest.raises(OptionError, match=r"raw \(9, 2\), f \(9,\), long .*--variable"):
        read_record(path)
    names = [c.name for c in read_record(path, variable="raw,f").output_channels]
    assert names == ["raw/1", "raw/2", "f"]
    with pytest.raises(FileError, match=r"different length .*raw: 9, long: 12"):
        read_record(path, variable=["raw", "long"])
    with pytest.raises(OptionError, match=r"No array is called 'rwa'.*'raw'"):
        read_record(path, variable="rwa")


def test_a_transposed_array_is_refused_and_read_on_demand(tmp_path: Path) -> None:
    """Time along the last axis is never guessed."""
    data = np.arange(12.0).reshape(2, 6)
    path = npz(tmp_path / "a.npz", u=data, y=-data, dt=1.0)
    with pytest.raises(FileError, match=r"2 samples of 6 channels .*--transpose"):
        read_record(path)
    record = read_record(path, transpose=True)
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.inputs, data.T)
    np.testing.assert_array_equal(record.outputs, -data.T)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"x": np.ones((5, 2), complex), "dt": 1.0}, "complex"),
        ({"x": np.array(["a", "b"]), "dt": 1.0}, "no signal"),
        ({"x": np.array([{}, {}], object), "dt": 1.0}, "as an NPZ file"),
        ({"x": np.ones((5, 2)), "dt": -1.0}, "dt = -1; it must be positive"),
        ({"x": np.ones((5, 2)), "dt": 1.0, "fs": 2.0}, "contradicts itself"),
        ({"x": np.ones((5, 2)), "t": [0, 1, 2, 3, 7.0]}, "uneven: row 5"),
        ({"y": np.ones((5, 2)), "u": np.ones((4, 1)), "dt": 1.0}, "different length"),
        ({"x": np.ones((5, 2))}, "cannot be known"),
    ],
)
def test_bad_arrays_are_refused(tmp_path: Path, arrays: dict[str, Any], message: str) -> None:
    """Each gives one clear error."""
    with pytest.raises(VibridError, match=message):
        read_record(npz(tmp_path / "a.npz", **arrays))


def test_another_archive_is_told_apart(tmp_path: Path) -> None:
    """A workbook is a ZIP archive too, but holds no arrays."""
    with zipfile.ZipFile(tmp_path / "a.xlsx", "w") as archive:
        archive.writestr("sheet.xml", "<a/>")
    with pytest.raises(FileError, match="ZIP archive without NumPy arrays"):
        read_record(tmp_path / "a.xlsx")


def test_npy_stays_on_disk_when_asked(tmp_path: Path) -> None:
    """Both memory orders are mapped; two arrays in one file are refused."""
    data = np.arange(40.0).reshape(20, 2)
    path = tmp_path / "a.npy"
    np.save(path, np.asfortranarray(data))
    record = read_record(path, dt=1.0, to_memory=False)
    assert isinstance(record, Record) and not record.is_in_memory
    np.testing.assert_array_equal(record.read(5, 9), data[5:9])
    with path.open("ab") as file:
        np.save(file, data)
    with pytest.raises(FileError, match="more than one array"):
        read_record(path, dt=1.0)


def test_mat_structures_and_cells(tmp_path: Path) -> None:
    """Fields of a structure are arrays; a cell array of text labels columns."""
    content = {
        "run": {"acc": np.arange(30.0).reshape(10, 3), "fs": 10.0},
        "other": np.array([1, "x"], object),
    }
    content["run"]["names"] = np.array(["a", "b", "c"], object)  # type: ignore[index]
    scipy.io.savemat(tmp_path / "a.mat", content)
    record = read_record(tmp_path / "a.mat")
    assert isinstance(record, Record)
    assert record.output_names == ("a", "b", "c")
    assert record.dt == pytest.approx(0.1)


def test_matlab_73_axes_labels_and_units_are_turned_back(tmp_path: Path) -> None:
    """HDF5 that MATLAB wrote has reversed axes; three axes come back in order."""
    data = np.arange(60.0).reshape(10, 3, 2)
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("acc", data=data.T).attrs["MATLAB_class"] = np.bytes_("double")
        cells = []
        for k, text in enumerate(("x", "y")):
            cell = file.create_dataset(f"#refs#/{k}", data=np.array([[ord(text)]], np.uint16))
            cell.attrs["MATLAB_class"] = np.bytes_("char")
            cells.append([cell.ref])
        names = file.create_dataset("axes", data=np.array(cells, h5py.ref_dtype))
        names.attrs["MATLAB_class"] = np.bytes_("cell")
    record = read_record(path, dt=0.1)
    assert isinstance(record, Record)
    np.testing.assert_array_equal(record.outputs, data.reshape(10, 6))
    assert record.output_names[:3] == ("acc/1/x", "acc/1/y", "acc/2/x")


def test_hdf5_groups_have_their_own_interval(tmp_path: Path) -> None:
    """dt and units stand on the dataset or above it; other groups do not matter."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for name, dt in (("slow", 0.1), ("fast", 0.01)):
            dataset = file.create_dataset(f"{name}/acc", data=np.ones((20, 2)))
            dataset.attrs["units"] = "m/s2"
            file[name].attrs["dt"] = dt
    with pytest.raises(OptionError, match="several arrays"):
        read_record(path)
    record = read_record(path, variable="fast/acc")
    assert isinstance(record, Record)
    assert record.dt == 0.01
    assert record.output_channels[1].quantity == "acceleration"


def test_damage_found_late_is_a_file_error(tmp_path: Path) -> None:
    """A chunk that cannot be unpacked while the record is walked is no traceback."""
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        data = np.random.default_rng(1).normal(size=(4000, 2))
        file.create_dataset("x", data=data, chunks=(500, 2), compression="gzip")
        offset = file["x"].id.get_chunk_info(3).byte_offset
    content = bytearray(path.read_bytes())
    content[offset : offset + 40] = bytes(40)
    path.write_bytes(bytes(content))
    record = read_record(path, dt=1.0, to_memory=False)
    assert isinstance(record, Record)
    with pytest.raises(FileError, match="damaged"):
        record.segments()


def test_a_saved_model_is_no_record(tmp_path: Path) -> None:
    """A saved model is told apart by its content, whatever its name."""
    with h5py.File(tmp_path / "run.dat", "w") as file:
        file["A"] = np.ones((9, 2))
        file.attrs["format"] = "vibrid-fit"
    with pytest.raises(FileError, match=r"saved model.* see it with load\(\) or vibrid info"):
        read_record(tmp_path / "run.dat")


def test_real_records(shared_data: Path) -> None:
    """Names, shapes and intervals of published records are those of their description."""
    frame = read_record(shared_data / "three_story_frame.npz", inputs=["acc/Ground Floor/x"])
    assert isinstance(frame, Record)
    assert (frame.n_samples, frame.n_outputs, frame.n_inputs) == (12115, 11, 1)
    assert frame.output_names[2] == "acc/1st Floor/x"
    bridge = read_record(shared_data / "bridge_painter_2012.npz", inputs=["3", "17", "20"])
    assert isinstance(bridge, Record)
    assert (bridge.dt, bridge.input_names) == (0.005, ("ch3", "ch17", "ch20"))
    with pytest.raises(OptionError, match="--dt"):
        read_record(shared_data / "flexible_subframe.mat")
    subframe = read_record(shared_data / "flexible_subframe.mat", dt=1 / 1024, inputs=["ch1", "2"])
    assert isinstance(subframe, Record)
    assert subframe.outputs.shape == (8523, 28)
    slicot = read_record(shared_data / "slicot_ib01.npz", dt=1.0, transpose=True)
    assert isinstance(slicot, Record)
    assert (slicot.n_samples, slicot.output_names, slicot.input_names) == (1000, ("y1",), ("u1",))
    dryer = read_record(shared_data / "dryer.dat", dt=0.08, inputs=["1"])
    assert isinstance(dryer, Record)
    assert dryer.output_names == ("ch2",)
