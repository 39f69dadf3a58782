"""Universal files: names, quantities, FRFs, and what is refused by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from uff_samples import DT, uff_set, write_uff

from vibrid.errors import FileError, OptionError
from vibrid.files import read_record
from vibrid.record import FrequencyResponses, Record

X = np.sin(np.arange(40.0))
FORCE: dict[str, Any] = {"ordinate_spec_data_type": 13, "ordinate_axis_units_lab": "N"}


def frf(row: int, column: int, kind: int = 4) -> dict[str, Any]:
    """Return an FRF (or its coherence) of acceleration over force at X directions."""
    values = (row + 10 * column) * np.exp(1j * np.arange(30.0)) if kind == 4 else np.full(30, 0.9)
    return uff_set(
        values,
        row,
        1,
        func_type=kind,
        ref_node=column,
        ref_dir=1,
        abscissa_min=2.0,
        abscissa_inc=0.5,
        abscissa_spec_data_type=18,
        orddenom_spec_data_type=13,
        orddenom_axis_units_lab="N",
    )


def made(path: Path, *sets: dict[str, Any]) -> Path:
    write_uff(path, list(sets))
    return path


def test_channels_are_named_by_node_and_direction(tmp_path: Path) -> None:
    """The driving point's two sensors differ by quantity and share the DOF."""
    sets = (uff_set(X, 1, 3), uff_set(X, 2, -3), uff_set(X, 1, 3, **FORCE))
    record = read_record(made(tmp_path / "a.uff", *sets), inputs=["1Z+/force"])
    assert isinstance(record, Record)
    described = [
        (c.name, c.quantity, c.unit, c.dof, c.sign)
        for c in (*record.output_channels, *record.input_channels)
    ]
    assert described == [
        ("1Z+/acceleration", "acceleration", "m/s2", "1Z+", 1),
        ("2Z-", "acceleration", "m/s2", "2Z+", -1),
        ("1Z+/force", "force", "N", "1Z+", 1),
    ]
    assert record.dt == pytest.approx(DT)


def test_frfs_become_a_matrix_with_coherence(tmp_path: Path) -> None:
    """Responses by references in any order of the file; rows can be chosen."""
    pairs = [(2, 3), (1, 3), (1, 1), (2, 1)]
    sets = [frf(*pair) for pair in pairs] + [frf(*pair, kind=6) for pair in pairs]
    path = made(tmp_path / "a.uff", *sets)
    responses = read_record(path)
    assert isinstance(responses, FrequencyResponses)
    assert [c.name for c in responses.output_channels] == ["2X+", "1X+/acceleration"]
    assert [c.name for c in responses.input_channels] == ["3X+", "1X+/force"]
    np.testing.assert_allclose(abs(responses.values[0]), [[32, 12], [31, 11]])
    np.testing.assert_allclose(responses.frequencies_hz, 2 + 0.5 * np.arange(30))
    assert responses.coherence is not None and responses.coherence.shape == (30, 2, 2)
    part = read_record(path, outputs=["2X+"], inputs=["3X+"])
    assert isinstance(part, FrequencyResponses)
    np.testing.assert_array_equal(part.values[:, 0, 0], responses.values[:, 0, 0])
    with pytest.raises(OptionError, match="No response is called"):
        read_record(path, outputs=["9X+"])


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        ([frf(1, 1), frf(2, 1), frf(1, 2)], r"missing or repeated: 2X\+ by 2X\+"),
        ([frf(1, 1), frf(1, 1)], r"repeated: 1X\+ by 1X\+"),
        ([frf(1, 1), frf(2, 1), frf(1, 1, 6)], r"each coherence .* 2X\+ by 1X\+"),
        ([frf(1, 1, 2)], "holds auto spectrum;"),
        ([frf(1, 1, 9), frf(1, 2, 3)], "holds cross spectrum, power spectral density;"),
        ([frf(1, 1, 6)], "holds coherence;"),
        ([frf(1, 1), uff_set(X, 1, 1)], "holds frequency response, time response;"),
        ([uff_set(X, 1, 1), uff_set(X[:30], 2, 1)], "30 to 40 samples"),
        ([uff_set(X, 1, 1), uff_set(X, 2, 1, abscissa_inc=0.5)], "different sampling interval"),
        ([uff_set(X, 1, 1), uff_set(X, 1, 1)], "two channels called '1X\\+/acceleration'"),
    ],
)
def test_other_content_is_refused(tmp_path: Path, sets: list[Any], message: str) -> None:
    """Missing pairs, spectra, mixtures and unequal channels are named."""
    with pytest.raises(FileError, match=message):
        read_record(made(tmp_path / "a.uff", *sets))


def test_a_missing_point_is_noticed(tmp_path: Path) -> None:
    """A data set that holds fewer values than it announces is damaged."""
    path = made(tmp_path / "a.uff", uff_set(X, 1, 1))
    rows = path.read_text().splitlines(keepends=True)
    path.write_text("".join(rows[:-3] + rows[-2:]))
    with pytest.raises(FileError, match="announces 40 points and holds 36"):
        read_record(path)


def test_uneven_time_is_refused(tmp_path: Path) -> None:
    """Stored instants are checked: even ones are read, others are refused by row."""
    even = uff_set(X, 1, 1, abscissa_spacing=0)
    record = read_record(made(tmp_path / "a.uff", even))
    assert isinstance(record, Record)
    assert record.dt == pytest.approx(DT, rel=1e-4)  # 6 digits printed
    uneven = uff_set(X, 1, 1, abscissa_spacing=0, x=DT * np.arange(40.0) ** 1.5)
    with pytest.raises(FileError, match=r"time axis of 1X\+ .* uneven"):
        read_record(made(tmp_path / "b.uff", uneven))


def test_other_data_sets_alone_are_refused(tmp_path: Path) -> None:
    """A file of geometry has nothing to read."""
    path = tmp_path / "a.uff"
    path.write_text("    -1\n   164\n         1\n    -1\n")
    with pytest.raises(FileError, match=r"no data set 58 \(it has: 164\)"):
        read_record(path)


def test_published_samples(shared_data: Path) -> None:
    """The text and the binary sample hold the same microphone signal."""
    text = read_record(shared_data / "Sample_UFF58_ascii.uff")
    binary = read_record(shared_data / "Sample_UFF58b_bin.uff")
    assert isinstance(text, Record) and isinstance(binary, Record)
    assert text.output_channels == binary.output_channels
    assert (text.output_names, text.output_channels[0].unit) == (("Mic 01",), "Pa")
    assert text.n_samples == 79292
    np.testing.assert_allclose(text.outputs, binary.outputs, rtol=6e-6)  # 6 digits printed
    assert text.dt == pytest.approx(2**-16, rel=1e-5)
