"""Identification methods: one file a family, one contract."""

from typing import Any

from .era import ERA, ERADC
from .finite_response import fir
from .n4sid import N4SID
from .okid import OKID
from .ssi import SSI

# a new method is one file and one line here; the contract tests then cover it
METHODS: dict[str, Any] = {"n4sid": N4SID, "ssi": SSI, "okid": OKID, "era": ERA, "eradc": ERADC}

__all__ = ["ERA", "ERADC", "METHODS", "N4SID", "OKID", "SSI", "fir"]
