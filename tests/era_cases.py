"""Chains, their pulse responses and a naive realization, which tests of ERA share."""

from __future__ import annotations

from typing import Any

import numpy as np

from vibrid.methods.era import ERA, ERADC
from vibrid.modes import modes_of
from vibrid.record import Floats, ImpulseResponses
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain

EXACT = 1e-8  # relative, promised for noise-free data; measured 1e-12
DT = 0.05
METHODS = [
    ERA(),
    ERA(rows=18, columns=70),
    ERA(rows=60, columns=17),
    ERADC(),
    ERADC(rows=16, columns=60, lag=3, row_shifts=2, column_shifts=1),
    ERADC(rows=40, columns=16, lag=1, row_shifts=0, column_shifts=3),
    ERADC(rows=17, columns=40, lag=10, row_shifts=1, column_shifts=0),
]


def structure(n_dof: int) -> Structure:
    """Return a chain with modes spread below Nyquist and 1 to 2 % damping."""
    return chain(np.linspace(1.0, 1.5, n_dof), np.full(n_dof, 800.0), rayleigh=(0.1, 2e-4))


def system(frame: Structure, forces: str = "all") -> StateSpace:
    pushed = frame.dofs[:1] if forces == "one" else frame.dofs
    return frame.state_space(forces=list(pushed)).to_discrete(DT)


def pulses(frame: Structure, n_lags: int = 120, forces: str = "all") -> ImpulseResponses:
    return ImpulseResponses(system(frame, forces).markov_parameters(n_lags), dt=DT)


def fitted(method: Any, data: Any, order: int) -> Any:
    return method.realize(method.decompose(data), order)


def assert_same_modes(fit: Any, frame: Structure, tolerance: float = EXACT) -> None:
    modes = modes_of(fit)
    assert modes.n_modes == len(frame.frequencies_hz)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=tolerance)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=tolerance)


def naive_era(h: Floats, rows: int, columns: int, order: int) -> tuple[Floats, ...]:
    """Realize Markov parameters by loops and a full decomposition."""
    H0 = np.block([[h[1 + i + j] for j in range(columns)] for i in range(rows)])
    H1 = np.block([[h[2 + i + j] for j in range(columns)] for i in range(rows)])
    U, s, Vt = np.linalg.svd(H0)
    U, root, V = U[:, :order], np.sqrt(s[:order]), Vt[:order].T
    A = np.diag(1 / root) @ U.T @ H1 @ V @ np.diag(1 / root)
    return A, (np.diag(root) @ V.T)[:, : h.shape[2]], (U @ np.diag(root))[: h.shape[1]]
