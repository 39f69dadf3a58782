"""TDMS: LabVIEW's measurement files, by the optional package npTDMS."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DataError, FileError, OptionError, check_names
from .labels import channel_of
from .tables import Columns, Part, Table, check_unique_names, reading


def read_tdms(path: Path, *, variable: Any = None, **_: Any) -> Table:
    """Read the channels of one group; `variable` names the group where there are several."""
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise OptionError(f"To read {path}, install npTDMS: pip install 'vibrid[tdms]'.") from None
    with reading(path, "a TDMS file"), _quiet():
        file = TdmsFile.read(path)
        if file.file_status.incomplete_final_segment:
            raise FileError(f"{path} is truncated: its last segment is incomplete. Copy it again.")
        group = _group(path, file, variable)
        channels = [channel for channel in group.channels() if len(channel)]
        _check(path, channels)
        labels = tuple(
            channel_of(channel.name, str(channel.properties.get("unit_string", "")))
            for channel in channels
        )
        signal = Columns(tuple(Part(np.asarray(channel[:])) for channel in channels), path)
        return Table(signal, labels, dt=_interval(path, channels), name=path.name)


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep npTDMS from printing; what it warns of is refused here."""
    from nptdms.log import log_manager

    level = log_manager.log_level
    log_manager.set_level(logging.CRITICAL)
    try:
        yield
    finally:
        log_manager.set_level(level)


def _group(path: Path, file: Any, variable: Any) -> Any:
    groups = [group for group in file.groups() if any(len(c) for c in group.channels())]
    names = [group.name for group in groups]
    if not groups:
        raise FileError(f"{path} holds no channel with samples.")
    if variable is not None:
        check_names("group", [variable], names)
        return groups[names.index(variable)]
    if len(groups) > 1:
        raise OptionError(
            f"{path} holds several groups: {', '.join(names)}; give variable (--variable NAME)."
        )
    return groups[0]


def _check(path: Path, channels: list[Any]) -> None:
    check_unique_names(path, [channel.name for channel in channels])
    for channel in channels:
        if channel.dtype.kind not in "iuf":
            raise DataError(f"Channel {channel.name!r} of {path} does not hold real numbers.")
        if len(channel) != len(channels[0]):
            raise FileError(
                f"{path} has channels of different length: {channels[0].name!r} has "
                f"{len(channels[0])} samples, {channel.name!r} has {len(channel)}."
            )


def _interval(path: Path, channels: list[Any]) -> float | None:
    steps = {channel.name: channel.properties.get("wf_increment") for channel in channels}
    if len(set(steps.values())) > 1:
        listed = ", ".join(f"{name}: {step}" for name, step in steps.items())
        raise FileError(f"{path} has channels of different sampling interval ({listed}) s.")
    step = next(iter(steps.values()))
    return None if step is None else float(step)
