"""Rules R1 to R7: when oscillations in a record do not determine a structure.

Each function returns what it looked at and, where the rule is broken, a `Refusal`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..record import Floats
from .result import Refusal

SURE = 5.0  # R1: σ over its deviation of the least certain mode
UNSURE = 4.0  # R2: of the most certain oscillation that is not a mode
GROWING = -5.0  # R3
IN_BAND = 1.5  # R4: power of the errors per line inside the band over that outside
SPREAD = 4.0  # R4: times the ratio's own deviation that must be exceeded as well
FEWEST_LINES = 20  # R4: outside the band, for a ratio to mean something
OUTSIDE = 1.3  # R4: times the highest frequency
LEAD = 5.0  # R5: log-likelihood above that of the next division
STIFFNESS, DAMPING = 0.15, 0.3  # R6: largest relative deviations
CONDITION = 1e8  # R7

Judged = tuple[dict[str, float], list[Refusal]]


def of_certainty(certainty: Floats, n_dof: int) -> Judged:
    """R1, R2, R3: as many oscillations decay as there are sensors, no more, and none grows.

    Parameters
    ----------
    certainty : array
        σ over its standard deviation of each oscillation, descending.
    n_dof : int
    """
    least = float(certainty[n_dof - 1]) if len(certainty) >= n_dof else 0.0
    further = certainty[n_dof:]
    checks = {"decay_certainty": least}
    refused = []
    if least < SURE:
        seen = int((certainty >= SURE).sum())
        refused.append(
            Refusal(
                "R1",
                f"{seen} of {n_dof} modes decay for certain: the next one's decay rate is "
                f"{least:.2g} times its standard deviation, and {SURE:g} is asked. Sensors see "
                "the structure through a transient only.",
                "Record from the start of the motion, or after a stop or an impact.",
                {"decay_certainty": least, "limit": SURE, "seen": seen},
            )
        )
    if len(further):
        checks["further_certainty"] = float(further[0])
        checks["growth_certainty"] = float(further[-1])
    if len(further) and further[0] > UNSURE:
        refused.append(
            Refusal(
                "R2",
                f"A further oscillation decays (rate {further[0]:.3g} times its deviation, limit "
                f"{UNSURE:g}): there are more modes than {n_dof} sensors, or the force is not "
                "periodic.",
                "Put a sensor at every degree of freedom, or filter to the band of their modes.",
                {"further_certainty": float(further[0]), "limit": UNSURE},
            )
        )
    if len(certainty) and certainty[-1] < GROWING:
        refused.append(
            Refusal(
                "R3",
                f"An oscillation grows ({certainty[-1]:.3g} times its deviation, limit "
                f"{GROWING:g}): the force changed during the record.",
                "Use a stretch with a steady force.",
                {"growth_certainty": float(certainty[-1]), "limit": GROWING},
            )
        )
    return checks, refused


def of_errors(errors: Sequence[Floats], dt: float, band_hz: tuple[float, float]) -> Judged:
    """R4: errors (n_samples, n_dof), whitened, are as small inside the band as outside."""
    inside, outside, lines = 0.0, 0.0, np.zeros(2)
    for each in errors:
        power = (np.abs(np.fft.rfft(each, axis=0)) ** 2).sum(axis=1)
        hertz = np.fft.rfftfreq(len(each), dt)
        within = (hertz >= band_hz[0]) & (hertz <= band_hz[1])
        beyond = hertz > OUTSIDE * band_hz[1]
        inside, outside = inside + power[within].sum(), outside + power[beyond].sum()
        lines += within.sum(), beyond.sum()
    if lines[0] < 1 or lines[1] < FEWEST_LINES:
        return {}, []
    ratio = float((inside / lines[0]) / (outside / lines[1]))
    checks = {"in_band_ratio": ratio}
    limit = max(IN_BAND, 1 + SPREAD / np.sqrt(lines[0] * errors[0].shape[1]))
    if ratio <= limit:
        return checks, []
    sentence = (
        f"What the oscillations leave is {ratio:.3g} times stronger per line from {band_hz[0]:.3g} "
        f"to {band_hz[1]:.3g} Hz than above (limit {limit:.3g}): the force is not a sum of a "
        "few sines."
    )
    cure = "Say what the force is with excitation=, or give a stretch without force."
    return checks, [Refusal("R4", sentence, cure, {"in_band_ratio": ratio, "limit": limit})]


def of_lead(lead: float) -> Judged:
    """R5: no other division into modes and forces is about as likely."""
    checks = {"division_lead": lead} if np.isfinite(lead) else {}
    if lead >= LEAD:
        return checks, []
    sentence = (
        f"Another division into modes and forces is about as likely (log-likelihood {lead:.2g} "
        f"lower, and {LEAD:g} is asked)."
    )
    cure = "Give the force's frequencies with input_frequencies_hz, or a longer transient."
    return checks, [Refusal("R5", sentence, cure, {"division_lead": lead, "limit": LEAD})]


def of_deviations(P: Floats, covariance: Floats) -> Judged:
    """R6: the predicted deviation of 𝒦; that of 𝒟 is a check only, 𝒟 alone is left out."""
    checks = relative_deviations(P, covariance)
    off = checks["stiffness_deviation"]
    if off <= STIFFNESS:
        return checks, []
    sentence = (
        f"The predicted relative deviation of M⁻¹K is {off:.2g}, and {STIFFNESS:g} is the most."
    )
    cure = "Use a stronger transient, a longer record, or structure= and mass= where known."
    return checks, [Refusal("R6", sentence, cure, {"stiffness_deviation": off, "limit": STIFFNESS})]


def relative_deviations(P: Floats, covariance: Floats) -> dict[str, float]:
    """Return the deviations of 𝒦 and 𝒟, of P = [𝒦 𝒟], relative to their size (Frobenius)."""
    n = len(P)
    variances = np.diag(covariance)
    return {
        "stiffness_deviation": float(np.sqrt(variances[: n * n].sum()) / np.linalg.norm(P[:, :n])),
        "damping_deviation": float(np.sqrt(variances[n * n :].sum()) / np.linalg.norm(P[:, n:])),
    }


def of_condition(condition: float) -> Judged:
    """R7: the equations of 𝒦, those of poles and shapes, are well conditioned."""
    checks = {"condition": condition}
    if condition <= CONDITION:
        return checks, []
    sentence = (
        f"The equations of M⁻¹K have the condition {condition:.2g} (limit {CONDITION:.0e}): "
        "shapes or poles coincide."
    )
    cure = "Put the sensors where the shapes differ."
    return checks, [Refusal("R7", sentence, cure, {"condition": condition, "limit": CONDITION})]


def of_stiffness(P: Floats) -> Judged:
    """R7: eigenvalues of 𝒦, of P = [𝒦 𝒟], have positive real parts."""
    smallest = float(np.linalg.eigvals(P[:, : len(P)]).real.min())
    checks = {"smallest_eigenvalue": smallest}
    if smallest > 0:
        return checks, []
    sentence = (
        f"M⁻¹K has an eigenvalue with the real part {smallest:.3g}; a structure has positive ones."
    )
    cure = "Check signs and DOFs of the channels."
    figures = {"smallest_eigenvalue": smallest, "limit": 0.0}
    return checks, [Refusal("R7", sentence, cure, figures)]


def together(*judged: Judged) -> tuple[Mapping[str, float], tuple[Refusal, ...]]:
    """Return all checks and all refusals."""
    checks: dict[str, float] = {}
    refused: list[Refusal] = []
    for figures, broken in judged:
        checks |= figures
        refused += broken
    return checks, tuple(refused)
