"""save and load: a Fit as one HDF5 file that other programs can read."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from ..chunks import Segment
from ..errors import FileError, OptionError, PathError, check_readable, check_writable
from ..fit import Diagnostics, Finding, Fit
from ..gram import BlockGram
from ..methods import METHODS
from ..record import Channel
from ..statespace import StateSpace

FORMAT = "vibrid-fit"
VERSION = 1
HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
MATRICES = ("A", "B", "C", "D")
ARRAYS = (
    "kalman_gain",
    "innovation_covariance",
    "initial_states",
    "input_offset",
    "output_offset",
    "feedthrough",
    "singular_values",
    "state_covariance",
)
GRAM_ARRAYS = ("lags", "sums", "heads", "tails", "columns", "owners", "centre", "scale")


def save(fit: Fit, path: str | os.PathLike[str]) -> Path:
    """Write a fit to an HDF5 file; `load` gives it back to the last bit.

    Matrices are datasets of the names of `Fit`; channels, method options and findings are
    JSON text in attributes, so the file can be read without vibrid.

    Raises
    ------
    PathError
        The path cannot be written. An existing file is only replaced by a complete one.
    """
    import h5py

    target = check_writable(path)
    if not isinstance(fit, Fit):
        raise OptionError(f"save takes a Fit; got {type(fit).__name__}.")
    partial = target.with_name(f".{target.name}.part")
    try:
        with h5py.File(partial, "w") as file:
            _write(file, fit)
        partial.replace(target)
    except OSError as problem:
        reason = os.strerror(problem.errno) if problem.errno else problem
        raise PathError(f"{target} cannot be written: {reason}.") from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()
    return target


def load(path: str | os.PathLike[str]) -> Fit:
    """Read a fit that `save` wrote.

    Raises
    ------
    PathError
        There is no such file.
    FileError
        The file is not a saved fit, is damaged, or is of a newer version.
    """
    import h5py

    source = check_readable(path)
    try:
        with h5py.File(source, "r") as file:
            if file.attrs.get("format") != FORMAT:
                raise FileError(f"{source} is not a saved fit; read records with read_record().")
            if file.attrs["version"] > VERSION:
                raise FileError(
                    f"{source} has version {file.attrs['version']}; this vibrid reads up to "
                    f"{VERSION}. Install a newer one."
                )
            return _read(file)
    except (OSError, LookupError, TypeError, ValueError, AttributeError, RuntimeError) as problem:
        if isinstance(problem, FileError):
            raise
        raise FileError(f"{source} is not a complete saved fit: {problem}.") from None


def is_fit(path: str | os.PathLike[str]) -> bool:
    """Tell whether a file is one that `save` wrote, by its content."""
    source = check_readable(path)
    with source.open("rb") as raw:
        if raw.read(len(HDF5_SIGNATURE)) != HDF5_SIGNATURE:
            return False
    import h5py

    try:
        with h5py.File(source, "r") as file:
            return bool(file.attrs.get("format") == FORMAT)
    except OSError:
        return False


def _write(file: Any, fit: Fit) -> None:
    file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
    for name in MATRICES:
        file[f"model/{name}"] = getattr(fit.model, name)
    file["model"].attrs["dt"] = fit.model.dt
    for name in ARRAYS:
        file[name] = getattr(fit, name)
    if fit.parameter_covariance is not None:
        file["parameter_covariance"] = fit.parameter_covariance
    if fit.gram is not None:
        _write_gram(file.create_group("gram"), fit.gram)
    numbers = file.create_group("figures")
    texts = {}
    for name, value in fit.diagnostics.figures.items():
        if isinstance(value, np.ndarray):
            numbers[name] = value
        else:
            texts[name] = value
    file.attrs["figures"] = json.dumps(texts, default=float)
    file.attrs["findings"] = json.dumps([dataclasses.asdict(f) for f in fit.diagnostics.findings])
    file.attrs["segments"] = json.dumps([dataclasses.astuple(s) for s in fit.segments])
    file.attrs["inputs"] = json.dumps([dataclasses.asdict(c) for c in fit.input_channels])
    file.attrs["outputs"] = json.dumps([dataclasses.asdict(c) for c in fit.output_channels])
    file.attrs["method"] = _method_name(fit.method)
    file.attrs["options"] = json.dumps(_options(fit.method))


def _method_name(method: Any) -> str:
    return next(name for name, kind in METHODS.items() if type(method) is kind)


def _options(method: Any) -> dict[str, Any]:
    """Return the options of a method; one that is a method itself keeps its name."""
    options = {}
    for field in dataclasses.fields(method):
        value = getattr(method, field.name)
        if dataclasses.is_dataclass(value):
            value = {"method": _method_name(value), **_options(value)}
        options[field.name] = value
    return options


def _method(name: str, options: dict[str, Any]) -> Any:
    made = {}
    for key, value in options.items():
        if isinstance(value, dict):
            inner = dict(value)
            made[key] = _method(inner.pop("method"), inner)
        else:
            made[key] = tuple(value) if isinstance(value, list) else value
    return METHODS[name](**made)


def _write_gram(group: Any, gram: BlockGram) -> None:
    for name in GRAM_ARRAYS:
        group[name] = getattr(gram, name)
    group.attrs["n_inputs"], group.attrs["offset"] = gram.n_inputs, gram.offset


def _read(file: Any) -> Fit:
    arrays = {name: file[name][()] for name in ARRAYS}
    A, B, C, D = (file[f"model/{name}"][()] for name in MATRICES)
    attributes = {
        name: json.loads(file.attrs[name])
        for name in ("figures", "findings", "segments", "inputs", "outputs", "options")
    }
    segments = tuple(Segment(*each) for each in attributes["segments"])
    figures = {
        **{
            name: tuple(value) if isinstance(value, list) else value
            for name, value in attributes["figures"].items()
        },
        **{name: data[()] for name, data in file["figures"].items()},
    }
    covariance = file.get("parameter_covariance")
    return Fit(
        model=StateSpace(A, B, C, D, float(file["model"].attrs["dt"])),
        segments=segments,
        method=_method(file.attrs["method"], attributes["options"]),
        order=len(A),
        parameter_covariance=None if covariance is None else covariance[()],
        diagnostics=Diagnostics(figures, tuple(Finding(**f) for f in attributes["findings"])),
        gram=_read_gram(file["gram"], segments) if "gram" in file else None,
        input_channels=tuple(Channel(**c) for c in attributes["inputs"]),
        output_channels=tuple(Channel(**c) for c in attributes["outputs"]),
        **arrays,
    )


def _read_gram(group: Any, segments: tuple[Segment, ...]) -> BlockGram:
    return BlockGram(
        **{name: group[name][()] for name in GRAM_ARRAYS},
        segments=segments,
        n_inputs=int(group.attrs["n_inputs"]),
        offset=str(group.attrs["offset"]),
    )
