"""Names, units and roles: what a user or a channel file says about the channels of a file."""

from __future__ import annotations

import csv
import dataclasses
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import FileError, OptionError, check_choice, check_names, check_readable
from ..record import Channel, Quantity

KEYS = ("name", "quantity", "unit", "dof", "sign", "delay", "role")
ROLES = ("input", "output")
WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<square>[^\[\]]*)\]|\((?P<round>[^()]*)\))$")
ALIAS = re.compile(r"^(?:ch|col)?([1-9][0-9]*)$")

_UNITS: dict[Quantity, tuple[str, ...]] = {
    "force": ("N", "kN", "MN", "mN", "lbf", "kgf"),
    "displacement": ("m", "mm", "cm", "µm", "um", "μm", "nm", "in"),
    "velocity": ("m/s", "mm/s", "cm/s", "in/s", "µm/s", "um/s"),
    "acceleration": (
        *("m/s2", "m/s^2", "m/s²", "m/s**2", "cm/s2", "cm/s^2", "cm/s²", "mm/s2", "mm/s^2"),
        *("mm/s²", "g", "mg", "Gal", "gal"),
    ),
}
QUANTITY_OF_UNIT = {unit: quantity for quantity, units in _UNITS.items() for unit in units}


def split_unit(label: str) -> tuple[str, str]:
    """Return name and unit of a heading.

    >>> split_unit("acc1 [m/s2]"), split_unit("acc1 (g)"), split_unit("acc1")
    (('acc1', 'm/s2'), ('acc1', 'g'), ('acc1', ''))
    """
    match = WITH_UNIT.match(label.strip())
    if match is None or not match["name"]:
        return label.strip(), ""
    return match["name"], (match["square"] or match["round"] or "").strip()


def channel_of(name: str, unit: str = "", **more: Any) -> Channel:
    """Return a channel; its unit, when known, tells the quantity (N: force, g: acceleration)."""
    return Channel(name, QUANTITY_OF_UNIT.get(unit, "other"), unit=unit, **more)


def resolve(names: Sequence[str], known: Sequence[str], numbered: bool) -> list[str]:
    """Return the channel names meant by `names`: "3" and "col3" mean ch3 where names are numbers.

    Raises
    ------
    OptionError
        An unknown or a repeated name.
    """
    if isinstance(names, str):
        names = [names]
    meant = [_meant(str(name), known, numbered) for name in names]
    check_names("channel", meant, known)
    for name in meant:
        if meant.count(name) > 1:
            raise OptionError(f"Channel {name!r} is named twice; name it once.")
    return meant


def override(
    channels: Sequence[Channel], changes: Mapping[str, Mapping[str, Any]], numbered: bool
) -> tuple[Channel, ...]:
    """Return the channels with fields replaced: `changes` is field → name → value."""
    known = [channel.name for channel in channels]
    fields: dict[str, dict[str, Any]] = {name: {} for name in known}
    for field, values in changes.items():
        for name, value in zip(
            resolve(list(values), known, numbered), values.values(), strict=True
        ):
            fields[name][field] = value
    return tuple(_replace(channel, fields[channel.name]) for channel in channels)


def read_channel_file(path: str | Path) -> dict[str, dict[str, Any]]:
    """Read a TOML or CSV channel file into name → fields.

    TOML holds one ``[[channel]]`` table a channel, CSV one row; the keys are name, quantity,
    unit, dof, sign, delay [s] and role (input or output). Only `name` is needed.

    Raises
    ------
    OptionError
        Unknown keys or values, a missing or repeated name, another extension.
    """
    path = check_readable(path)
    readers = {".toml": _toml_rows, ".csv": _csv_rows}
    if path.suffix.lower() not in readers:
        raise OptionError(f"A channel file is .toml or .csv; got {path}.")
    described: dict[str, dict[str, Any]] = {}
    for row in readers[path.suffix.lower()](path):
        fields = _check_row(path, row)
        name = fields.pop("name")
        if name in described:
            raise OptionError(f"{path} describes channel {name!r} twice; keep one.")
        described[name] = fields
    if not described:
        raise OptionError(f"{path} describes no channel; write one [[channel]] or one row each.")
    return described


def _meant(name: str, known: Sequence[str], numbered: bool) -> str:
    match = ALIAS.match(name)
    if name in known or not numbered or match is None:
        return name
    return f"ch{match[1]}"


def _replace(channel: Channel, fields: Mapping[str, Any]) -> Channel:
    new = dict(fields)
    if "unit" in new and "quantity" not in new and channel.quantity == "other":
        new["quantity"] = QUANTITY_OF_UNIT.get(new["unit"], "other")
    return dataclasses.replace(channel, **new)


def _toml_rows(path: Path) -> list[dict[str, Any]]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise FileError(f"{path} is not valid TOML: {problem}.") from None
    check_names("key of a channel file", content, ("channel",))
    rows = content.get("channel", [])
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise OptionError(f"{path} must hold one [[channel]] table for each channel.")
    return rows


def _csv_rows(path: Path) -> list[dict[str, Any]]:
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = [row for row in csv.reader(file, skipinitialspace=True) if "".join(row).strip()]
    except (csv.Error, UnicodeDecodeError) as problem:
        raise FileError(f"{path} is not a readable CSV file: {problem}.") from None
    if not lines:
        raise OptionError(f"{path} is empty; its first line names the columns {', '.join(KEYS)}.")
    keys = [key.strip() for key in lines[0]]
    for number, cells in enumerate(lines[1:], start=2):
        if len(cells) != len(keys):
            raise FileError(f"{path} has {len(cells)} cells in row {number}; expected {len(keys)}.")
    # an empty cell says nothing, so the default stays
    return [
        {key: cell.strip() for key, cell in zip(keys, cells, strict=True) if cell.strip()}
        for cells in lines[1:]
    ]


def _check_row(path: Path, row: Mapping[str, Any]) -> dict[str, Any]:
    check_names("key of a channel", row, KEYS)
    fields = dict(row)
    if not isinstance(fields.get("name"), str) or not fields["name"]:
        raise OptionError(f"{path} describes a channel without a name; give each a name.")
    for key in ("quantity", "unit", "dof"):
        if key in fields:
            fields[key] = str(fields[key])
    if "role" in fields:
        check_choice(f"role of channel {fields['name']!r}", fields["role"], ROLES)
    for key, kind in (("sign", int), ("delay", float)):
        if key in fields:
            fields[key] = _number(fields["name"], key, fields[key], kind)
    return fields


def _number(name: str, key: str, value: Any, kind: type) -> Any:
    try:
        if isinstance(value, bool):
            raise ValueError
        number = float(value)
        if number != number or (kind is int and number not in (1, -1)):
            raise ValueError
        return kind(number)
    except (TypeError, ValueError, OverflowError):
        wanted = "1 or -1" if kind is int else "a number of seconds"
        raise OptionError(f"{key} of channel {name!r} must be {wanted}; got {value!r}.") from None
