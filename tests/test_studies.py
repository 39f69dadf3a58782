"""Long studies: what is finished is kept, what other code made is not counted, lines tell truly."""

from __future__ import annotations

import importlib
import json
import pkgutil
from pathlib import Path
from typing import Any

import pytest

import studies
from studies import blind, blind_acceptance, rows
from studies.__main__ import STUDIES
from studies.acceptance import Runs, binomial_band, median_line, share_line
from studies.rows import Cell, code_state, finished, in_turn, run_jobs
from vibrid.errors import DataError


def halved(name: str, seed: int) -> dict[str, Any]:
    """Return a row; a record without an answer and a defect are among the runs."""
    if name == "short":
        raise DataError("too few samples")
    if name == "broken":
        raise IndexError(name)
    return {"accepted": True, "half": seed / 2}


CELLS = [Cell(halved, ("a",), 3), Cell(halved, ("b",), 1)]


def test_runs_come_in_turn() -> None:
    """First runs of all cells stand before second ones."""
    keys = [job.key for job in in_turn(CELLS)]
    assert keys == ["halved|a|0", "halved|b|0", "halved|a|1", "halved|a|2"]


def test_finished_runs_are_kept(tmp_path: Path) -> None:
    """A line that was cut off is made again, a finished one is not, another code's not counted."""
    path = tmp_path / "rows.jsonl"
    run_jobs(in_turn(CELLS), path, "now", minutes=0)
    assert not finished(path, "now")
    kept = {"key": "halved|a|0", "half": 99, "code": "now"}
    other = {"key": "halved|b|0", "half": 99, "code": "before"}
    path.write_text(f'{json.dumps(kept)}\n{json.dumps(other)}\n{{"key": "halved|a|1", "ha')
    run_jobs(in_turn(CELLS), path, "now", workers=2)
    done = finished(path, "now")
    assert {key: row["half"] for key, row in done.items()} == {
        "halved|a|0": 99,
        "halved|b|0": 0.0,
        "halved|a|1": 0.5,
        "halved|a|2": 1.0,
    }
    assert [row["half"] for row in CELLS[0].rows(done)] == [99, 0.5, 1.0]


def test_a_stop_loses_what_runs_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C after the second row leaves two rows."""
    path = tmp_path / "rows.jsonl"

    def stop(count: int, total: int) -> None:
        if count == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(rows, "_tell", stop)
    with pytest.raises(KeyboardInterrupt):
        run_jobs(in_turn(CELLS), path, "now")
    assert list(finished(path, "now")) == ["halved|a|0", "halved|b|0"]


def test_runs_that_fail_are_rows(tmp_path: Path) -> None:
    """No answer and a defect are kept with what they said; the others go on."""
    path = tmp_path / "rows.jsonl"
    cells = [Cell(halved, (name,), 1) for name in ("short", "broken", "a")]
    run_jobs(in_turn(cells), path, "now")
    done = finished(path, "now")
    assert done["halved|short|0"]["failed"] == "too few samples"
    assert done["halved|broken|0"]["crashed"] == "IndexError('broken')"
    assert done["halved|a|0"]["accepted"]


def test_words_do_not_change_the_state_of_the_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Comments and docstrings do not count; a number does."""
    monkeypatch.setattr(rows, "ROOT", tmp_path)
    states = []
    for text in ('def f():\n    "Say."\n    return 1', "def f():  # other\n    return 1"):
        (tmp_path / "a.py").write_text(text)
        states.append(code_state(["a.py"]))
    (tmp_path / "a.py").write_text("def f():\n    return 2")
    assert states[0] == states[1] != code_state(["a.py"])


def test_lines_tell_what_is_met() -> None:
    """A median and a share on both sides of their limits; a run without a figure is infinite."""
    runs = Runs([{"e": 1.0, "ok": True}, {"e": 3.0, "ok": True}, {}], 4)
    assert median_line("1", "e", runs, "e", 3.0).met is True
    assert median_line("1", "e", runs, "e", 2.9).met is False
    assert "worst inf" in median_line("1", "e", runs, "e", 3.0).measured
    assert share_line("1", "ok", runs, "ok", least=2 / 3).met is True
    assert share_line("1", "ok", runs, "ok", least=0.7).met is False
    assert share_line("1", "ok", runs, "ok", most=0).met is False
    line = share_line("1", "ok", runs, "ok", least=0.7)
    assert str(line) == "| 1 | ok | ≥ 70 % | 2 of 3 | 3 of 4 | 9 to 99 % | **no**, so far |\n"
    assert median_line("1", "e", Runs([], 4), "e", 3.0).met is None


def test_binomial_band() -> None:
    """Known values: 19 of 20, none of 20."""
    assert binomial_band(19, 20) == pytest.approx((0.7513, 0.9987), abs=1e-4)
    assert binomial_band(0, 20) == pytest.approx((0.0, 0.1684), abs=1e-4)


@pytest.mark.parametrize("study", [blind, blind_acceptance])
def test_pages_need_no_runs(study: Any) -> None:
    """A page without rows has all its tables and claims nothing."""
    page = study.page(study.cells(None), {})
    assert "yes" not in page and "**no**" not in page and "| 3 " in page


def test_every_study_is_run() -> None:
    """`make studies` knows all modules that have a main()."""
    names = [each.name for each in pkgutil.iter_modules(studies.__path__) if each.name[0] != "_"]
    modules = {name: importlib.import_module(f"studies.{name}") for name in names}
    assert sorted(STUDIES) == sorted(
        name for name, each in modules.items() if hasattr(each, "main")
    )
