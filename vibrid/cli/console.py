"""What goes to the terminal, and what every failure becomes: one sentence and a status."""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
import traceback
from typing import Any

from cyclopts import CycloptsError, UnknownOptionError, UnusedCliTokensError
from rich.console import Console, RenderableType

DONE, FAILED, WRONG_USE, INTERRUPTED = 0, 1, 2, 130
DEBUG = "VIBRID_DEBUG"


def output() -> Console:
    return Console(markup=False, highlight=False, emoji=False)


def errors() -> Console:
    return Console(stderr=True)


def show(what: RenderableType) -> None:
    console = output()
    if console.is_terminal:
        console.print(what)
        return
    with console.capture() as captured:
        console.print(what)
    # columns are padded; in a file or pipe nobody wants blanks at the ends of lines
    print("\n".join(line.rstrip() for line in captured.get().splitlines()))


def show_json(facts: dict[str, Any]) -> None:
    print(json.dumps(facts, ensure_ascii=False, allow_nan=False, indent=2))


def fail(message: str, status: int) -> int:
    print(f"vibrid: {message}" if status != INTERRUPTED else message, file=sys.stderr)
    return status


def wrong_use(error: CycloptsError) -> str:
    if isinstance(error, UnknownOptionError) and error.token.value == "-":
        return "Standard input is not read; write it to a file and give its path."
    if isinstance(error, UnusedCliTokensError):
        rest = " ".join(error.unused_tokens or ())
        return f"Nothing takes the argument {rest!r}; give one FILE, and options by name."
    words = re.sub(r'^Command "[^"]*" parameter ', "", " ".join(str(error).split()))
    words = words.replace("positional arguments. Only got", "values; got")
    return f"{words} See {' '.join(['vibrid', *(error.command_chain or ())])} --help."


def bug(error: Exception) -> int:
    if os.environ.get(DEBUG):
        traceback.print_exc()
    words = " ".join(str(error).split())
    return fail(
        f"internal error, please report it: {type(error).__name__}: {words} "
        f"({DEBUG}=1 shows where).",
        FAILED,
    )


def pipe_closed() -> int:
    """End quietly when the reader, such as head, has gone."""
    give_up_output()
    return FAILED


def give_up_output() -> None:
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def settle_streams() -> None:
    """Print to nowhere where a stream is closed, and never fail at a letter it cannot encode."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
