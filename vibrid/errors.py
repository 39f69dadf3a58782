"""The exceptions that vibrid raises, and the small checks that raise them.

::

    VibridError
    ├── OptionError            wrong use: an argument, option or name (exit status 2)
    │   └── PathError          a path that cannot be opened or written
    └── DataError              data that cannot be identified (exit status 1)
        ├── FileError          a damaged, truncated or unsupported file
        └── UnstableModelError a model with poles on or outside the stability limit

Every message names the number, the limit and the cure.
"""

from __future__ import annotations

import difflib
import math
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

ALIKE = 0.5  # of difflib's ratio: "accel" is meant for "acceleration"


class VibridError(Exception):
    """Base of all errors that vibrid raises on purpose."""


class OptionError(VibridError, ValueError):
    """An argument, option or name that cannot be meant."""


class PathError(OptionError):
    """A path that cannot be opened for reading or writing."""


class DataError(VibridError, ValueError):
    """Data that cannot be identified as they are."""


class FileError(DataError):
    """A file that is damaged, truncated or of an unsupported kind."""


class UnstableModelError(DataError):
    """A model that has poles on or outside the stability limit."""


def check_choice(name: str, value: object, choices: Sequence[str]) -> None:
    """Raise `OptionError` unless `value` is one of `choices`; suggest the nearest."""
    if value in choices:
        return
    near = difflib.get_close_matches(str(value), choices, n=1, cutoff=ALIKE)
    hint = f" Did you mean {near[0]!r}?" if near else ""
    raise OptionError(f"{name} must be one of {', '.join(choices)}; got {value!r}.{hint}")


def check_names(kind: str, wanted: Iterable[str], known: Sequence[str]) -> None:
    """Raise `OptionError` when a wanted name is unknown; suggest the nearest."""
    for name in wanted:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1, cutoff=ALIKE)
            hint = f" Did you mean {near[0]!r}?" if near else ""
            shown = ", ".join(known[:12]) + (" …" if len(known) > 12 else "")
            raise OptionError(f"No {kind} is called {name!r}; there are {shown}.{hint}")


def check_positive(name: str, value: float, unit: str = "") -> None:
    """Raise `OptionError` unless `value` is a positive finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise OptionError(f"{name} must be a positive number; got {value!r}.")
    if not (math.isfinite(value) and value > 0):
        raise OptionError(f"{name} must be positive; got {value:g}{' ' + unit if unit else ''}.")


def check_whole(name: str, value: object, smallest: int, largest: int | None = None) -> None:
    """Raise `OptionError` unless `value` is a whole number in [smallest, largest]."""
    limits = f"at least {smallest}" if largest is None else f"from {smallest} to {largest}"
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise OptionError(f"{name} must be a whole number, {limits}; got {value!r}.")
    if value < smallest or (largest is not None and value > largest):
        raise OptionError(f"{name} must be {limits}; got {value}.")


def check_readable(path: str | os.PathLike[str]) -> Path:
    """Return `path` as a Path, or raise `PathError` when it is not a readable file."""
    path = Path(path)
    try:
        if path.is_dir():
            raise PathError(f"{path} is a folder; give the path of a file in it.")
        if path.exists() and not path.is_file():  # a pipe would be waited for, and read once only
            raise PathError(f"{path} is a pipe or device; write its content to a file first.")
        with path.open("rb") as file:
            file.read(1)
        return path
    except FileNotFoundError:
        raise PathError(f"There is no file {path}. Check the path.") from None
    except OSError as problem:
        raise PathError(f"{path} cannot be read: {problem.strerror}.") from None


def check_writable(path: str | os.PathLike[str]) -> Path:
    """Return `path` as a Path, or raise `PathError` when it cannot be written.

    Called before the work begins, so that no result is lost at the end. A file is made beside
    it and removed; what `path` holds is not touched.
    """
    path = Path(path)
    folder = path.parent
    try:
        if path.is_dir():
            raise PathError(f"{path} is a folder; give the path of a file to write.")
        if not folder.is_dir():
            raise PathError(f"There is no folder {folder}; make it first or write elsewhere.")
        if path.exists() and not path.is_file():  # to replace a device would break the system
            raise PathError(f"{path} is a pipe or device; give the path of a file to write.")
        if path.exists() and not os.access(path, os.W_OK):
            raise PathError(f"{path} is not writable; write elsewhere.")
        with tempfile.NamedTemporaryFile(prefix=f".{path.name}.", dir=folder):
            return path
    except OSError as problem:
        raise PathError(f"{path} cannot be written: {problem.strerror}; write elsewhere.") from None
