"""Order by elimination: from a model with too many modes, the least needed go one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..chunks import Stream
from ..errors import OptionError
from ..fit import Fit
from ..record import Floats
from ..varpro import Blocks, Progress, removals
from .output_error import DEFAULT, Search, refine_output_error, searched, start_of
from .place import Place, errors_of, starts_of
from .result import fit_of


@dataclass(frozen=True, eq=False)
class Elimination:
    """What is left of a model as its modes are removed one by one.

    Attributes
    ----------
    fit : Fit
        The model with too many modes.
    search : Search
    """

    fit: Fit
    search: Search
    place: Place
    steps: tuple[tuple[NDArray[np.bool_], float], ...]

    def __repr__(self) -> str:
        return f"<Elimination: orders {self.orders[0]} to {self.orders[-1]}>"

    @cached_property
    def orders(self) -> NDArray[np.int64]:
        """Orders passed through, descending from the model's own."""
        used = self.place.projected.blocks.used
        return np.array([used[left].sum() for left, _ in self.steps])

    @property
    def costs(self) -> Floats:
        """Weighted squares of the simulation errors at each order, relative to the first."""
        costs = np.array([cost for _, cost in self.steps])
        return np.asarray(costs / costs[0])

    def at(self, order: int) -> Fit:
        """Return the model of the largest order passed up to `order`; no pass over the data."""
        figures = {"elimination_orders": self.orders, "elimination_costs": self.costs}
        return fit_of(self.fit, self._place(order), figures)

    def _place(self, order: int) -> Place:
        which = np.flatnonzero(self.orders <= order)
        if not len(which):
            raise OptionError(
                f"order={order} is below {self.orders[-1]}, the smallest that elimination from "
                f"order {self.orders[0]} reaches."
            )
        projected = self.place.projected
        sums = projected.sums.select(self.steps[which[0]][0])
        return replace(self.place, projected=replace(projected, sums=sums))

    def refined(self, order: int, steps: int | None = None) -> Fit:
        """Return the model of that order after output-error refinement.

        Parameters
        ----------
        order : int
        steps : int, optional
            Of the search at most; then without deviations and findings. 0 is `at`.
        """
        if steps is None:
            return refine_output_error(self.at(order), self.place.stream, self.search)
        place = self._place(order)
        if steps:
            search = replace(self.search, largest=steps)
            place = searched(place.again(), search).point
        return fit_of(self.fit, place, {})


def eliminate(fit: Fit, stream: Stream, search: Search = DEFAULT) -> Elimination:
    """Return what is left as modes are removed from a model with too many.

    Each step removes the complex pair or real pole whose loss costs least; B and initial
    states of the others stay, C, D and offsets are fitted anew. One pass over the data.

    Parameters
    ----------
    fit : Fit
        Of an order well above the one looked for: 1.5 to 2 times.
    stream : Stream
    search : Search
        What is slower than its `drift` goes first.
    """
    starts = starts_of(fit, stream)
    errors = errors_of(fit, stream, starts)
    place = start_of(fit, stream, search, starts, errors, pair_real=False)
    slow = _slow(place.projected.blocks, stream, search.drift)
    return Elimination(fit, search, place, tuple(removals(place.projected, slow)))


def held_out_curve(
    folds: Sequence[tuple[Elimination, Callable[[Fit], float]]],
    orders: Sequence[int],
    steps: int | None = None,
    progress: Progress | None = None,
) -> dict[int, float]:
    """Return the mean error of each order's refined model on data it has not seen.

    Parameters
    ----------
    folds : sequence of (elimination on the seen data, error of a model on the unseen data)
    orders : sequence of int
        Those that some elimination does not reach are left out.
    steps : int, optional
        Of each search at most: a few are enough to rank orders.
    progress : callable (what, done, total), optional
    """
    means = {}
    for done, order in enumerate(orders):
        if progress is not None:
            progress("held out", done, len(orders))
        if all(order >= elimination.orders[-1] for elimination, _ in folds):
            errors = [error(elimination.refined(order, steps)) for elimination, error in folds]
            means[order] = float(np.mean(errors))
    return means


def _slow(blocks: Blocks, stream: Stream, drift: float) -> NDArray[np.bool_]:
    """Tell which blocks turn and decay by less than `drift` over the longest piece."""
    longest = max(segment.length for segment in stream.segments)
    root = np.where(blocks.single, 0, blocks.spread * np.sqrt(np.maximum(blocks.shape, 0)))
    with np.errstate(divide="ignore"):  # a pole at zero is as fast as can be
        rate = np.abs(np.log(blocks.centre + 1j * root))
    return np.asarray(rate * longest < drift)
