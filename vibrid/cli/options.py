"""Options of the commands; those of the methods come from the methods' own fields."""

from __future__ import annotations

import csv
import dataclasses
import types
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Group, Parameter

from ..chunks import OFFSETS
from ..errors import OptionError, check_choice
from ..files import read_record
from ..identification.stability import POLICIES
from ..methods import METHODS
from ..record import QUANTITIES, FrequencyResponses, Record

READING = Group("Reading the file", sort_key=1)
IDENTIFYING = Group("Identifying", sort_key=2)
METHOD_OPTIONS = Group("Options of the methods named in brackets", sort_key=3)
RESULTS = Group("Results", sort_key=5)

LARGEST_LOADED = 2**31  # bytes as float64: larger records stay on disk

Names = tuple[str, ...]


def help_of(words: str, **more: Any) -> Parameter:
    return Parameter(help=words, **more)


@Parameter(name="*", group=READING)
@dataclass(frozen=True)
class Reading:
    """How a file is read."""

    inputs: Annotated[
        Names | None,
        help_of(
            "Channels that drive the structure: a,b,c or repeated, names with commas in double "
            "quotes; '' for none. Default: as the file says, else none."
        ),
    ] = None
    outputs: Annotated[
        Names | None, help_of("Channels that respond. Default: all that are not inputs.")
    ] = None
    dt: Annotated[float | None, help_of("Sampling interval [s]. Default: from the file.")] = None
    channels: Annotated[
        Path | None,
        help_of(
            "TOML or CSV file that describes channels: name, quantity, unit, dof, sign, delay [s], "
            "role. Default: none."
        ),
    ] = None
    quantity: Annotated[
        Names,
        help_of(
            f"What a channel measures, NAME=QUANTITY, repeated: {', '.join(QUANTITIES)}. Default: "
            "by unit, else other."
        ),
    ] = ()
    dof: Annotated[
        Names,
        help_of(
            "Degree of freedom, NAME=LABEL, repeated; joins sensors and forces at one point. "
            "Default: from the file, else none."
        ),
    ] = ()
    unit: Annotated[
        Names,
        help_of("Unit, NAME=UNIT, repeated, such as m/s2, g, mm or N. Default: from the file."),
    ] = ()
    variable: Annotated[
        Names,
        help_of(
            "Array of a MAT, NPZ or HDF5 file, or group of a TDMS file, that holds the signals. "
            "Default: the only one."
        ),
    ] = ()
    transpose: Annotated[
        bool,
        help_of("Time runs along the last axis of the arrays. Default: along the first."),
    ] = False
    correct_delays: Annotated[
        bool, help_of("Shift channels by the delays [s] that --channels states. Default: no.")
    ] = False

    def read(self, file: Path) -> Record | FrequencyResponses:
        """Return what the file holds, delays removed if asked."""
        content = read_record(
            file,
            inputs=split_names(self.inputs),
            outputs=split_names(self.outputs),
            dt=self.dt,
            channels=self.channels,
            quantities=pairs("quantity", self.quantity),
            dofs=pairs("dof", self.dof),
            units=pairs("unit", self.unit),
            variable=split_names(self.variable) or None,
            transpose=self.transpose,
        )
        if self.correct_delays and isinstance(content, Record):
            return loaded(content, "--correct-delays").correct_delays()
        return content


def loaded(record: Record, option: str) -> Record:
    """Return a record in memory, as filters need it, or refuse one that is too large."""
    if record.is_in_memory:
        return record
    size = 8 * record.n_samples * (record.n_inputs + record.n_outputs)
    if size > LARGEST_LOADED:
        raise OptionError(
            f"{option} needs the record in memory, {size / 2**30:.3g} GiB; at most "
            f"{LARGEST_LOADED / 2**30:g} GiB are loaded. Choose fewer channels (--outputs), leave "
            f"{option} out, or decimate the file first."
        )
    return record.in_memory()


@Parameter(name="*", group=IDENTIFYING)
@dataclass(frozen=True)
class Identifying:
    """What is identified, and how."""

    band: Annotated[
        tuple[float, float] | None,
        help_of(
            "LOW HIGH [Hz]: filter and decimate to the band of interest; LOW may be 0. "
            "Default: all up to half the sampling rate."
        ),
    ] = None
    method: Annotated[
        str | None,
        help_of(
            f"{' or '.join(METHODS)}. Default: n4sid when there are inputs, ssi when there are "
            "none."
        ),
    ] = None
    order: Annotated[
        str,
        help_of(
            "Number of states (two for each mode), or auto: chosen from the data. Default: auto."
        ),
    ] = "auto"
    offset: Annotated[
        str,
        help_of(
            "What to do about constant offsets: estimate (project them out), mean (subtract means) "
            "or none. Default: estimate."
        ),
    ] = "estimate"
    stability: Annotated[
        str,
        help_of(
            f"What to do about an unstable model: {', '.join(POLICIES)}; raise stops with an "
            "error, project moves its poles inside. Default: raise."
        ),
    ] = "raise"
    feedthrough: Annotated[
        bool | None,
        help_of(
            "Whether inputs act on outputs within the same sample (matrix D). Default: all but "
            "displacements and velocities.",
            negative="--no-feedthrough",
        ),
    ] = None

    refine: Annotated[
        bool,
        help_of(
            "Improve the model by maximum likelihood, with standard deviations; with inputs and "
            "order auto, the order by elimination. Default: the subspace model."
        ),
    ] = False

    def check(self) -> None:
        """Refuse what no record could make right, before any work."""
        check_choice("--offset", self.offset, OFFSETS)
        check_choice("--stability", self.stability, POLICIES)
        if self.method is not None:
            check_choice("--method", self.method, list(METHODS))
        self.chosen_order()

    def chosen_order(self) -> int | str:
        """Return the order as a number, or "auto"."""
        if self.order == "auto":
            return "auto"
        if not self.order.isdecimal() or len(self.order) > 9 or int(self.order) < 1:
            raise OptionError(
                f"--order must be auto or a whole number, at least 1; got {self.order!r}."
            )
        return int(self.order)


