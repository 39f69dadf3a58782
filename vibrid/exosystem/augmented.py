"""A structure augmented with the model of its input, and whether outputs show all of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from ..errors import OptionError
from ..modes import Complexes
from ..record import Floats
from ..statespace import StateSpace

UNSEEN = 1e-9  # relative gain or singular value: less is rounding
TOGETHER = 1e-7  # relative distance of poles of the input that are one frequency


def augmented_model(system: StateSpace, signal: StateSpace) -> StateSpace:
    """Return the system whose input comes from a signal model, without inputs.

    A_a = [A  B C_u; 0  A_u], C_a = [C  D C_u], states [x; x_u] (Han, Bohn & Bauer 2021,
    eq. 17 continuous, 18 discrete). A discrete model of a continuous structure is exact for
    continuous sines when the continuous models are augmented first, and for held inputs when
    the discrete ones are.

    Raises
    ------
    OptionError
        Different time domains; a signal model with another number of outputs than the system
        has inputs, or with inputs.

    Examples
    --------
    >>> integrator = StateSpace([[1.0]], [[1.0]], [[1.0]], [[0.0]], 1.0)
    >>> constant = StateSpace([[1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)), 1.0)
    >>> augmented_model(integrator, constant).A
    array([[1., 1.],
           [0., 1.]])
    """
    _check_fit(system, signal)
    n, m = system.order, signal.order
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[:n, n:], A[n:, n:] = system.A, system.B @ signal.C, signal.A
    C = np.hstack([system.C, system.D @ signal.C])
    return StateSpace(A, np.zeros((n + m, 0)), C, np.zeros((len(C), 0)), system.dt)


@dataclass(frozen=True, eq=False)
class Observability:
    """Which parts of an augmented model the outputs show.

    Attributes
    ----------
    frequencies_hz : array (n_lines,)
        Different frequencies of the signal model, ascending; 0 for a constant.
    gains : array (n_lines,)
        Smallest amplification of the signal model's directions at each frequency by
        G C_u, relative to ‖C_u‖ (‖C‖ ‖(sI − A)⁻¹ B‖ + ‖D‖), states balanced; inf at a pole of
        the structure.
    structure : float
        Smallest singular value of [A − λI; C] over the structure's poles, balanced and
        relative: 0 where a mode is not seen.
    """

    frequencies_hz: Floats
    gains: Floats
    structure: float

    @property
    def unseen_hz(self) -> Floats:
        """Frequencies of the signal that do not reach the outputs [Hz]."""
        return self.frequencies_hz[self.gains <= UNSEEN]

    @property
    def observable(self) -> bool:
        """Whether outputs determine all states."""
        return self.structure > UNSEEN and not len(self.unseen_hz)


def augmented_observability(system: StateSpace, signal: StateSpace) -> Observability:
    """Test whether outputs show the structure and every part of its input.

    Besides the structure itself, the condition is that at every pole s = jω_k of the signal
    model no direction of its states is lost: G(jω_k) C_u v ≠ 0 for all v in the eigenspace.
    For accelerations and velocities G(0) = 0, so that a constant force is never seen; more
    inputs than outputs with states of their own never are either; a shared state may be seen
    with any number of inputs.

    Raises
    ------
    OptionError
        As of `augmented_model`.

    Notes
    -----
    Corrects Han, Bohn & Bauer (2021), proposition B.1: its rank of C_s B_s does not matter,
    its case (1) fails at s = 0 and its case (3) for shared states. Popov-Belevitch-Hautus.

    Examples
    --------
    >>> mass = StateSpace([[0, 1], [-4, -0.1]], [[0], [1]], [[-4, -0.1]], [[1]], None)
    >>> force = StateSpace([[0.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)), None)
    >>> augmented_observability(mass, force).unseen_hz
    array([0.])
    """
    _check_fit(system, signal)
    poles, spaces = _eigenspaces(signal)
    gains = [
        _gain(system, pole, signal.C @ space) for pole, space in zip(poles, spaces, strict=True)
    ]
    hertz = _turning(poles, signal.dt) / (2 * np.pi)
    return Observability(hertz, np.array(gains), _smallest_singular(system))


def _check_fit(system: StateSpace, signal: StateSpace) -> None:
    if system.dt != signal.dt:
        raise OptionError(
            f"The system has dt={system.dt} and the signal dt={signal.dt}; give both in one time "
            "domain, with to_discrete(dt)."
        )
    if signal.n_inputs or signal.n_outputs != system.n_inputs:
        raise OptionError(
            f"The signal model has {signal.n_outputs} outputs and {signal.n_inputs} inputs; it "
            f"needs {system.n_inputs} outputs, one an input of the system, and no inputs."
        )


def _turning(poles: Complexes, dt: float | None) -> Floats:
    """Return the angular frequencies of poles on the stability limit [rad/s]."""
    return poles.imag if dt is None else np.angle(poles) / dt


def _eigenspaces(signal: StateSpace) -> tuple[Complexes, list[Complexes]]:
    """Return one pole of each frequency, ascending, and an orthonormal basis of its vectors."""
    values, vectors = np.linalg.eig(signal.A.astype(complex))
    keep = np.flatnonzero(values.imag >= 0)
    keep = keep[np.argsort(_turning(values[keep], signal.dt), kind="stable")]
    scale = max(1.0, float(np.abs(values).max()))
    groups: list[list[int]] = []
    for k in keep:
        if groups and abs(values[k] - values[groups[-1][0]]) <= TOGETHER * scale:
            groups[-1].append(int(k))
        else:
            groups.append([int(k)])
    poles = np.array([values[group[0]] for group in groups], dtype=np.complex128)
    return poles, [np.linalg.qr(vectors[:, group])[0] for group in groups]


def _gain(system: StateSpace, point: complex, directions: Complexes) -> float:
    """Return the smallest amplification of C_u V by G, relative to G's own terms.

    Those of a balanced model: where G is zero, so is the sum of the terms, not their size.
    """
    if np.abs(system.poles - point).min() <= 1e-12 * max(1.0, abs(point)):
        return np.inf
    balanced, (scale, _) = scipy.linalg.matrix_balance(system.A, permute=False, separate=True)
    B, C = system.B / scale[:, None], system.C * scale
    states = np.linalg.solve(point * np.eye(system.order) - balanced, B.astype(complex))
    size = np.linalg.norm(C, 2) * np.linalg.norm(states, 2) + np.linalg.norm(system.D, 2)
    size *= np.linalg.norm(directions, 2)
    if size == 0 or directions.shape[1] > system.n_outputs:
        return 0.0
    moved = (C @ states + system.D) @ directions
    return float(np.linalg.svd(moved, compute_uv=False)[-1] / size)


def _smallest_singular(system: StateSpace) -> float:
    balanced, (scale, _) = scipy.linalg.matrix_balance(system.A, permute=False, separate=True)
    C = system.C * scale
    C = C * np.linalg.norm(balanced, 2) / np.linalg.norm(C, 2)
    stacked = [np.vstack([balanced - pole * np.eye(len(balanced)), C]) for pole in system.poles]
    smallest = min(np.linalg.svd(each, compute_uv=False)[-1] for each in stacked)
    return float(smallest / np.linalg.norm(balanced, 2))
