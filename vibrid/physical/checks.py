"""Self-checks: how far matrices agree with the modal data that they are made from."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..mechanics import MOTIONS, mechanical_state_space
from ..modes import Complexes
from ..record import Floats
from .layout import Layout
from .masses import asymmetry
from .modal import ModalData
from .scaling import normalized_of

LINES = 300  # of the transfer functions compared
NO_DAMPING = 1e-9  # of M and the fastest pole: R below it is rounding


def orthogonality(W: Complexes) -> float:
    """Return the size of W Wᵀ, which is zero for a true set of shapes, relative to |W||W|ᵀ."""
    size = np.abs(W)
    return float(np.linalg.norm((W @ W.T).real) / np.linalg.norm(size @ size.T))


def symmetry_checks(shapes: Complexes, poles: Complexes, mass: Floats | None) -> dict[str, float]:
    """Return how far M (M⁻¹K) and M (M⁻¹R) of the shapes alone are from symmetric."""
    if mass is None or not np.isfinite(mass).all() or shapes.shape[1] != 2 * len(shapes):
        return {}
    damping, stiffness = normalized_of(shapes, poles)
    least = smallest_damping(mass, poles)
    return {
        "asymmetry_stiffness": asymmetry(mass @ stiffness),
        "asymmetry_damping": asymmetry(mass @ damping, least),
    }


def smallest_damping(mass: Floats, poles: Complexes) -> float:
    """Return the size of R that is rounding, of a structure without damping."""
    return float(NO_DAMPING * np.linalg.norm(mass) * np.abs(poles).max())


def definiteness(matrices: Mapping[str, Floats], least: float) -> dict[str, float]:
    """Return smallest over largest |eigenvalue| of each matrix; 0 of R up to `least`."""
    checks = {}
    for name, matrix in matrices.items():
        if np.isfinite(matrix).all():
            values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
            size = float(np.abs(values).max())
            none = name == "damping" and size <= least
            checks[f"smallest_{name}"] = 0.0 if none else float(values[0] / max(size, 1e-300))
    return checks


def pole_error(damping: Floats, stiffness: Floats, poles: Complexes) -> float:
    """Return the largest relative error of the poles of M⁻¹R and M⁻¹K."""
    n = len(damping)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    found = np.linalg.eigvals(A)
    left = list(range(len(found)))
    worst = 0.0
    for pole in poles:
        gaps = np.abs(found[left] - pole)
        nearest = int(np.argmin(gaps))
        worst = max(worst, float(gaps[nearest] / abs(pole)))
        left.pop(nearest)
    return worst


def transfer_error(
    data: ModalData,
    layout: Layout,
    normalized: tuple[Floats, Floats],
    mass: Floats | None,
) -> float:
    """Return the relative error of the frequency responses made from M, R and K.

    Of forces with `mass`; of base acceleration without. Over the band of the poles.
    """
    hertz = np.abs(data.poles) / (2 * np.pi)
    lines = np.linspace(0.3 * hertz.min(), 1.3 * hertz.max(), LINES)
    n_forces = len(layout.forces) if mass is not None else 0
    if not n_forces and not len(layout.bases):
        return float("nan")
    drive = np.hstack([data.forces[:, :n_forces], data.bases])
    direct = data.direct[:, [*range(n_forces), *range(len(layout.forces), data.direct.shape[1])]]
    measured = responses(data, drive, layout, lines) + direct
    M = np.eye(layout.n_dof) if mass is None else mass
    sensors = [
        (MOTIONS[power], int(dof))
        for power, dof in zip(layout.powers, layout.sensor_dofs, strict=True)
    ]
    model = mechanical_state_space(
        M,
        M @ normalized[0],
        M @ normalized[1],
        sensors=sensors,
        forces=[int(dof) for dof in layout.force_dofs[:n_forces]],
        base=True if len(layout.bases) else None,
        absolute=is_absolute(data, layout),
    )
    made = model.frequency_response(lines)
    return float(np.linalg.norm(made - measured) / np.linalg.norm(measured))


def responses(data: ModalData, drive: Complexes, layout: Layout, lines: Floats) -> Complexes:
    """Return Σ v λᵇ g / (jω − λ) (n_lines, n_outputs, n_inputs)."""
    seen = data.shapes * data.poles ** layout.powers[:, None]
    gains = 1 / (2j * np.pi * lines[:, None] - data.poles)
    return np.asarray(np.einsum("sk,fk,ka->fsa", seen, gains, drive, optimize=True))


def is_absolute(data: ModalData, layout: Layout) -> bool:
    """Return whether accelerometers include the base's motion: D of the base is 0, not −1."""
    rows = layout.powers == 2
    columns = data.direct[:, len(layout.forces) :]
    return not rows.any() or not columns.size or float(columns[rows].mean()) > -0.5
