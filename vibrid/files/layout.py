"""How a text file is laid out: delimiter, decimal sign, headings."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileError

MISSING = ("", "nan")

Line = tuple[int, str]  # line number in the file, text


@dataclass(frozen=True)
class Layout:
    """How the rows of a text file are cut into numbers."""

    delimiter: str | None  # None: any white space
    n_columns: int
    decimal_comma: bool = False
    trailing: bool = False  # every line ends with the delimiter
    quoted: bool = False


def layout_of(
    path: Path, sample: Sequence[Line], comments: Sequence[str]
) -> tuple[Layout, list[str], int]:
    """Settle how rows are cut; return it with the headings and how many lines these take."""
    every = [text for _, text in sample]
    rows = every[1:] or every
    delimiter = _delimiter(rows)
    trailing = delimiter is not None and all(text.endswith(delimiter) for text in every)
    decimal_comma = _decimal_comma(path, rows, delimiter)
    first = _headings(every[0], delimiter, trailing)
    is_heading = not all(_is_number(cell, decimal_comma) for cell in first)
    if is_heading and len(sample) == 1:
        raise FileError(f"{path} holds one line of text and no numbers; give rows of samples.")
    if is_heading:
        _check_heading(path, sample[0], first)
    second = _headings(every[1], delimiter, trailing) if is_heading else first
    if len(first) != len(second):
        raise FileError(
            f"{path} has {len(first)} names in its heading (line {sample[0][0]}) and "
            f"{len(second)} cells in line {sample[1][0]}; they must agree."
        )
    quoted = any('"' in text for text in every)
    layout = Layout(delimiter, len(second), decimal_comma, trailing, quoted)
    if is_heading:
        return layout, first, 1
    return layout, _commented(comments, delimiter, len(first)), 0


def _delimiter(rows: Sequence[str]) -> str | None:
    if any(";" in row for row in rows):
        return ";"
    if all("\t" in row for row in rows) and not any(
        len(cell.split()) > 1 for row in rows for cell in row.split("\t")
    ):
        return "\t"
    return "," if any("," in row for row in rows) else None


def _decimal_comma(path: Path, rows: Sequence[str], delimiter: str | None) -> bool:
    if delimiter not in (";", "\t"):
        return False
    comma, point = (any(sign in row for row in rows) for sign in ",.")
    if comma and point:
        raise FileError(
            f"{path} uses both comma and point inside numbers, so the decimal sign is unclear; "
            "export it with one decimal sign and no thousands separator."
        )
    return comma


def _headings(text: str, delimiter: str | None, trailing: bool) -> list[str]:
    if delimiter is None:
        # a unit set apart by a blank belongs to the name before it
        return re.sub(r"\s+(?=[\[(])", "", text).split()
    cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True))
    cells = [cell.strip() for cell in cells]
    return cells[:-1] if trailing else cells


def _check_heading(path: Path, line: Line, cells: Sequence[str]) -> None:
    """Refuse a first line of measured numbers with a damaged cell; 1, 2, … may be names."""
    for cell in cells:
        if not cell.isdigit() and _is_number(cell, "," in cell) and cell:
            text = next(c for c in cells if not _is_number(c, "," in c))
            raise FileError(
                f"Line {line[0]} of {path} mixes text ({text[:40]!r}) and numbers ({cell}); the "
                "heading must name every column, and a row of samples holds only numbers."
            )


def _commented(comments: Sequence[str], delimiter: str | None, count: int) -> list[str]:
    """Return the names in the last comment, as NumPy's savetxt writes them, or []."""
    if not comments or delimiter is None:
        return []
    cells = _headings(comments[-1].lstrip("#% "), delimiter, False)
    is_heading = len(cells) == count and not any(_is_number(cell, False) for cell in cells)
    return cells if is_heading else []


def _is_number(cell: str, decimal_comma: bool) -> bool:
    try:
        number_of(cell, decimal_comma)
    except ValueError:
        return False
    return True


def number_of(cell: str, decimal_comma: bool) -> float:
    """Return the number in a cell, NaN where a sample is missing; ValueError for anything else."""
    text = cell.strip()
    if text.lower() in MISSING:
        return np.nan
    if "_" in text or (decimal_comma and "." in text):
        raise ValueError
    return float(text.replace(",", ".") if decimal_comma else text)
