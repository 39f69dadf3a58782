"""Between continuous and discrete time, exactly for the hold of the input.

With Φ = e^{A dt} and the input between samples

- "zoh": held; x is the state at the sample.
- "foh": a straight line from sample to sample. The discrete state is x − Γ₂ u, with which
  the system needs no look at the next sample.
- "band_limited": impulse invariance, B_d = dt Φ B, with half the jump at lag 0,
  D_d = D + ½ dt C B. The discrete state is x − ½ dt B u.

C is never changed. The way back takes the principal logarithm, so every pole is taken to
lie below the Nyquist frequency.
"""

from __future__ import annotations

import warnings

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..errors import DataError, check_choice
from ..record import Floats

HOLDS = ("zoh", "foh", "band_limited")
NEGATIVE_AXIS = 1e-12  # relative distance from the axis that is rounding only


def discretize(
    A: Floats, B: Floats, C: Floats, D: Floats, dt: float, hold: str
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the discrete A, B, C, D; valid for singular A too (Van Loan 1978)."""
    check_choice("hold", hold, HOLDS)
    if hold == "band_limited":
        power = _expm(A * dt)
        return power, dt * (power @ B), C, D + 0.5 * dt * (C @ B)
    power, held, ramp = hold_integrals(A, dt)
    if hold == "zoh":
        return power, held @ B, C, D
    return power, (held + (power - np.eye(len(A))) @ ramp) @ B, C, D + C @ ramp @ B


def undiscretize(
    A: Floats, B: Floats, C: Floats, D: Floats, dt: float, hold: str
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the continuous A, B, C, D whose discretization is given.

    Raises
    ------
    DataError
        A has a pole at zero or on the negative real axis (no principal logarithm), or its
        logarithm is lost to rounding.
    """
    check_choice("hold", hold, HOLDS)
    A_c = principal_log(A) / dt
    if hold == "band_limited":
        B_c = _solve(A, B) / dt
        return A_c, B_c, C, D - 0.5 * dt * (C @ B_c)
    power, held, ramp = hold_integrals(A_c, dt)
    if hold == "zoh":
        return A_c, _solve(held, B), C, D
    B_c = _solve(held + (power - np.eye(len(A))) @ ramp, B)
    return A_c, B_c, C, D - C @ ramp @ B_c


def state_shift(A: Floats, B: Floats, dt: float, hold: str) -> Floats:
    """Return S (n, m): the discrete state is x − S u, x the continuous state at the sample."""
    check_choice("hold", hold, HOLDS)
    if hold == "zoh":
        return np.zeros_like(B)
    if hold == "band_limited":
        return 0.5 * dt * B
    return hold_integrals(A, dt)[2] @ B


def hold_integrals(A: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Return e^{A dt}, ∫₀^dt e^{As} ds and ∫₀^dt e^{As} (1 − s/dt) ds, each (n, n).

    One exponential of the augmented matrix [A I 0; 0 0 I; 0 0 0] (Van Loan 1978).
    """
    n = len(A)
    stacked = np.zeros((3 * n, 3 * n))
    stacked[:n, :n] = A * dt
    stacked[:n, n : 2 * n] = dt * np.eye(n)
    stacked[n : 2 * n, 2 * n :] = np.eye(n)
    top = _expm(stacked)[:n]
    return top[:, :n], top[:, n : 2 * n], top[:, 2 * n :]


def principal_log(A: Floats) -> Floats:
    """Return the real principal logarithm of A, checked.

    A is balanced first: displacements and velocities differ in size by ω.

    Raises
    ------
    DataError
        There is none, or rounding has destroyed it.
    """
    _check_log_exists(np.linalg.eigvals(A).astype(np.complex128))
    balanced, (scale, _) = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    with warnings.catch_warnings():  # SciPy warns from 1e-13 on; the check is ours, below
        warnings.simplefilter("ignore", RuntimeWarning)
        log = scale[:, None] * np.asarray(scipy.linalg.logm(balanced)).real / scale
    error = np.linalg.norm(_expm(log) - A) / np.linalg.norm(A)
    if not error < 1e-8:
        raise DataError(
            f"The logarithm of A is exact to {error:.1e} only (1e-8 is needed): A is too close "
            "to having none. Use a lower order."
        )
    return np.asarray(log, dtype=np.float64)


def _check_log_exists(poles: NDArray[np.complex128]) -> None:
    size = np.abs(poles)
    zero = size <= len(poles) * np.finfo(float).eps * size.max()
    negative = (poles.real < 0) & (np.abs(poles.imag) <= NEGATIVE_AXIS * size)
    for bad, where in ((zero, "at zero"), (negative, "on the negative real axis")):
        if bad.any():
            raise DataError(
                f"The discrete pole {complex(poles[bad][0]):.4g} is {where}, so that no "
                "continuous model has it. Use a lower order or another number of block rows, "
                "or remove the pole; a real structure above the Nyquist frequency wants a "
                "shorter dt."
            )


def _solve(matrix: Floats, right: Floats) -> Floats:
    return np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)


def _expm(matrix: Floats) -> Floats:
    return np.asarray(scipy.linalg.expm(matrix), dtype=np.float64)
