"""Delays of sensors, from the phase of the shapes over frequency."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import OptionError, check_names
from ..modes import Complexes, mpc
from ..record import Channel, Floats


@dataclass(frozen=True, eq=False)
class Delays:
    """How far sensors lag, as the shapes tell it.

    Attributes
    ----------
    names : tuple of str
        Of the outputs.
    seconds : array (n_outputs,)
        Lag behind the first output, whose own is zero; negative where it leads.
    phase_collinearity, corrected_collinearity : arrays (n_modes,)
        MPC of the shapes as they are and with the delays set right.
    common : float
        Lag of all sensors behind the forces, or the base acceleration [s]; NaN without
        inputs. It changes neither poles nor shapes, but the scale that forces give.
    imaginary, corrected_imaginary : float
        Imaginary share of the response to the inputs in all modes, before and after the
        common lag is set right; NaN without inputs.
    """

    names: tuple[str, ...]
    seconds: Floats
    phase_collinearity: Floats
    corrected_collinearity: Floats
    common: float = float("nan")
    imaginary: float = float("nan")
    corrected_imaginary: float = float("nan")


def sensor_delays(
    shapes: Complexes,
    poles: Complexes,
    channels: Sequence[Channel],
    drives: Complexes | None = None,
) -> Delays:
    """Estimate the delays that make all shapes as real as they can be.

    A sensor that lags by τ sees each mode times e^{−λτ}: a phase proportional to frequency.
    What else makes shapes complex (damping that is not proportional, noise) is not, but is
    counted as delay where it looks alike; with few modes the two cannot be told apart.

    Parameters
    ----------
    shapes : complex array (n_outputs, n_modes)
        Displacement shapes, one of each pair.
    poles : complex array (n_modes,)
    channels : sequence of Channel
    drives : complex array (n_modes, n_inputs), optional
        Participations of forces or of a base acceleration.

    Notes
    -----
    Minimizes Σ_k ‖Im(e^{−iφ_k} c_k ∘ e^{λ_k τ})‖² / ‖c_k‖² with
    φ_k = ½ arg Σ (c_k ∘ e^{λ_k τ})².
    """
    names = tuple(channel.name for channel in channels)
    seconds = _estimate(shapes, poles)
    right = _moved(shapes, poles, seconds)
    common = imaginary = after = float("nan")
    if drives is not None and drives.size:
        common, imaginary, after = _common_delay(right, poles, drives)
    return Delays(names, seconds, mpc(shapes), mpc(right), common, imaginary, after)


def given_delays(values: Mapping[str, float], channels: Sequence[Channel]) -> Floats:
    """Return delays [s] given by channel name as an array, zero where not named."""
    names = [channel.name for channel in channels]
    check_names("output", values, names)
    seconds = np.array([float(values.get(name, 0.0)) for name in names])
    if not np.isfinite(seconds).all():
        raise OptionError("delays must be finite, in seconds.")
    return seconds


def _moved(shapes: Complexes, poles: Complexes, seconds: Floats) -> Complexes:
    return np.asarray(shapes * np.exp(seconds[:, None] * poles))


def _estimate(shapes: Complexes, poles: Complexes) -> Floats:
    from scipy.optimize import least_squares  # slow to import, and used only here

    n = len(shapes)
    if n < 2 or len(poles) < 2:
        return np.zeros(n)
    unit = 1 / np.abs(poles).max()
    sized = shapes / np.linalg.norm(shapes, axis=0)

    def misfit(x: Floats) -> Floats:
        right = _moved(sized, poles, unit * np.append(0.0, x))
        phase = 0.5 * np.angle(np.sum(right**2, axis=0))
        return np.asarray((right * np.exp(-1j * phase)).imag.ravel())

    found = least_squares(misfit, np.zeros(n - 1), xtol=1e-12, ftol=1e-12, gtol=1e-14)
    return np.append(0.0, unit * found.x)


def _common_delay(
    shapes: Complexes, poles: Complexes, drives: Complexes
) -> tuple[float, float, float]:
    """Return the lag behind the inputs and the imaginary shares before and after."""
    from scipy.optimize import least_squares

    responses = shapes[:, :, None] * (drives * 2j * poles.imag[:, None])
    total = np.linalg.norm(responses)
    unit = 1 / np.abs(poles).max()

    def misfit(x: Floats) -> Floats:
        right = responses * np.exp(unit * x[0] * poles)[:, None]
        return np.asarray(right.imag.ravel() / total)

    found = least_squares(misfit, np.zeros(1), xtol=1e-12, ftol=1e-12, gtol=1e-14)
    before, after = np.linalg.norm(misfit(np.zeros(1))), np.linalg.norm(found.fun)
    return float(unit * found.x[0]), float(before), float(after)
