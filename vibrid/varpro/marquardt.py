"""Levenberg-Marquardt steps whose cost never rises."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

import numpy as np
import scipy.linalg as sla
from numpy.typing import NDArray

from ..record import Floats

FIRST_DAMPING = 1e-3
SMALLEST_DAMPING = 1e-9
LARGEST_DAMPING = 1e8
GOOD, POOR = 0.75, 0.25  # gain over promise at which the damping is eased, or raised
Progress = Callable[[str, int, int], None]
FLAT = 1e-11  # relative eigenvalue of the information below which a direction changes nothing


class Point(Protocol):
    """A place in the search: cost Σ e², half its gradient, and JᵀJ."""

    @property
    def cost(self) -> float: ...
    @property
    def gradient(self) -> Floats: ...
    @property
    def information(self) -> Floats: ...
    @property
    def neutral(self) -> Floats:
        """Directions (n_parameters, k) that change nothing."""
        ...

    def moved(self, step: Floats) -> Self: ...
    def pushed_out(self, step: Floats) -> NDArray[np.bool_]:
        """Tell which parameters are at a bound that the step would cross."""
        ...


class Projecting:
    """A point whose cost and slopes are those of its `projected`."""

    projected: Any

    @property
    def cost(self) -> float:
        return float(self.projected.cost)

    @property
    def gradient(self) -> Floats:
        return np.asarray(self.projected.gradient)

    @property
    def information(self) -> Floats:
        return np.asarray(self.projected.information)

    @property
    def neutral(self) -> Floats:
        return np.asarray(self.projected.neutral)


P = TypeVar("P", bound=Point)


@dataclass(frozen=True, eq=False)
class Descent(Generic[P]):
    """Where a search ended: the point, and how it got there."""

    point: P
    iterations: int
    start_cost: float
    converged: bool


def descend(
    start: P,
    *,
    tolerance: float,
    negligible: float = 0.0,
    largest: int = 50,
    progress: Progress | None = None,
) -> Descent[P]:
    """Return the point of least cost that damped Gauss-Newton steps reach.

    Steps are of minimum norm in parameters of unit information, and orthogonal to what changes
    nothing, which therefore needs no canonical form. Parameters that a step would push over
    their bound are held for it.

    Parameters
    ----------
    start : Point
    tolerance : float
        Ends when a full step promises a relative fall of the cost below this,
    negligible : float
        or a fall below this.
    largest : int
        Number of steps taken at most.
    progress : callable (what, done, total), optional
        Called before every step.
    """
    point, damping = start, FIRST_DAMPING
    for taken in range(largest):
        if progress is not None:
            progress("refine", taken, largest)
        system = _System(point)
        if system.step(0.0)[1] <= max(tolerance * point.cost, negligible):
            return Descent(point, taken, start.cost, True)
        trial = None
        while trial is None:
            step, promised = system.step(damping)
            trial = point.moved(step)
            gain = point.cost - trial.cost
            damping = _adapted(damping, gain / promised if promised > 0 else -1.0)
            if not gain > 0:
                if damping > LARGEST_DAMPING:
                    return Descent(point, taken, start.cost, False)
                trial = None
        point = trial
    return Descent(point, largest, start.cost, False)


def _adapted(damping: float, ratio: float) -> float:
    if ratio > GOOD:
        return max(damping / 10, SMALLEST_DAMPING)
    if ratio > POOR:
        return damping
    return 4 * damping if ratio > 0 else 10 * max(damping, FIRST_DAMPING)


class _System:
    """The normal equations at a point, in parameters of unit information."""

    def __init__(self, point: Point, held: NDArray[np.bool_] | None = None) -> None:
        self.point, self.held = point, held
        H, g = point.information, point.gradient
        size = np.sqrt(np.maximum(np.diag(H), 0))
        free = size > 0 if held is None else (size > 0) & ~held
        self.size = np.where(free, size, np.inf)
        unit = _orthogonal(H / self.size / self.size[:, None], size[:, None] * point.neutral)
        self.values, self.vectors = sla.eigh(unit, check_finite=False, driver="evd")
        self.slope = self.vectors.T @ (g / self.size)

    def step(self, damping: float) -> tuple[Floats, float]:
        """Return a step and the fall of the cost that it promises."""
        kept = self.values > FLAT * self.values.max(initial=1e-300)
        inverse = np.where(kept, 1 / np.where(kept, self.values + damping, 1), 0)
        turned = inverse * self.slope
        step = -(self.vectors @ turned) / self.size
        if self.held is None:
            held = self.point.pushed_out(step)
            if held.any():
                return _System(self.point, held).step(damping)
        promised = 2 * self.slope @ turned - self.values @ turned**2
        return np.asarray(step), float(promised)


def _orthogonal(matrix: Floats, directions: Floats) -> Floats:
    """Return N matrix N, N the projection off some directions; those of zero length are none."""
    if directions.shape[1] == 0:
        return matrix
    length = np.linalg.norm(directions, axis=0)
    Q = sla.qr(directions[:, length > 0] / length[length > 0], mode="economic")[0]
    across = Q.T @ matrix
    inner = across @ Q
    return np.asarray(matrix - Q @ across - (across.T - Q @ inner) @ Q.T)
