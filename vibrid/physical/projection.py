"""Nearest M, R, K of a given structure, by constrained least squares on the modal data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike, NDArray

from ..errors import DataError, OptionError, check_choice
from ..modes import Complexes
from ..record import Floats

PATTERNS = ("symmetric", "diagonal", "chain")
SHORTHANDS = {
    "symmetric": ("symmetric", "symmetric", "symmetric"),
    "diagonal": ("diagonal", "symmetric", "symmetric"),
    "chain": ("diagonal", "chain", "chain"),
}
DETERMINED = 1e-9  # smallest singular value of the equilibrated equations, relative
TOUCHED = 1e-6  # share of an entry in what the data leave open, beyond which it is
MOST_NAMED = 8  # entries in a message
INDEFINITE = 1e-12  # negative eigenvalue that is rounding, relative to the largest
POLES_COUNT = 30.0  # times what shapes and scale count: poles are known that much better. Of
# noisy 3-mass records (5 %), 10 to 1000 do alike; 1 makes R two to four times worse.
ROUNDS = 5000
SETTLED = 1e-9
BALANCE = 10.0  # between the two residuals of the alternation, beyond which its weight changes


@dataclass(frozen=True, eq=False)
class Topology:
    """Which entries of M, R and K may differ from zero, all three being symmetric.

    Parameters
    ----------
    mass, damping, stiffness : "symmetric", "diagonal", "chain" or bool array (n_dof, n_dof)
        "chain" is tridiagonal in the order of the DOFs, springs to the ground allowed.
    weights : sequence of float, optional
        One a mode, by ascending frequency: how much its equations count.
    definite : bool
        Whether M is to be positive definite, R and K positive semidefinite.
    """

    mass: Any = "diagonal"
    damping: Any = "symmetric"
    stiffness: Any = "symmetric"
    weights: Sequence[float] | None = None
    definite: bool = True

    @classmethod
    def of(cls, value: Any) -> Topology:
        """Return a Topology, from one or from "symmetric", "diagonal" (M) or "chain"."""
        if isinstance(value, Topology):
            return value
        check_choice("structure", value, tuple(SHORTHANDS))
        return cls(*SHORTHANDS[value])


@dataclass(frozen=True, eq=False)
class Projection:
    """What the structure asked for made of the matrices, and what it cost.

    Attributes
    ----------
    mass, damping, stiffness : arrays (n_dof, n_dof)
    misfit : float
        Root mean square of what the modal equations leave, in parts of 1.
    definite_bound : bool
        Whether positive (semi)definiteness had to be forced.
    n_parameters, n_equations : int
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    misfit: float
    definite_bound: bool
    n_parameters: int
    n_equations: int


