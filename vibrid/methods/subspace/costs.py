"""What a model misses over the horizon, from the factor alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...linalg import triangle
from ...record import Floats
from ...statespace import free_responses
from ..result import Realization
from .layout import Layout
from .states import NOISE_FREE

_unstable_overflow = np.errstate(over="ignore", invalid="ignore")  # seen by what is not finite


@_unstable_overflow
def prediction_cost(
    R: Floats, layout: Layout, state_map: Floats, model: Realization, samples: int
) -> float:
    """Return log det of the covariance of y − ŷ at the last future step.

    ŷ(k) = C Ã^k J W_p + Σ_j C Ã^(k−1−j) [B̃ u(j) + K y(j)] + D u(k); Ã = A − K C, B̃ = B − K D.
    `R` is the triangle of the Hankel rows in the order of `layout`, `state_map` (as many states
    or more, n_past) is J, `samples` the number of Hankel columns.
    """
    step, p = layout.future_rows - 1, layout.n_outputs
    A, B = model.A - model.K @ model.C, model.B - model.K @ model.D
    free = free_responses(A, model.C, step + 1)
    errors = np.zeros((len(R), p))
    first = len(R) - layout.future_rows * p
    errors[: step * layout.n_inputs] = -_stacked(free @ B, step)
    errors[first : first + step * p] = -_stacked(free @ model.K, step)
    errors[layout.past] = -(free[step] @ state_map[: len(model.A)]).T
    errors[layout.inputs(step)] = -model.D.T
    errors[layout.outputs(step)] = np.eye(p)
    return _log_det(R @ errors, R[:, layout.outputs(step)], samples)


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Triangle of the rows [x, y(steps)] less what the future inputs explain of them.

    What B and D are does not matter to it: under a coloured input they are known far worse
    than A. It is much smaller than the factor, and serves models of every order.
    """

    triangle: Floats
    steps: tuple[int, ...]
    floor: Floats

    @_unstable_overflow
    def cost(self, A: Floats, C: Floats, samples: int) -> float:
        """Return the mean over the steps of log det of the covariance of y − C Aᵏ x."""
        (p, n), count = C.shape, len(self.steps)
        free = free_responses(A, C, self.steps[-1] + 1)
        if not np.isfinite(free).all():
            return np.inf
        expected = free[list(self.steps)].reshape(count * p, n).T
        outputs = self.triangle[:, self.triangle.shape[1] - count * p :]
        missed = (outputs - self.triangle[:, :n] @ expected).T.reshape(count, p, -1)
        covariances = missed @ missed.transpose(0, 2, 1) + self.floor
        return float(np.linalg.slogdet(covariances / samples)[1].mean())


def free_run(R: Floats, layout: Layout, state_map: Floats) -> FreeRun:
    """Return what free responses over the horizon need: four steps, the last one among them."""
    last, p = layout.future_rows - 1, layout.n_outputs
    steps = sorted({max(1, last * k // 4) for k in (1, 2, 3, 4)})
    outputs = R[:, np.concatenate([layout.outputs(step) for step in steps])]
    # the future inputs come first in the factor: their rows hold what they explain
    free = slice(layout.n_future_inputs, None)
    samples = np.hstack([R[free, layout.past] @ state_map.T, outputs[free]])
    size = (outputs**2).sum(axis=0).reshape(-1, p, 1)  # rounding is of the whole outputs
    return FreeRun(triangle(samples), tuple(steps), NOISE_FREE**2 * size * np.eye(p))


def _stacked(responses: Floats, step: int) -> Floats:
    """Return what inputs 0 … step − 1 do at the step, rows by time (step · m, p)."""
    late_first = responses[:step][::-1].transpose(0, 2, 1)
    return np.asarray(late_first.reshape(-1, responses.shape[1]))


def _log_det(errors: Floats, outputs: Floats, samples: int) -> float:
    if not np.isfinite(errors).all():
        return np.inf
    floor = NOISE_FREE**2 * np.diag((outputs**2).sum(axis=0))
    return float(np.linalg.slogdet((errors.T @ errors + floor) / samples)[1])
