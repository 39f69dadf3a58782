"""Order by elimination from a model with too many modes, scored on unseen halves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import Stream
from ..errors import DataError, OptionError
from ..fit import Finding, Fit
from ..methods.preparation import check_length
from ..refinement import Elimination, Search, eliminate, held_out_curve, refine_output_error
from ..scores import start_samples
from .choice import choose
from .finishing import finish
from .held_out import GRID, halves_of, scored_segments, unseen_error
from .noise_forms import LARGEST_PREDICTOR, Progress, by_folds, explained
from .options import closed, leaves_horizon
from .stability import settle

Mask = bool | Sequence[bool] | None
DRIFT = 20.0  # see `Search`: keeps drifts out of the order that is looked for
LARGEST_OVER = 1500  # rows of the Hankel matrix of the model with too many modes
LONGEST_OVER = 60  # block rows of it
OVER_ORDER = 44
SAMPLES_PER_STATE = 20  # at least, of the model with too many modes
ENOUGH = 1.02  # of the smallest error: what a smaller order may cost
SIMPLER = 1.05  # of its error: what fewer states, found without elimination, may cost
WORTH = 1.6  # of the smallest error before refinement: orders beyond are not refined
FINE = range(28, OVER_ORDER + 1, 2)  # orders tried beside those of the grid
QUICK = 2  # steps of the search that ranks orders


def refined_order(
    stream: Stream, method: Any, feedthrough: Mask = None, progress: Progress | None = None
) -> Fit:
    """Return the refined model of the order that simulates unseen halves about best.

    A model with too many modes loses them one by one (`eliminate`); what is left is refined
    and scored on unseen halves. The smallest order within 2 % of the best is eliminated to on
    all data, and refined. Where the predictor is not too large to be searched, the model that
    identify() finds without elimination is refined too, in the better form of noise, and kept
    if unseen halves say so.

    Parameters
    ----------
    stream : Stream
        With inputs.
    method : Method
        Its weighting and transition where given; a long horizon unless `block_rows` is.
    feedthrough : as for identify()
    progress : callable (what, done, total), optional

    Returns
    -------
    Fit
        Figures "elimination_orders" and "elimination_costs" of all data, "held_out_errors"
        (n, 2) of order and mean error on unseen halves, "choices" with the reason.

    Raises
    ------
    OptionError
        There are no inputs: elimination ranks modes by what they add to a simulation.
    """
    if not stream.n_inputs:
        raise OptionError(
            "Order by elimination needs inputs, because it ranks modes by what they add to the "
            "simulation; give the inputs, or an order."
        )
    report: Progress = progress or (lambda what, done, total: None)
    report("eliminate", 0, 3)
    whole = _eliminated(stream, method, feedthrough)
    folds = _folds(stream, method, feedthrough, report)
    curve = _curve(folds, [int(order) for order in whole.orders], report)
    if curve:
        limit = ENOUGH * min(curve.values())
        order = min(order for order, error in curve.items() if error <= limit)
        why = (
            f"order={order} is the smallest reached by elimination from {whole.orders[0]} that, "
            f"refined, simulates unseen halves within {100 * (ENOUGH - 1):.2g} % of the error of "
            f"the best ({100 * curve[order]:.3g} %)"
        )
    else:
        order, why = _by_cost(whole, stream)
    fit = refine_output_error(whole.at(order), stream, whole.search, progress)
    fit = explained(fit, "the order was found by simulation errors", choices=(why,))
    if curve and order * (stream.n_inputs + stream.n_outputs + 2) <= LARGEST_PREDICTOR:
        fit = _better(fit, curve[order], _rival(stream, method, feedthrough, report))
    figures = {
        "held_out_errors": np.array(sorted(curve.items())),
        "elimination_orders": whole.orders,
        "elimination_costs": whole.costs,
    }
    return replace(fit, diagnostics=fit.diagnostics.joined(figures))


def _eliminated(stream: Stream, method: Any, feedthrough: Mask) -> Elimination:
    """Return the elimination from a model with too many modes."""
    option = _over(method, stream)
    decomposition = option.decompose(stream, feedthrough=feedthrough)
    order = min(OVER_ORDER, decomposition.largest_order, _most_states(stream))
    fit = settle(option.realize(decomposition, order), "project", option, decomposition)
    fit = _with(replace(fit, method=method), decomposition.findings)
    return eliminate(fit, stream, Search(weights="balanced", drift=DRIFT))


def _with(fit: Fit, findings: Sequence[Finding]) -> Fit:
    """Return the fit with these findings, each once."""
    more = [each for each in findings if each not in fit.diagnostics.findings]
    return replace(fit, diagnostics=fit.diagnostics.joined({}, more))


def _rival(stream: Stream, method: Any, feedthrough: Mask, report: Progress) -> Fit | None:
    """Return the refinement of what is identified without elimination, if it can be judged.

    Elimination sees simulations only: where much noise drives the structure, its smallest
    errors are at orders that fit this noise, and the innovations form does better.
    """
    choice = choose(stream, method, "auto", feedthrough, report)
    start = finish(choice.method, choice.decomposition, choice.order, stream, "project")
    fit = by_folds(start, stream, report)
    if "refinement_errors" not in fit.diagnostics.figures:
        return None
    fit = replace(fit, diagnostics=fit.diagnostics.joined({"choices": choice.reasons}))
    return _with(fit, choice.decomposition.findings)


def _better(fit: Fit, error: float, rival: Fit | None) -> Fit:
    """Return the rival where it simulates unseen halves better, or as well with fewer states."""
    if rival is None:
        return fit
    known = rival.diagnostics.figures
    other = known["refinement_errors"][known["refinement"]]
    if rival.order == fit.order and known["refinement"] == fit.diagnostics.figures["refinement"]:
        return fit
    if other > (SIMPLER if rival.order < fit.order else 1.0) * error:
        return fit
    why = (
        f"elimination went to order {fit.order}, which simulates unseen halves with "
        f"{100 * error:.3g} %: order {rival.order} as identified, refined, with {100 * other:.3g} %"
    )
    return explained(rival, known["refinement_reason"], choices=(*known["choices"], why))


def _over(method: Any, stream: Stream) -> Any:
    """Return the method with a long horizon, weighting and transition that keep all modes."""
    over = closed(method, weighting="moesp", transition="shift")
    if not leaves_horizon(over):
        return over
    channels = stream.n_inputs + stream.n_outputs
    rows = min(LONGEST_OVER, LARGEST_OVER // (2 * channels))
    return replace(over, block_rows=_longest(stream, max(rows, 2)))


def _longest(stream: Stream, rows: int) -> int:
    for shorter in range(rows, 2, -1):
        try:
            check_length(stream, 2 * shorter)
        except DataError:
            continue
        return shorter
    return 2


def _most_states(stream: Stream) -> int:
    return max(2, stream.n_samples * stream.n_outputs // (SAMPLES_PER_STATE * len(stream.scale)))


def _folds(
    stream: Stream, method: Any, feedthrough: Mask, report: Progress
) -> list[tuple[Elimination, Stream]]:
    """Return the elimination on each half with the other half; none where they are too short."""
    halves, found = halves_of(stream), []
    for k, (seen, unseen) in enumerate((halves, halves[::-1])):
        report("eliminate", 1 + k, 3)
        try:
            eliminated = _eliminated(seen, method, feedthrough)
        except DataError:
            return []
        if not scored_segments(unseen, start_samples(int(eliminated.orders[0]))):
            return []
        found.append((eliminated, unseen))
    return found


def _curve(
    folds: Sequence[tuple[Elimination, Stream]], orders: Sequence[int], report: Progress
) -> dict[int, float]:
    """Return order → mean error on unseen halves of the models that a few steps have refined."""
    if not folds:
        return {}
    skipped = start_samples(max(orders))

    def scored_on(unseen: Stream) -> Callable[[Fit], float]:
        return lambda fit: unseen_error(fit, unseen, skipped)

    scored = [(eliminated, scored_on(unseen)) for eliminated, unseen in folds]
    wanted = [order for order in (*GRID, *FINE) if min(orders) <= order <= max(orders)]
    grid = sorted({max(order for order in orders if order <= each) for each in wanted})
    rough = held_out_curve(scored, grid, 0)
    limit = WORTH * min(rough.values(), default=0.0)
    good = [order for order in rough if rough[order] <= limit]
    curve = held_out_curve(scored, good, QUICK, report)
    return {order: value for order, value in curve.items() if np.isfinite(value)}


def _by_cost(whole: Elimination, stream: Stream) -> tuple[int, str]:
    """Return the order that balances cost and parameters (Schwarz 1978)."""
    m, p, count = stream.n_inputs, stream.n_outputs, stream.n_samples
    observed = count * p
    values = observed * np.log(whole.costs) + whole.orders * (m + p) * np.log(observed)
    order = int(whole.orders[int(np.argmin(values))])
    why = (
        f"order={order} balances simulation error and parameters best of what elimination from "
        f"{whole.orders[0]} passes; the record is too short for unseen halves"
    )
    return order, why
