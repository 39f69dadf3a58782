"""fit_rayleigh(): proportional damping from the damping ratios of modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, check_whole
from ..mechanics import check_matrices
from ..modes import Complexes, Modes
from ..record import Floats
from .model import MechanicalModel

EXPLAINED = 0.1  # relative misfit of the damping ratios up to which the law explains them
LIKELY = 0.05  # probability of a larger misfit by chance, below which it does not


@dataclass(frozen=True, eq=False)
class Rayleigh:
    """A law of proportional damping, R = M Σ a_j (M⁻¹K)ʲ; of two terms, R = αM + βK.

    Attributes
    ----------
    coefficients : array (n_terms,)
        a_j [s^(2j−1)]; the first two are α and β.
    frequencies_hz, damping_ratios : arrays (n_modes,)
        As identified.
    fitted_ratios : array (n_modes,)
        What the law gives for them.
    misfit : float
        Root mean square of what the law leaves, relative to that of the ratios.
    probability : float
        Of at least this misfit by chance under the law (χ²); NaN where the standard
        deviations of the ratios are not known, or there are no more modes than terms.
    explained : bool or None
        Whether the law explains the ratios: `probability` at least 5 %, or, where it is not
        known, `misfit` at most 10 %. None where there are no more modes than terms: any
        ratios fit then.
    complexity : array (n_modes,)
        Of each shape φ, 1 − MAC(φ, Re φ), turned so that it is least: 0 for the real shapes
        of proportional damping, ½ at most. Delays and noise count here too.
    """

    coefficients: Floats
    frequencies_hz: Floats
    damping_ratios: Floats
    fitted_ratios: Floats
    misfit: float
    probability: float
    explained: bool | None
    complexity: Floats

    @property
    def alpha(self) -> float:
        """Of M [1/s]."""
        return float(self.coefficients[0])

    @property
    def beta(self) -> float:
        """Of K [s]; zero for a law of one term."""
        return float(self.coefficients[1]) if len(self.coefficients) > 1 else 0.0

    def ratios_at(self, frequencies_hz: ArrayLike) -> Floats:
        """Return the damping ratios that the law gives at these frequencies."""
        w = 2 * np.pi * np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
        return _slopes(w, len(self.coefficients)) @ self.coefficients

    def damping_matrix(self, mass: ArrayLike, stiffness: ArrayLike) -> Floats:
        """Return R* = M Σ a_j (M⁻¹K)ʲ, of two terms αM + βK (Pappalardo et al. 2022, eq. 131)."""
        M, K = check_matrices(mass, stiffness)
        term, total = M, np.zeros_like(M)
        for coefficient in self.coefficients:
            total = total + coefficient * term
            term = K @ np.linalg.solve(M, term)
        return np.asarray(0.5 * (total + total.T))


def fit_rayleigh(
    modes: Modes | MechanicalModel,
    *,
    n_terms: int = 2,
    weights: Sequence[float] | None = None,
) -> Rayleigh:
    """Return the law of proportional damping that fits the damping ratios best.

    Parameters
    ----------
    modes : Modes or MechanicalModel
    n_terms : int
        2 is Rayleigh damping αM + βK; more are a Caughey series (Caughey & O'Kelly 1965).
    weights : sequence of float, optional
        One a mode; by default 1/σ² where the standard deviations are known, else 1.

    Returns
    -------
    Rayleigh

    Raises
    ------
    OptionError
        Fewer modes than terms, or weights that do not fit.

    Notes
    -----
    ζ_i = ½ Σ_j a_j ω_i^(2j−1), least squares with one row a mode (Pappalardo et al. 2022,
    eq. 125-130, where rows are counted twice, without effect).

    Examples
    --------
    >>> from vibrid.structures import chain
    >>> from vibrid.modes import modes_of
    >>> model = chain([1.0, 1.0], [100.0, 100.0], rayleigh=(0.2, 0.001)).state_space("velocity")
    >>> law = fit_rayleigh(modes_of(model))
    >>> round(law.alpha, 9), round(law.beta, 9), law.explained
    (0.2, 0.001, None)
    """
    poles, shapes, std = _modal(modes)
    check_whole("n_terms", n_terms, 1)
    if len(poles) < n_terms:
        raise OptionError(
            f"A law of {n_terms} terms needs as many modes; there are {len(poles)}. "
            "Use fewer terms or a model with more modes."
        )
    w = np.abs(poles)
    ratios = np.asarray(-poles.real / w)
    known = bool(np.isfinite(std).all() and (std > 0).all())
    root = np.sqrt(_weights(weights, std if known else None, len(w)))
    slopes = _slopes(w, n_terms)
    coefficients = _weighted_solution(slopes, ratios, root)
    fitted = slopes @ coefficients
    misfit = float(np.linalg.norm(fitted - ratios) / max(float(np.linalg.norm(ratios)), 1e-300))
    chance = _probability((fitted - ratios) / std, n_terms) if known else float("nan")
    return Rayleigh(
        coefficients,
        w / (2 * np.pi),
        ratios,
        fitted,
        misfit,
        chance,
        _is_explained(len(w) - n_terms, misfit, chance),
        shape_complexity(shapes),
    )


def shape_complexity(shapes: Complexes) -> Floats:
    """Return 1 − MAC of each shape and its real part, the phase chosen so that it is least.

    That is ½ (1 − |Σφ²| / Σ|φ|²) = ½ (1 − MPC^½).
    """
    square = np.abs(np.sum(shapes**2, axis=0))
    return np.asarray(0.5 * (1 - square / np.sum(np.abs(shapes) ** 2, axis=0)))


def _modal(modes: Modes | MechanicalModel) -> tuple[Complexes, Complexes, Floats]:
    if isinstance(modes, Modes):
        return modes.poles, modes.shapes, modes.damping_std
    oscillating = modes.poles.imag > 0
    poles, shapes = modes.poles[oscillating], modes.shapes[:, oscillating]
    return poles, shapes, np.full(len(poles), np.nan)


def _slopes(w: Floats, n_terms: int) -> Floats:
    return np.asarray(0.5 * w[:, None] ** (2.0 * np.arange(n_terms) - 1))


def _weights(given: Sequence[float] | None, std: Floats | None, count: int) -> Floats:
    if given is None:
        return np.ones(count) if std is None else 1 / std**2
    weights = np.asarray(given, dtype=np.float64)
    if weights.shape != (count,) or not (np.isfinite(weights).all() and (weights >= 0).all()):
        raise OptionError(f"weights must be {count} numbers, one a mode, none negative.")
    return weights


def _weighted_solution(slopes: Floats, ratios: Floats, root: Floats) -> Floats:
    rows = root[:, None] * slopes
    size = np.linalg.norm(rows, axis=0)  # powers of ω differ by many orders
    solved = np.linalg.lstsq(rows / size, root * ratios, rcond=None)[0]
    return np.asarray(solved / size)


def _probability(errors: Floats, n_terms: int) -> float:
    from scipy.stats import chi2  # slow to import, and used only here

    freedom = len(errors) - n_terms
    return float(chi2.sf(float(errors @ errors), freedom)) if freedom else float("nan")


def _is_explained(freedom: int, misfit: float, chance: float) -> bool | None:
    if freedom <= 0:
        return None
    return misfit <= EXPLAINED if np.isnan(chance) else chance >= LIKELY
