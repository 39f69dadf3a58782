"""From a realization in scaled units to a Fit in the units of the data."""

from __future__ import annotations

import numpy as np

from ...fit import Diagnostics, Finding, Fit
from ...gram import PIVOT_LIMIT
from ...kalman import spectral_radius
from ...statespace import StateSpace
from .models import Realization, Subspace


def as_fit(method: object, subspace: Subspace, found: Realization) -> Fit:
    """Return the realization in the units of the data."""
    stream = subspace.stream
    u, y = stream.input_scale, stream.output_scale
    m = stream.n_inputs
    channels = stream.records[0]
    return Fit(
        model=StateSpace(
            found.A,
            found.B / u,
            y[:, None] * found.C,
            y[:, None] * found.D / u,
            channels.dt,
        ),
        kalman_gain=found.K / y,
        innovation_covariance=found.innovation * np.outer(y, y),
        initial_states=np.full((len(stream.segments), len(found.A)), np.nan),
        segments=stream.segments,
        input_offset=stream.centre[:m],
        output_offset=stream.centre[m:],
        feedthrough=subspace.feedthrough,
        method=method,
        order=len(found.A),
        singular_values=subspace.singular_values,
        state_covariance=found.state_covariance,
        parameter_covariance=None,
        diagnostics=_diagnostics(subspace, found),
        gram=subspace.gram,
        input_channels=channels.input_channels,
        output_channels=channels.output_channels,
    )


def _diagnostics(subspace: Subspace, found: Realization) -> Diagnostics:
    layout, factor = subspace.layout, subspace.factor
    memory = spectral_radius(found.A - found.K @ found.C) ** layout.past_rows
    findings = []
    if factor.path == "qr":
        pivot = f"squared pivot {factor.smallest_pivot:.1g}, limit {PIVOT_LIMIT:g}"
        why = "no Cholesky factor" if np.isnan(factor.smallest_pivot) else pivot
        findings.append(
            Finding(
                "qr-path",
                "note",
                f"The Gram matrix is nearly singular ({why}): the data were factored by QR in a "
                "second pass.",
            )
        )
    if found.gain.startswith("none"):
        findings.append(Finding("no-gain", "note", f"The Kalman gain is zero ({found.gain[6:]})."))
    figures = {
        "past_rows": layout.past_rows,
        "future_rows": layout.future_rows,
        "columns": subspace.n_columns,
        "factorization": factor.path,
        "smallest_pivot": factor.smallest_pivot,
        "transition": found.transition,
        "gain": found.gain,
        "spectral_radius": found.radius,
        "predictor_memory": memory,
        "prediction_cost": subspace.prediction_cost(found),
    }
    return Diagnostics(figures, tuple(findings))
