"""Find the oscillations of a record one by one, and leave out those that are not needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...linalg import one_blas_thread
from ...record import Floats
from ...varpro import descend
from .components import Components, Signals
from .place import ROUNDING, Place

RATES = (0.0, 0.7, 1.5, 3.0, 6.0, 12.0, 25.0, 50.0, 100.0, 200.0)  # σ T that are tried
SECOND_START = 0.7  # σ T: a slower start is tried from here too
LOWEST = 1.5  # cycles in the record
SHORT, LONG = 8, 60  # steps while growing, and at last
NOISE_MARGIN = 1.3  # times the noise as estimated, which is off by some per cents
HOPELESS = 2.0  # times as many oscillations as are left would be needed at the last one's rate
QUIET_LINES = 0.25  # of the lines, the highest, that tell the noise
COARSE, FINE = 1e-1, 1e-7  # fall of −2 log L that is not worth a step
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Growth:
    """The oscillations found, and whether there is an end of them in sight."""

    place: Place
    explained: bool


def grow(signals: Signals, most: int, progress: Progress | None = None) -> Growth:
    """Return the damped oscillations that explain the records, greedily, all refitted.

    Each is started at the peak of the spectra of the whitened errors times e^{−σt}. Ends when
    another gains less than (2 n + 4) ln N of 2 log L, at rounding level, at `most`, or when
    what is left would need far more of the last one's energy.

    Parameters
    ----------
    signals : Signals
    most : int
        Largest number of oscillations.
    progress : callable (what, done, total), optional
    """
    place = Place(Components.none(len(signals.samples)), signals)
    with one_blas_thread():
        while len(place.components) < most and place.relative_errors > ROUNDING:
            if progress is not None:
                progress("oscillations", len(place.components), most)
            trial = _refitted(place, *strongest(place))
            if place.cost - trial.cost < price(signals):
                break
            if _is_hopeless(place, trial, most):
                return Growth(trial, False)
            place = trial
        return Growth(eliminate(settle(place)), True)


def _is_hopeless(place: Place, trial: Place, most: int) -> bool:
    """Tell whether the energy left is more than the oscillations that may follow can take.

    The strongest are found first, so each takes at most what the last one took.
    """
    n, left = place.signals.n_channels, most - len(trial.components)
    if len(trial.components) <= n + 1:
        return False
    before, after = _excess(place), _excess(trial)
    return after > HOPELESS * max(left, 1) * max(before - after, 0.0)


def _excess(place: Place) -> float:
    """Return the energy above the noise, relative to that of each channel."""
    total = 0.0
    for record, (part, size) in enumerate(zip(place.parts, place.signals.sizes, strict=True)):
        y = place.signals.samples[record]
        power = np.abs(np.fft.rfft(y, axis=0)) ** 2
        line = np.median(power[int((1 - QUIET_LINES) * len(power)) :], axis=0) / np.log(2)
        # Σ e² of white noise is the expected power of a line
        total += float((np.maximum(part.squares - NOISE_MARGIN * line, 0) / size**2).sum())
    return total


def price(signals: Signals) -> float:
    """Return what one more oscillation has to gain of 2 log L."""
    unknown = 2 * signals.n_channels * len(signals.samples) + 4
    return float(unknown * np.log(signals.count))


def settle(place: Place, *, largest: int = LONG, negligible: float = FINE) -> Place:
    """Return the place of the greatest likelihood near by."""
    if not len(place.components):
        return place
    return descend(place, tolerance=0.0, negligible=negligible, largest=largest).point


def strongest(place: Place) -> tuple[float, float]:
    """Return ω and σ of the strongest oscillation in the whitened errors."""
    signals = place.signals
    n_lines = 2 ** int(np.ceil(np.log2(2 * max(signals.lengths))))
    hertz = np.fft.rfftfreq(n_lines, signals.dt)
    seen = hertz > LOWEST / signals.duration
    best, found = -1.0, (0.0, 0.0)
    errors = [(place.residual(record) / np.sqrt(v)).T for record, v in enumerate(place.variances)]
    for rate in RATES:
        decay = rate / signals.duration
        energy = np.sum([_energy(each, decay, signals.dt, n_lines) for each in errors], axis=0)
        peak = int(np.argmax(np.where(seen, energy, -1)))
        if energy[peak] > best:
            best, found = float(energy[peak]), (2 * np.pi * hertz[peak], decay)
    return found


def _energy(errors: Floats, decay: float, dt: float, n_lines: int) -> Floats:
    """Return how much of Σ e² each line of one decay explains."""
    window = np.exp(-decay * dt * np.arange(errors.shape[1]))
    spectrum = np.fft.rfft(errors * window, n_lines, axis=1)
    squares = (spectrum.real**2 + spectrum.imag**2).sum(axis=0)
    return np.asarray(2 * squares / (window**2).sum())


def _refitted(place: Place, frequency: float, decay: float) -> Place:
    """Return the place with one more oscillation, the better of two starts."""
    signals = place.signals
    starts = {decay, max(decay, SECOND_START / signals.duration)}
    trials = [
        settle(
            Place(place.components.with_one(frequency, start), signals),
            largest=SHORT,
            negligible=COARSE,
        )
        for start in sorted(starts)
    ]
    return min(trials, key=lambda trial: trial.cost)


def eliminate(place: Place) -> Place:
    """Drop oscillations that are not worth their parameters, the least needed first."""
    while len(place.components) > 1 and place.relative_errors > ROUNDING:
        every = np.arange(len(place.components))
        without = [Place(place.components.select(every != k), place.signals) for k in every]
        trial = settle(min(without, key=lambda each: each.cost))
        if trial.cost - place.cost >= price(place.signals):
            return place
        place = trial
    return place
