"""Run the worked examples of a page of the documentation."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

import vibrid as vb

DOCS = Path(__file__).resolve().parent.parent / "docs"


def run(page: str, *sections: str) -> dict[str, Any]:
    """Run the code of these sections of docs/`page` in turn and return its names."""
    names: dict[str, Any] = {"np": np, "vb": vb}
    text = (DOCS / page).read_text(encoding="utf-8")
    parts = re.split(r"^## (.*)$", text, flags=re.MULTILINE)
    code = dict(zip(parts[1::2], parts[2::2], strict=True))
    for section in sections:
        for block in re.findall(r"```python\n(.*?)```", code[section], flags=re.DOTALL):
            exec(block, names)
    return names
