"""Identification methods: one file a family, one contract."""

from typing import Any

from .n4sid import N4SID
from .ssi import SSI

# a new method is one file and one line here; the contract tests then cover it
METHODS: dict[str, Any] = {"n4sid": N4SID, "ssi": SSI}

__all__ = ["METHODS", "N4SID", "SSI"]
