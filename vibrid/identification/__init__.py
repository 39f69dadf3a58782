"""identify(): from records to a finished model, every choice explained."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..chunks import OFFSETS, open_stream
from ..errors import DataError, OptionError, check_choice
from ..fit import Fit
from ..methods import ERA, ERADC, METHODS, N4SID, SSI
from ..record import FrequencyResponses, ImpulseResponses, Record
from .assessment import Assessment, assess, assess_last
from .choice import Progress, choose, choose_for_responses
from .completion import complete
from .findings import with_findings, with_reasons
from .finishing import finish, settled
from .refining import refined, refined_order
from .scan import OrderScan, scan_orders, steady_modes
from .stability import POLICIES

__all__ = [
    "METHODS",
    "Assessment",
    "OrderScan",
    "assess",
    "assess_unseen",
    "complete",
    "default_method",
    "identify",
    "scan_orders",
    "steady_modes",
]

Responses = ImpulseResponses | FrequencyResponses


def default_method(data: Record | Responses) -> Any:
    """Return N4SID for a record with inputs, SSI for one without, ERA for responses."""
    if not isinstance(data, Record):
        return ERA()
    return N4SID() if data.n_inputs else SSI()


def identify(
    data: Record | Sequence[Record] | Responses,
    method: Any = None,
    order: int | str = "auto",
    *,
    offset: str = "estimate",
    feedthrough: bool | Sequence[bool] | None = None,
    stability: str = "raise",
    refine: bool = False,
    progress: Progress | None = None,
) -> Fit:
    """Identify a state-space model from records or from measured responses.

    Parameters
    ----------
    data : Record, sequence of Record, ImpulseResponses or FrequencyResponses
        Several records of the same channels and rate are one identification; NaN samples
        are gaps. Every contiguous piece has an initial state of its own.
    method : N4SID, SSI, OKID, ERA or ERADC, optional
        N4SID when there are inputs, SSI when there are none, ERA for responses (free decays
        need it named). Options left out are chosen, and the reasons said.
    order : int or "auto"
        Number of states. "auto" takes, with inputs, the smallest order up to the lowest
        information criterion that simulates unseen halves of the record within 5 % of the
        best; without, the smallest that holds every mode that persists over the orders.
    offset : "estimate", "mean" or "none"
        Project a constant out exactly, subtract means, or use raw data.
    feedthrough : bool or one for each output, optional
        Whether D is estimated; None: not for displacements and velocities.
    stability : "raise", "project" or "ignore"
        What to do when the model is unstable. With "project" poles outside the unit circle are
        reflected, and what is so only by noise is not passed over: a better transition, and
        without inputs the orders of nearly undamped motion.
    refine : bool
        Improve the model by maximum likelihood, see `refine`; with inputs and order "auto"
        the order comes from elimination: modes of a model with too many are removed one by
        one, what is left refined and scored on unseen halves, against the order found
        without.
    progress : callable (what, done, total), optional
        Called now and then during long work.

    Returns
    -------
    Fit
        Its `diagnostics` hold the reasons ("choices"), figures and findings.

    Raises
    ------
    OptionError
        An unknown option or an order that is not possible.
    DataError
        Data that cannot be identified: too short, constant or empty channels, NaN only.
    UnstableModelError
        The model is unstable and `stability` is "raise".

    Examples
    --------
    >>> from vibrid.excitation import white_noise
    >>> from vibrid.structures import chain
    >>> frame = chain([1.0, 1.0], [400.0, 400.0], damping_ratio=0.01)
    >>> force = white_noise(2000, rng=np.random.default_rng(0))
    >>> fit = identify(frame.simulate(force, 0.05, forces=["f1"]), order=4)
    >>> (fit.model.frequencies_hz / frame.frequencies_hz).round(6).tolist()
    [1.0, 1.0]
    """
    check_choice("stability", stability, POLICIES)
    check_choice("offset", offset, OFFSETS)
    _check_order(order)
    report: Progress = progress or (lambda what, done, total: None)
    if isinstance(data, Responses):
        if refine:
            raise OptionError("refine=True needs records; responses are realized as they are.")
        return _from_responses(data, method, order, feedthrough, stability, report)
    stream = open_stream(data, offset)
    method = _checked_method(method, stream.records[0])
    report("reduce", 0, 1)
    if refine and isinstance(order, str) and stream.n_inputs:
        return with_findings(refined_order(stream, method, feedthrough, report), stream)
    choice = choose(stream, method, order, feedthrough, report, stability)
    report("complete", 0, 1)
    fit = finish(choice.method, choice.decomposition, choice.order, stream, stability)
    if refine:
        fit = refined(fit, stream, progress=report)
    return with_reasons(fit, stream, choice)


def _from_responses(
    responses: Responses,
    method: Any,
    order: int | str,
    feedthrough: bool | Sequence[bool] | None,
    stability: str,
    report: Progress,
) -> Fit:
    """Identify from impulse or frequency responses: the realization is the whole model."""
    method = _checked_method(method, responses)
    if not isinstance(method, ERA | ERADC):
        raise OptionError(
            f"{type(method).__name__} takes records; for {type(responses).__name__} use ERA() or "
            "ERADC() (--method era)."
        )
    report("reduce", 0, 1)
    decomposition = method.decompose(responses, feedthrough=feedthrough)
    choice = choose_for_responses(decomposition, order, report)
    fit = settled(choice.method, decomposition, choice.order, stability)
    return with_reasons(fit, None, choice)


def assess_unseen(record: Record, fit: Fit, share: float = 0.25) -> Assessment | None:
    """Score the fit's method and order on data they have not seen.

    Identifies the first part of the record again with the method's options and order as
    chosen, refines it where the fit was refined, and scores the last `share` of it. None where
    a part is too short for that.
    """
    cut = round((1 - share) * record.n_samples)
    offset = fit.gram.offset if fit.gram is not None else "estimate"
    mask = fit.feedthrough.tolist()
    part, form = record.slice(0, cut), fit.diagnostics.figures.get("refinement", "none")
    try:
        twin = identify(
            part, fit.method, fit.order, offset=offset, feedthrough=mask, stability="project"
        )
        if form != "none":
            twin = refined(twin, open_stream(part, offset), noise=form)
        return assess_last(twin, record, cut)
    except (DataError, OptionError):
        return None


def _check_order(order: int | str) -> None:
    if isinstance(order, str):
        check_choice("order", order, ("auto",))
    elif isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 1:
        raise OptionError(f'order must be "auto" or a whole number, at least 1; got {order!r}.')


def _checked_method(method: Any, data: Record | Responses) -> Any:
    if method is None:
        return default_method(data)
    if not isinstance(method, tuple(METHODS.values())):
        known = ", ".join(f"{each.__name__}()" for each in METHODS.values())
        raise OptionError(f"method must be one of {known}; got {method!r}.")
    return method
