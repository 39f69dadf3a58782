"""From a realization in scaled units to a Fit in the units of the data."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..fit import Diagnostics, Finding, Fit
from ..gram import PIVOT_LIMIT, BlockGram, Factor
from ..kalman import spectral_radius
from ..linalg import one_blas_thread
from ..record import Floats
from ..statespace import StateSpace

Matrices = tuple[Floats, Floats, Floats, Floats]  # A, B, C, D
NO_NOISE = "none: no noise to learn it from"


@dataclass(frozen=True, eq=False)
class Draft:
    """A model in a stream's scaled units without its gain, and how A and C were found."""

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    transition: str

    @cached_property
    def radius(self) -> float:
        """Spectral radius of A."""
        return spectral_radius(self.A)


@dataclass(frozen=True, eq=False)
class Realization(Draft):
    """An innovations model in a stream's scaled units, and how its gain was found."""

    K: Floats
    innovation: Floats
    state_covariance: Floats
    gain: str

    @cached_property
    def predictor_radius(self) -> float:
        """Spectral radius of A − K C."""
        return spectral_radius(self.A - self.K @ self.C)


class Remembering:
    """A decomposition that makes the model of each order once.

    Scanning orders and then realizing one asks for the same models again.
    """

    def realize(self, order: int) -> Realization:
        """Return the model of this order in the stream's scaled units."""
        if order not in self._made:
            with one_blas_thread():
                self._made[order] = self._realized(order)
        return self._made[order]

    @cached_property
    def _made(self) -> dict[int, Realization]:
        return {}

    def _realized(self, order: int) -> Realization:
        raise NotImplementedError


def as_fit(
    method: Any,
    stream: Stream,
    found: Realization,
    *,
    singular_values: Floats,
    feedthrough: NDArray[np.bool_],
    diagnostics: Diagnostics,
    gram: BlockGram | None,
) -> Fit:
    """Return the realization in the units of the data; initial states are left to find."""
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
        feedthrough=feedthrough,
        method=method,
        order=len(found.A),
        singular_values=singular_values,
        state_covariance=found.state_covariance,
        parameter_covariance=None,
        diagnostics=diagnostics,
        gram=gram,
        input_channels=channels.input_channels,
        output_channels=channels.output_channels,
    )


def factor_findings(factor: Factor) -> list[Finding]:
    """Say when the data were factored by QR."""
    if factor.path != "qr":
        return []
    pivot = f"squared pivot {factor.smallest_pivot:.1g}, limit {PIVOT_LIMIT:g}"
    why = "no Cholesky factor" if np.isnan(factor.smallest_pivot) else pivot
    return [
        Finding(
            "qr-path",
            "note",
            f"The Gram matrix is nearly singular ({why}): the data were factored by QR in a "
            "second pass.",
        )
    ]


def gain_findings(found: Realization) -> list[Finding]:
    """Say when there is no Kalman gain, and why."""
    if not found.gain.startswith("none"):
        return []
    return [Finding("no-gain", "note", f"The Kalman gain is zero ({found.gain[6:]}).")]
