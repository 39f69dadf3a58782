"""Choose the observer order: long enough for damping, short enough for the record."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...chunks import Stream
from ...errors import DataError
from ...gram import reduce
from ...record import Floats
from ..preparation import LARGEST_MATRIX
from .regression import Regression, regress

FIRST_TRIED = 20
LARGEST_HANKEL = 2600  # rows: beyond it a factorization takes seconds
LONGEST = 200  # past samples that an automatic choice tries
COLUMNS_PER_ROW = 4  # of the Hankel matrix that automatic orders keep to
BEYOND = 2  # times the information criterion's order, which is too short for damping
NEAR_END = 0.9  # of the longest tried: a minimum there is no minimum
ENOUGH_GAIN = 0.95  # of the Bayesian criterion's fall, where Akaike's has no minimum
EXACT_MARGIN = 2  # past samples more than noise-free data need: the factor is better conditioned


def choose_observer_order(
    stream: Stream, feedthrough: NDArray[np.bool_], whitening: int, margin: int
) -> tuple[int, str]:
    """Return an observer order and why.

    Twice the order that Akaike's criterion asks for: one-step errors hardly suffer from a
    short observer, damping does. Where that criterion falls for ever, because the noise is
    coloured or the structure not linear, a long observer plays the noise: then twice the
    order with most of what the Bayesian criterion gains. With whitening not doubled. Where the
    data are nearly noise-free, the smallest order that leaves nothing, and `margin` more.
    """
    largest = min(LONGEST, longest_order(stream, whitening, COLUMNS_PER_ROW))
    for tried in _doubling(largest):
        data = regress(stream, reduce(stream, tried + 1), tried, feedthrough)
        exact = next((k for k in range(1, tried + 1) if data.is_exact(k)), None)
        if exact is not None:
            return min(exact + margin, largest), (
                f"{exact} past samples explain these nearly noise-free data, and {margin} more "
                "condition them better"
            )
        if BEYOND * akaike_order(data) <= tried:
            break
    wanted, why = _ordered(data)
    longer = max(1, wanted if whitening else BEYOND * wanted)
    if longer > largest:
        return largest, "is the longest that this record and its channels allow"
    return longer, f"{'' if whitening else f'{BEYOND} times '}{wanted}, {why}"


def _ordered(data: Regression) -> tuple[int, str]:
    """Return the order that the criteria ask for, and which did."""
    best = akaike_order(data)
    if best <= NEAR_END * data.largest_order:
        return best, "the order of the lowest information criterion (AIC)"
    values = _criterion(data, float(np.log(data.n_columns)))
    enough = values[0] - ENOUGH_GAIN * (values[0] - values.min())
    return int(np.flatnonzero(values <= enough)[0]), (
        f"the order that reaches {100 * ENOUGH_GAIN:g} % of the fall of the Bayesian criterion; "
        f"Akaike's falls on to the longest tried, {data.largest_order}: noise is coloured, or the "
        "structure not linear"
    )


def akaike_order(data: Regression) -> int:
    """Return the order of lowest N log det S + 2 · parameters."""
    return int(np.argmin(_criterion(data, 2.0)))


def _criterion(data: Regression, penalty: float) -> Floats:
    parameters = data.n_outputs * data.n_channels
    return np.array(
        [
            data.n_columns * np.linalg.slogdet(data.innovation(k))[1] + penalty * parameters * k
            for k in range(data.largest_order + 1)
        ]
    )


def longest_order(stream: Stream, whitening: int, columns_per_row: int) -> int:
    """Return the longest observer order with so many columns a row; at least 1."""
    channels = stream.n_inputs + stream.n_outputs
    order = 1
    while (
        n_rows(order + 1, whitening) * channels <= LARGEST_HANKEL
        and n_columns(stream, n_rows(order + 1, whitening))
        >= columns_per_row * n_rows(order + 1, whitening) * channels
    ):
        order += 1
    return order


def n_rows(order: int, whitening: int) -> int:
    """Return the block rows of the Gram: residuals of residuals reach further back."""
    return order * (whitening + 1) + 1


def n_columns(stream: Stream, rows: int) -> int:
    """Return the columns that the pieces of the stream have, constants taken out."""
    lengths = [segment.length for segment in stream.segments if segment.length >= rows]
    constants = len(lengths) if stream.offset == "estimate" else 0
    return sum(length - rows + 1 for length in lengths) - constants


def check_observer_order(stream: Stream, order: int, whitening: int) -> None:
    """Raise `DataError` when the regression has fewer columns than rows, or too many rows."""
    channels = stream.n_inputs + stream.n_outputs
    rows = n_rows(order, whitening)
    named = f"observer_order={order}" + (f" with whitening={whitening}" if whitening else "")
    named += f" and {channels} channels"
    longest = max(segment.length for segment in stream.segments)
    if n_columns(stream, rows) < rows * channels:
        most = (longest // (channels + 1) - 1) // (whitening + 1)
        cure = f"Use at most {most}, or a longer record."
        if most < 1:
            cure = f"Record at least {n_rows(1, whitening) * (channels + 1)} samples in one piece."
        raise DataError(
            f"{named} needs at least {rows * (channels + 1)} samples; "
            + (
                f"the record has {longest}. {cure}"
                if len(stream.segments) == 1
                else f"the longest of {len(stream.segments)} pieces has {longest}. {cure}"
            )
        )
    size = 8 * (rows * channels) ** 2
    if size > LARGEST_MATRIX:
        most = (int((LARGEST_MATRIX / 8) ** 0.5) // channels - 1) // (whitening + 1)
        raise DataError(
            f"{named} makes a matrix of {size / 2**30:.3g} GiB; at most "
            f"{LARGEST_MATRIX / 2**30:g} GiB are tried. Use at most {most}, or fewer channels."
        )


def _doubling(largest: int) -> Iterator[int]:
    tried = min(FIRST_TRIED, largest)
    while tried < largest:
        yield tried
        tried = min(2 * tried, largest)
    yield largest
