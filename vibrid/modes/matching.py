"""match_modes: which mode of one model is which of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import check_positive
from .shapes import mac
from .values import Modes


def match_modes(
    first: Modes,
    second: Modes,
    *,
    frequency_limit: float = 0.02,
    damping_limit: float | None = None,
    mac_limit: float = 0.8,
) -> NDArray[np.int64]:
    """Pair modes of two models, each at most once: as many as the limits allow, then the closest.

    Parameters
    ----------
    first, second : Modes
        Of the same outputs.
    frequency_limit : float
        Largest relative difference of frequency.
    damping_limit : float, optional
        Largest relative difference of the damping ratio; unlimited by default.
    mac_limit : float
        Smallest MAC.

    Returns
    -------
    array (n_pairs, 2)
        Indices into `first` and `second`, ordered by the first.
    """
    from scipy.optimize import linear_sum_assignment  # slow to import, and used only here

    if first.n_modes == 0 or second.n_modes == 0:
        return np.zeros((0, 2), dtype=np.int64)
    check_positive("frequency_limit", frequency_limit)
    f, g = first.frequencies_hz[:, None], second.frequencies_hz[None, :]
    apart = np.abs(f - g) / np.maximum(f, g)
    alike = mac(first.shapes, second.shapes)
    allowed = (apart <= frequency_limit) & (alike >= mac_limit)
    if damping_limit is not None:
        z, y = first.damping_ratios[:, None], second.damping_ratios[None, :]
        allowed &= np.abs(z - y) <= damping_limit * np.maximum(np.abs(z), np.abs(y))
    far = 10.0  # dearer than any allowed pair, so the number of pairs comes first
    cost = np.where(allowed, apart / frequency_limit + (1 - alike), far)
    rows, columns = linear_sum_assignment(cost)
    kept = allowed[rows, columns]
    return np.stack([rows[kept], columns[kept]], axis=1)
