"""Build spring-mass structures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, check_whole
from ..mechanics import modal_damping, rayleigh_damping
from ..record import Floats
from .structure import Structure


def chain(
    masses: ArrayLike,
    springs: ArrayLike,
    *,
    damping_ratio: ArrayLike | None = None,
    rayleigh: tuple[float, float] | None = None,
    damping: ArrayLike | None = None,
    dashpots: ArrayLike | None = None,
    dofs: Sequence[str] = (),
) -> Structure:
    """Return masses in a row, joined by springs; the first spring goes to the ground.

    Parameters
    ----------
    masses : array (n_dof,)
        [kg]
    springs : array (n_dof,) or (n_dof + 1,)
        Stiffness [N/m] of the spring below each mass; one more joins the last mass to the
        ground as well. Zero leaves a spring out.
    damping_ratio : float or array (n_dof,), optional
        Modal damping, by ascending frequency.
    rayleigh : (alpha [1/s], beta [s]), optional
        R = alpha M + beta K.
    damping : array (n_dof, n_dof), optional
        R itself [N s/m].
    dashpots : array, optional
        [N s/m], one beside each spring.
    dofs : sequence of str
        Labels; f1, f2, … by default.

    Raises
    ------
    OptionError
        More than one kind of damping (none at all is undamped), or lengths that do not fit.

    Examples
    --------
    >>> chain([1.0, 1.0], [2.0, 3.0], dashpots=[0.1, 0.0]).stiffness
    array([[ 5., -3.],
           [-3.,  3.]])
    """
    m = np.atleast_1d(np.asarray(masses, dtype=np.float64))
    k = np.atleast_1d(np.asarray(springs, dtype=np.float64))
    M, K = np.diag(m), _tridiagonal(k, len(m), "springs")
    given = {
        "damping_ratio": damping_ratio,
        "rayleigh": rayleigh,
        "damping": damping,
        "dashpots": dashpots,
    }
    chosen = [name for name, value in given.items() if value is not None]
    if len(chosen) > 1:
        raise OptionError(f"Give one kind of damping, not {' and '.join(chosen)}.")
    if damping_ratio is not None:
        R = modal_damping(M, K, damping_ratio)
    elif rayleigh is not None:
        R = rayleigh_damping(M, K, *rayleigh)
    elif dashpots is not None:
        c = np.atleast_1d(np.asarray(dashpots, dtype=np.float64))
        R = _tridiagonal(c, len(m), "dashpots", len(k))
    else:
        R = np.zeros_like(M) if damping is None else np.asarray(damping, dtype=np.float64)
    return Structure(M, R, K, tuple(dofs))


def shear_frame(
    n_storeys: int,
    mass: ArrayLike,
    stiffness: ArrayLike,
    *,
    damping_ratio: ArrayLike | None = None,
    rayleigh: tuple[float, float] | None = None,
    damping: ArrayLike | None = None,
    dashpots: ArrayLike | None = None,
    dofs: Sequence[str] = (),
) -> Structure:
    """Return a frame of rigid floors: a chain, fixed at its foot and free at its top.

    Parameters
    ----------
    n_storeys : int
    mass, stiffness : float or array (n_storeys,)
        Of every floor [kg] and every storey [N/m], from the ground up; one number for all.
    damping_ratio, rayleigh, damping, dashpots, dofs
        As in `chain`; one dashpot number serves all storeys.

    Examples
    --------
    >>> shear_frame(5, 25.91, 1e4, damping_ratio=0.02).frequencies_hz.round(4)
    array([0.89  , 2.5978, 4.0951, 5.2607, 6.0001])
    """
    check_whole("n_storeys", n_storeys, 1)
    return chain(
        _per_storey(mass, n_storeys, "mass"),
        _per_storey(stiffness, n_storeys, "stiffness"),
        damping_ratio=damping_ratio,
        rayleigh=rayleigh,
        damping=damping,
        dashpots=None if dashpots is None else _per_storey(dashpots, n_storeys, "dashpots"),
        dofs=dofs,
    )


def _per_storey(values: ArrayLike, n_storeys: int, name: str) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.shape not in ((), (n_storeys,)):
        raise OptionError(
            f"{name} must be one number or {n_storeys}, one a storey; got shape {array.shape}."
        )
    return np.array(np.broadcast_to(array, (n_storeys,)))


def _tridiagonal(springs: Floats, n: int, name: str, wanted: int | None = None) -> Floats:
    """Return the matrix of springs between neighbours, the first and last to the ground."""
    if springs.ndim != 1 or len(springs) not in ((n, n + 1) if wanted is None else (wanted,)):
        allowed = f"{n} (last mass free) or {n + 1} (both ends held)" if wanted is None else wanted
        raise OptionError(f"{name} must be {allowed} numbers; got shape {springs.shape}.")
    k = np.append(springs, 0.0)[: n + 1]
    return np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
