"""The likelihood of white errors whose covariance is unknown, correlated between outputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..record import Floats
from .projection import Projected

SMALLEST_NOISE = 1e-14  # of an output's variance: less cannot be told from rounding


@dataclass(frozen=True, eq=False)
class Likely(Projected):
    """A place whose cost is N ln det S, S = Σ e eᵀ / N: −2 × log-likelihood, S eliminated.

    Where all outputs have the same Φ, the linear part of least squares is that of every weight,
    and the slope of the cost is that of squares weighed by S⁻¹. Where only some have D it is
    not: then S counts by its diagonal, as if the errors were independent between outputs.

    Attributes
    ----------
    weights : array (p,)
        1 / variance of the outputs, for the smallest errors that can be told from none.
    count : int
        N, number of samples.
    """

    count: int = 1

    @cached_property
    def covariance(self) -> Floats:
        """S, held off zero (p, p)."""
        S = self.errors / self.count
        if self.feedthrough.any() and not self.feedthrough.all():
            S = np.diag(np.diag(S))
        return np.asarray(S + np.diag(SMALLEST_NOISE / self.weights))

    @cached_property
    def cost(self) -> float:
        sign, value = np.linalg.slogdet(self.covariance)
        return float(self.count * value) if sign > 0 else np.inf

    @cached_property
    def weighing(self) -> Floats:
        return np.asarray(np.linalg.inv(self.covariance))
