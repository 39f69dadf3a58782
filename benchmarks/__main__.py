"""Measure vibrid alone (bench_*.py) and beside other packages; write docs/benchmarks.md.

`--quick` runs everything at small sizes, with those other packages that are installed already,
and writes no page; `--only W5` (or `--only W1,bench_gram`) measures a part and renews the page.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import pkgutil
import sys
from pathlib import Path
from typing import Any, TextIO

import benchmarks
from benchmarks.others.environments import ROOT
from benchmarks.others.harness import Limits, Row, entries, run_row
from benchmarks.others.workloads import TABLES, Table, write
from benchmarks.report import PAGE, facts, keep, table_text, write_page


class Both(io.StringIO):
    """What is printed is shown as before, and kept."""

    def __init__(self, shown: TextIO) -> None:
        super().__init__()
        self.shown = shown

    def write(self, text: str) -> int:
        self.shown.write(text)
        self.shown.flush()
        return super().write(text)


def options(arguments: list[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes; no page is written")
    parser.add_argument("--only", default="", help="tables or benchmarks by the start of the name")
    parser.add_argument("--packages", default="", help="some packages only; no page is written")
    parser.add_argument("--seconds", type=int, default=180, help="limit of one process")
    parser.add_argument("--gigabytes", type=float, default=12.0, help="limit of one process")
    parser.add_argument("--folder", type=Path, default=ROOT / ".bench", help="environments, data")
    return parser.parse_args(arguments)


def chosen(name: str, wanted: str) -> bool:
    """Return whether `name` begins like one of a comma-separated list; an empty one is all."""
    parts = [part.strip().lower() for part in wanted.split(",") if part.strip()]
    return not parts or any(name.lower().startswith(part) for part in parts)


def own_benchmark(name: str, quick: bool) -> str:
    """Run one bench_*.py and return what it prints."""
    print(f"\n== {name}", flush=True)
    with contextlib.redirect_stdout(Both(sys.stdout)) as printed:
        importlib.import_module(f"benchmarks.{name}").main(["--quick"] if quick else [])
    return printed.getvalue()


def compare(table: Table, given: argparse.Namespace, limits: Limits) -> list[Row]:
    """Return the rows of one table, one process after the other."""
    print(f"\n== {table.name}", flush=True)
    data = write(table.data, given.folder / "data", given.quick)
    rows = []
    for entry in entries(table.name):
        if chosen(entry.package, given.packages):
            print(f"{entry.package}: {entry.task.computes} …", flush=True)
            rows.append(run_row(entry, data, given.folder, limits, install=not given.quick))
    print(table_text(table, rows), flush=True)
    return rows


def main(arguments: list[str] | None = None) -> None:
    """Run what is asked for, by default everything."""
    given = options(sys.argv[1:] if arguments is None else arguments)
    limits = Limits(given.seconds, given.gigabytes)
    results: dict[str, dict[str, Any]] = {}
    for module in sorted(module.name for module in pkgutil.iter_modules(benchmarks.__path__)):
        if module.startswith("bench_") and chosen(module, given.only) and not given.packages:
            results[module] = {"text": own_benchmark(module, given.quick)}
    for table in TABLES:
        if chosen(table.name, given.only):
            rows = compare(table, given, limits)
            results[table.name] = {"rows": [row.as_dict() for row in rows]}
    if given.quick or given.packages:
        return
    for name, result in results.items():
        keep(given.folder, name, result | {"facts": facts(limits)})
    write_page(given.folder)
    print(f"\nWrote {PAGE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
