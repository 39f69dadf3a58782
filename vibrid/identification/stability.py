"""What to do with an unstable model: raise, project, or return it as it is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import UnstableModelError
from ..fit import Finding, Fit
from ..kalman import DETECTABLE, STABLE_TO, spectral_radius
from ..record import Floats
from .options import option_names

NEIGHBOURS = 12  # orders above and below that the error message tries
NEAR_CIRCLE = 1e-4  # magnitudes closer to 1 are shown by their excess
INSIDE = 1 - 1e-9  # a projected pole stays at least this far from the circle
SIZES = {"block_rows": "block_rows", "observer_order": "observer_order", "rows": "rows and columns"}

POLICIES = ("raise", "project", "ignore")


def is_stable(fit: Fit) -> bool:
    """Tell whether no pole lies outside the unit circle (an undamped one may lie on it)."""
    return fit.model.spectral_radius <= STABLE_TO


def settle(fit: Fit, policy: str, method: Any, decomposition: Any) -> Fit:
    """Return the fit as the stability policy wants it.

    Raises
    ------
    UnstableModelError
        The policy is "raise" and a pole lies outside the unit circle.
    """
    if is_stable(fit):
        return fit
    outside = worst_pole(fit)
    if policy == "raise":
        near = _stable_orders(method, decomposition, fit.order)
        raise UnstableModelError(
            f"The model of order {fit.order} is unstable: {outside}. "
            + (f"{near}; or u" if near else "U")
            + f'se other {_sizes(method)}, or stability="project" (--stability project).'
        )
    if policy == "project":
        return projected(fit)
    # without segments the realization is the whole model
    kept = "; B, D, offsets and initial states were not fitted to the data" if fit.segments else ""
    finding = Finding("unstable", "warning", f"The model is unstable: {outside}{kept}.")
    figures = {"completion": "regression"} if fit.segments else {}
    return replace(fit, diagnostics=fit.diagnostics.joined(figures, [finding]))


def _sizes(method: Any) -> str:
    """Return the options of this method that another size of the problem is asked for by."""
    return next((words for name, words in SIZES.items() if name in option_names(method)), "data")


def worst_pole(fit: Fit) -> str:
    """Return magnitude and frequency of the largest pole of an unstable fit, in words."""
    poles = fit.model.poles
    worst = poles[np.argmax(np.abs(poles))]
    dt = fit.model.dt or 1.0
    frequency = abs(np.log(complex(worst))) / (2 * np.pi * dt)
    count = int((np.abs(poles) > STABLE_TO).sum())
    more = f", the worst of {count} such poles" if count > 1 else ""
    size = abs(worst)
    shown = f"{size:.6g}" if size > 1 + NEAR_CIRCLE else f"1 + {size - 1:.2g}"
    return f"a pole has magnitude {shown} at {frequency:.4g} Hz{more}"


def _stable_orders(method: Any, decomposition: Any, order: int) -> str:
    """Say which orders next to this one are stable; empty if none is near."""
    found = []
    largest = decomposition.largest_order
    for step in (
        range(order - 1, max(0, order - NEIGHBOURS), -1),
        range(order + 1, min(largest, order + NEIGHBOURS) + 1),
    ):
        for k in step:
            if is_stable(method.realize(decomposition, k)):
                found.append(str(k))
                break
    if len(found) == 2:
        return f"Orders {found[0]} and {found[1]} are stable"
    return f"Order {found[0]} is stable" if found else ""


def projected(fit: Fit) -> Fit:
    """Return the fit with the poles outside the unit circle reflected; frequencies stay."""
    values, vectors = np.linalg.eig(fit.model.A)
    size = np.abs(values)
    inside = np.where(size > 1, np.minimum(1 / size, INSIDE) / size * values, values)
    A: Floats = np.real(vectors * inside @ np.linalg.inv(vectors))
    finding = Finding(
        "projected",
        "warning",
        f"The model was unstable ({worst_pole(fit)}) and was projected: its poles outside the unit "
        "circle were reflected into it.",
        "Damping of these poles is not to be believed; try another order.",
    )
    model = fit.model
    K = fit.kalman_gain
    if spectral_radius(A - K @ model.C) >= DETECTABLE:
        K = np.zeros_like(K)
    return replace(
        fit,
        model=_with_transition(model, A),
        kalman_gain=K,
        diagnostics=fit.diagnostics.joined({}, [finding]),
    )


def _with_transition(model: Any, A: Floats) -> Any:
    """Return the model with another A."""
    return type(model)(A, model.B, model.C, model.D, model.dt)
