"""Results of the benchmarks: kept as JSON, written out as docs/benchmarks.md."""

from __future__ import annotations

import datetime
import json
import math
import os
import platform
import subprocess
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.others.environments import ROOT
from benchmarks.others.harness import Limits, Row
from benchmarks.others.workloads import TABLES, Table

PAGE = ROOT / "docs" / "benchmarks.md"
HEADER = (
    "| package | computes | CPU s | ratio | MB above data | modes | frequency error | "
    "damping error | version, or what happened |\n"
    "|---|---|--:|--:|--:|--:|--:|--:|---|"
)
TOP = """# Benchmarks

Written by `make bench`; nothing here is typed by hand.

vibrid beside other packages, on the same data files. Every row is a process of its own, in the
package's own pinned environment (`benchmarks/others/<package>.txt`), with one BLAS thread, a limit
of memory and a limit of time. What does not install, fails or exceeds a limit is a row that
says so. How each package is called: `benchmarks/others/run_<package>.py`. Data are in memory and
in the package's own form before the clock starts, except where a row reads mapped files.

- **CPU s**: median of five measurements after a first run, each of one run, or the mean of as many
  as 50 ms hold; a first run of more than 5 s stands alone (¹).
- **ratio**: these seconds over those of the first row of the table. Rows do not all compute the
  same; the second column says what they return.
- **MB above data**: largest resident memory during the first run, less that before it.
- **modes**: true modes with a pole within 10 % of them; the errors are the largest among these,
  relative, of natural frequency and damping ratio.

The structure: a chain of masses with 1 % damping, sampled at 100 Hz, white forces held between
samples, accelerations with 5 % white noise. Ten masses have modes of 4.7 to 40 Hz.
"""


def facts(limits: Limits) -> dict[str, str]:
    """Return when, on what and with what the figures were measured."""
    blas = np.show_config(mode="dicts")["Build Dependencies"]["blas"]
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--tags"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    return {
        "date": datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%d"),
        "revision": described.stdout.strip() or "unknown revision",
        "machine": f"{_processor()}, {os.cpu_count()} cores, {memory:.0f} GB, {platform.system()}",
        "software": f"Python {platform.python_version()}, NumPy {np.__version__} with "
        f"{blas['name']} {blas['version']}",
        "limits": f"{limits.gigabytes:g} GB and {limits.seconds} s a process",
    }


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def keep(folder: Path, name: str, result: dict[str, Any]) -> None:
    """Store the result of one table or one benchmark, in place of an older one."""
    path = folder / "results" / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(result, indent=1), encoding="utf-8")


def kept(folder: Path, name: str) -> dict[str, Any] | None:
    """Return a stored result, or None."""
    path = folder / "results" / f"{name}.json"
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.exists() else None


def write_page(folder: Path, page: Path = PAGE) -> None:
    """Write the page from all results that are stored."""
    sections = [TOP]
    for table in TABLES:
        found = kept(folder, table.name)
        if found is not None:
            rows = [Row(**row) for row in found["rows"]]
            sections.append(f"{table_text(table, rows)}\n\n{_measured(found['facts'])}\n")
    sections.append("## vibrid alone\n")
    for path in sorted((folder / "results").glob("bench_*.json")):
        found = kept(folder, path.stem) or {}
        text = f"### {path.stem}\n\n```text\n{found['text'].strip()}\n```"
        sections.append(f"{text}\n\n{_measured(found['facts'])}\n")
    page.write_text("\n".join(sections), encoding="utf-8")


def _measured(facts: dict[str, str]) -> str:
    return (
        f"{facts['date']}, vibrid {facts['revision']}; {facts['machine']}; "
        f"{facts['software']}; {facts['limits']}."
    )


def table_text(table: Table, rows: Iterable[Row]) -> str:
    """Return one comparison as a Markdown section."""
    rows = list(rows)
    ours = rows[0].seconds if rows else math.nan
    lines = [_line(row, ours) for row in rows]
    return "\n".join([f"## {table.name}: {table.asked}\n", HEADER, *lines])


def _line(row: Row, ours: float) -> str:
    if row.message:
        return f"| {row.package} | {row.computes} | – | – | – | – | – | – | {row.message} |"
    once = " ¹" if row.runs == 1 else ""
    cells = [
        row.package,
        row.computes,
        f"{_figure(row.seconds)}{once}",
        _figure(row.seconds / ours, 2),
        "–" if math.isnan(row.megabytes) else f"{row.megabytes:.0f}",
        "{} of {}".format(*row.modes),
        _percent(row.frequency_error),
        _percent(row.damping_error),
        f"{row.version} (NumPy {row.numpy})" if row.numpy else row.version,
    ]
    return f"| {' | '.join(cells)} |"


def _figure(value: float, digits: int = 3) -> str:
    """Return `value` with so many significant digits, never in powers of ten."""
    if not math.isfinite(value) or value == 0:
        return "–" if not math.isfinite(value) else "0"
    places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{places}f}"


def _percent(value: float) -> str:
    return f"{_figure(100 * value, 2)} %" if math.isfinite(value) else "–"
