"""What is wrong with records, as far as their Gram and one walk tell: findings, never repairs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft as fft
from numpy.typing import NDArray

from ..chunks import Stream
from ..fit import Finding
from ..gram import BlockGram
from ..record import Channel, Floats, rows_per_chunk

RANK_LIMIT = 1e-11  # of the largest eigenvalue of the inputs' scaled Gram: rounding leaves 1e-13
LARGEST_INPUT_GRAM = 600  # rows: beyond it fewer block rows are looked at
COLLINEAR = 0.02  # smallest eigenvalue of the coherence matrix, mean over the energy: 0 is exact
EXACTLY_COLLINEAR = 1e-6
NAMED = 0.3  # share of an eigenvector that makes a channel part of the relation
HIGH_BAND = 0.9  # of the Nyquist frequency
HIGH_SHARE = 0.15  # of an output's energy above it: a flat spectrum has 0.1
CLIPPED_COUNT = (
    4  # times that three samples in a row rest on an extreme: a slow peak rests on its top once
)
FEWEST_HITS = 3  # samples of a stretch on the extreme, before runs are looked for
CLIPPED_SHARE = 0.02  # of the samples on an extreme: for motion too fast to rest there
TWO_LEVELS = 0.5  # of the samples: a two-level input rests on its extremes by design
DEAD_LEVEL = 1e-5  # of the median deviation of the channels with the same quantity and unit
STILL_SHARE = 0.9  # of the samples that equal the one before
STUCK_RUN = (
    200  # samples of one value in a row, within a chunk: no resolution is so coarse for long
)
STUCK_SHARE = 0.02  # of the samples in such runs
SPECTRUM_LINES = 256


def data_findings(stream: Stream, gram: BlockGram) -> tuple[Finding, ...]:
    """Return what the data lack: excitation, independent inputs, living or whole channels.

    Persistency of excitation and collinear inputs come from the Gram, energy near the Nyquist
    frequency from its lags, clipped and still channels from one walk over the data.
    """
    spectra = _spectra(gram)
    relation = _collinear(stream, gram, spectra)
    return (
        *(relation or _persistency(gram)),
        *_near_nyquist(stream, gram, spectra),
        *_walked(stream),
    )


# -- inputs


def _persistency(gram: BlockGram) -> list[Finding]:
    """Say when the inputs' Hankel matrix lacks rank: too few frequencies for the horizon."""
    m = gram.n_inputs
    if m == 0:
        return []
    rows = max(1, min(gram.n_rows, LARGEST_INPUT_GRAM // m))
    inputs = _of_inputs(gram.shorten(rows)).matrix()
    size = np.sqrt(np.diag(inputs))
    size[size == 0] = 1.0
    values = np.linalg.eigvalsh(inputs / size / size[:, None])
    rank = int((values > RANK_LIMIT * values[-1]).sum())
    if rank == len(values):
        return []
    return [
        Finding(
            "excitation",
            "doubt",
            f"The inputs excite too little: over {rows} block rows they have rank {rank} of the "
            f"{rows * m} that a general model needs (persistency of excitation of order "
            f"{rank // m}). States between the excited frequencies cannot be told apart.",
            "Use an input with more frequencies, a shorter horizon, a lower order, or a record "
            "that starts with free motion.",
        )
    ]


def _of_inputs(gram: BlockGram) -> BlockGram:
    m = gram.n_inputs
    return replace(
        gram,
        lags=gram.lags[:, :, :m, :m],
        sums=gram.sums[:, :m],
        heads=gram.heads[:, :, :m],
        tails=gram.tails[:, :, :m],
        centre=gram.centre[:m],
        scale=gram.scale[:m],
    )


def _collinear(stream: Stream, gram: BlockGram, spectra: Floats) -> list[Finding]:
    """Say when one input is (nearly) a filtered sum of the others over the band they excite."""
    m = gram.n_inputs
    if m < 2:
        return []
    cross = spectra[:, :m, :m]
    power = np.maximum(np.einsum("fii->fi", cross).real, 1e-300)
    coherence = cross / np.sqrt(power[:, :, None] * power[:, None, :])
    weight = (power / power.sum(axis=0)).mean(axis=1)
    values, vectors = np.linalg.eigh(coherence)
    smallest = float(weight @ np.maximum(values[:, 0], 0))
    if smallest > COLLINEAR:
        return []
    share = np.sqrt(weight @ np.abs(vectors[:, :, 0]) ** 2)
    names = [stream.records[0].input_names[k] for k in np.flatnonzero(share > NAMED)]
    exact = smallest < EXACTLY_COLLINEAR
    how = "follow from each other" if exact else "nearly follow from each other"
    return [
        Finding(
            "collinear-inputs",
            "warning" if exact else "doubt",
            f"The inputs {', '.join(names)} {how}: over the band that they excite the smallest "
            f"eigenvalue of their coherence is {smallest:.2g} (limit {COLLINEAR:g}, 1 is "
            "independent). What each does by itself cannot be told.",
            "Drive them independently, or leave all but one of them out (select(inputs=[…])).",
        )
    ]


# -- outputs


def _spectra(gram: BlockGram) -> Floats:
    """Return cross spectra (lines, c, c) from the lags, Bartlett window, up to Nyquist."""
    lags = gram.covariances()
    count = len(lags)
    length = fft.next_fast_len(max(2 * count, 2 * SPECTRUM_LINES), real=True)
    window = (1 - np.arange(count) / count)[:, None, None]
    one_sided = fft.rfft(lags * window, n=length, axis=0)
    return np.asarray(one_sided + one_sided.conj().transpose(0, 2, 1) - lags[0])


def _near_nyquist(stream: Stream, gram: BlockGram, spectra: Floats) -> list[Finding]:
    """Say when outputs hold much energy next to Nyquist: what is above it may have folded."""
    m = gram.n_inputs
    power = np.maximum(np.einsum("fii->fi", spectra).real[:, m:], 0)
    high = power[int(HIGH_BAND * len(power)) :].sum(axis=0) / np.maximum(power.sum(axis=0), 1e-300)
    names = [stream.records[0].output_names[k] for k in np.flatnonzero(high > HIGH_SHARE)]
    if not names:
        return []
    nyquist = 0.5 / stream.records[0].dt
    return [
        Finding(
            "near-nyquist",
            "doubt",
            f"{_listed(names)}: up to {100 * high.max():.2g} % of the energy lies above "
            f"{HIGH_BAND * nyquist:.4g} Hz, next to the Nyquist frequency {nyquist:.4g} Hz. What "
            "vibrates faster may be folded into the band (aliasing).",
            "Sample faster, or behind an anti-aliasing filter; modes there are not to be believed.",
        )
    ]


# -- channels


@dataclass
class _Extremes:
    """Extremes of each channel so far, and how often three samples in a row rested on them."""

    value: Floats
    triples: Floats
    count: Floats


def _walked(stream: Stream) -> list[Finding]:
    channels = (*stream.records[0].input_channels, *stream.records[0].output_channels)
    c = len(channels)
    tops = [_Extremes(np.full(c, -np.inf), np.zeros(c), np.zeros(c)) for _ in range(2)]
    still, stuck = np.zeros(c), np.zeros(c)
    for segment in stream.segments:
        record = stream.records[segment.record]
        step = rows_per_chunk(c)
        for start in range(segment.start, segment.stop, step):
            rows = record.read(start, min(start + step, segment.stop))
            same = rows[1:] == rows[:-1]
            count = same.sum(axis=0)
            still += count
            for k in np.flatnonzero(count >= STUCK_RUN - 1):
                runs = np.diff(np.flatnonzero(np.concatenate([[True], ~same[:, k], [True]])))
                stuck[k] += runs[runs >= STUCK_RUN].sum()
            _rest_on(tops[0], rows)
            _rest_on(tops[1], -rows)
    still /= stream.n_samples
    clipped = _clipped(channels, tops, stream.n_samples, still)
    dead = _dead(channels, still, stream.deviation)
    return clipped + dead + _stuck(channels, stuck / stream.n_samples, still, stream.n_inputs)


def _rest_on(top: _Extremes, rows: Floats) -> None:
    """Count where rows rest on an extreme; a channel that does so once or twice is skipped."""
    largest = rows.max(axis=0)
    higher = largest > top.value
    top.value = np.where(higher, largest, top.value)
    hit = rows == top.value
    count = hit.sum(axis=0)
    triples = np.zeros(len(count))
    often = np.flatnonzero(count >= FEWEST_HITS)
    for k in often:
        column = hit[:, k]
        triples[k] = (column[2:] & column[1:-1] & column[:-2]).sum()
    top.triples = np.where(higher, 0, top.triples) + triples
    top.count = np.where(higher, 0, top.count) + count


def _clipped(
    channels: Sequence[Channel], tops: Sequence[_Extremes], n_samples: int, still: Floats
) -> list[Finding]:
    triples = sum((top.triples for top in tops), np.zeros(len(channels)))
    count = sum((top.count for top in tops), np.zeros(len(channels)))
    rests = (triples >= CLIPPED_COUNT) | (count > CLIPPED_SHARE * n_samples)
    by_design = (count >= TWO_LEVELS * n_samples) | (still > STILL_SHARE)
    seen = np.flatnonzero(rests & ~by_design)
    if not len(seen):
        return []
    worst = seen[np.argmax(count[seen])]
    return [
        Finding(
            "clipping",
            "warning",
            f"{_subject(channels, seen, 'rest')} on the largest or smallest value (up to "
            f"{100 * count[worst] / n_samples:.2g} % of the samples): clipped, or resolved too "
            "coarsely.",
            "Record with a larger range, or mark these samples as missing (NaN).",
        )
    ]


def _dead(channels: Sequence[Channel], still: Floats, deviation: Floats) -> list[Finding]:
    """Say when a channel hardly moves: sensor off, cable loose, or a range too coarse."""
    kinds = [(channel.quantity, channel.unit) for channel in channels]
    typical = np.array(
        [np.median(deviation[[k for k, kind in enumerate(kinds) if kind == own]]) for own in kinds]
    )
    comparable = np.array([unit != "" for _, unit in kinds])
    seen: NDArray[np.int64] = np.flatnonzero(
        (comparable & (deviation < DEAD_LEVEL * typical)) | (still > STILL_SHARE)
    )
    if not len(seen):
        return []
    return [
        Finding(
            "dead-channel",
            "warning",
            f"{_subject(channels, seen, 'hardly move')}: at most "
            f"{(deviation / typical)[seen].max():.2g} of their kind's deviation, or the same "
            f"value as the sample before in up to {100 * still[seen].max():.3g} % of the samples.",
            "Check the sensor and its range, or leave the channel out.",
        )
    ]


def _stuck(
    channels: Sequence[Channel], share: Floats, still: Floats, n_inputs: int
) -> list[Finding]:
    """Say when an output keeps one value for long; a force may rest by design."""
    late = np.arange(len(channels)) >= n_inputs
    seen = np.flatnonzero(late & (share > STUCK_SHARE) & (still <= STILL_SHARE))
    if not len(seen):
        return []
    return [
        Finding(
            "stuck-channel",
            "doubt",
            f"{_subject(channels, seen, 'keep')} one value for {STUCK_RUN} "
            f"samples or longer, in all up to {100 * share[seen].max():.3g} % of the samples: a "
            "gap that was filled, a loose cable, or a structure at rest.",
            "Mark these samples as missing (NaN) unless the structure was at rest.",
        )
    ]


def _subject(channels: Sequence[Channel], seen: NDArray[np.int64], verb: str) -> str:
    """Return the names of the channels that were seen, and the verb in their number."""
    names = _listed([channels[int(k)].name for k in seen])
    return f"{names} {verb}{'s' if len(seen) == 1 else ''}"


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (" …" if len(names) > 6 else "")
