"""Periodic and finite-length signals as outputs of systems without inputs.

Each frequency is a block of two states that turn,

    continuous [0 ω; −ω 0],    discrete [cos θ  sin θ; −sin θ  cos θ],  θ = ω dt,

and a constant is one state. The discrete model is the sampled continuous one. (The companion
block [0 −1; 1 2 cos θ] of Han, Bohn & Bauer 2021, eq. 14, has the same poles but is not: its
logarithm is no rotation.)
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, check_positive, check_whole
from ..record import Floats
from ..statespace import StateSpace

BELOW_NYQUIST = 1e-9  # relative distance: at Nyquist a sine cannot be told from nothing


def harmonics(fundamental_hz: float, highest_hz: float, lowest_hz: float = 0.0) -> Floats:
    """Return the multiples of a fundamental in a band [Hz], without zero.

    Examples
    --------
    >>> harmonics(0.5, 2.0)
    array([0.5, 1. , 1.5, 2. ])
    """
    check_positive("fundamental_hz", fundamental_hz, "Hz")
    check_positive("highest_hz", highest_hz, "Hz")
    if not lowest_hz >= 0:
        raise OptionError(f"lowest_hz must not be negative; got {lowest_hz:g}.")
    first = max(1, int(np.ceil(lowest_hz / fundamental_hz * (1 - 1e-12))))
    last = int(np.floor(highest_hz / fundamental_hz * (1 + 1e-12)))
    if last < first:
        raise OptionError(
            f"No multiple of {fundamental_hz:g} Hz lies between {lowest_hz:g} and "
            f"{highest_hz:g} Hz; widen the band or lower the fundamental."
        )
    return np.asarray(fundamental_hz * np.arange(first, last + 1), dtype=np.float64)


def periodic_signal(
    frequencies_hz: ArrayLike,
    *,
    offset: bool = False,
    outputs: ArrayLike | None = None,
    dt: float | None = None,
) -> StateSpace:
    """Return the model of signals made of sines, without inputs.

    Parameters
    ----------
    frequencies_hz : array (n_frequencies,)
        Positive and different; below the Nyquist frequency of a discrete model [Hz].
    offset : bool
        Whether the first state is a constant.
    outputs : array (n_signals, n_states), optional
        C_u; n_states is 2 n_frequencies, and one more with an offset. All signals share the
        states: one record excites two states of a frequency, however many signals have it.
        By default one signal, the sum of the first state of each block.
    dt : float, optional
        Sampling interval [s]; without it the model is continuous.

    Returns
    -------
    StateSpace
        Its initial state holds amplitudes and phases: of a block (a, b) the signal
        a cos ωt + b sin ωt.

    Raises
    ------
    OptionError
        Frequencies that are not positive, repeated or at or above Nyquist; outputs that do
        not fit.

    Notes
    -----
    Han, Bohn & Bauer (2021), eq. (6)-(10) continuous, (11)-(13) discrete with the blocks of
    (67), (16) with a shared state: its block diagonal of one copy per signal could not be
    excited by one record.

    Examples
    --------
    >>> model = periodic_signal([0.25], dt=1.0)
    >>> model.simulate(initial_state=[0, 2], n_samples=4)[:, 0].round(12).tolist()
    [0.0, 2.0, 0.0, -2.0]
    """
    hertz = _checked(frequencies_hz, dt)
    n_states = 2 * len(hertz) + offset
    if not n_states:
        raise OptionError("A signal needs a frequency or an offset; got neither.")
    A = np.zeros((n_states, n_states))
    if offset and dt is not None:
        A[0, 0] = 1
    at = offset + 2 * np.arange(len(hertz))
    angles = 2 * np.pi * hertz * (1 if dt is None else dt)
    A[at, at] = A[at + 1, at + 1] = 0 if dt is None else np.cos(angles)
    A[at, at + 1] = angles if dt is None else np.sin(angles)
    A[at + 1, at] = -A[at, at + 1]
    C = _outputs(outputs, n_states, at, offset)
    return StateSpace(A, np.zeros((n_states, 0)), C, np.zeros((len(C), 0)), dt)


def phasor_signal(
    frequencies_hz: ArrayLike,
    phasors: ArrayLike,
    *,
    offset: ArrayLike | None = None,
    dt: float | None = None,
) -> tuple[StateSpace, Floats]:
    """Return the shared model of signals with known phasors, and its initial state.

    Parameters
    ----------
    frequencies_hz : array (n_frequencies,)
    phasors : complex array (n_signals, n_frequencies)
        Signal i is Σ_k Re(p_ik e^{jω_k t}).
    offset : array (n_signals,), optional
        Constant added to each signal.

    Returns
    -------
    model : StateSpace
        u = C_u x_u with a full C_u (n_signals, n_states).
    initial_state : array (n_states,)
        (1, 0) in every block.

    Examples
    --------
    >>> model, start = phasor_signal([0.25], [[-1j], [3.0]], dt=1.0)
    >>> model.simulate(initial_state=start, n_samples=3).round(12).tolist()
    [[0.0, 3.0], [1.0, 0.0], [0.0, -3.0]]
    """
    hertz = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
    p = np.asarray(phasors, dtype=np.complex128)
    if p.ndim != 2 or p.shape[1] != len(hertz):
        raise OptionError(
            f"phasors must have the shape (n_signals, {len(hertz)}), one column a frequency; got "
            f"{p.shape}."
        )
    blocks = np.stack([p.real, p.imag], axis=2).reshape(len(p), -1)
    start = np.tile([1.0, 0.0], len(hertz))
    if offset is not None:
        blocks = np.hstack([np.asarray(offset, dtype=np.float64).reshape(len(p), 1), blocks])
        start = np.append(1.0, start)
    return periodic_signal(hertz, offset=offset is not None, outputs=blocks, dt=dt), start


def finite_signal(
    n_samples: int,
    dt: float,
    highest_hz: float,
    *,
    lowest_hz: float = 0.0,
    period: float | None = None,
    n_signals: int = 1,
) -> StateSpace:
    """Return the discrete model of any band-limited signal of finite length.

    Parameters
    ----------
    n_samples : int
    dt : float
        [s]
    highest_hz, lowest_hz : float
        Band; a constant belongs to it where `lowest_hz` is 0.
    period : float, optional
        After which the model repeats itself [s], n_samples · dt by default. A signal that
        ends elsewhere than it began has a jump there, which leaks into the whole record
        (Gibbs); a longer period leaves room for the way back.
    n_signals : int
        Each has states of its own: their amplitudes are all unknown.

    Returns
    -------
    StateSpace
        Valid for n_samples samples; the order grows with length times bandwidth.

    Raises
    ------
    OptionError
        A band without a line, or up to Nyquist; a period shorter than the signal.

    Notes
    -----
    Han, Bohn & Bauer (2021), proposition 4.1, eq. (66), (67): harmonics of 1 / period below
    Nyquist, for the samples 0 … n_samples − 1.

    Examples
    --------
    >>> finite_signal(10000, 1e-4, 50.0).order
    101
    """
    check_whole("n_samples", n_samples, 2)
    check_positive("dt", dt, "s")
    check_whole("n_signals", n_signals, 1)
    length = n_samples * dt
    whole = length if period is None else period
    if whole < length * (1 - 1e-9):
        raise OptionError(
            f"period={whole:g} s is shorter than the signal's {length:g} s; give at least that."
        )
    hertz = harmonics(1 / whole, highest_hz, lowest_hz)
    one = periodic_signal(hertz, offset=lowest_hz == 0, dt=dt)
    if n_signals == 1:
        return one
    many = np.eye(n_signals)
    A, C = np.kron(many, one.A), np.kron(many, one.C)
    return StateSpace(A, np.zeros((len(A), 0)), C, np.zeros((n_signals, 0)), dt)


def signal_basis(frequencies_hz: ArrayLike, times: ArrayLike, *, offset: bool = False) -> Floats:
    """Return the columns [1] cos ω_1 t, sin ω_1 t, … (n_samples, n_states) at times [s].

    Their coefficients are the initial state of `periodic_signal`.
    """
    hertz = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
    t = np.asarray(times, dtype=np.float64)
    angles = 2 * np.pi * t[:, None] * hertz
    columns = np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(t), -1)
    return np.hstack([np.ones((len(t), 1)), columns]) if offset else columns


def _checked(frequencies_hz: ArrayLike | Sequence[float], dt: float | None) -> Floats:
    hertz = np.asarray(frequencies_hz, dtype=np.float64).ravel()
    if not np.isfinite(hertz).all() or (hertz <= 0).any():
        raise OptionError(f"frequencies_hz must be positive; got {hertz.tolist()}.")
    if len(np.unique(hertz)) < len(hertz):
        raise OptionError(
            "frequencies_hz must be different: one record excites two states of a frequency."
        )
    if dt is not None:
        check_positive("dt", dt, "s")
        if len(hertz) and hertz.max() * dt >= 0.5 * (1 - BELOW_NYQUIST):
            raise OptionError(
                f"{hertz.max():g} Hz is not below the Nyquist frequency {0.5 / dt:g} Hz."
            )
    return hertz


def _outputs(outputs: ArrayLike | None, n_states: int, at: np.ndarray, offset: bool) -> Floats:
    if outputs is None:
        C = np.zeros((1, n_states))
        C[0, at] = 1
        C[0, :offset] = 1
        return C
    C = np.asarray(outputs, dtype=np.float64)
    if C.ndim != 2 or C.shape[1] != n_states or not len(C):
        raise OptionError(
            f"outputs must have the shape (n_signals, {n_states}), one column a state; got "
            f"{C.shape}."
        )
    return C
