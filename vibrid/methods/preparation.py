"""What every Gram-based method does first: open the data, check the horizon, reduce."""

from __future__ import annotations

from collections.abc import Sequence

from ..chunks import Stream, open_stream
from ..errors import DataError, OptionError, check_whole
from ..gram import BlockGram, reduce
from ..record import Record

DEFAULT_BLOCK_ROWS = 20  # where no automatic choice was asked for
SHORTEST = 4  # block rows, past and future together: the smallest sensible horizon
LARGEST_MATRIX = 2**32  # bytes of the square matrix that is factorized; several live at once


def prepare(
    data: Record | Sequence[Record] | Stream,
    past_rows: int,
    future_rows: int,
    offset: str,
    gram: BlockGram | None,
) -> tuple[Stream, BlockGram]:
    """Return the open stream and its Gram of `past_rows + future_rows` block rows."""
    stream = data if isinstance(data, Stream) else open_stream(data, offset)
    n_rows = past_rows + future_rows
    check_length(stream, n_rows, _horizon_words(past_rows, future_rows))
    return stream, reduce(stream, n_rows) if gram is None else gram.shorten(n_rows)


def check_length(stream: Stream, n_rows: int, named: str = "", cure: str = "") -> None:
    """Raise `DataError` when the Hankel matrix has fewer columns than rows, or too many rows.

    `n_rows` counts past and future rows; `named` says how they were given, in words, `cure` what
    to do about too few samples.
    """
    channels = stream.n_inputs + stream.n_outputs
    named = named or _horizon_words(n_rows - n_rows // 2, n_rows // 2)
    lengths = [segment.length for segment in stream.segments]
    used = [length - n_rows + 1 for length in lengths if length >= n_rows]
    # every further piece spends a column on its own constant
    columns = sum(used) - (max(0, len(used) - 1) if stream.offset == "estimate" else 0)
    what = _count(stream.n_outputs, "output")
    if stream.n_inputs:
        what = f"{_count(stream.n_inputs, 'input')} and {what}"
    if columns >= n_rows * channels:
        _check_size(n_rows, channels, f"{named} with {what}")
        return
    pieces = (
        f"the record has {lengths[0]}"
        if len(lengths) == 1
        else f"the longest of {len(lengths)} pieces has {max(lengths)}"
    )
    most = (max(lengths) + 1) // (2 * (channels + 1))
    if not cure and 2 * most < SHORTEST:
        least = SHORTEST * (channels + 1) - 1
        cure = (
            f"Record at least {least} samples in one piece, enough for 2 block rows; better more."
        )
    cure = cure or f"Use at most {most} block rows or a longer record."
    needed = n_rows * (channels + 1) - 1
    raise DataError(f"{named} with {what} needs at least {needed} samples; {pieces}. {cure}")


def _check_size(n_rows: int, channels: int, what: str) -> None:
    """Raise `DataError` before a matrix is made that no memory holds."""
    size = 8 * (n_rows * channels) ** 2
    if size > LARGEST_MATRIX:
        most = int((LARGEST_MATRIX / 8) ** 0.5) // (2 * channels)
        raise DataError(
            f"{what} makes a matrix of {size / 2**30:.3g} GiB; at most {LARGEST_MATRIX / 2**30:g} "
            f"GiB are tried. Use at most {most} block rows, or fewer channels."
        )


def _horizon_words(past_rows: int, future_rows: int) -> str:
    words = f"block_rows={future_rows}"
    return words if past_rows == future_rows else f"{words} and past_rows={past_rows}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def horizon(block_rows: int | None, past_rows: int | None) -> tuple[int, int]:
    """Return (past_rows, future_rows), checked."""
    future = DEFAULT_BLOCK_ROWS if block_rows is None else block_rows
    check_whole("block_rows", future, 2)
    past = future if past_rows is None else past_rows
    check_whole("past_rows", past, 1)
    return past, future


def check_order(order: object, largest: int, why: str) -> None:
    """Raise `OptionError` unless the order is possible; say what limits it."""
    if isinstance(order, int) and not isinstance(order, bool) and order > largest:
        raise OptionError(
            f"order={order} is more than {why} allow: at most {largest}. "
            "Use a lower order, or a longer horizon where the data hold more."
        )
    check_whole("order", order, 1, largest)
