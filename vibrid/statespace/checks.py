"""Checks of what is simulated."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import DataError, OptionError, check_whole
from ..record import Floats

ROWS = 2**16  # rows at a time


def as_inputs(inputs: Any, n_samples: int | None, n_inputs: int) -> Any:
    """Return inputs with 2 axes, zero when None; arrays on disk stay there."""
    if inputs is None:
        if n_samples is None:
            raise OptionError("Give inputs, or n_samples for a response to no input.")
        check_whole("n_samples", n_samples, 1)
        return np.zeros((n_samples, n_inputs))
    u = inputs if hasattr(inputs, "shape") else np.asarray(inputs, dtype=np.float64)
    if len(u.shape) == 1:
        u = np.asarray(u).reshape(-1, 1)
    if len(u.shape) != 2 or u.shape[1] != n_inputs or not u.shape[0]:
        raise OptionError(
            f"inputs must have the shape (n_samples, {n_inputs}), time along axis 0; "
            f"got {tuple(u.shape)}."
        )
    if n_samples not in (None, u.shape[0]):
        raise OptionError(f"inputs have {u.shape[0]} samples, but n_samples={n_samples}.")
    _check_finite(u)
    return u


def as_state(initial_state: ArrayLike | None, order: int) -> Floats:
    """Return the initial state (order,), zero when None."""
    if initial_state is None:
        return np.zeros(order)
    state = np.asarray(initial_state, dtype=np.float64)
    if state.shape != (order,) or not np.isfinite(state).all():
        raise OptionError(
            f"initial_state must be {order} finite numbers, one a state; got shape {state.shape}."
        )
    return state


def _check_finite(u: Any) -> None:
    for start in range(0, u.shape[0], ROWS):
        good = np.isfinite(np.asarray(u[start : start + ROWS], dtype=np.float64)).all(axis=1)
        if not good.all():
            raise DataError(
                f"Input sample {start + int(np.argmin(good))} is NaN or infinite; simulate the "
                "pieces between gaps (record.segments()) one by one."
            )
