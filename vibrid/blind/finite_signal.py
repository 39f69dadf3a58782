"""Forces that are not periodic, on every degree of freedom (proposition 4.1).

Any 𝒦 and 𝒟 explain any motion if the force is free: M⁻¹f = q̈ + 𝒟q̇ + 𝒦q. Only a limit of the
force in band or in time tells the structure from it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ..errors import DataError, OptionError, check_whole
from ..exosystem import harmonics, signal_basis
from ..methods.preparation import check_order
from ..modes import Complexes
from ..record import Floats, Record
from .result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from .sensors import Sensors, sensors_of
from .subspace import blind_subspace
from .subspace.answer import in_physical_coordinates
from .subspace.case import Case
from .subspace.division import Division
from .subspace.poles import FreePoles, largest_order, order_by_fall, oscillating, usual_horizon

ROOM = 1.5  # period of the force's model over the record: what is not periodic needs room
REDUNDANT = 1e-12  # columns of its basis that add less than this share
SPARE = 0.8  # of the largest horizon that leaves enough columns
EDGE = 0.05  # of the band limits: a pole so close counts as inside
REASON = (
    "An arbitrary force on every degree of freedom explains the record with any M⁻¹K and M⁻¹D, "
    "as M⁻¹f = q̈ + M⁻¹D q̇ + M⁻¹K q: the data cannot tell them."
)
CURE = (
    "Limit the force: force_band=(low, high) in Hz with the modes outside it, force_free="
    '(start, stop) in s, excitation="point" where some degrees of freedom are not forced, or '
    'excitation="ambient" for white noise.'
)


def blind_finite_signal(
    record: Record,
    n_dof: int,
    *,
    force_band: tuple[float, float] | None = None,
    force_free: tuple[float, float] | None = None,
    mass: ArrayLike | None = None,
    block_rows: int | None = None,
    order: int | None = None,
) -> BlindFit:
    """Identify 𝒦 and 𝒟 under a non-periodic force on every degree of freedom, where possible.

    Parameters
    ----------
    record : Record
    n_dof : int
        Number of sensors.
    force_band : (low, high) [Hz], optional
        All of the force lies in it, and all modes outside. The force comes out too.
    force_free : (start, stop) [s], optional
        A stretch without force: a free decay.
    mass, block_rows, order
        As of `blind_subspace`.

    Returns
    -------
    BlindFit
        Without either limit, or with a mode in the band, the refusal "in_band".

    Raises
    ------
    OptionError
        Both limits, or limits outside the record or beyond Nyquist.
    DataError
        As of `blind_subspace`.

    Notes
    -----
    Han, Bohn & Bauer (2021), proposition 4.1 and figure 7. Instead of a band-pass, whose own
    poles would be found beside the structure's, the lines of the finite-length signal model
    (67) are projected out of every Hankel row, which leaves its column space to the
    structure. Their period is 1.5 times the record, so that no jump leaks from band to band.
    """
    sensors = sensors_of(record, n_dof)
    if force_band is not None and force_free is not None:
        raise OptionError("Give force_band or force_free, not both.")
    if force_free is not None:
        return _free(record, n_dof, force_free, mass, block_rows, order)
    if force_band is None:
        return _refused(sensors, REASON, {})
    low, high = force_band
    if not 0 <= low < high < 0.5 / record.dt:
        raise OptionError(
            f"force_band must rise from 0 or more to below {0.5 / record.dt:g} Hz; got {low:g} to "
            f"{high:g}."
        )
    return _outside(record, sensors, (low, high), mass, block_rows, order)


def _free(
    record: Record,
    n_dof: int,
    window: tuple[float, float],
    mass: ArrayLike | None,
    block_rows: int | None,
    order: int | None,
) -> BlindFit:
    """Return the answer of a free decay; the force elsewhere is not estimated."""
    part = record.between(*window).select(inputs=[])
    states = 2 * n_dof if order is None else order
    found = blind_subspace(part, n_dof, mass=mass, block_rows=block_rows, order=states)
    determined = {**found.verdict.determined, "normalized_force": False}
    missing = (*found.verdict.missing, "the force outside the free stretch")
    verdict = replace(found.verdict, kind="force_free", determined=determined, missing=missing)
    return replace(
        found,
        normalized_force=np.full((record.n_samples, n_dof), np.nan),
        force_phasors=np.zeros((1, n_dof, 0), dtype=np.complex128),
        input_frequencies_hz=np.zeros(0),
        verdict=verdict,
    )


def _outside(
    record: Record,
    sensors: Sensors,
    band: tuple[float, float],
    mass: ArrayLike | None,
    block_rows: int | None,
    order: int | None,
) -> BlindFit:
    """Return the answer of modes outside the force's band."""
    n, y = sensors.setting.n_dof, sensors.outputs(record)
    lines = harmonics(1 / (ROOM * record.duration), band[1], band[0])
    lines = lines[lines >= band[0]]
    horizon = _horizon(len(y), n, len(lines)) if block_rows is None else block_rows
    check_whole("block_rows", horizon, 2)
    found = projected_poles(y, record.dt, horizon, lines, 2 * n, order)
    hertz = found.poles.imag / (2 * np.pi)
    within = (hertz > band[0] * (1 - EDGE)) & (hertz < band[1] * (1 + EDGE))
    outside = found.poles[~within]
    if len(outside) < n:
        words = (
            f"Only {len(outside)} of {n} modes stand outside the force's band of {band[0]:g} to "
            f"{band[1]:g} Hz. {REASON}"
        )
        return _refused(sensors, words, {"modes_outside": len(outside)}, outside)
    shorter = max(2, 2 * horizon // 3)
    kept = min(found.order, largest_order(shorter, n))
    again = projected_poles(y, record.dt, shorter, lines, 2, kept)
    none = np.zeros(0)
    division = Division(outside[:n], outside[n:], lines, none, none)
    made = in_physical_coordinates(
        Case(record, sensors, found, division, (again,), mass=mass, limited=True)
    )
    return made if made.accepted else _with_reason(made)


def _with_reason(refused: BlindFit) -> BlindFit:
    """Return a refusal with the likely reason: a mode in the band is taken for force."""
    words = "A mode may lie in the force's band, where no data tell it from the force."
    verdict = refused.verdict
    more = (*verdict.refusals, Refusal("in_band", words, CURE))
    return replace(refused, verdict=replace(verdict, refusals=more))


def _horizon(n_samples: int, n_channels: int, n_lines: int) -> int:
    """Return a horizon for which columns remain beside the lines of the force."""
    room = SPARE * (n_samples - 2 * n_lines) / (2 * (n_channels + 1))
    return max(2, min(usual_horizon(n_samples, n_channels), int(room)))


def projected_poles(
    outputs: Floats,
    dt: float,
    block_rows: int,
    lines_hz: Floats,
    smallest_order: int,
    order: int | None = None,
) -> FreePoles:
    """Return the poles that remain when sines and a constant are taken out of a record.

    Each Hankel row holds a sine as the same two functions of time, so an orthogonal
    projection of the rows removes it and keeps the column space of all else exactly.

    Raises
    ------
    DataError
        Too few samples.
    """
    N, p = outputs.shape
    columns = N - 2 * block_rows + 1
    basis = signal_basis(lines_hz, dt * np.arange(max(columns, 1)), offset=True)
    if columns <= 2 * block_rows * p + basis.shape[1]:
        raise DataError(
            f"{N} samples are too few for {block_rows} block rows of {p} outputs beside "
            f"{len(lines_hz)} lines of the force; use fewer block rows, a narrower band or a "
            "longer record."
        )
    Q, R, _ = sla.qr(basis, mode="economic", pivoting=True, check_finite=False)
    sizes = np.abs(np.diag(R))
    Q = Q[:, sizes > REDUNDANT * sizes[0]]
    scaled = outputs / np.linalg.norm(outputs - outputs.mean(axis=0), axis=0)
    rows = np.vstack([scaled[k : k + columns].T for k in range(2 * block_rows)])
    for _ in range(2):  # once more, for what rounding left
        rows = rows - (rows @ Q) @ Q.T
    lower = np.asarray(sla.qr(rows.T, mode="r", check_finite=False)[0])[: len(rows)].T
    half, largest = block_rows * p, largest_order(block_rows, p)
    U, singular, _ = sla.svd(lower[half:, :half], full_matrices=False)
    if order is None:
        order = order_by_fall(singular, smallest_order, largest)
    check_order(order, largest, f"{block_rows} block rows")
    gamma = U[:, :order]
    A = np.linalg.lstsq(gamma[:-p], gamma[p:], rcond=None)[0]
    return FreePoles(oscillating(A, dt), gamma.shape[1], singular, block_rows)


def _refused(
    sensors: Sensors,
    words: str,
    figures: dict[str, float],
    poles: Complexes | None = None,
) -> BlindFit:
    n = sensors.setting.n_dof
    nothing = np.full((n, n), np.nan)
    kept = np.zeros(0, dtype=np.complex128) if poles is None else poles
    verdict = BlindVerdict(
        "none",
        dict.fromkeys(("normalized_stiffness", "normalized_damping", "normalized_force"), False),
        (CURE,),
        figures,
        (Refusal("in_band", words, CURE, figures),),
        sensors.findings,
    )
    modes = modes_from(kept, np.full((n, len(kept)), np.nan + 0j), sensors.setting)
    return blind_fit(sensors.setting, nothing, nothing, modes, verdict)
