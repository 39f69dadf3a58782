"""One small file of every format, with the same two outputs and one input."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray
from uff_samples import DT, uff_set, write_uff

N = 120
Floats = NDArray[np.float64]
MakeFile = Callable[[Path, Floats], None]


@pytest.fixture
def signals(rng: np.random.Generator) -> Floats:
    """Return three channels of whole eighths, which every format can hold exactly."""
    return np.asarray(np.round(8 * rng.normal(size=(N, 3))) / 8)


def _csv(path: Path, x: Floats) -> None:
    time = np.arange(N) * DT
    table = np.column_stack([time, x])
    head = "time [s],acc1 [m/s2],acc2 (g),force [N]"
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")


def _dat(path: Path, x: Floats) -> None:
    np.savetxt(path, x)


def _npz(path: Path, x: Floats) -> None:
    np.savez(path, y=x[:, :2], u=x[:, 2:], dt=DT)


def _mat(path: Path, x: Floats) -> None:
    scipy.io.savemat(path, {"y": x[:, :2], "u": x[:, 2:], "fs": 1 / DT}, do_compression=True)


def _mat73(path: Path, x: Floats) -> None:
    """Write what MATLAB writes for v7.3: HDF5 behind 512 bytes, axes reversed, classes named."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in (("y", x[:, :2]), ("u", x[:, 2:]), ("fs", np.array([[1 / DT]]))):
            file.create_dataset(name, data=array.T).attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as handle:
        handle.write(b"MATLAB 7.3 MAT-file".ljust(116) + struct.pack("<8xHH", 0x0200, 0x4D49))


def _hdf5(path: Path, x: Floats) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run")
        group.create_dataset("outputs", data=x[:, :2], chunks=(50, 2), compression="gzip")
        group.create_dataset("inputs", data=x[:, 2:])
        group.attrs["dt"] = DT


def _uff(path: Path, x: Floats, binary: int = 0) -> None:
    force = {"ordinate_spec_data_type": 13, "ordinate_axis_units_lab": "N"}
    more = {"binary": binary}
    write_uff(
        path,
        [
            uff_set(x[:, 0], 1, 3, **more),
            uff_set(x[:, 1], 2, -3, **more),
            uff_set(x[:, 2], 1, 3, **more, **force),
        ],
    )


def _uffb(path: Path, x: Floats) -> None:
    _uff(path, x, binary=1)


def _wav(path: Path, x: Floats) -> None:
    scipy.io.wavfile.write(path, 64, x.astype(np.float32))


def _tdms(path: Path, x: Floats) -> None:
    nptdms = pytest.importorskip("nptdms")
    channels = [
        nptdms.ChannelObject(
            "run", name, column, properties={"wf_increment": DT, "unit_string": unit}
        )
        for name, unit, column in zip(("acc1", "acc2", "force"), ("g", "g", "N"), x.T, strict=True)
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


MAKERS: dict[str, MakeFile] = {
    **{"a.csv": _csv, "a.dat": _dat, "a.npy": np.save, "a.npz": _npz, "a.mat": _mat},
    **{"v73.mat": _mat73, "a.h5": _hdf5, "a.uff": _uff, "b.uff": _uffb, "a.wav": _wav},
    **{"a.tdms": _tdms},
}


@pytest.fixture(params=list(MAKERS))
def sample(request: pytest.FixtureRequest, tmp_path: Path, signals: Floats) -> Path:
    """Return the path of a small file, of each format in turn."""
    path = tmp_path / str(request.param)
    MAKERS[path.name](path, signals)
    return path
