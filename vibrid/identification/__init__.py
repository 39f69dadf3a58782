"""identify(): from records to a finished model, every choice explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..chunks import OFFSETS, Stream, open_stream
from ..errors import DataError, OptionError, check_choice
from ..fit import Finding, Fit
from ..methods import METHODS, N4SID, SSI
from ..modes import modes_of
from ..record import Record
from .assessment import Assessment, assess, assess_last
from .choice import Choice, Progress, choose
from .completion import complete
from .finishing import finish
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

SHORT_MEMORY = 1e-2  # what a predictor may still remember at the end of the past horizon
POOR_SIMULATION = 0.7  # rms error over standard deviation: half of the variance is missed
DRIFT_SHARE = 1 / 3  # of the record: a real pole slower than this plays a drift


def default_method(record: Record) -> Any:
    """Return N4SID for a record with inputs, SSI for one without."""
    return N4SID() if record.n_inputs else SSI()


def identify(
    data: Record | Sequence[Record],
    method: Any = None,
    order: int | str = "auto",
    *,
    offset: str = "estimate",
    feedthrough: bool | Sequence[bool] | None = None,
    stability: str = "raise",
    progress: Progress | None = None,
) -> Fit:
    """Identify a state-space model from one or several records.

    Parameters
    ----------
    data : Record or sequence of Record
        Several records of the same channels and rate are one identification; NaN samples
        are gaps. Every contiguous piece has an initial state of its own.
    method : N4SID or SSI, optional
        N4SID when there are inputs, SSI when there are none. Options left out (block_rows)
        are chosen by prediction error.
    order : int or "auto"
        Number of states. "auto" takes, with inputs, the smallest order up to the lowest
        information criterion that simulates unseen halves of the record within 5 % of the
        best; without, the smallest that holds every mode that persists over the orders.
    offset : "estimate", "mean" or "none"
        Project a constant out exactly, subtract means, or use raw data.
    feedthrough : bool or one for each output, optional
        Whether D is estimated; None: not for displacements and velocities.
    stability : "raise", "project" or "ignore"
        What to do when the model is unstable.
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
    stream = open_stream(data, offset)
    method = _checked_method(method, stream)
    report: Progress = progress or (lambda what, done, total: None)
    report("reduce", 0, 1)
    choice = choose(stream, method, order, feedthrough, report)
    report("complete", 0, 1)
    fit = finish(choice.method, choice.decomposition, choice.order, stream, stability)
    return _with_reasons(fit, stream, choice)


def assess_unseen(record: Record, fit: Fit, share: float = 0.25) -> Assessment | None:
    """Score the fit's method and order on data they have not seen.

    Identifies the first part of the record again with the method's options and order as
    chosen, and scores the last `share` of it. None where a part is too short for that.
    """
    cut = round((1 - share) * record.n_samples)
    offset = fit.gram.offset if fit.gram is not None else "estimate"
    mask = fit.feedthrough.tolist()
    try:
        twin = identify(
            record.slice(0, cut),
            fit.method,
            fit.order,
            offset=offset,
            feedthrough=mask,
            stability="project",
        )
        return assess_last(twin, record, cut)
    except (DataError, OptionError):
        return None


def _check_order(order: int | str) -> None:
    if isinstance(order, str):
        check_choice("order", order, ("auto",))
    elif isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 1:
        raise OptionError(f'order must be "auto" or a whole number, at least 1; got {order!r}.')


def _checked_method(method: Any, stream: Stream) -> Any:
    if method is None:
        return default_method(stream.records[0])
    if not isinstance(method, tuple(METHODS.values())):
        known = ", ".join(f"{each.__name__}()" for each in METHODS.values())
        raise OptionError(f"method must be one of {known}; got {method!r}.")
    return method


def _with_reasons(fit: Fit, stream: Stream, choice: Choice) -> Fit:
    figures: dict[str, Any] = {"choices": choice.reasons}
    if choice.scan is not None:
        figures["orders"] = choice.scan.orders
        figures["criterion"] = choice.scan.criterion
        figures["held_out_errors"] = choice.held_out
        figures["persistence"] = choice.scan.persistence(modes_of(fit), fit.order // 2)
    findings = [
        *_input_findings(fit),
        *_error_findings(fit),
        *_memory_findings(fit),
        *_drift_findings(fit, stream),
    ]
    return replace(fit, diagnostics=fit.diagnostics.joined(figures, findings))


def _input_findings(fit: Fit) -> list[Finding]:
    """Say when what usually drives a structure was taken as a response."""
    drives = [
        channel.name
        for channel in fit.output_channels
        if channel.quantity in ("force", "base_acceleration")
    ]
    if not drives or fit.input_channels:
        return []
    names = ",".join(drives)
    return [
        Finding(
            "input-as-response",
            "warning",
            f"{', '.join(drives)} measured what usually drives a structure and was taken as a "
            "response.",
            f"If it drives: select(inputs=[…]), or --inputs {names}.",
        )
    ]


def _error_findings(fit: Fit) -> list[Finding]:
    error = fit.diagnostics.figures.get("simulation_error", 0.0)
    if not (fit.input_channels and error > POOR_SIMULATION):
        return []
    return [
        Finding(
            "poor-simulation",
            "warning",
            f"Simulated from the inputs, the model misses {100 * error:.3g} % of the outputs' "
            "standard deviation.",
            "Try another order, a band, or check that the inputs are what drives the structure.",
        )
    ]


def _memory_findings(fit: Fit) -> list[Finding]:
    figures = fit.diagnostics.figures
    memory, rows = figures.get("predictor_memory", 0.0), figures.get("past_rows")
    # shift invariance does not suffer; with inputs and "auto" the two were compared
    compared = bool(fit.input_channels) and getattr(fit.method, "transition", "") == "auto"
    if memory <= SHORT_MEMORY or compared or figures.get("transition") != "regression":
        return []
    return [
        Finding(
            "short-horizon",
            "doubt",
            f"The predictor still remembers {100 * memory:.2g} % after the {rows} past rows "
            f"(limit {100 * SHORT_MEMORY:g} %), which biases damping.",
            "Use more block_rows.",
        )
    ]


def _drift_findings(fit: Fit, stream: Stream) -> list[Finding]:
    longest = max(segment.length for segment in stream.segments) * (fit.model.dt or 1.0)
    rates = np.abs(fit.model.continuous_poles)
    slow = int((rates * longest * DRIFT_SHARE < 1).sum())
    if not slow:
        return []
    return [
        Finding(
            "drift-pole",
            "doubt",
            f"{slow} pole(s) are slower than a third of the record ({longest:.4g} s): they play "
            "a drift, not the structure.",
            "Detrend the record, or identify in a band (--band).",
        )
    ]
