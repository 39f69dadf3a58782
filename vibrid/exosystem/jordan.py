"""Real Jordan form of a matrix."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ..errors import DataError, OptionError
from ..modes import Complexes
from ..record import Floats

DEFECTIVE = 1e10  # condition of the eigenvectors from which there is no full set of them


@dataclass(frozen=True, eq=False)
class RealJordan:
    """A = T J T⁻¹ with J real and block diagonal.

    Attributes
    ----------
    J : array (n, n)
        Blocks [σ ω; −ω σ] by ascending |λ|, then real eigenvalues, ascending.
    T : array (n, n)
        Columns √2 Re ψ, √2 Im ψ of each pair, and ψ of a real eigenvalue; ‖ψ‖ = 1.
    pairs : complex array (n_pairs,)
        σ + jω with ω > 0.
    reals : array (n − 2 n_pairs,)
    """

    J: Floats
    T: Floats
    pairs: Complexes
    reals: Floats


def real_jordan_form(A: ArrayLike) -> RealJordan:
    """Return the real Jordan form of a matrix with a full set of eigenvectors.

    Eigenvalues may be repeated as long as each repetition has its own vector. Chains of
    generalized vectors (ones above the diagonal) are refused: they are lost by any rounding.

    Parameters
    ----------
    A : array (n, n)

    Raises
    ------
    OptionError
        A matrix that is not square, empty or not finite.
    DataError
        No full set of eigenvectors, as of a rigid-body motion.

    Notes
    -----
    Han, Bohn & Bauer (2021), appendix A, (A.2), (A.3): with ψ = α + jβ the columns √2 α, √2 β
    give the block [σ ω; −ω σ], since A (α + jβ) = (σ + jω)(α + jβ).

    Examples
    --------
    >>> form = real_jordan_form([[0.0, 2.0], [-2.0, 0.0]])
    >>> form.J.round(12)
    array([[ 0.,  2.],
           [-2.,  0.]])
    """
    matrix = np.asarray(A, dtype=np.float64)
    if matrix.ndim != 2 or len(set(matrix.shape)) > 1 or not matrix.size:
        raise OptionError(f"A must be square, and not empty; got the shape {matrix.shape}.")
    if not np.isfinite(matrix).all():
        raise OptionError("A holds NaN or infinite values; it must be finite.")
    balanced, (scale, _) = scipy.linalg.matrix_balance(matrix, permute=False, separate=True)
    values, vectors = np.linalg.eig(balanced)
    condition = float(np.linalg.cond(vectors))
    if condition > DEFECTIVE:
        raise DataError(
            f"The matrix has no full set of eigenvectors (their condition number is "
            f"{condition:.1e}; {DEFECTIVE:.0e} is the limit), as of a rigid-body motion. Use "
            "accelerations only, which do not see it, or a lower order."
        )
    vectors = scale[:, None] * vectors
    vectors = vectors / np.linalg.norm(vectors, axis=0)
    upper = np.flatnonzero(values.imag > 0)
    upper = upper[np.argsort(np.abs(values[upper]), kind="stable")]
    real = np.flatnonzero(values.imag == 0)
    real = real[np.argsort(values[real].real, kind="stable")]
    pairs, reals = values[upper].astype(np.complex128), values[real].real
    T = np.hstack([_real_columns(vectors[:, upper]), vectors[:, real].real])
    return RealJordan(_blocks(pairs, reals), T, pairs, reals)


def _real_columns(vectors: Complexes) -> Floats:
    columns = np.sqrt(2) * np.stack([vectors.real, vectors.imag], axis=2)
    return np.asarray(columns.reshape(len(vectors), -1), dtype=np.float64)


def _blocks(pairs: Complexes, reals: Floats) -> Floats:
    blocks = [np.array([[z.real, z.imag], [-z.imag, z.real]]) for z in pairs]
    return np.asarray(scipy.linalg.block_diag(*blocks, *reals), dtype=np.float64)
