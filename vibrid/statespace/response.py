"""The exact sampled response of a continuous system, for every hold of the input."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import ArrayLike

from ..errors import DataError, OptionError, check_choice, check_positive
from ..record import Floats
from . import lifting
from .checks import as_inputs, as_state
from .frequency import Complexes
from .sampling import HOLDS, discretize, state_shift
from .state_space import StateSpace

SINGULAR = 1e13  # condition number of the balanced A from which A counts as singular
ON_A_LINE = 1e-9  # distance of a pole from a line, relative to the fastest pole
LINES = 2**13  # spectral lines at a time


def sampled_response(
    system: StateSpace,
    inputs: Any,
    dt: float,
    hold: str = "zoh",
    initial_state: ArrayLike | None = None,
    *,
    n_samples: int | None = None,
) -> Floats:
    """Return the outputs (n_samples, p) of a continuous system at the samples of its inputs.

    Parameters
    ----------
    system : StateSpace
        Continuous.
    inputs : array (n_samples, m) or None
        None is no input for `n_samples`.
    dt : float
        Sampling interval [s].
    hold : "zoh", "foh" or "band_limited"
        How the inputs move between samples. "band_limited" is the trigonometric polynomial
        through the samples, of period n_samples · dt, its Nyquist line a cosine.
    initial_state : array (n,), optional
        Continuous state at the first sample; zero by default.

    Raises
    ------
    OptionError
        The system is discrete; shapes that do not fit; an unknown hold.
    DataError
        Band-limited only: A is singular and an input's mean is not zero (no steady state),
        or a pole lies on a line of the spectrum.

    Notes
    -----
    The band-limited response is the steady state, by the FFT with G(jω), and the free
    response to what the initial state differs from it.
    """
    if system.dt is not None:
        raise OptionError("sampled_response needs a continuous system; call to_continuous().")
    check_positive("dt", dt, "s")
    check_choice("hold", hold, HOLDS)
    u = np.asarray(as_inputs(inputs, n_samples, system.n_inputs), dtype=np.float64)
    x = as_state(initial_state, system.order)
    A, B, C, D = system.A, system.B, system.C, system.D
    if hold != "band_limited":
        start = x - state_shift(A, B, dt, hold) @ u[0]
        return lifting.simulate(*discretize(A, B, C, D, dt, hold), u, start)[0]
    steady, steady_state = _steady_response(system, u, dt)
    power = np.asarray(scipy.linalg.expm(A * dt), dtype=np.float64)
    nothing = np.zeros((len(u), 0))
    free, _ = lifting.simulate(power, B[:, :0], C, D[:, :0], nothing, x - steady_state)
    return steady + free


def _steady_response(system: StateSpace, inputs: Floats, dt: float) -> tuple[Floats, Floats]:
    """Return the periodic outputs (n_samples, p), and the periodic state at the first sample."""
    N = len(inputs)
    if not inputs.any():
        return np.zeros((N, system.n_outputs)), np.zeros(system.order)
    lines_hz = np.arange(N // 2 + 1) / (N * dt)
    spectrum: Complexes = np.fft.rfft(inputs, axis=0)
    first = _first_line(system.A, spectrum, N)
    _check_no_resonance(system.poles, lines_hz[first:])
    weights = np.full(len(lines_hz), 2.0)  # a line and its mirror image
    weights[0] = 1
    if N % 2 == 0:
        weights[-1] = 1
    with_states = StateSpace(
        system.A,
        system.B,
        np.vstack([system.C, np.eye(system.order)]),
        np.vstack([system.D, np.zeros((system.order, system.n_inputs))]),
        None,
    )
    outputs = np.zeros((len(lines_hz), system.n_outputs), dtype=np.complex128)
    state = np.zeros(system.order)
    for start in range(first, len(lines_hz), LINES):
        part = slice(start, start + LINES)
        moved = with_states.frequency_response(lines_hz[part]) @ spectrum[part, :, None]
        outputs[part] = moved[:, : system.n_outputs, 0]
        state += weights[part] @ moved[:, system.n_outputs :, 0].real / N
    return np.fft.irfft(outputs, N, axis=0), state


def _first_line(A: Floats, spectrum: Complexes, N: int) -> int:
    """Return 0, or 1 when A is singular and the inputs have no mean to respond to."""
    balanced = scipy.linalg.matrix_balance(A)[0]
    if np.linalg.cond(balanced) < SINGULAR:
        return 0
    means = np.abs(spectrum[0]) / N
    if (means > 1e-12 * np.abs(spectrum).max() / N).any():
        raise DataError(
            f"An input has the mean {means.max():.3g} and the system a pole at zero (a rigid-body "
            "mode): a periodic input has no steady response. Remove the mean, or use hold='zoh' "
            "or 'foh'."
        )
    return 1


def _check_no_resonance(poles: Complexes, lines_hz: Floats) -> None:
    if not lines_hz.size:
        return
    nearest = np.abs(poles.imag) / (2 * np.pi)
    after = np.clip(np.searchsorted(lines_hz, nearest), 0, len(lines_hz) - 1)
    for index in (after, np.maximum(after - 1, 0)):
        gap = np.abs(1j * np.abs(poles.imag) + poles.real - 2j * np.pi * lines_hz[index])
        if (gap < ON_A_LINE * np.abs(poles).max()).any():
            hertz = lines_hz[index][int(np.argmin(gap))]
            raise DataError(
                f"An undamped pole lies on the spectral line {hertz:.6g} Hz of the band-limited "
                "input: the steady response is infinite. Add damping, or change n_samples or dt."
            )
