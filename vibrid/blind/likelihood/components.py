"""Oscillations e^{−σt} cos(ωt + φ): what decays is the structure's, what does not the force's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...modes import Complexes
from ...record import Floats

Mask = NDArray[np.bool_]
GROWTH = 2.0  # largest growth rate looked at, over 1 / duration
DECAY = 0.5  # largest decay rate, over 1 / dt


@dataclass(frozen=True, eq=False)
class Signals:
    """Several records of the same sensors, sampled alike, and what is known of the force.

    Attributes
    ----------
    samples : tuple of arrays (n_samples, n_channels)
        Of each record; time starts at zero in each.
    dt : float
    known : array (n_known,)
        Angular frequencies [rad/s] of the force that are given.
    """

    samples: tuple[Floats, ...]
    dt: float
    known: Floats

    @property
    def n_channels(self) -> int:
        return int(self.samples[0].shape[1])

    @cached_property
    def lengths(self) -> tuple[int, ...]:
        return tuple(len(each) for each in self.samples)

    @property
    def count(self) -> int:
        """Samples of all records together."""
        return sum(self.lengths)

    @property
    def duration(self) -> float:
        """Of the longest record: the unit of rates."""
        return max(self.lengths) * self.dt

    @cached_property
    def sizes(self) -> tuple[Floats, ...]:
        """Root mean square of each channel of each record."""
        return tuple(np.sqrt(np.mean(each**2, axis=0)) for each in self.samples)


@dataclass(frozen=True, eq=False)
class Components:
    """Oscillations that all records share; amplitudes are each record's own.

    Attributes
    ----------
    frequencies : array (k,)
        ω [rad/s].
    decays : array (k,)
        σ [1/s], zero where not `damped`.
    damped : array of bool (k,)
    real : array of bool (k,)
        Whether all channels swing in phase: one amplitude each and one phase for all.
    phases : array (n_records, k)
        φ of the real ones, else zero.
    """

    frequencies: Floats
    decays: Floats
    damped: Mask
    real: Mask
    phases: Floats

    @classmethod
    def none(cls, n_records: int) -> Components:
        no = np.zeros(0, dtype=bool)
        return cls(np.zeros(0), np.zeros(0), no, no, np.zeros((n_records, 0)))

    def __len__(self) -> int:
        return len(self.frequencies)

    @property
    def poles(self) -> Complexes:
        return np.asarray(-self.decays + 1j * self.frequencies)

    def with_one(self, frequency: float, decay: float) -> Components:
        """Return the components and one more, damped and of free shape."""
        return Components(
            np.append(self.frequencies, frequency),
            np.append(self.decays, decay),
            np.append(self.damped, True),
            np.append(self.real, False),
            np.hstack([self.phases, np.zeros((len(self.phases), 1))]),
        )

    def select(self, kept: Mask | Sequence[int]) -> Components:
        return Components(
            self.frequencies[kept],
            self.decays[kept],
            self.damped[kept],
            self.real[kept],
            self.phases[:, kept],
        )

    def held(self, damped: Mask, start_decay: float) -> Components:
        """Return the components with only some damped; those start no lower than given."""
        decays = np.where(damped, np.maximum(self.decays, start_decay), 0)
        return replace(self, decays=decays, damped=damped)

    def moved(self, step: Floats, signals: Signals) -> Components:
        """Return the components after a step in units of 1 / duration, inside the bounds."""
        frequencies, decays, phases = self.unpacked(step)
        T, dt = signals.duration, signals.dt
        limits = -GROWTH / T, DECAY / dt
        moved = np.clip(self.decays + np.clip(decays, -1, 1) / T, *limits)
        return replace(
            self,
            frequencies=np.clip(
                self.frequencies + np.clip(frequencies, -1, 1) / T, 1e-3 / T, np.pi / dt
            ),
            decays=np.where(self.damped, moved, 0),
            phases=self.phases + phases,
        )

    def unpacked(self, step: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the parts of a vector of all parameters: of ω, σ and φ."""
        k = len(self)
        return step[:k], step[k : 2 * k], step[2 * k :].reshape(len(self.phases), k)


def oscillations(components: Components, record: int, n_samples: int, dt: float) -> Complexes:
    """Return e^{λt + iφ} (k, n_samples), as products of short runs: few exponentials."""
    rates = components.poles * dt
    run = int(np.ceil(np.sqrt(n_samples)))
    short = np.exp(rates[:, None] * np.arange(run))
    long = np.exp(rates[:, None] * run * np.arange(-(-n_samples // run)))
    long *= np.exp(1j * components.phases[record])[:, None]
    whole = long[:, :, None] * short[:, None, :]
    return np.asarray(whole.reshape(len(rates), run * long.shape[1])[:, :n_samples])
