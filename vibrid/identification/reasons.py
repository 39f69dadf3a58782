"""The reasons of a choice, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from .candidates import AS_GOOD, CLOSE, Candidate
from .options import rows_of, weighting_of
from .scan import OrderScan


def as_asked(method: Any) -> tuple[str, ...]:
    """Say which horizon was asked for; nothing of a method without one."""
    rows = rows_of(method)
    return () if rows is None else (f"block_rows={rows} as asked for",)


def skipped_orders(scan: OrderScan) -> str:
    """Say how many orders were unstable; empty if none."""
    count = int((~scan.stable).sum())
    if not count:
        return ""
    said = f"; {count} of {len(scan.orders)} orders were unstable and skipped"
    if not scan.n_near:
        return said
    return said + (
        f", {scan.n_near} of them by growth of less than e over the record, which noise makes of "
        'undamped motion: stability="project" keeps these'
    )


def horizon_reason(method: Any, tried: Sequence[tuple[Any, Any]], where: str) -> str:
    """Say why this horizon was taken: by rank, length of the record, or prediction error."""
    rows = f"block_rows={method.block_rows}"
    if method == tried[-1][0] and tried[-1][1].rank_limited:
        return f"{rows} shows the rank of these nearly noise-free data"
    if len(tried) == 1:
        return f"{rows} is the longest that this record and its channels allow"
    others = ", ".join(str(each) for each in sorted({option.block_rows for option, _ in tried}))
    return (
        f"{rows} is the shortest of {others} whose prediction error{where} is within "
        f"{100 * CLOSE:g} % of the best"
    )


def simulation_reason(method: Any, tried: Sequence[Candidate], order: int) -> str:
    """Say why this horizon and weighting were taken: by simulation of the data."""
    rows = sorted({option.block_rows for option, _ in tried})
    others = [name for option, _ in tried if (name := weighting_of(option)) != weighting_of(method)]
    named = f"block_rows={method.block_rows}"
    if len(rows) == 1:
        why = f"{named} is the longest that this record and its channels allow"
    else:
        why = (
            f"{named} is one of {', '.join(str(each) for each in rows)} that simulates at order "
            f"{order} within {100 * (AS_GOOD - 1):.2g} % of the error of the best, and of these "
            f"the shortest whose prediction error is within {100 * CLOSE:g} %"
        )
    if others:
        why += f"; weighting={method.weighting} was found so, against {others[0]}"
    return why
