"""Frequency responses C (zI − A)⁻¹ B + D at many frequencies."""

from __future__ import annotations

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ..errors import DataError
from ..record import Floats

Complexes = NDArray[np.complex128]
CHUNK_ELEMENTS = 2**21


def frequency_response(A: Floats, B: Floats, C: Floats, D: Floats, points: Complexes) -> Complexes:
    """Return C (zI − A)⁻¹ B + D at every point z of the complex plane (n_points, p, m).

    A is brought to complex Schur form once (a unitary change of basis, so nothing is lost
    however defective A is); each point then costs one triangular solve, done for all points
    at once, a row at a time.

    Raises
    ------
    DataError
        A point is a pole.
    """
    T, Q = scipy.linalg.schur(A, output="complex")
    hit = np.flatnonzero((points[:, None] == np.diag(T)).any(axis=1))
    if hit.size:
        raise DataError(
            f"The response is infinite at {points[hit[0]]:.6g}: it is a pole. Leave this "
            "frequency out."
        )
    reach, observe = Q.conj().T @ B, C @ Q
    step = max(1, CHUNK_ELEMENTS // (len(A) * max(1, B.shape[1])))
    parts = [
        observe @ _solve_triangular(T, reach, points[k : k + step]) + D
        for k in range(0, len(points), step)
    ]
    return np.concatenate(parts) if parts else np.empty((0, *D.shape), dtype=np.complex128)


def _solve_triangular(T: Complexes, right: Complexes, points: Complexes) -> Complexes:
    """Return (zI − T)⁻¹ right for every z (n_points, n, m), T upper triangular."""
    n, m = right.shape
    x = np.empty((n, len(points) * m), dtype=np.complex128)
    for i in range(n - 1, -1, -1):
        row = (T[i, i + 1 :] @ x[i + 1 :]).reshape(len(points), m) + right[i]
        x[i] = (row / (points - T[i, i])[:, None]).ravel()
    return x.reshape(n, len(points), m).transpose(1, 0, 2)
