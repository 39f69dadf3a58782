"""What every ERA decomposition says of itself, whatever its responses are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...chunks import Stream
from ...fit import Finding, Fit
from ...gram import BlockGram
from ...kalman import spectral_radius
from ...record import Floats
from ..excitation_checks import data_findings
from .models import HankelModels

NOISE_FREE = 1e-8  # error over response, rms: below it rounding outweighs the noise


@dataclass(frozen=True, eq=False)
class Evidence:
    """A factored Hankel matrix with the choices that led to it.

    Attributes
    ----------
    method : ERA or ERADC, with every option as used
    kernel : HankelModels
    feedthrough : array of bool (n_outputs,)
    stream, gram : of records; None for measured responses
    reasons : tuple of str
    remarks : tuple of Finding
        What was noticed while the responses were made.
    """

    method: Any
    kernel: HankelModels
    feedthrough: NDArray[np.bool_]
    stream: Stream | None
    gram: BlockGram | None
    reasons: tuple[str, ...]
    remarks: tuple[Finding, ...]

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """What the data lack, and what was noticed."""
        if self.stream is None or self.gram is None:
            return self.remarks
        return (*data_findings(self.stream, self.gram), *self.remarks)

    @property
    def largest_order(self) -> int:
        return self.kernel.largest_order

    @property
    def rank_limited(self) -> bool:
        """Whether singular values beyond the largest order are nothing but rounding."""
        return self.kernel.rank_limited

    @property
    def limit(self) -> str:
        """What the largest order follows from, in words."""
        return self.kernel.limit

    @property
    def singular_values(self) -> Floats:
        """Of the balanced Hankel (or block correlation) matrix."""
        return self.kernel.singular_values

    @property
    def n_columns(self) -> int:
        """How many independent looks at the outputs there are."""
        raise NotImplementedError

    def criterion(self, order: int) -> tuple[float, bool]:
        """Return the information criterion of this order, and whether it is stable."""
        raise NotImplementedError

    def factors(self, order: int) -> tuple[Floats, Floats | None]:
        """Return observability (rows · p, n) and, where known, controllability (n, columns · m).

        In the coordinates of the order's model; their first blocks are C and B.
        """
        raise NotImplementedError

    def fit(self, order: int, method: Any) -> Fit:
        """Return the model of one order with its figures."""
        raise NotImplementedError

    @property
    def criterion_decides(self) -> bool:
        """Whether errors are white, so that the criterion has its minimum at the order."""
        return True

    def figures(self, order: int, A: Floats) -> dict[str, Any]:
        """Return what is known of the realization of one order."""
        return {
            "rows": self.method.rows,
            "columns": self.method.columns,
            "transition": type(self.method).__name__,
            "tail": self.kernel.tail(order),
            "spectral_radius": spectral_radius(A),
        }


def information(log_variances: float, n_columns: int, parameters: float) -> float:
    """Return columns · log det of the error covariance + ln(columns) a parameter (BIC)."""
    return float(n_columns * log_variances + np.log(n_columns) * parameters)


NO_GAIN = "none: {0} hold no process noise to learn it from"
