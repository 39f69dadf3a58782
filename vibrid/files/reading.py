"""read_record: find the format of a file, read it, label and choose its channels."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileError, OptionError, check_names, check_readable
from ..record import Channel, FrequencyResponses, Record, Signal, in_memory
from .hdf5 import read_hdf5
from .labels import override, read_channel_file, resolve
from .mat import read_mat
from .numpy_files import read_npy, read_npz
from .tables import Table, settle_dt
from .tdms import read_tdms
from .text import read_text
from .uff import read_uff
from .wav import read_wav

MEMORY_BYTES = 2**29  # as float64; larger signals stay on disk unless asked

Reader = Callable[..., Table | FrequencyResponses]
Described = Mapping[str, Mapping[str, Any]]  # name → field → value, or field → name → value
READERS: dict[str, Reader] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".asc"), read_text),
    **{".npy": read_npy, ".npz": read_npz, ".mat": read_mat},
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".he5"), read_hdf5),
    **dict.fromkeys((".uff", ".unv", ".uf", ".58", ".bunv"), read_uff),
    **{".wav": read_wav, ".tdms": read_tdms},
}
ARRAY_READERS = (read_npy, read_npz, read_mat, read_hdf5)
VARIABLE_READERS = (read_npz, read_mat, read_hdf5, read_tdms)
BINARY_READERS = (read_npy, read_npz, read_hdf5, read_wav, read_tdms)
SIGNATURES: tuple[tuple[int, bytes, Reader], ...] = (
    (0, b"\x93NUMPY", read_npy),
    (0, b"PK\x03\x04", read_npz),
    (0, b"\x89HDF\r\n\x1a\n", read_hdf5),
    (512, b"\x89HDF\r\n\x1a\n", read_hdf5),
    (0, b"MATLAB 5.0 MAT", read_mat),
    (0, b"RIFF", read_wav),
    (0, b"RIFX", read_wav),
    (0, b"RF64", read_wav),
    (0, b"TDSm", read_tdms),
    (0, b"    -1", read_uff),
)


def read_record(
    path: str | os.PathLike[str],
    *,
    inputs: Sequence[str] | None = None,
    outputs: Sequence[str] | None = None,
    dt: float | None = None,
    channels: str | os.PathLike[str] | None = None,
    quantities: Mapping[str, str] | None = None,
    dofs: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    variable: str | Sequence[str] | None = None,
    transpose: bool = False,
    to_memory: bool | None = None,
) -> Record | FrequencyResponses:
    """Read a file of measured signals.

    CSV, TSV and other text, NPY, NPZ, MAT (all versions), HDF5, UFF 58 (text and binary), WAV
    and TDMS; the content decides before the extension does. Nothing is guessed: what the file
    does not say (the sampling interval, which of several arrays) is asked for by the error.

    Parameters
    ----------
    path : path
        The file.
    inputs, outputs : sequence of str, optional
        Names of the channels on each side. With `inputs` alone, all other channels are
        outputs; with `outputs` alone, the inputs are those that `channels` states; with
        neither, the roles that the file or `channels` states, otherwise all channels are
        outputs. Channels without names are ch1, ch2, … (counted without a time column); "1"
        and "col1" mean ch1.
    dt : float, optional
        Sampling interval [s]; needed when the file has neither an interval, a rate nor a time
        column, and must agree with it to 0.1 %.
    channels : path, optional
        TOML (``[[channel]]`` tables) or CSV with name, quantity, unit, dof, sign, delay, role.
    quantities, dofs, units : mapping of name to value, optional
        Override what file and `channels` say. A unit tells the quantity where none is given.
    variable : str or sequence of str, optional
        Which array of a NPZ, MAT or HDF5 file, or which group of a TDMS file.
    transpose : bool
        Time runs along the last axis of the arrays; otherwise along the first.
    to_memory : bool, optional
        Read into memory as float64 (True) or leave on disk where the format allows (False);
        by default signals up to 512 MiB are read.

    Returns
    -------
    Record or FrequencyResponses
        FrequencyResponses from a UFF file of FRFs, otherwise a Record.

    Raises
    ------
    PathError, OptionError
        No such file; unknown names or options; what must be given.
    FileError, DataError
        A damaged, truncated, empty or unsupported file; text or complex data.

    Notes
    -----
    The time column of a text file is the one called t, time, Zeit, …, in the unit of its
    heading. A first column without such a name is time in seconds when it rises evenly, and is
    refused when it rises unevenly; 0, 1, 2, … only counts samples. Even means to 0.1 % of the
    step, or to what the printed digits resolve. Missing samples are empty cells or "nan".

    Examples
    --------
    >>> from vibrid.files import write_record
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_record(Record([[1.0, 2.0], [3.0, 4.0]], dt=0.5), f"{folder}/a.csv")
    ...     record = read_record(path, inputs=["y2"])
    >>> record.output_names, record.input_names, record.dt
    (('y1',), ('y2',), 0.5)
    """
    path = check_readable(path)
    reader = _reader_of(path)
    if variable is not None and reader not in VARIABLE_READERS:
        raise OptionError(f"{path} has no named arrays or groups; leave variable (--variable) out.")
    if transpose and reader not in ARRAY_READERS:
        raise OptionError(
            f"transpose (--transpose) applies to NPY, NPZ, MAT and HDF5 files, not to {path}."
        )
    content = reader(path, variable=variable, transpose=transpose, dt=dt)
    described = {} if channels is None else read_channel_file(Path(channels))
    extra = {"quantity": quantities or {}, "dof": dofs or {}, "unit": units or {}}
    if isinstance(content, FrequencyResponses):
        return _responses(content, described, extra, inputs, outputs)
    record, roles = _record(path, content, dt, described, extra, to_memory)
    return _choose(record, content.numbered, inputs, outputs, roles)


def _reader_of(path: Path) -> Reader:
    with path.open("rb") as file:
        head = file.read(520)
    if not head:
        raise FileError(f"{path} is empty; give a file with samples.")
    for offset, signature, reader in SIGNATURES:
        if head[offset:].startswith(signature):
            return reader
    reader_by_name = READERS.get(path.suffix.lower())
    if reader_by_name is None:
        raise FileError(
            f"The extension {path.suffix or '(none)'} of {path} is not known; supported are "
            f"{', '.join(READERS)}."
        )
    if reader_by_name in BINARY_READERS:
        raise FileError(
            f"{path} is not the {path.suffix} file that its name says: the first bytes differ. "
            "It is damaged or of another kind."
        )
    return reader_by_name


def _record(
    path: Path,
    table: Table,
    dt: float | None,
    described: Described,
    extra: Described,
    to_memory: bool | None,
) -> tuple[Record, dict[str, str]]:
    """Label the table's signals and make them a record; return it with the stated roles."""
    step = settle_dt(path, table.dt, dt)
    every = (*table.output_channels, *table.input_channels)
    every, roles = _labelled(every, described, extra, table.numbered)
    count = len(table.output_channels)
    record = Record(
        _settled(table.outputs, to_memory),
        None if table.inputs is None else _settled(table.inputs, to_memory),
        dt=step,
        output_channels=every[:count],
        input_channels=every[count:],
        name=table.name,
    )
    return record, roles