def project(
    vectors: Complexes,
    poles: Complexes,
    topology: Topology,
    dofs: Sequence[str],
    *,
    scaled: bool,
    mass: Floats | None = None,
) -> Projection:
    """Return the symmetric M, R, K of a topology that fit the modal data best.

    Parameters
    ----------
    vectors : complex array (n_dof, n_poles)
        Displacement shapes; with `scaled`, so that Ψᵀ U Ψ = I.
    poles : complex array (n_poles,)
        Both of each pair, side by side.
    topology : Topology
    dofs : sequence of str
        To name entries that are not determined.
    scaled : bool
        Whether the scale of the shapes is known.
    mass : array () or (n_dof, n_dof), optional
        The total Σ M_ij, kept exactly, or all of M. Needed without a scale.

    Raises
    ------
    OptionError
        No mass without a scale; weights that do not fit.
    DataError
        The data do not determine the matrices of this topology.

    Notes
    -----
    Least squares on what is linear in M, R and K. With a scale the orthogonality
    relations WᵀRW + WᵀMWΛ + ΛWᵀMW = I and ΛWᵀMWΛ − WᵀKW = Λ (Pappalardo et al. 2022,
    eq. 107-108), the second by |λ_i λ_j|^½; without, M Φ Λ² + R Φ Λ + K Φ = 0, columns by
    |λ|² ‖φ‖. What hangs on a pole alone (φᴴ times its own column) counts 30 times, because
    poles are far better known than shapes and scale. Definiteness by alternating
    directions in the metric of the equations (ADMM; Boyd et al. 2011).
    """
    n = len(vectors)
    spaces = [pattern_space(x, n) for x in (topology.mass, topology.damping, topology.stiffness)]
    if not np.diagonal(spaces[0].sum(axis=0)).all():
        raise OptionError(
            "The pattern of M must allow all of its diagonal: no DOF is without mass."
        )
    _check_mass(mass, scaled)
    weights = _weights(topology.weights, len(poles))
    equations = _scaled_equations if scaled else _free_equations
    slope, wanted = equations(vectors, poles, spaces, weights)
    if mass is not None and mass.ndim == 2:
        spaces, slope, wanted = _with_known_mass(spaces, slope, wanted, mass)
    start, free = _constraint(spaces, mass)
    p = start + _solved(slope, wanted - slope @ start, free, _labels(spaces, dofs))
    bound = topology.definite and not all(_is_definite(x) for x in _matrices(p, spaces))
    if bound:
        p = _definite(slope, wanted, start, free, p, spaces)
    left = slope @ p - wanted
    M, R, K = _matrices(p, spaces)
    if mass is not None and mass.ndim == 2:
        M = mass
    misfit = float(np.sqrt(np.mean(left**2)))
    return Projection(M, R, K, misfit, bound, free.shape[1], len(wanted))


Space = NDArray[np.float64]  # (n_parameters, n, n): the matrices that span


def pattern_space(pattern: Any, n: int) -> Space:
    """Return the symmetric matrices that span a pattern, one for each free entry.

    Parameters
    ----------
    pattern : "symmetric", "diagonal", "chain" or symmetric array of bool (n, n)
    n : int

    Raises
    ------
    OptionError
        A pattern of another name or shape.
    """
    if isinstance(pattern, str):
        check_choice("a pattern of a Topology", pattern, PATTERNS)
        reach = {"symmetric": n, "diagonal": 0, "chain": 1}[pattern]
        apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        mask = apart <= reach
    else:
        mask = np.asarray(pattern, dtype=bool)
        if mask.shape != (n, n) or (mask != mask.T).any():
            raise OptionError(
                f"A pattern must be one of {', '.join(PATTERNS)} or a symmetric {n} × {n} array "
                f"of True and False; got shape {mask.shape}."
            )
    rows, columns = np.nonzero(np.triu(mask))
    space = np.zeros((len(rows), n, n))
    k = np.arange(len(rows))
    space[k, rows, columns] = space[k, columns, rows] = 1
    return space


def _check_mass(mass: Floats | None, scaled: bool) -> None:
    if mass is None and not scaled:
        raise OptionError(
            "A structure needs a scale: add a force at a sensor's DOF, or give mass= (the "
            "total, one a DOF, or the matrix)."
        )


def _weights(given: Sequence[float] | None, n_poles: int) -> Floats:
    if given is None:
        return np.ones(n_poles)
    values = np.asarray(given, dtype=np.float64)
    if 2 * len(values) != n_poles or not (np.isfinite(values).all() and (values >= 0).all()):
        raise OptionError(f"weights must be {n_poles // 2} numbers, one a mode, none negative.")
    return np.repeat(values, 2)


