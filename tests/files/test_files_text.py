"""Text files: delimiters, headings, time columns, gaps, and where a damaged line is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vibrid.errors import FileError, OptionError, VibridError
from vibrid.files import read_record
from vibrid.record import Record

ROWS = [(0.25 * k, float(np.sin(k)), float(k % 5)) for k in range(12)]


def record_of(path: Path, text: str, **options: object) -> Record:
    """Write text and read it as a record."""
    path.write_text(text, encoding="utf-8")
    record = read_record(path, **options)  # type: ignore[arg-type]
    assert isinstance(record, Record)
    return record


def lines(delimiter: str, *, decimal: str = ".", end: str = "", rows: object = ROWS) -> str:
    """Return rows of numbers as text."""
    texts = (delimiter.join(repr(x) for x in row) + end for row in rows)  # type: ignore[attr-defined]
    return "\n".join(texts).replace(".", decimal) + "\n"


@pytest.mark.parametrize(
    ("heading", "delimiter", "decimal", "end"),
    [
        ("t,a,b\n", ",", ".", ""),
        ("Zeit [s];a;b\n", ";", ",", ""),
        ("time\ta\tb\n", "\t", ".", ""),
        ("Time (s)\ta\tb\t\n", "\t", ",", "\t"),
        ("# a comment\nt a b\n", " ", ".", ""),
        ('"t", "a", "b"\n', ",", ".", ""),
        ("% data\n\n", "   ", ".", "\t"),
        ("", ",", ".", ","),
        ("# t,a,b\n", ",", ".", ""),
    ],
)
def test_layouts(tmp_path: Path, heading: str, delimiter: str, decimal: str, end: str) -> None:
    """Delimiter, decimal sign, trailing delimiters and headings are recognized."""
    text = heading + lines(delimiter, decimal=decimal, end=end)
    record = record_of(tmp_path / "a.csv", text)
    assert record.dt == pytest.approx(0.25)
    assert record.output_names == (("a", "b") if "b" in heading else ("ch1", "ch2"))
    np.testing.assert_array_equal(record.outputs, np.array(ROWS)[:, 1:])


def test_units_tell_the_quantity(tmp_path: Path) -> None:
    """Units stand in brackets after the name; they say force or acceleration."""
    text = "t [ms],acc1 [m/s2],acc2 (g),hammer [N],x\n" + lines(
        ",", rows=[(k, 1.5 * k, k % 3, k % 2, k % 7) for k in range(9)]
    )
    record = record_of(tmp_path / "a.csv", text)
    assert record.dt == pytest.approx(1e-3)
    described = [(c.name, c.quantity, c.unit) for c in record.output_channels]
    assert described == [
        ("acc1", "acceleration", "m/s2"),
        ("acc2", "acceleration", "g"),
        ("hammer", "force", "N"),
        ("x", "other", ""),
    ]


def test_empty_cells_and_nan_are_gaps(tmp_path: Path) -> None:
    """Missing samples become NaN, and nothing else changes."""
    rows = lines(",").replace("\n0.5,", "\n0.5,,1\n#0.5,").replace("\n1.0,", "\n1.0,NaN,2\n#")
    record = record_of(tmp_path / "a.csv", "t,a,b\n" + rows)
    assert np.isnan(record.outputs[:, 0]).nonzero()[0].tolist() == [2, 4]
    assert record.outputs[2, 1] == 1
    rows = lines("\t").replace("\t0.0\n", "\t\n").replace("\t1.0\n", "\t \n")
    tabs = record_of(tmp_path / "b.csv", "t\ta\tb\n" + rows)
    assert np.isnan(tabs.outputs).sum(axis=0).tolist() == [0, 6]


def test_rounded_times_are_even(tmp_path: Path) -> None:
    """Times printed to a few digits give the exact interval of the whole axis."""
    rows = "".join(f"{k / 256:.4f},{k % 3}\n" for k in range(2561))
    record = record_of(tmp_path / "a.csv", "t,a\n" + rows)
    assert record.dt == pytest.approx(1 / 256, rel=1e-5)


def test_jitter_is_not_rounding(tmp_path: Path) -> None:
    """Steps that differ by a fifth, printed with all digits, are uneven."""
    rows = "".join(f"{k / 256 + (k % 2) / 1280:.8f},{k % 3}\n" for k in range(257))
    with pytest.raises(FileError, match="is uneven"):
        record_of(tmp_path / "a.csv", "t,a\n" + rows)


def test_a_capital_t_is_no_time(tmp_path: Path) -> None:
    """T may be a torque or a temperature."""
    record = record_of(tmp_path / "a.csv", "a,T\n" + lines(",", rows=[(1, 2), (0, 3)]), dt=1.0)
    assert record.output_names == ("a", "T")


def test_uneven_time_is_refused_by_row(tmp_path: Path) -> None:
    """A missing row is named with its step; so it is without headings."""
    table = ROWS[:6] + ROWS[7:]
    for heading in ("t,a,b\n", ""):
        with pytest.raises(FileError, match=r"uneven: row 7 is 0\.5 after .* 0\.25 is usual"):
            record_of(tmp_path / "a.csv", heading + lines(",", rows=table))


def test_interval_is_asked_for(tmp_path: Path) -> None:
    """Without time, or with a bare sample counter, dt must be given."""
    bare = [(a, b) for _, a, b in ROWS]
    with pytest.raises(OptionError, match=r"cannot be known from .*a\.dat; give dt"):
        record_of(tmp_path / "a.dat", lines(" ", rows=bare))
    counted = [(k, a, b) for k, (_, a, b) in enumerate(ROWS)]
    with pytest.raises(OptionError, match="counts samples; give dt"):
        record_of(tmp_path / "a.dat", lines(" ", rows=counted))
    record = record_of(tmp_path / "a.dat", lines(" ", rows=counted), dt=0.5)
    assert (record.dt, record.output_names) == (0.5, ("ch1", "ch2"))


def test_interval_must_agree_with_the_time_column(tmp_path: Path) -> None:
    """A dt within 0.1 % stands; another is refused."""
    assert record_of(tmp_path / "a.csv", "t,a,b\n" + lines(","), dt=0.2501).dt == 0.2501
    with pytest.raises(OptionError, match=r"dt = 0\.26 s disagrees"):
        record_of(tmp_path / "a.csv", "t,a,b\n" + lines(","), dt=0.26)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,a\n0,1\n1,x\n2,3\n", "Line 3, column 2 .*'x'"),
        ("t,a\n0,1\n1,2,3\n2,3\n", "Line 3 .* 3 cells where 2"),
        ("t,a\n0,1\n1\n", "Line 3 .* 1 cells where 2"),
        ("t,a,b\n0,1\n1,2\n", "3 names in its heading .* 2 cells"),
        ("t,a,a\n0,1,2\n1,2,3\n", "two channels called 'a'"),
        ("t,a,\n0,1,2\n1,2,3\n", "Column 3 .* no name"),
        ("t,a\n0,1+2j\n1,2\n", "Line 2, column 2"),
        ("t,a\n0,1_000\n1,2\n", "Line 2, column 2"),
        ("t,a\n0,1\n1,inf\n", "Line 3, column 2 .* infinite"),
        ("t,a\n0,\n1,\n", "no numeric data"),
        ("t\n0\n1\n2\n", "a time column and no channel"),
        ("t [days],a\n0,1\n1,2\n", "'days' .* is not known"),
        ("t,time,a\n0,0,1\n1,1,2\n", "several time columns"),
        ("0.5,1.5x\n0.5,2\n", "mixes text .* and numbers"),
        ("t;a\n0,5;1.000,5\n1,5;2\n", "decimal sign is unclear"),
        ("t,a\n,1\n1,2\n", "no number in row 1"),
        ("freq,a\n" + "".join(f"{k},1\n" for k in range(20)), "function of frequency"),
        ("only words here\n", "one line of text"),
        ("# nothing\n\n", "holds no numbers"),
        ("t,a\n0,1\n", "1 sample"),
        ("\0\0\0", "binary data"),
    ],
)
def test_bad_text_is_refused(tmp_path: Path, text: str, message: str) -> None:
    """Every kind of damaged text names its place and the cure in one or two sentences."""
    with pytest.raises(VibridError, match=message) as caught:
        record_of(tmp_path / "a.csv", text)
    assert str(tmp_path) in str(caught.value)


def test_a_long_file_keeps_its_line_numbers(tmp_path: Path) -> None:
    """Chunks of lines do not shift the line that an error names."""
    rows = ["1.5,2"] * 60_000
    rows[55_000] = "1.5,y"
    with pytest.raises(FileError, match="Line 55002, column 2"):
        record_of(tmp_path / "a.csv", "a,b\n" + "\n".join(rows), dt=1.0)


def test_other_encodings(tmp_path: Path) -> None:
    """Latin-1 and UTF-16 exports keep their units."""
    text = "t,a [µm]\n0,1\n1,2\n2,3\n"
    for encoding in ("utf-8-sig", "latin-1", "utf-16"):
        path = tmp_path / f"{encoding}.csv"
        path.write_text(text, encoding=encoding)
        record = read_record(path)
        assert record.output_channels[0].unit == "µm"
        assert record.output_channels[0].quantity == "displacement"
