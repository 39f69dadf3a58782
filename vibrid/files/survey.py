"""survey: what a record holds and what is wrong with it, before anything is identified."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..errors import DataError
from ..record import Channel, Floats, Record
from .bands import drift_of, energy_band, strongest_line, suggest_band, survey_spectrum
from .statistics import Statistics, statistics_of

MOSTLY = 0.5  # of the samples: a two-level input rests on its extremes by design
NOTED_DRIFT = 0.1  # of the energy
LARGEST_DRIFT = 1.0  # in standard deviations, between the first and the last tenth
CLIPPED_RUNS = 2  # a slow peak rests on its top once; clipping comes back

Band = tuple[float, float]


@dataclass(frozen=True)
class ChannelSurvey:
    """What one channel holds; NaN where it could not be computed.

    `drift` is the mean of the last tenth less that of the first, over the standard deviation;
    `clipped_fraction` counts the samples that rest, three or more in a row, on the largest or
    smallest value; `peak_hz` is the strongest spectral line, slow drift of the record left
    out; `energy_band_hz` holds 95 % of the energy without the mean.
    """

    name: str
    quantity: str
    unit: str
    role: str
    mean: float
    std: float
    smallest: float
    largest: float
    missing_fraction: float
    clipped_fraction: float
    drift: float
    is_constant: bool
    is_clipped: bool
    is_drifting: bool
    peak_hz: float
    energy_band_hz: Band


@dataclass(frozen=True)
class Survey:
    """What a record holds; `findings` says in plain words what deserves attention.

    `suggested_band_hz` is given when the energy sits far below Nyquist, otherwise None;
    `suggestion` says so in words, otherwise it is empty.
    """

    name: str
    n_samples: int
    dt: float
    channels: tuple[ChannelSurvey, ...]
    n_gaps: int
    n_missing: int
    energy_band_hz: Band
    suggested_band_hz: Band | None
    findings: tuple[str, ...] = ()
    suggestion: str = ""

    @property
    def duration(self) -> float:
        """Number of samples times dt [s]."""
        return self.n_samples * self.dt

    @property
    def rate(self) -> float:
        """Samples per second [Hz]."""
        return 1.0 / self.dt

    @property
    def missing_duration(self) -> float:
        """Total length of the gaps [s]."""
        return self.n_missing * self.dt


def survey(record: Record) -> Survey:
    """Look through a record of any size, a stretch at a time.

    Two passes over the data, and a spectrum of at most about two million samples.

    Raises
    ------
    DataError
        A value is infinite.
    """
    statistics = statistics_of(record)
    try:
        lines, psd = survey_spectrum(record)
    except DataError:  # gaps everywhere, or far too short
        lines, psd = np.array([np.nan]), np.full((1, record.n_inputs + record.n_outputs), np.nan)
    every = [(channel, "input") for channel in record.input_channels]
    every += [(channel, "output") for channel in record.output_channels]
    responses = psd[:, record.n_inputs :]
    valley, share = drift_of(lines, responses)
    channels = tuple(
        _channel(channel, role, record.n_samples, _of(statistics, k), lines, psd[:, k], valley)
        for k, (channel, role) in enumerate(every)
    )
    looked = Survey(
        record.name,
        record.n_samples,
        record.dt,
        channels,
        statistics.n_gaps,
        statistics.n_missing,
        energy_band(lines, responses),
        suggest_band(lines, responses, is_forced=record.n_inputs > 0),
    )
    findings = _findings(looked, valley, share)
    return dataclasses.replace(looked, findings=findings, suggestion=_suggestion(looked))


def _of(statistics: Statistics, k: int) -> dict[str, float]:
    """Return the figures of channel k by name."""
    per_channel = {
        name: value for name, value in vars(statistics).items() if isinstance(value, np.ndarray)
    }
    return {name: float(values[k]) for name, values in per_channel.items()}


def _channel(
    channel: Channel,
    role: str,
    n_samples: int,
    of: dict[str, float],
    lines: Floats,
    psd: Floats,
    valley: float,
) -> ChannelSurvey:
    is_constant = of["largest"] == of["smallest"]
    dead = np.full_like(psd, np.nan)
    return ChannelSurvey(
        name=channel.name,
        quantity=channel.quantity,
        unit=channel.unit,
        role=role,
        mean=of["mean"],
        std=of["std"],
        smallest=of["smallest"],
        largest=of["largest"],
        missing_fraction=1.0 - of["count"] / n_samples,
        clipped_fraction=0.0 if is_constant else of["clipped"] / n_samples,
        drift=of["drift"],
        is_constant=is_constant,
        is_clipped=not is_constant
        and of["clipped_runs"] >= CLIPPED_RUNS
        and of["clipped"] < MOSTLY * n_samples,
        is_drifting=not is_constant and abs(of["drift"]) > LARGEST_DRIFT,
        peak_hz=strongest_line(lines, dead if is_constant else psd, above=valley),
        energy_band_hz=energy_band(lines, (dead if is_constant else psd)[:, None]),
    )


def _findings(survey: Survey, valley: float, share: float) -> tuple[str, ...]:
    """Say in plain words what deserves attention."""
    said = []
    for channel in survey.channels:
        said += _channel_findings(channel)
    if survey.n_gaps:
        said.append(
            f"{survey.n_gaps} gap{'s' * (survey.n_gaps > 1)} of missing samples, together "
            f"{survey.missing_duration:.4g} s"
        )
    if share > NOTED_DRIFT:
        said.append(
            f"{share:.0%} of the outputs' energy lies below {valley:.3g} Hz, before the first "
            "valley of the spectrum: drift or quasi-static motion"
        )
    return tuple(said)


def _suggestion(survey: Survey) -> str:
    if survey.suggested_band_hz is None:
        return ""
    low, high = survey.suggested_band_hz
    return (
        f"what vibrates sits far below the Nyquist frequency of {survey.rate / 2:g} Hz; "
        f"a band of {low:g} to {high:g} Hz is worth trying (--band {low:g} {high:g})"
    )


def _channel_findings(channel: ChannelSurvey) -> list[str]:
    name = f"channel {channel.name}"
    if channel.missing_fraction == 1:
        return [f"{name} holds no sample"]
    if channel.is_constant:
        return [f"{name} is constant"]
    said = []
    if channel.is_clipped:
        said.append(
            f"{name} rests on its largest or smallest value ({channel.clipped_fraction:.2%} of the "
            "samples): clipped, or resolved too coarsely"
        )
    if channel.is_drifting:
        said.append(
            f"{name} drifts: its mean moves by {abs(channel.drift):.1f} standard deviations "
            "between the first and the last tenth"
        )
    return said
