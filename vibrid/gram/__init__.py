"""The block-Hankel Gram matrix of a record, and its triangular factor."""

from .blocks import BlockGram
from .factor import PIVOT_LIMIT, Factor, factorize, scaled_cholesky, stacked_qr, triangle_of
from .reduction import lagged_sums, reduce

__all__ = [
    "PIVOT_LIMIT",
    "BlockGram",
    "Factor",
    "factorize",
    "lagged_sums",
    "reduce",
    "scaled_cholesky",
    "stacked_qr",
    "triangle_of",
]
