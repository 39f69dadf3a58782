"""What a subspace realization says of itself, and its Fit."""

from __future__ import annotations

from typing import Any

from ...fit import Diagnostics, Fit
from ..result import NO_NOISE, Realization, as_fit, factor_findings, gain_findings
from .models import Subspace


def subspace_fit(method: Any, subspace: Subspace, found: Realization) -> Fit:
    """Return the realization in the units of the data."""
    return as_fit(
        method,
        subspace.stream,
        found,
        singular_values=subspace.singular_values,
        feedthrough=subspace.feedthrough,
        diagnostics=_diagnostics(subspace, found),
        gram=subspace.gram,
    )


def _diagnostics(subspace: Subspace, found: Realization) -> Diagnostics:
    layout, factor = subspace.layout, subspace.factor
    figures = {
        "past_rows": layout.past_rows,
        "future_rows": layout.future_rows,
        "columns": subspace.n_columns,
        "factorization": factor.path,
        "smallest_pivot": factor.smallest_pivot,
        "transition": found.transition,
        "gain": found.gain,
    }
    if found.gain != NO_NOISE:  # without noise every past is long enough, and there is no K
        figures["predictor_memory"] = found.predictor_radius**layout.past_rows
    return Diagnostics(figures, (*factor_findings(factor), *gain_findings(found)))
