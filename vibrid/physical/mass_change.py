"""Scale of an output-only model from known masses added to the structure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import DataError, OptionError, check_names, check_positive
from ..modes import mac
from ..record import Floats
from .model import MechanicalModel

SAME_SHAPE = 0.5  # smallest MAC of a mode before and after


@dataclass(frozen=True, eq=False)
class MassChange:
    """What masses added to a structure tell about its own.

    Attributes
    ----------
    mass : array (n_dof, n_dof)
        M [kg] of the structure before; NaN where the sensors do not see as many DOFs as
        there are modes. Use it as `mechanical_model(fit, mass=….mass)`.
    modal_masses : array (n_modes,)
        φᵀ M φ for shapes whose largest component is 1, mode by mode, to first order in the
        added mass.
    frequencies_hz, changed_hz : arrays (n_modes,)
        Before and after.
    misfit : float
        What the equations for `mass` leave, relative; NaN where there is none.
    """

    mass: Floats
    modal_masses: Floats
    frequencies_hz: Floats
    changed_hz: Floats
    misfit: float


def mass_change(
    before: MechanicalModel,
    after: MechanicalModel,
    added: Mapping[str, float],
    *,
    lumped: bool = False,
) -> MassChange:
    """Return the mass matrix that explains how known added masses change the structure.

    Parameters
    ----------
    before, after : MechanicalModel
        Without a scale, of the same DOFs, identified without and with the masses.
    added : mapping of DOF to kg
    lumped : bool
        Whether M is diagonal.

    Raises
    ------
    OptionError
        Different DOFs, unknown DOFs, masses that are not positive.
    DataError
        Frequencies do not sink, modes that are not the same ones, or M is not determined.

    Notes
    -----
    Stiffness stays: M N = (M + ΔM) N′ with N = M⁻¹K before and N′ after; with M and M N
    symmetric this is linear least squares in M and exact, however large ΔM. A mass at a
    node of a mode says nothing of that mode.
    Mode by mode m = ω′² φᵀ ΔM φ / (ω² − ω′²) (Parloo et al. 2002; Brincker & Andersen 2003).
    """
    if before.dofs != after.dofs:
        raise OptionError(
            f"Both models must have the same DOFs; got {', '.join(before.dofs)} and "
            f"{', '.join(after.dofs)}."
        )
    check_names("DOF", added, before.dofs)
    for dof, kilograms in added.items():
        check_positive(f"the mass added at {dof}", kilograms, "kg")
    more = np.array([float(added.get(dof, 0.0)) for dof in before.dofs])
    order = _same_modes(before, after)
    modal = _modal_masses(before, after, order, more)
    n = len(before.dofs)
    mass, misfit = np.full((n, n), np.nan), float("nan")
    if before.verdict.kind == after.verdict.kind == "normalized":
        mass, misfit = _exact_mass(
            before.normalized_stiffness, after.normalized_stiffness, more, lumped
        )
    return MassChange(mass, modal, before.frequencies_hz, after.frequencies_hz[order], misfit)


def _same_modes(before: MechanicalModel, after: MechanicalModel) -> Floats:
    from scipy.optimize import linear_sum_assignment  # slow to import, and used only here

    if before.shapes.shape != after.shapes.shape:
        raise DataError(
            f"The models have {before.shapes.shape[1]} and {after.shapes.shape[1]} modes; both "
            "need the same. Choose them with frequencies_hz."
        )
    alike = mac(before.shapes, after.shapes)
    rows, columns = linear_sum_assignment(-alike)
    worst = alike[rows, columns].min()
    if worst < SAME_SHAPE:
        raise DataError(
            f"A shape of one model is not found in the other (MAC {worst:.2f}, at least "
            f"{SAME_SHAPE:g} needed). Add less mass, or choose the modes with frequencies_hz."
        )
    return np.asarray(columns)


def _modal_masses(
    before: MechanicalModel, after: MechanicalModel, order: Floats, more: Floats
) -> Floats:
    squares, changed = np.abs(before.poles) ** 2, np.abs(after.poles[order]) ** 2
    if (changed >= squares).any():
        hertz = before.frequencies_hz[int(np.argmax(changed >= squares))]
        raise DataError(
            f"The mode at {hertz:.4g} Hz does not sink with the added mass: the change is lost "
            "in noise, or the mass sits at its node. Add more, or elsewhere."
        )
    energy = more @ np.abs(before.shapes) ** 2
    return np.asarray(changed * energy / (squares - changed))


def _exact_mass(N: Floats, changed: Floats, more: Floats, lumped: bool) -> tuple[Floats, float]:
    n = len(N)
    rows, columns = np.diag_indices(n) if lumped else np.triu_indices(n)
    slope = []
    for i, j in zip(rows, columns, strict=True):
        unit = np.zeros((n, n))
        unit[i, j] = unit[j, i] = 1
        stiffness = unit @ N
        both = (stiffness - stiffness.T, stiffness - unit @ changed)
        slope.append(np.concatenate([each.ravel() for each in both]))
    matrix = np.array(slope).T
    wanted = np.concatenate([np.zeros(n * n), (more[:, None] * changed).ravel()])
    solved, _, rank, _ = np.linalg.lstsq(matrix, wanted, rcond=1e-10)
    if rank < len(rows):
        raise DataError(
            f"The added mass determines {rank} of {len(rows)} entries of M. Add mass where "
            "every mode moves, or take M as lumped."
        )
    mass = np.zeros((n, n))
    mass[rows, columns] = mass[columns, rows] = solved
    left = np.linalg.norm(matrix @ solved - wanted) / np.linalg.norm(wanted)
    return mass, float(left)
