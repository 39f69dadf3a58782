"""Checks of a division into structure and input: when the subspace answer is refused.

Any n pairs of poles give consistent 𝒦 and 𝒟, an input's pole taken for a mode too; so the
division itself must be clear, repeatable, and leave nothing but noise.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ...modes import Complexes
from ...record import Floats
from ..result import Refusal
from .case import Case
from .division import Amplitudes, unexplained

FADED = 0.7  # σT of a mode: less cannot be told from a sine that does not decay
STEADY = 0.7  # |σ|T of an input: more is no sine
GROWING = 1.0  # −σT
GAP = 3.0  # slowest mode over fastest input
MOVED = 0.5  # change of a pole from horizon to horizon or stretch to stretch, over its σ
HIDDEN = 10.0  # size of a mode in standard deviations of its estimate
COLOURED = 2.0  # residual power inside the band over that outside
FRONT = 0.1  # of the record: where a fast mode that was not found would be left
UNEVEN = 1.0  # residual power in the front over that behind, less chance
CHANCE = 4.0  # standard deviations of such a ratio that are chance
ROUNDING = 1e-9  # of the outputs' size: a residual without meaning
UNMODELLED = 1e-5  # the same where a finite signal stands for the force
BAND = 1.3  # times the highest and through the lowest frequency: the band


def check_figures(case: Case, fitted: Amplitudes) -> dict[str, float]:
    """Return the figures that the rules of `refusals` look at."""
    division, duration, dt = case.division, case.record.duration, case.record.dt
    decay = -division.structure.real * duration
    inputs = np.abs(division.inputs.real) * duration
    every = np.concatenate([division.structure, division.inputs])
    size = np.linalg.norm(case.outputs - case.outputs.mean(axis=0), axis=0)
    floor = size * (UNMODELLED if case.limited else ROUNDING)
    left = unexplained(fitted, dt, division)
    if (np.linalg.norm(left, axis=0) <= floor).all():
        left = np.zeros_like(left)
    changes = [_change(division.structure, each.poles) for each in case.again]
    return {
        "modes_found": float(len(decay)),
        "slowest_decay": float(decay.min(initial=np.inf)),
        "fastest_input": float(inputs.max(initial=0.0)),
        "growth": float(every.real.max(initial=0.0) * duration),
        "change": max(changes, default=0.0),
        "weakest_mode": float(fitted.sizes.min(initial=np.inf)),
        "residual_colour": _colour(left / size, every, dt),
        "residual_front": _front(left),
    }


def _change(poles: Complexes, others: Complexes) -> float:
    """Return the largest distance to the nearest of other poles, over the decay rate."""
    if not len(others):
        return np.inf
    gaps = np.abs(poles[:, None] - others[None, :]).min(axis=1)
    return float((gaps / np.maximum(np.abs(poles.real), 1e-300)).max(initial=0.0))


def _colour(residuals: Floats, poles: Complexes, dt: float) -> float:
    """Return the residual's power density inside the band over outside; 1 where it is nothing."""
    if not residuals.any() or not len(poles):
        return 1.0
    hertz = np.fft.rfftfreq(len(residuals), dt)
    window = np.hanning(len(residuals))[:, None]
    power = (np.abs(np.fft.rfft(residuals * window, axis=0)) ** 2).sum(axis=1)
    band = np.abs(poles.imag) / (2 * np.pi)
    inside = (hertz >= band.min() / BAND) & (hertz <= band.max() * BAND)
    outside = hertz > band.max() * BAND
    if inside.sum() < 10 or outside.sum() < 10:
        return 1.0
    return float(power[inside].mean() / max(power[outside].mean(), 1e-300))


def _front(residuals: Floats) -> float:
    """Return the residual power of the front over the rest, the worst channel, and over chance."""
    if not residuals.any():
        return 1.0
    edge = max(1, int(FRONT * len(residuals)))
    power = residuals**2
    ratios = power[:edge].mean(axis=0) / np.maximum(power[edge:].mean(axis=0), 1e-300)
    return float(ratios.max() / (1 + CHANCE * np.sqrt(2 / edge)))


