"""Feedback: do the inputs that come know what the outputs did by themselves?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from scipy.special import chdtrc

from ...fit import Finding
from ...linalg import triangle
from ...record import Floats
from .layout import Layout
from .states import NOISE_FREE

FALSE_ALARM = 1e-4  # probability that a record without feedback is suspected
NOTABLE_SHARE = 1e-3  # of the innovations' variance: less does not move a pole
NOTABLE_NOISE = 0.05  # of the outputs' variance: without noise there is nothing to feed back
BETWEEN_SAMPLES = 3  # next inputs that tell how the input moved between samples
MOST_STEPS = 10  # future inputs after these that are looked at
MOST_REGRESSORS = 200  # past samples taken into account


@dataclass(frozen=True)
class Feedback:
    """Result of the test.

    Attributes
    ----------
    probability : float
        Of a statistic as large as this where there is no feedback.
    share : float
        Of the innovations' variance that the future inputs explain, mean over outputs, less
        what chance explains.
    noise : float
        Share of the outputs' variance at the end of the horizon that neither the past nor
        the inputs explain: what a feedback could carry into the inputs.
    """

    probability: float
    share: float
    noise: float

    @property
    def suspected(self) -> bool:
        return (
            self.probability < FALSE_ALARM
            and self.share > NOTABLE_SHARE
            and self.noise > NOTABLE_NOISE
        )

    def findings(self) -> list[Finding]:
        """Say when feedback is suspected."""
        if not self.suspected:
            return []
        return [
            Finding(
                "feedback",
                "doubt",
                "The inputs follow what the outputs did before: future inputs explain "
                f"{100 * self.share:.2g} % of the innovations (by chance with a probability of "
                f"{self.probability:.1g}). That is feedback, from a controller or a shaker that "
                "the structure drives; shift invariance of a projected matrix is biased by it, "
                "regression of the states is not.",
                'Use weighting="ssarx" or "cva" with transition="regression" and '
                'completion="prediction", which "auto" takes here.',
            )
        ]


def feedback_of(R: Floats, layout: Layout, samples: int) -> Feedback | None:
    """Test whether innovations are correlated with future inputs; None without inputs or noise.

    The innovation is what a regression on the past and the present input leaves of y(t); the
    future inputs, too, are taken less what the past says of them. The next three inputs count
    among the known ones: a force that is not held between samples makes y(t) depend on them,
    less from one to the next, which is no feedback. In open loop the one is
    white given the other, and N tr(Σ_ee⁻¹ Σ_eu Σ_uu⁻¹ Σ_ue) is χ² with p m k degrees of
    freedom (Caines & Chan 1975 propose the test of causality in this direction).

    Parameters
    ----------
    R : array
        Triangle of the Hankel rows that `layout` describes.
    samples : int
        Columns of the Hankel matrix.
    """
    m, p = layout.n_inputs, layout.n_outputs
    steps = min(MOST_STEPS, layout.future_rows - 1 - BETWEEN_SAMPLES)
    if m == 0 or steps < 1:
        return None
    past = layout.past[-MOST_REGRESSORS:]
    known = len(past) + m * (1 + BETWEEN_SAMPLES)
    inputs = [layout.inputs(k) for k in range(1 + BETWEEN_SAMPLES + steps)]
    columns = np.concatenate([past, *inputs, layout.outputs(0)])
    T = triangle(R[:, columns])
    explained = T[known : len(columns) - p, -p:]
    error = T[known:, -p:]
    if _singular(T, known, p):
        return None
    whitened = sla.solve_triangular(_root(error), explained.T, lower=True)
    freedom = p * m * steps
    statistic = float((whitened**2).sum()) * samples
    share = max(0.0, (statistic - freedom) / (samples * p))
    return Feedback(float(chdtrc(freedom, statistic)), share, _noise(R, layout))


def _noise(R: Floats, layout: Layout) -> float:
    last = R[:, layout.outputs(layout.future_rows - 1)] ** 2
    known = layout.n_future_inputs + layout.n_past
    return float((last[known:].sum(axis=0) / last.sum(axis=0)).mean())


def _singular(T: Floats, known: int, n_outputs: int) -> bool:
    """Tell whether there are no innovations, or no news in the future inputs, to compare."""
    size = np.linalg.norm(T, axis=0)
    left = np.linalg.norm(T[known:, -n_outputs:], axis=0)
    own = np.abs(np.diag(T))[known : T.shape[1] - n_outputs]
    inputs = size[known : T.shape[1] - n_outputs]
    return bool((left <= NOISE_FREE * size[-n_outputs:]).any() or (own <= 1e-6 * inputs).any())


def _root(error: Floats) -> Floats:
    return np.asarray(np.linalg.cholesky(error.T @ error))
