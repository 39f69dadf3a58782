"""Indicators of mode shapes alone: assurance criterion and phase collinearity."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError
from ..record import Floats


def mac(first: NDArray[Any], second: NDArray[Any]) -> Floats:
    """Return the modal assurance criterion between the columns of two sets of shapes.

    |φᴴψ|² / (φᴴφ · ψᴴψ) (Allemang & Brown 1982), between 0 and 1.

    Parameters
    ----------
    first, second : array (n_outputs, k), (n_outputs, l)

    Returns
    -------
    array (k, l)

    Examples
    --------
    >>> mac(np.array([[1.0], [2.0]]), np.array([[2.0, -2.0], [4.0, 1.0]])).round(12).tolist()
    [[1.0, 0.0]]
    """
    if first.shape[0] != second.shape[0]:
        raise OptionError(
            f"Shapes have {first.shape[0]} and {second.shape[0]} components; must agree."
        )
    cross = np.abs(first.conj().T @ second) ** 2
    size = np.sum(np.abs(first) ** 2, axis=0)[:, None] * np.sum(np.abs(second) ** 2, axis=0)
    return np.asarray(np.divide(cross, size, out=np.zeros_like(cross), where=size > 0))


def mpc(shapes: NDArray[Any]) -> Floats:
    """Return the modal phase collinearity of each column: 1 where all move in phase.

    ((Sxx − Syy)² + 4 Sxy²) / (Sxx + Syy)² of the real and imaginary parts about zero
    (Pappa, Elliott & Schenk 1993; no mean is removed, which suits shapes of one sign too).

    Parameters
    ----------
    shapes : complex array (n_outputs, n_modes)

    Returns
    -------
    array (n_modes,)
    """
    x, y = np.real(shapes), np.imag(shapes)
    xx, yy, xy = (x * x).sum(axis=0), (y * y).sum(axis=0), (x * y).sum(axis=0)
    total = xx + yy
    spread = (xx - yy) ** 2 + 4 * xy**2
    return np.asarray(np.divide(spread, total**2, out=np.ones_like(total), where=total > 0))