def _labelled(
    every: tuple[Channel, ...], described: Described, extra: Described, numbered: bool
) -> tuple[tuple[Channel, ...], dict[str, str]]:
    """Return the channels as the channel file and the arguments describe them, and the roles."""
    names = resolve(list(described), [channel.name for channel in every], numbered)
    changes: dict[str, dict[str, Any]] = {}
    for name, fields in zip(names, described.values(), strict=True):
        for field, value in fields.items():
            changes.setdefault(field, {})[name] = value
    roles = changes.pop("role", {})
    for change in (changes, extra):
        every = override(every, change, numbered)
    return every, roles


def _settled(signal: Signal, to_memory: bool | None) -> Signal:
    if in_memory(signal):
        return signal
    small = signal.shape[0] * signal.shape[1] * 8 <= MEMORY_BYTES
    if to_memory or (to_memory is None and small):
        return np.asarray(signal[:], dtype=np.float64)
    return signal


def _choose(
    record: Record,
    numbered: bool,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
    roles: Mapping[str, str],
) -> Record:
    """Put the wanted channels on each side."""
    known = record.output_names + record.input_names
    if inputs is None and outputs is None and roles:
        marked = [name for name in known if _role(record, name, roles) == "input"]
        inputs = marked
        outputs = [name for name in known if name not in marked]
    elif inputs is None and outputs is not None:
        kept = resolve(outputs, known, numbered)
        inputs = [name for name in known if roles.get(name) == "input" and name not in kept]
    if inputs is not None:
        inputs = resolve(inputs, known, numbered)
        if outputs is None:
            outputs = [name for name in known if name not in inputs]
    if outputs is not None:
        outputs = resolve(outputs, known, numbered)
    if inputs is None and outputs is None:
        return record
    return record.select(outputs=outputs, inputs=inputs)


def _role(record: Record, name: str, roles: Mapping[str, str]) -> str:
    return roles.get(name, "input" if name in record.input_names else "output")


def _responses(
    responses: FrequencyResponses,
    described: Described,
    extra: Described,
    inputs: Sequence[str] | None,
    outputs: Sequence[str] | None,
) -> FrequencyResponses:
    """Label frequency responses and keep the wanted rows and columns."""
    every = (*responses.output_channels, *responses.input_channels)
    every, roles = _labelled(every, described, extra, False)
    if roles:
        raise OptionError(
            "Responses and references of frequency responses are fixed; leave role out of the "
            "channel file."
        )
    count = len(responses.output_channels)
    rows = _positions(every[:count], outputs, "response")
    columns = _positions(every[count:], inputs, "reference")
    coherence = responses.coherence
    return FrequencyResponses(
        responses.values[:, rows][:, :, columns],
        responses.frequencies_hz,
        output_channels=[every[k] for k in rows],
        input_channels=[every[count + k] for k in columns],
        coherence=None if coherence is None else coherence[:, rows][:, :, columns],
    )


def _positions(channels: Sequence[Channel], wanted: Sequence[str] | None, kind: str) -> list[int]:
    names = [channel.name for channel in channels]
    if wanted is None:
        return list(range(len(names)))
    wanted = [wanted] if isinstance(wanted, str) else wanted
    check_names(kind, wanted, names)
    if not wanted:
        raise OptionError(f"No {kind} is left; name at least one of {', '.join(names)}.")
    return [names.index(name) for name in wanted]
