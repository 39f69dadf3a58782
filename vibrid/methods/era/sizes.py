"""How many block rows and columns a Hankel matrix gets, and what that needs."""

from __future__ import annotations

import numpy as np

from ...errors import DataError
from ...record import Floats

ENERGY_KEPT = 0.99  # of the responses: later lags hold more noise than they say of damping
LEVEL_LIMIT = 0.25  # energy of the last fifth over that of the first
STEADY_LIMIT = 0.7  # energy of the last fifth over that of the one before
FEWEST_LAGS = 60
SHORT_SIDE = 600  # elements: beyond it the decomposition takes most of a second
LONG_SIDE = 6000


def chosen_sizes(
    rows: int | None,
    columns: int | None,
    highest: int,
    p: int,
    m: int,
    reach: int = 0,
    stacked: int = 0,
) -> tuple[int, int]:
    """Return block rows and columns, the missing ones chosen.

    The responses reach to lag `highest`, of which rows + columns + reach can be used. Halves
    are within a few percent of the best for damping, anything from a third to two thirds is;
    so chosen sizes share the lags evenly, as far as the smaller side has at most 600 elements
    and the other 6000. With correlations, `stacked` on each other, the rows are the smaller.

    Raises
    ------
    DataError
        Too few lags for the sizes asked for, or for any.
    """
    free = highest - reach
    _check_lags(rows, columns, highest, reach)
    if rows is None and columns is None:
        if stacked or p < m:
            rows = _most(free // 2, SHORT_SIDE, p * max(1, stacked))
        else:
            columns = _most(free // 2, SHORT_SIDE, m)
    if rows is None:
        assert columns is not None
        return _most(free - columns, LONG_SIDE, p), columns
    return rows, _most(free - rows, LONG_SIDE, m) if columns is None else columns


def lasting_lags(energy: Floats) -> int:
    """Return the lag up to which responses hold 99 % of their energy, noise taken off.

    Rows of noise alone cost the well damped modes more than they give the others. All lags
    where the last two fifths do not look like noise: their energies differ, or are not
    small against the first fifth's.

    Parameters
    ----------
    energy : array (highest + 1,)
        Of all responses at each lag, balanced; lag 0 takes no part.
    """
    lags = len(energy) - 1
    fifth = max(1, lags // 5)
    first, fourth, floor = (
        energy[start : start + fifth].mean()
        for start in (1, lags - 2 * fifth + 1, lags - fifth + 1)
    )
    if floor > LEVEL_LIMIT * first or floor < STEADY_LIMIT * fourth:
        return lags
    reached = np.cumsum(energy[1:] - floor)
    kept = 1 + int(np.argmax(reached >= ENERGY_KEPT * reached[-1]))
    return min(lags, max(FEWEST_LAGS, kept))


def _most(blocks: int, elements: int, channels: int) -> int:
    return max(1, min(blocks, max(elements // channels, 2)))


def _check_lags(rows: int | None, columns: int | None, highest: int, reach: int) -> None:
    needed = max(2, (rows or 1) + (columns or 1)) + reach
    if highest >= needed:
        return
    given = (("rows", rows), ("columns", columns))
    named = " and ".join(f"{name}={value}" for name, value in given if value)
    shifts = f" with {reach} lags of shifts" if reach else ""
    cures = ["fewer rows and columns"] * bool(named) + ["smaller shifts"] * bool(reach)
    raise DataError(
        f"{named or 'The smallest Hankel matrix'}{shifts} needs responses up to lag {needed}; "
        f"they end at lag {highest}. Use {', '.join([*cures, ''])}{'or ' * bool(cures)}longer "
        "responses."
    )
