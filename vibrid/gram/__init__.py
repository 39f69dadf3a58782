"""The block-Hankel Gram matrix of a record, and its triangular factor."""

from .blocks import BlockGram
from .factor import PIVOT_LIMIT, Factor, factorize, scaled_cholesky, stacked_qr, triangle_of
from .reduction import reduce

__all__ = [
    "PIVOT_LIMIT",
    "BlockGram",
    "Factor",
    "factorize",
    "reduce",
    "scaled_cholesky",
    "stacked_qr",
    "triangle_of",
]