def refusals(
    figures: Mapping[str, float], n_dof: int, duration: float, limited: bool = False
) -> list[Refusal]:
    """Return what speaks against a division, before any matrix is made.

    `limited`: the division is known from the force's band, not from decays.
    """
    if figures["modes_found"] < n_dof:
        return [_too_few(figures, n_dof)]
    found = [] if limited else _of_decay(figures, n_dof, duration)
    if figures["growth"] > GROWING:
        found.append(
            _refusal(
                "R3",
                f"An oscillation grows by e^{figures['growth']:.2g} within {duration:g} s (limit "
                f"{GROWING:g}): the force changes.",
                "Use a stretch in which it does not.",
                figures,
                "growth",
            )
        )
    return found + _of_evidence(figures)


def _of_decay(figures: Mapping[str, float], n_dof: int, duration: float) -> list[Refusal]:
    slow, fast = figures["slowest_decay"], figures["fastest_input"]
    if slow < FADED:
        return [
            _refusal(
                "R1",
                f"The slowest of {n_dof} modes decays by e^{-slow:.2g} only within {duration:g} s "
                f"(limit {FADED:g}). Modes are told from forces by a transient alone.",
                "Record from the start of the motion, or for longer.",
                figures,
                "slowest_decay",
            )
        ]
    if fast > STEADY and fast * GAP > slow:
        return [
            _refusal(
                "R2",
                f"More oscillations decay than there are sensors ({n_dof}): one more by "
                f"e^-{fast:.2g} within {duration:g} s (limit {STEADY:g}).",
                "Measure at more degrees of freedom, or give input_frequencies_hz.",
                figures,
                "fastest_input",
            )
        ]
    if slow < GAP * fast:
        return [
            _refusal(
                "R5",
                f"Modes and forces do not separate: the slowest mode decays {slow / fast:.2g} "
                f"times as fast as the fastest input ({GAP:g} are needed).",
                "Give input_frequencies_hz, or a longer record.",
                figures,
                "slowest_decay",
                "fastest_input",
            )
        ]
    return []


def _of_evidence(figures: Mapping[str, float]) -> list[Refusal]:
    found = []
    if figures["change"] > MOVED:
        found.append(
            _refusal(
                "R1",
                f"A mode's pole moves by {figures['change']:.2g} of its decay rate between two "
                f"horizons or between the record and its first half (limit {MOVED:g}).",
                "Less noise, a larger transient or a higher sampling rate would steady it.",
                figures,
                "change",
            )
        )
    if figures["weakest_mode"] < HIDDEN:
        found.append(
            _refusal(
                "R1",
                f"The weakest mode is {figures['weakest_mode']:.2g} standard deviations large "
                f"({HIDDEN:g} are needed).",
                "Excite it more, or measure with less noise.",
                figures,
                "weakest_mode",
            )
        )
    if figures["residual_colour"] > COLOURED:
        found.append(
            _refusal(
                "R4",
                f"Inside the band the model leaves {figures['residual_colour']:.2g} times the "
                f"power density that it leaves outside (limit {COLOURED:g}): the force is not "
                "made of a few sines.",
                'Use excitation="point" or "ambient" where that is meant.',
                figures,
                "residual_colour",
            )
        )
    elif figures["residual_front"] > UNEVEN:
        found.append(
            _refusal(
                "R4",
                f"At the start the model leaves {figures['residual_front']:.2g} times the power "
                "that chance allows: a mode that decays fast was not found.",
                "Give order, or measure at more degrees of freedom.",
                figures,
                "residual_front",
            )
        )
    return found


def _too_few(figures: Mapping[str, float], n_dof: int) -> Refusal:
    count = int(figures["modes_found"])
    return _refusal(
        "R1",
        f"Beside the input there are {count} oscillations for {n_dof} degrees of freedom; the "
        "transient has died, or a rigid-body mode is invisible to accelerometers.",
        "Record from the start of the motion.",
        figures,
        "modes_found",
    )


def _refusal(
    rule: str, sentence: str, cure: str, figures: Mapping[str, float], *names: str
) -> Refusal:
    return Refusal(rule, sentence, cure, {name: figures[name] for name in names})