def _scaled_equations(
    W: Complexes, poles: Complexes, spaces: list[Space], weights: Floats
) -> tuple[Floats, Floats]:
    n = len(poles)
    rows, columns = np.triu_indices(n)
    both = weights[rows] * weights[columns]
    both = np.where(_are_one_mode(poles, rows, columns), POLES_COUNT * both, both)
    li, lj = poles[rows], poles[columns]
    size = np.sqrt(np.abs(li * lj))
    inner = [
        np.einsum("ai,pab,bj->pij", W, space, W, optimize=True)[:, rows, columns].T
        for space in spaces
    ]
    r, k = inner[1].shape[1], inner[2].shape[1]
    N = len(rows)
    first = np.hstack([inner[0] * (li + lj)[:, None], inner[1], np.zeros((N, k))])
    second = np.hstack([inner[0] * (li * lj)[:, None], np.zeros((N, r)), -inner[2]]) / size[:, None]
    one = np.where(rows == columns, 1.0, 0.0) + 0j
    slope = np.vstack([first, second]) * np.tile(both, 2)[:, None]
    wanted = np.concatenate([one, np.where(rows == columns, li, 0) / size]) * np.tile(both, 2)
    return _real(slope), _real(wanted)


def _are_one_mode(poles: Complexes, rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[Any]:
    """Return which entries join the two poles of one pair."""
    return np.asarray((poles[rows] == poles[columns].conj()) & (rows != columns))


def _free_equations(
    shapes: Complexes, poles: Complexes, spaces: list[Space], weights: Floats
) -> tuple[Floats, Floats]:
    unit = shapes / np.linalg.norm(shapes, axis=0)
    own = np.einsum("ik,jk->kij", unit, unit.conj())
    heavier = np.eye(len(shapes)) + (POLES_COUNT - 1) * own  # each mode's own part
    powers = (poles**2, poles, np.ones_like(poles))
    columns = [
        np.einsum(
            "kij,pjl,lk->ikp", heavier, space, unit * power * weights / np.abs(poles) ** 2
        ).reshape(shapes.size, len(space))
        for space, power in zip(spaces, powers, strict=True)
    ]
    slope = _real(np.hstack(columns))
    return slope, np.zeros(len(slope))


def _real(values: NDArray[Any]) -> Floats:
    return np.concatenate([values.real, values.imag])


def _with_known_mass(
    spaces: list[Space], slope: Floats, wanted: Floats, mass: Floats
) -> tuple[list[Space], Floats, Floats]:
    """Move the mass's part of the equations to the right."""
    count = len(spaces[0])
    basis = spaces[0].reshape(count, -1).T
    p, *_ = np.linalg.lstsq(basis, mass.ravel(), rcond=None)
    if np.abs(basis @ p - mass.ravel()).max() > 1e-9 * np.abs(mass).max():
        raise OptionError("The given mass matrix does not have the pattern asked of M.")
    empty = np.zeros((0, *mass.shape))
    return [empty, *spaces[1:]], slope[:, count:], wanted - slope[:, :count] @ p


def _constraint(spaces: list[Space], mass: Floats | None) -> tuple[Floats, Floats]:
    """Return a point and a basis of the parameters that keep the total mass, if given."""
    counts = [len(space) for space in spaces]
    n = sum(counts)
    if mass is None or mass.ndim == 2:
        return np.zeros(n), np.eye(n)
    row = np.concatenate([spaces[0].sum(axis=(1, 2)), np.zeros(n - counts[0])])
    start = row * (float(mass) / (row @ row))
    _, _, right = np.linalg.svd(row[None, :])
    return start, right[1:].T


def _matrices(p: Floats, spaces: list[Space]) -> list[Floats]:
    ends = np.cumsum([0] + [len(space) for space in spaces])
    return [
        np.tensordot(p[a:b], space, 1)
        for a, b, space in zip(ends[:-1], ends[1:], spaces, strict=True)
    ]


def _labels(spaces: list[Space], dofs: Sequence[str]) -> list[str]:
    """Return a name such as K[f1, f2] for each parameter."""
    names = []
    for symbol, space in zip("MRK", spaces, strict=True):
        for unit in space:
            i, j = np.argwhere(unit)[0]
            names.append(f"{symbol}[{dofs[i]}, {dofs[j]}]")
    return names


def _solved(slope: Floats, wanted: Floats, free: Floats, labels: list[str]) -> Floats:
    """Return free @ q of the least squares in q with equilibrated columns.

    Raises
    ------
    DataError
        Some entries are not determined; they are named.
    """
    reduced = slope @ free
    size = np.linalg.norm(reduced, axis=0)
    size[size == 0] = 1.0
    left, values, right = np.linalg.svd(reduced / size)
    rank = int(np.count_nonzero(values > DETERMINED * values[0]))
    if rank < len(size):
        moved = np.abs(free @ (right[rank:] / size).T)
        reach = moved / np.abs(free / size).max(axis=1)[:, None]
        open_ones = [labels[k] for k in np.flatnonzero(reach.max(axis=1) > TOUCHED)]
        raise DataError(
            f"The modal data determine {rank} of the {len(size)} entries of M, R and K of this "
            f"structure, not {_listed(open_ones)}; give more modes, a sparser structure or the "
            "mass."
        )
    found = right[:rank].T @ ((left[:, :rank].T @ wanted) / values[:rank])
    return np.asarray(free @ (found / size))


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _is_definite(matrix: Floats) -> bool:
    values = np.linalg.eigvalsh(matrix)
    return bool(values[0] >= -INDEFINITE * np.abs(values).max())


def _definite(
    slope: Floats, wanted: Floats, start: Floats, free: Floats, p: Floats, spaces: list[Space]
) -> Floats:
    """Return the best parameters whose matrices are positive semidefinite.

    Alternating directions (ADMM): the quadratic problem with the matrices drawn to their
    positive parts, each matrix in units of its own size.
    """
    sizes = [max(float(np.linalg.norm(x)), 1e-300) for x in _matrices(p, spaces)]
    unit = np.repeat(np.array(sizes), [len(space) for space in spaces])
    maps = [_entries(space) for space in spaces]
    stacked = _block_diagonal(maps) @ (free / unit[:, None])
    offset = _block_diagonal(maps) @ (start / unit)
    scaled = slope @ free
    H, h = scaled.T @ scaled, scaled.T @ (wanted - slope @ start)
    S = stacked.T @ stacked
    rho = float(np.trace(H) / max(float(np.trace(S)), 1e-300))
    z = y = np.zeros(len(stacked))
    shapes = [space.shape[1] for space in spaces]
    lengths = [len(entries) for entries in maps]
    for _ in range(ROUNDS):
        q = np.linalg.solve(H + rho * S, h + rho * stacked.T @ (z - y - offset))
        flat = stacked @ q + offset
        previous, z = z, _positive_parts(flat + y, shapes, lengths)
        y = y + flat - z
        apart, moved = np.linalg.norm(flat - z), np.linalg.norm(z - previous)
        if max(apart, moved) < SETTLED * np.linalg.norm(flat):
            break
        if apart > BALANCE * moved or moved > BALANCE * apart:
            change = 2.0 if apart > moved else 0.5
            rho, y = rho * change, y / change
    return np.asarray(start + free @ q)


def _entries(space: Space) -> Floats:
    return np.asarray(space.reshape(len(space), space.shape[1] ** 2).T)


def _block_diagonal(blocks: list[Floats]) -> Floats:
    return np.asarray(scipy.linalg.block_diag(*blocks))


def _positive_parts(flat: Floats, sizes: list[int], lengths: list[int]) -> Floats:
    parts, at = [], 0
    for n, length in zip(sizes, lengths, strict=True):
        matrix = flat[at : at + length].reshape(n, n)
        values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
        parts.append(((vectors * np.maximum(values, 0)) @ vectors.T).ravel())
        at += length
    return np.concatenate(parts)


def relative_change(new: ArrayLike, old: ArrayLike) -> float:
    """Return ‖new − old‖_F / ‖old‖_F."""
    a, b = np.asarray(new), np.asarray(old)
    return float(np.linalg.norm(a - b) / np.linalg.norm(b))