@Parameter(name="*", group=RESULTS)
@dataclass(frozen=True)
class Results:
    """Where results go."""

    save: Annotated[
        Path | None,
        help_of(
            "Write the model to this file (HDF5), such as run.vibrid.h5; vibrid info shows it. "
            "Default: not written."
        ),
    ] = None
    json: Annotated[bool, help_of("Print one JSON object instead of tables. Default: tables.")] = (
        False
    )


def split_names(values: Sequence[str] | None) -> list[str] | None:
    """Return names given with commas, repeated, or both; double quotes keep a comma.

    >>> split_names(("a,b", "c")), split_names(("",)), split_names(None)
    (['a', 'b', 'c'], [], None)
    >>> split_names(('"hammer, left",a',))
    ['hammer, left', 'a']
    """
    if values is None:
        return None
    rows = csv.reader(values, skipinitialspace=True)
    return [name.strip() for row in rows for name in row if name.strip()]


def pairs(option: str, values: Sequence[str]) -> dict[str, str]:
    """Return name → value of NAME=VALUE; the last = parts them.

    >>> pairs("unit", ("acc1=g,acc2=g", "f=N"))
    {'acc1': 'g', 'acc2': 'g', 'f': 'N'}
    """
    found = {}
    for text in split_names(values) or []:
        name, equals, value = text.rpartition("=")
        if not (name and equals and value):
            raise OptionError(f"--{option} takes NAME=VALUE; got {text!r}.")
        found[name] = value
    return found


def method_of(name: str, given: Mapping[str, Any]) -> Any:
    """Return a method with the options that were given.

    Raises
    ------
    OptionError
        An option that belongs to another method, or a value that it refuses.
    """
    kind = METHODS[name]
    own = {field.name: field for field in dataclasses.fields(kind)}
    for option in given:
        if option not in own:
            owners = " and ".join(_owners(option))
            raise OptionError(
                f"{_flag(option)} is an option of {owners}; {name} takes "
                f"{', '.join(map(_flag, own))}."
            )
    return kind(**{option: _settled(value) for option, value in given.items()})


def given_options(options: Any) -> dict[str, Any]:
    """Return the method options that were named on the command line."""
    values = {field.name: getattr(options, field.name) for field in dataclasses.fields(options)}
    return {name: value for name, value in values.items() if value is not None}


def option_type(methods: Mapping[str, type]) -> type:
    """Return a dataclass with the fields of every method, all None until given."""
    fields: dict[str, list[tuple[str, dataclasses.Field[Any], Any]]] = {}
    for name, kind in methods.items():
        hints = typing.get_type_hints(kind)
        for field in dataclasses.fields(kind):
            hint = field.metadata.get("type", hints[field.name])
            fields.setdefault(field.name, []).append((name, field, hint))
    made = dataclasses.make_dataclass(
        "MethodOptions",
        [
            (name, _annotation(owners), dataclasses.field(default=None))
            for name, owners in fields.items()
        ],
        frozen=True,
        # without a module of its own, the command line takes it for a built-in type
        namespace={"__module__": __name__},
    )
    return Parameter(name="*", group=METHOD_OPTIONS)(made)


def _annotation(owners: Sequence[tuple[str, dataclasses.Field[Any], Any]]) -> Any:
    hint: Any = None
    for _, _, each in owners:
        hint = each | hint
    is_flag = bool in typing.get_args(hint)
    return Annotated[hint, Parameter(help=_described(owners), negative=None if is_flag else ())]


def _described(owners: Sequence[tuple[str, dataclasses.Field[Any], Any]]) -> str:
    """Return the help of one option; what several methods say alike is said once."""
    said: dict[str, list[str]] = {}
    for name, field, _ in owners:
        words = field.metadata.get("help", field.name.replace("_", " "))
        # None means chosen, or all: the words say so
        known = field.default is not None and field.default is not dataclasses.MISSING
        said.setdefault(words + (f" (default {field.default})" if known else ""), []).append(name)
    return " ".join(f"[{', '.join(names)}] {words}." for words, names in said.items())


def _owners(option: str) -> list[str]:
    return [
        name
        for name, kind in METHODS.items()
        if option in {field.name for field in dataclasses.fields(kind)}
    ]


def _flag(option: str) -> str:
    return "--" + option.replace("_", "-")


def _settled(value: Any) -> Any:
    """Return names in a tuple with their commas split."""
    return tuple(split_names(value) or ()) if isinstance(value, tuple) else value


if TYPE_CHECKING:
    MethodOptions = types.SimpleNamespace
else:
    MethodOptions = option_type(METHODS)
