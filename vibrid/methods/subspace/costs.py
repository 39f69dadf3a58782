"""What a model misses over the horizon, from the factor alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...linalg import triangle
from ...record import Floats
from ..result import Realization
from .layout import Layout
from .states import NOISE_FREE


def prediction_cost(
    R: Floats, layout: Layout, state_map: Floats, model: Realization, samples: int
) -> float:
    """Return log det of the covariance of y − ŷ at the last future step.

    ŷ(k) = C Ã^k J W_p + Σ_j C Ã^(k−1−j) [B̃ u(j) + K y(j)] + D u(k).
    """
    step, p = layout.future_rows - 1, layout.n_outputs
    free, driven, corrected = _responses(model, model.K, step)
    errors = np.zeros((len(R), p))
    first = len(R) - layout.future_rows * p
    errors[: step * layout.n_inputs] = -_stacked(driven, step)
    errors[first : first + step * p] = -_stacked(corrected, step)
    errors[layout.past()] = -(free[step] @ state_map[: len(model.A)]).T
    errors[layout.inputs(step)] = -model.D.T
    errors[layout.outputs(step)] = np.eye(p)
    return _log_det(R @ errors, R[:, layout.outputs(step)], samples)


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Triangle of the rows [u(0) … u(last), x, y(steps)] that a simulation needs.

    It is much smaller than the factor, and serves models of every order.
    """

    triangle: Floats
    steps: tuple[int, ...]
    n_inputs: int
    n_outputs: int

    @property
    def _first_output(self) -> int:
        return len(self.triangle) - len(self.steps) * self.n_outputs

    @cached_property
    def _floor(self) -> Floats:
        """Rounding of the outputs' covariance at each step (steps, p, p)."""
        size = (self.triangle[:, self._first_output :] ** 2).sum(axis=0)
        diagonal = size.reshape(-1, self.n_outputs, 1) * np.eye(self.n_outputs)
        return np.asarray(NOISE_FREE**2 * diagonal)

    def cost(self, model: Realization, samples: int) -> float:
        """Return the mean over the steps of log det of the covariance of y − ŷ."""
        m, p, n = self.n_inputs, self.n_outputs, len(model.A)
        free, driven, _ = _responses(model, np.zeros_like(model.K), self.steps[-1])
        states, outputs = (self.steps[-1] + 1) * m, self._first_output
        errors = np.zeros((len(self.triangle), len(self.steps) * p))
        for k, step in enumerate(self.steps):
            columns = slice(k * p, (k + 1) * p)
            errors[: step * m, columns] = -_stacked(driven, step)
            errors[step * m : (step + 1) * m, columns] = -model.D.T
            errors[states : states + n, columns] = -free[step].T
            errors[outputs + k * p : outputs + (k + 1) * p, columns] = np.eye(p)
        missed = (self.triangle @ errors).T.reshape(len(self.steps), p, -1)
        if not np.isfinite(missed).all():
            return np.inf
        covariances = missed @ missed.transpose(0, 2, 1) + self._floor
        return float(np.linalg.slogdet(covariances / samples)[1].mean())


def free_run(R: Floats, layout: Layout, state_map: Floats) -> FreeRun:
    """Return what simulations over the horizon need: four steps, the last one among them."""
    last = layout.future_rows - 1
    steps = sorted({max(1, last * k // 4) for k in (1, 2, 3, 4)})
    outputs = np.concatenate([layout.outputs(step) for step in steps])
    samples = np.hstack(
        [
            R[:, : (last + 1) * layout.n_inputs],
            R[:, layout.past()] @ state_map.T,
            R[:, outputs],
        ]
    )
    T = triangle(samples)
    square = np.pad(T, ((0, samples.shape[1] - len(T)), (0, 0)))
    return FreeRun(square, tuple(steps), layout.n_inputs, layout.n_outputs)


def _stacked(responses: Floats, step: int) -> Floats:
    """Return what inputs 0 … step − 1 do at the step, rows by time (step · m, p)."""
    late_first = responses[:step][::-1].transpose(0, 2, 1)
    return np.asarray(late_first.reshape(-1, responses.shape[1]))


def _log_det(errors: Floats, outputs: Floats, samples: int) -> float:
    if not np.isfinite(errors).all():
        return np.inf
    floor = NOISE_FREE**2 * np.diag((outputs**2).sum(axis=0))
    return float(np.linalg.slogdet((errors.T @ errors + floor) / samples)[1])


def _responses(model: Realization, gain: Floats, count: int) -> tuple[Floats, Floats, Floats]:
    """Return C Ã^k, C Ã^k B̃ and C Ã^k K for k ≤ count; Ã = A − K C, B̃ = B − K D."""
    A, B = model.A - gain @ model.C, model.B - gain @ model.D
    free = np.empty((count + 1, *model.C.shape))
    free[0] = model.C
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable model; seen by the caller
        for k in range(count):
            free[k + 1] = free[k] @ A
        return free, free @ B, free @ gain
