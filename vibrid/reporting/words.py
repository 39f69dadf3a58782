"""Small pieces of text: numbers, channels, lengths, tables without vertical lines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from rich import box
from rich.console import RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from ..fit import Finding
from ..record import Channel, Record

NAMES_SHOWN = 6
LONG = 1e7  # decimals are for numbers below it


def heading(words: str) -> Text:
    return Text(words, style="bold")


def line(words: str, style: str = "") -> Padding:
    """Return indented text; never read as markup, for names may hold brackets."""
    return Padding(Text(words, style=style), (0, 0, 0, 2))


def indented(made: Table) -> Padding:
    return Padding(made, (0, 0, 0, 2))


def table(*columns: str, left: Sequence[str] = ()) -> Table:
    """Return an empty table; the columns named in `left` stand left, numbers right.

    Only the first of `left`, the names, may break into several lines.
    """
    made = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for name in columns:
        breaks = name in left[:1]
        made.add_column(
            Text(name),
            justify="left" if name in left else "right",
            no_wrap=not breaks,
            overflow="fold" if breaks else "ellipsis",
            min_width=len(name) if breaks else None,
        )
    return made


def add(target: Table, *cells: str, style: str = "") -> None:
    target.add_row(*(Text(cell) for cell in cells), style=style)


def number(value: float, form: str = ".4g") -> str:
    """Return a number, or – where there is none; decimals are not shown of a huge one.

    >>> number(12.345, ".1f"), number(-3.2e80, ".1f"), number(1.23456e7, ".5g"), number(math.nan)
    ('12.3', '-3.2e+80', '1.2346e+07', '–')
    """
    if not math.isfinite(value):
        return "–"
    huge = abs(value) >= LONG and form.endswith("f")
    return format(value, ".3g" if huge else form)


def change(ratio: float, digits: int) -> str:
    """Return the signed difference of a ratio from 1 in percent.

    >>> change(1.0012, 2), change(1 - 1e-9, 2)
    ('+0.12', '+0.00')
    """
    return number(round(100 * (ratio - 1), digits) + 0.0, f"+.{digits}f")


def hertz(value: float) -> str:
    """Return a frequency of three digits without an exponent.

    >>> hertz(19731.4), hertz(0.012345)
    ('19700', '0.0123')
    """
    return f"{float(f'{value:.3g}'):g}"


def plural(count: int, word: str) -> str:
    """
    >>> plural(1, "input"), plural(3, "output")
    ('1 input', '3 outputs')
    """
    return f"{count} {word}{'' if count == 1 else 's'}"


def duration(seconds: float) -> str:
    """
    >>> duration(9.5), duration(900.0), duration(5400.0)
    ('9.5 s', '900 s (15 min)', '5400 s (90 min)')
    """
    return f"{seconds:.4g} s" + (f" ({seconds / 60:.3g} min)" if seconds >= 180 else "")


def size(record: Record) -> str:
    rate = f"{1 / record.dt:.6g} Hz"
    return f"{record.n_samples} samples at {rate}, {duration(record.duration)}"


def channel_names(channels: Sequence[Channel]) -> str:
    """Return names, the middle of many left out."""
    names = [channel.name for channel in channels]
    if len(names) > NAMES_SHOWN:
        names = [*names[: NAMES_SHOWN - 2], "…", names[-1]]
    return ", ".join(names)


def kinds(channels: Sequence[Channel]) -> str:
    """Return quantity and unit of the channels, with counts where they differ."""
    counts: dict[str, int] = {}
    for channel in channels:
        label = _kind(channel)
        counts[label] = counts.get(label, 0) + 1
    if len(counts) == 1:
        return next(iter(counts))
    return "; ".join(f"{count} {label}" for label, count in counts.items())


def _kind(channel: Channel) -> str:
    if channel.quantity == "other":
        return f"in {channel.unit}, quantity not stated" if channel.unit else "quantity not stated"
    quantity = channel.quantity.replace("_", " ")
    return f"{quantity} in {channel.unit}" if channel.unit else f"{quantity}, unit not stated"


def finding_line(finding: Finding) -> Padding:
    return line(f"{finding.severity}: {finding}", "yellow" if finding.severity == "warning" else "")


def findings_section(findings: Sequence[Finding]) -> Iterator[RenderableType]:
    """Yield a heading and a line for each finding; nothing where there is none."""
    if findings:
        yield heading("Findings")
        yield from map(finding_line, findings)
