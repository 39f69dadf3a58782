"""How well the data determine a model and what follows from it."""

from __future__ import annotations

import numpy as np

from ..record import Floats
from .blocks import Blocks
from .projection import Projected

GAUGE = 1e-10  # relative eigenvalue of the information below which the data say nothing


def parameter_covariance(projected: Projected, covariance: Floats) -> Floats:
    """Return the covariance of the searched parameters, all that is linear being unknown too.

    H⁻¹ M H⁻¹ with the information M that errors of this covariance leave; H⁻¹ alone where the
    errors are weighed by their inverse covariance, which is the Cramér-Rao bound.

    Parameters
    ----------
    projected : Projected
        At the least cost.
    covariance : array (p, p)
        Of the errors, which are taken as white.
    """
    inverse = _inverse(projected.information)
    W = projected.weighing
    return np.asarray(inverse @ projected.information_of(W @ covariance @ W) @ inverse)


def pole_covariance(projected: Projected, covariance: Floats) -> Floats:
    """Return the covariance of the poles' coefficients, everything else being unknown too.

    Coefficients are (a₁, a₂) of q² + a₁ q + a₂ for each block and a₁ of q + a₁ for a single
    one, in the order of the blocks' states.

    Returns
    -------
    array (n, n)
    """
    turn = _coefficients(projected.blocks)
    k = turn.shape[1]
    return np.asarray(turn @ parameter_covariance(projected, covariance)[:k, :k] @ turn.T)


def derived_covariance(
    projected: Projected,
    covariance: Floats,
    spread: Floats,
    by_step: Floats,
    by_rows: Floats,
) -> Floats:
    """Return the covariance of quantities that depend on the whole model, from derivatives.

    The linear part follows every step of the others, and has errors of its own.

    Parameters
    ----------
    projected : Projected
    covariance : array (p, p)
        Of the errors.
    spread : array (q, q)
        `parameter_covariance`.
    by_step : array (n_quantities, q)
        Derivatives by the step of `Blocks.moved`, C held in the coordinates before the step.
    by_rows : array (n_quantities, rows, p)
        Derivatives by the stacked linear part.

    Returns
    -------
    array (n_quantities, n_quantities)
    """
    total = by_step + projected.answered(by_rows)
    own = np.zeros((len(total), len(total)))
    for outputs, root, _ in projected.groups:
        rows = by_rows[:, projected.rows_of(outputs)] * outputs
        seen = np.einsum("rk,grp->gkp", root, rows)
        own += np.tensordot(seen @ covariance, seen, axes=([1, 2], [1, 2]))
    free = projected.tied(total.T).T
    return np.asarray(free @ spread @ free.T + own)


def _inverse(information: Floats) -> Floats:
    size = np.sqrt(np.maximum(np.diag(information), 0))
    size[size == 0] = np.inf
    unit = information / size / size[:, None]
    return np.asarray(np.linalg.pinv(unit, rcond=GAUGE, hermitian=True) / size / size[:, None])


def _coefficients(blocks: Blocks) -> Floats:
    """Return the derivatives of the coefficients by the steps (β₁, β₂) of `Blocks.moved`.

    a₁ = −2 r + s β₁ and a₂ = (r − s β₁) r + s² (b + β₂); a single pole is r − s β₂. The a₂ of
    an undamped block is 1.
    """
    k, r, s = blocks.n_blocks, blocks.centre, blocks.spread
    turn = np.zeros((k, 2, k, 2))
    each = np.arange(k)
    turn[each, 0, each, 0], turn[each, 1, each, 0] = s, np.where(blocks.undamped, 0, -r * s)
    turn[each, 1, each, 1] = np.where(blocks.single, s, np.where(blocks.undamped, 0, s**2))
    return np.asarray(turn.reshape(2 * k, 2 * k)[blocks.used.ravel()])


def mode_deviations(blocks: Blocks, covariance: Floats) -> tuple[Floats, Floats]:
    """Return standard deviations of the oscillating blocks, by ascending frequency.

    Parameters
    ----------
    blocks : Blocks
    covariance : array (n, n)
        `pole_covariance`.

    Returns
    -------
    frequencies [1 / samples], damping_ratios : array (n_modes,)
    """
    places = np.cumsum(blocks.used.sum(axis=1)) - blocks.used.sum(axis=1)
    pairs = np.flatnonzero(~blocks.single & (blocks.shape > 0))
    root = blocks.spread * np.sqrt(np.maximum(blocks.shape, 0))
    found = []
    for b in pairs:
        pole = complex(blocks.centre[b], root[b])
        # λ² + a₁ λ + a₂ = 0
        slope = -np.array([pole, 1]) / (2j * pole.imag)
        local = covariance[places[b] : places[b] + 2, places[b] : places[b] + 2]
        turns = np.multiply.outer(frequency_and_damping(pole), slope).real
        variances = np.einsum("gi,ij,gj->g", turns, local, turns)
        found.append((abs(np.log(pole)), *np.sqrt(np.maximum(variances, 0))))
    table = np.array(sorted(found)).reshape(-1, 3)
    return table[:, 1], table[:, 2]


def frequency_and_damping(pole: complex) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """Return c with δf = Re(c₀ δμ) [1 / samples] and δζ = Re(c₁ δμ) of a discrete pole μ.

    ln μ = |ln μ| (−ζ + i √(1 − ζ²)).
    """
    rate = np.log(pole)
    size = abs(rate)
    along = np.conj(rate) / size / pole
    return np.array([along / (2 * np.pi), (rate.real * along / size - 1 / pole) / size])
