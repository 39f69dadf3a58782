"""Algorithms 1 (PSSID) and 2 (blind) of Han, Bohn & Bauer (2021): from a record to an answer."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from ...errors import OptionError, check_choice, check_whole
from ...record import Floats, Record
from ...statespace import HOLDS
from ..likelihood.data import frequencies_of
from ..result import BlindFit
from ..sensors import sensors_of
from .answer import in_physical_coordinates
from .case import Case
from .division import divide
from .poles import FreePoles, free_poles, largest_order, usual_horizon

OTHER_HORIZON = 1.5  # times the horizon, or the horizon through it: for the poles found again


def blind_subspace(
    record: Record,
    n_dof: int,
    *,
    input_frequencies_hz: Sequence[float] | None = None,
    hold: str = "band_limited",
    mass: ArrayLike | None = None,
    order: int | None = None,
    block_rows: int | None = None,
    stretch: tuple[float, float] | None = None,
) -> BlindFit:
    """Identify 𝒦 = M⁻¹K, 𝒟 = M⁻¹D and a periodic force from outputs alone.

    Structure and force together are one system that runs freely; its poles come from
    stochastic subspace identification. Those at the frequencies given (PSSID, algorithm 1),
    or those that do not decay (blind identification, algorithm 2), belong to the force. Where
    inputs were measured, ℬ follows too. Use `method="ml"` of `identify_blind` for records
    with more noise than 40 dB; this is the published method, and quick.

    Parameters
    ----------
    record : Record
        One displacement, velocity or acceleration at every degree of freedom, mixed as they
        come, from the start of the motion: only a transient tells modes from forces.
    n_dof : int
        Number of sensors.
    input_frequencies_hz : sequence of float, optional
        Of the force; blind without them.
    hold : "band_limited", "zoh" or "foh"
        How the force moves between samples; concerns the force only, not 𝒦 and 𝒟.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        Total, masses or matrix [kg], for stiffness, damping and force in physical units.
    order : int, optional
        States of structure and force together, 2 n_dof + 2 a frequency; from the singular
        values when left out.
    block_rows : int, optional
        Horizon [samples]; a tenth of the record when left out.
    stretch : (start, stop) [s], optional
        Rows from which the amplitudes of the force are fitted; all by default.

    Returns
    -------
    BlindFit
        A refusal is a value: NaN matrices, `verdict.accepted` False, the rules broken.

    Raises
    ------
    OptionError
        n_dof other than the number of sensors, unknown hold, frequencies, an order or a
        stretch that do not fit.
    DataError
        Gaps, too few samples, constant channels.

    Notes
    -----
    1. Poles by SSI, with a constant projected out of the Hankel rows: the offset of a force
       is unobservable from accelerations. 2. Division. 3. Columns c_i of the sensors by least
    squares over the whole record, no initial state needed. 4. [𝒦 𝒟] = −Φ Λ² [Φ; Φ Λ]⁻¹ with
    φ_i = c_i / λ_i², the closed form of step III. 5. Force phasors p_k = G(jω_k)⁻¹ c_k, on
    the axis exactly, so that the history cannot drift. Refused unless: exactly n_dof pairs
    decay clearly faster than all others, the same at another horizon and in the first half,
    no other poles near them explain more than noise, and 𝒦 has positive eigenvalues. Standard
    deviations hold the distance to the greatest likelihood beside the Cramér-Rao bound.
    """
    check_choice("hold", hold, HOLDS)
    sensors = sensors_of(record, n_dof)
    known = sorted(frequencies_of(input_frequencies_hz, record.dt).tolist())
    part = _rows(stretch, record)
    y = sensors.outputs(record)
    horizon = usual_horizon(len(y), n_dof) if block_rows is None else block_rows
    check_whole("block_rows", horizon, 2)
    found = free_poles(y, record.dt, horizon, 2 * n_dof, order)
    division = divide(found.poles, n_dof, record.duration, known)
    again = _again(y, record.dt, found)
    return in_physical_coordinates(Case(record, sensors, found, division, again, hold, mass, part))


def _rows(stretch: tuple[float, float] | None, record: Record) -> slice | None:
    if stretch is None:
        return None
    start, stop = stretch
    if not 0 <= start < stop <= record.duration * (1 + 1e-9):
        raise OptionError(
            f"stretch={start:g} to {stop:g} s does not lie in the record of {record.duration:g} s."
        )
    return slice(round(start / record.dt), round(stop / record.dt))


def _again(outputs: Floats, dt: float, found: FreePoles) -> tuple[FreePoles, ...]:
    """Return the poles at another horizon, and of the first half, where the transient is.

    The other horizon is the longer one where that is affordable: short ones see less.
    """
    n_samples, n_channels = outputs.shape
    other = round(OTHER_HORIZON * found.block_rows)
    if other > usual_horizon(n_samples, n_channels):
        other = max(2, int(found.block_rows / OTHER_HORIZON))
    front = outputs[: n_samples // 2]
    longest = (len(front) + 1) // (2 * (n_channels + 1))
    half = min(found.block_rows, usual_horizon(len(front), n_channels), longest)
    return tuple(
        free_poles(y, dt, rows, 2, min(found.order, largest_order(rows, n_channels)))
        for y, rows in ((outputs, other), (front, half))
    )
