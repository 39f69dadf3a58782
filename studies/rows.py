"""Long studies run by run: every run is a line of a file, kept when the study is stopped.

A line holds the key of its run and the state of the code that a study is about (`CODE`), so that
it goes on where it stopped, and never mixes what different states of that code have found.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import json
import math
import multiprocessing
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from threadpoolctl import threadpool_limits

from vibrid.errors import DataError

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "studies"
CODE = (
    "vibrid/blind",
    "vibrid/varpro",
    "vibrid/linalg.py",
    "studies/blind_records.py",
    "studies/blind_excitations.py",
    "studies/blind_runs.py",
    "studies/bounds.py",
)
TOLD_EVERY = 20  # runs
Row = dict[str, Any]
Rows = Mapping[str, Row]


class Job(NamedTuple):
    """One run: a function of a module, so that another process finds it, and its arguments."""

    work: Callable[..., Row]
    arguments: tuple[Any, ...]

    @property
    def key(self) -> str:
        return "|".join([self.work.__name__, *map(str, self.arguments)])


class Cell(NamedTuple):
    """Runs that differ in their seed alone, the last argument."""

    work: Callable[..., Row]
    arguments: tuple[Any, ...]
    runs: int

    @property
    def jobs(self) -> list[Job]:
        return [Job(self.work, (*self.arguments, seed)) for seed in range(self.runs)]

    def rows(self, done: Rows) -> list[Row]:
        """Return the rows that are there, by seed."""
        return [done[job.key] for job in self.jobs if job.key in done]


def in_turn(cells: Sequence[Cell]) -> Iterator[Job]:
    """Yield the first run of all cells, then the second: what is stopped early is balanced."""
    for seed in range(max(cell.runs for cell in cells)):
        yield from (cell.jobs[seed] for cell in cells if seed < cell.runs)


def code_state(paths: Iterable[str] = CODE) -> str:
    """Return a short hash of the statements of the code; comments and docstrings do not count."""
    found = hashlib.sha256()
    for path in map(ROOT.joinpath, paths):
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            tree = ast.parse(file.read_text(encoding="utf-8"))
            for node in ast.walk(tree):
                if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
                    node.body = node.body[ast.get_docstring(node) is not None :]
            found.update(f"{file.relative_to(ROOT)}{ast.dump(tree)}".encode())
    return found.hexdigest()[:8]


def finished(path: Path, code: str) -> dict[str, Row]:
    """Return the rows that this state of the code has made."""
    return {row["key"]: row for row in _lines(path) if row.get("code") == code}


def _lines(path: Path) -> Iterator[Row]:
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            yield json.loads(line)
        except json.JSONDecodeError:  # cut off when its process was killed: the run is made again
            continue


def run_jobs(
    jobs: Iterable[Job], path: Path, code: str, *, minutes: float = math.inf, workers: int = 1
) -> None:
    """Append a line for every job that has none, `workers` of them at a time.

    After `minutes` nothing new begins, and what runs ends. KeyboardInterrupt stops at once and
    loses what runs.
    """
    done, end = finished(path, code), time.monotonic() + 60 * minutes
    left = [job for job in jobs if job.key not in done]
    path.parent.mkdir(parents=True, exist_ok=True)
    cut = path.exists() and not path.read_bytes().endswith(b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" * cut)
        for count, row in enumerate(_made(left, workers, end), 1):
            file.write(json.dumps({**row, "code": code}) + "\n")
            file.flush()
            _tell(count, len(left))


def _made(jobs: Sequence[Job], workers: int, end: float) -> Iterator[Row]:
    """Yield rows as they come; as many jobs are handed out as there are workers, none waits."""
    left, running = iter(jobs), set[Future[Row]]()
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), _begin) as pool:
        try:
            while True:
                for job in islice(left, workers - len(running)):
                    if time.monotonic() < end:
                        running.add(pool.submit(_row, job))
                if not running:
                    return
                ready, running = wait(running, return_when=FIRST_COMPLETED)
                yield from (each.result() for each in ready)
        except BaseException:
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that hands out
    threadpool_limits(1, user_api="blas")


def _row(job: Job) -> Row:
    started = time.process_time()
    try:
        row = job.work(*job.arguments)
    except DataError as problem:
        row = {"accepted": False, "failed": str(problem)}
    except Exception as problem:  # a defect: it is shown on the page, and the other runs go on
        row = {"accepted": False, "crashed": repr(problem)}
    return {"key": job.key, **row, "seconds": time.process_time() - started}


def _tell(count: int, total: int) -> None:
    if count % TOLD_EVERY == 0 or count == total:
        print(f"{count} of {total} runs", flush=True)


def study(
    about: str,
    cells: Callable[[int | None], Sequence[Cell]],
    page: Callable[[Sequence[Cell], Rows], str],
    output: Path,
) -> None:
    """Run what is missing of a study as the command line says, and write its page."""
    options = _parser(about, output).parse_args()
    chosen, code = cells(options.runs), code_state()
    if options.fresh:
        options.rows.unlink(missing_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    stopped = False
    try:
        run_jobs(
            in_turn(chosen), options.rows, code, minutes=options.minutes, workers=options.workers
        )
    except KeyboardInterrupt:
        stopped = True
    done = finished(options.rows, code)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(page(chosen, done) + _origin(chosen, done, code), encoding="utf-8")
    print(f"{options.output} written")
    if stopped:
        sys.exit(130)


def _parser(about: str, output: Path) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=about)
    parser.add_argument("--runs", type=int, help="runs per cell; by default all")
    parser.add_argument("--minutes", type=float, default=math.inf, help="begin nothing after this")
    parser.add_argument("--workers", type=int, default=1, help="processes, one BLAS thread each")
    parser.add_argument("--fresh", action="store_true", help="forget all finished runs")
    parser.add_argument("--rows", type=Path, default=PAGES / "blind.jsonl", help="finished runs")
    parser.add_argument("--output", type=Path, default=output, help="page to write")
    return parser


def _origin(cells: Sequence[Cell], done: Rows, code: str) -> str:
    """Return what the page rests on: counts, code, runs that failed."""
    rows = [row for cell in cells for row in cell.rows(done)]
    failed = Counter(row[name] for row in rows for name in ("failed", "crashed") if name in row)
    minutes = sum(row["seconds"] for row in rows) / 60
    lines = [
        "\n## Runs\n\n",
        f"{len(rows)} runs, {minutes:.1f} minutes of one core. All were made by one ",
        f"state of the code, `{code}` (statements of {', '.join(CODE)}): a run of another state ",
        "is never counted, and is made again.\n",
        *(f"\n{count} runs ended with: {what}\n" for what, count in failed.items()),
    ]
    return "".join(lines)
