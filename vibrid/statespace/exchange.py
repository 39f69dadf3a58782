"""StateSpace to and from the types of SciPy and python-control."""

from __future__ import annotations

from typing import Any

from ..errors import OptionError


def control_module() -> Any:
    """Return python-control, loaded when first needed."""
    try:
        import control
    except ImportError:
        raise OptionError(
            "python-control is not installed; run: pip install vibrid[control]."
        ) from None
    return control


def known_dt(dt: object, source: str) -> float | None:
    """Return a foreign dt as ours, None being continuous; refuse an unknown one."""
    if dt is None or (isinstance(dt, (int, float)) and not isinstance(dt, bool)):
        return None if not dt else float(dt)
    raise OptionError(
        f"The {source} system has dt={dt!r}: its sampling interval is not known. Set dt in seconds."
    )
