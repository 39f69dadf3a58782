"""What every Gram-based method does first: open the data, check the horizon, reduce."""

from __future__ import annotations

from collections.abc import Sequence

from ..chunks import Stream, open_stream
from ..errors import DataError, OptionError, check_whole
from ..gram import BlockGram, reduce
from ..record import Record

DEFAULT_BLOCK_ROWS = 20  # where no automatic choice was asked for


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
    check_length(stream, n_rows)
    return stream, reduce(stream, n_rows) if gram is None else gram.shorten(n_rows)


def check_length(stream: Stream, n_rows: int) -> None:
    """Raise `DataError` when the Hankel matrix would have fewer columns than rows."""
    channels = stream.n_inputs + stream.n_outputs
    lengths = [segment.length for segment in stream.segments]
    columns = sum(max(0, length - n_rows + 1) for length in lengths)
    if columns >= n_rows * channels:
        return
    what = f"{stream.n_outputs} outputs"
    if stream.n_inputs:
        what = f"{stream.n_inputs} inputs and {what}"
    pieces = (
        f"the record has {lengths[0]}"
        if len(lengths) == 1
        else f"the longest of {len(lengths)} pieces has {max(lengths)}"
    )
    most = (max(lengths) + 1) // (2 * (channels + 1))
    cure = f"Use at most {most} block rows or a longer record." if most else "Record longer."
    raise DataError(
        f"block_rows={n_rows / 2:g} with {what} needs at least {n_rows * (channels + 1) - 1} "
        f"samples; {pieces}. {cure}"
    )


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
        raise OptionError(f"order={order} is more than {why} allow: at most {largest}.")
    check_whole("order", order, 1, largest)
