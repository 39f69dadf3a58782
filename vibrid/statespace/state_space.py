"""StateSpace: x(k+1) = A x + B u, y = C x + D u, or dx/dt in continuous time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, UnstableModelError, check_positive, check_whole
from ..record import Floats, ImpulseResponses
from . import exchange, gramians, lifting, sampling
from .checks import as_inputs, as_state
from .frequency import frequency_response

Complexes = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, init=False)
class StateSpace:
    """Hold a linear time-invariant system.

    Parameters
    ----------
    A : array (n, n)
    B : array (n, n_inputs)
        n_inputs may be 0.
    C : array (n_outputs, n)
    D : array (n_outputs, n_inputs)
    dt : float or None
        Sampling interval [s]; None is continuous time.

    Raises
    ------
    OptionError
        Shapes that do not fit, values that are not finite real numbers, dt not positive.

    Examples
    --------
    >>> model = StateSpace([[0.5]], [[1.0]], [[2.0]], [[0.0]], 0.1)
    >>> model.order, model.n_inputs, model.n_outputs, model.is_stable
    (1, 1, 1, True)
    >>> model.markov_parameters(4)[:, 0, 0]
    array([0. , 2. , 1. , 0.5])
    """

    A: Floats
    B: Floats
    C: Floats
    D: Floats
    dt: float | None

    def __init__(
        self, A: ArrayLike, B: ArrayLike, C: ArrayLike, D: ArrayLike, dt: float | None
    ) -> None:
        a, b, c, d = (_matrix(x, name) for x, name in ((A, "A"), (B, "B"), (C, "C"), (D, "D")))
        n, m, p = a.shape[0], b.shape[1], c.shape[0]
        _check_shape("A", a, (n, n))
        _check_shape("B", b, (n, m))
        _check_shape("C", c, (p, n))
        _check_shape("D", d, (p, m))
        if n == 0 or p == 0:
            raise OptionError(f"A StateSpace needs a state and an output; got {n} and {p}.")
        if dt is not None:
            check_positive("dt", dt, "s")
            dt = float(dt)
        for field, value in zip("ABCD", (a, b, c, d), strict=True):
            object.__setattr__(self, field, value)
        object.__setattr__(self, "dt", dt)

    # -- what it is

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def n_inputs(self) -> int:
        return int(self.B.shape[1])

    @property
    def n_outputs(self) -> int:
        return int(self.C.shape[0])

    @property
    def poles(self) -> Complexes:
        """Eigenvalues of A (n,)."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    @property
    def continuous_poles(self) -> Complexes:
        """Poles in continuous time (n,) [rad/s]: ln μ / dt of the discrete ones."""
        if self.dt is None:
            return self.poles
        with np.errstate(divide="ignore"):  # a pole at zero is infinitely fast: −inf
            return np.asarray(np.log(self.poles) / self.dt, dtype=np.complex128)

    @property
    def frequencies_hz(self) -> Floats:
        """Natural frequencies |λ| / 2π of the complex pairs, ascending [Hz]."""
        return np.abs(self._pairs()) / (2 * np.pi)

    @property
    def damping_ratios(self) -> Floats:
        """Damping ratios −Re λ / |λ|, in the order of `frequencies_hz`."""
        pairs = self._pairs()
        return np.asarray(-pairs.real / np.abs(pairs))

    @property
    def spectral_radius(self) -> float:
        """Largest |eigenvalue| of A."""
        return float(np.abs(self.poles).max())

    @property
    def is_stable(self) -> bool:
        """Whether every pole is strictly inside the stability limit."""
        return bool(self._margins(self.poles).max() < 0)

    def _pairs(self) -> Complexes:
        """One continuous pole of each complex pair, by |λ|; real ones do not oscillate."""
        pairs = self.continuous_poles[self.poles.imag > 0]
        return pairs[np.argsort(np.abs(pairs), kind="stable")]

    def _margins(self, poles: Complexes) -> Floats:
        return poles.real if self.dt is None else np.abs(poles) - 1

    # -- responses

    def simulate(
        self,
        inputs: Any = None,
        initial_state: ArrayLike | None = None,
        *,
        n_samples: int | None = None,
    ) -> Floats:
        """Return the outputs (n_samples, n_outputs) to the inputs; discrete systems only.

        Parameters
        ----------
        inputs : array (n_samples, n_inputs) or (n_samples,), optional
            In memory or on disk. Without inputs they are zero and `n_samples` is needed.
        initial_state : array (n,), optional
            State at the first sample; zero by default.
        n_samples : int, optional
            Number of samples, when there are no inputs.

        Raises
        ------
        OptionError
            A continuous system, shapes that do not fit.
        DataError
            An input is NaN or infinite.

        Notes
        -----
        By lifting (see `statespace.lifting`), as exact as the plain loop and some hundred
        times faster.
        """
        self._need_dt("simulate")
        u, start = as_inputs(inputs, n_samples, self.n_inputs), as_state(initial_state, self.order)
        return lifting.simulate(self.A, self.B, self.C, self.D, u, start)[0]

    def simulate_states(
        self,
        inputs: Any = None,
        initial_state: ArrayLike | None = None,
        *,
        n_samples: int | None = None,
    ) -> Floats:
        """Return the states (n_samples, n); arguments as in `simulate`."""
        self._need_dt("simulate_states")
        u, start = as_inputs(inputs, n_samples, self.n_inputs), as_state(initial_state, self.order)
        return lifting.simulate_states(self.A, self.B, u, start)[0]

    def markov_parameters(self, n_lags: int) -> Floats:
        """Return D, CB, CAB, … (n_lags, n_outputs, n_inputs)."""
        check_whole("n_lags", n_lags, 1)
        values = np.empty((n_lags, self.n_outputs, self.n_inputs))
        values[0], reach = self.D, self.B
        for k in range(1, n_lags):
            values[k] = self.C @ reach
            reach = self.A @ reach
        return values

    def impulse_responses(self, n_lags: int) -> ImpulseResponses:
        """Return the Markov parameters of a discrete system, labelled."""
        return ImpulseResponses(self.markov_parameters(n_lags), dt=self._need_dt("pulse responses"))

    def frequency_response(self, frequencies_hz: ArrayLike) -> Complexes:
        """Return C (zI − A)⁻¹ B + D (n_lines, n_outputs, n_inputs), in either time domain.

        z is e^{jω dt}, or jω in continuous time.
        """
        hertz = np.atleast_1d(np.asarray(frequencies_hz, dtype=np.float64))
        lines = (2j * np.pi * hertz).astype(np.complex128)
        points = lines if self.dt is None else np.exp(lines * self.dt)
        return frequency_response(self.A, self.B, self.C, self.D, points)

    # -- between the time domains

    def to_discrete(self, dt: float, hold: str = "zoh") -> StateSpace:
        """Return the discrete system, exact for inputs that move as `hold` says.

        Parameters
        ----------
        dt : float
            Sampling interval [s].
        hold : "zoh", "foh" or "band_limited"
            How the input moves between samples. For "foh" and "band_limited" the states are
            shifted by a multiple of the input; see `statespace.sampling`.
        """
        if self.dt is not None:
            raise OptionError(f"The system is discrete already, dt={self.dt:g} s.")
        check_positive("dt", dt, "s")
        return StateSpace(*sampling.discretize(self.A, self.B, self.C, self.D, dt, hold), dt)

    def to_continuous(self, hold: str = "zoh") -> StateSpace:
        """Return the continuous system of which this is the discretization under `hold`.

        Raises
        ------
        DataError
            A pole at zero or on the negative real axis: there is no principal logarithm.
        """
        dt = self._need_dt("to_continuous")
        return StateSpace(*sampling.undiscretize(self.A, self.B, self.C, self.D, dt, hold), None)

    # -- bases

    def transform(self, T: ArrayLike) -> StateSpace:
        """Return the system in the states x_new of x = T x_new: A_new = T⁻¹ A T."""
        basis = _matrix(T, "T")
        _check_shape("T", basis, self.A.shape)
        return StateSpace(
            np.linalg.solve(basis, self.A @ basis),
            np.linalg.solve(basis, self.B),
            self.C @ basis,
            self.D,
            self.dt,
        )

    def controllability_matrix(self, k: int | None = None) -> Floats:
        """Return [B AB … A^(k−1) B] (n, k n_inputs); k is the order by default."""
        k = self.order if k is None else k
        check_whole("k", k, 1)
        blocks = [self.B]
        for _ in range(k - 1):
            blocks.append(self.A @ blocks[-1])
        return np.hstack(blocks)

    def observability_matrix(self, k: int | None = None) -> Floats:
        """Return [C; CA; …; CA^(k−1)] (k n_outputs, n); k is the order by default."""
        k = self.order if k is None else k
        check_whole("k", k, 1)
        return lifting.free_responses(self.A, self.C, k).reshape(-1, self.order)

    def controllability_gramian(self) -> Floats:
        """Return P (n, n): A P Aᵀ − P + B Bᵀ = 0, or A P + P Aᵀ + B Bᵀ = 0 in continuous time.

        Raises
        ------
        UnstableModelError
            A pole is on or outside the stability limit.
        """
        self._need_stable("A Gramian")
        return gramians.gramian(self.A, self.B, self.dt is not None)

    def observability_gramian(self) -> Floats:
        """Return Q (n, n): Aᵀ Q A − Q + Cᵀ C = 0, or Aᵀ Q + Q A + Cᵀ C = 0; see above."""
        self._need_stable("A Gramian")
        return gramians.gramian(self.A.T, self.C.T, self.dt is not None)

    def balanced(self) -> tuple[StateSpace, Floats]:
        """Return the system with both Gramians diagonal and equal, and the diagonal.

        Returns
        -------
        model : StateSpace
        hankel_singular_values : array (n,), descending

        Raises
        ------
        UnstableModelError
            A pole is on or outside the stability limit.
        DataError
            A state is unreachable or unobservable.
        """
        T, T_inverse, values = gramians.balancing(
            self.controllability_gramian(), self.observability_gramian()
        )
        model = StateSpace(T_inverse @ self.A @ T, T_inverse @ self.B, self.C @ T, self.D, self.dt)
        return model, values

    # -- other packages

    def to_scipy(self) -> Any:
        """Return a `scipy.signal.StateSpace`."""
        from scipy.signal import StateSpace as SciPyStateSpace

        time = {} if self.dt is None else {"dt": self.dt}
        return SciPyStateSpace(self.A, self.B, self.C, self.D, **time)

    @classmethod
    def from_scipy(cls, system: Any) -> StateSpace:
        """Return a `scipy.signal` system (lti or dlti) as a StateSpace."""
        system = system.to_ss()
        dt = exchange.known_dt(system.dt, "scipy.signal")
        return cls(system.A, system.B, system.C, system.D, dt)

    def to_control(self) -> Any:
        """Return a python-control `StateSpace`; needs the extra `control`."""
        control = exchange.control_module()
        time = 0 if self.dt is None else self.dt
        return control.StateSpace(self.A, self.B, self.C, self.D, time, remove_useless_states=False)

    @classmethod
    def from_control(cls, system: Any) -> StateSpace:
        """Return a python-control system (state space or transfer function) as a StateSpace."""
        system = exchange.control_module().ss(system)
        dt = exchange.known_dt("unspecified" if system.dt is None else system.dt, "python-control")
        return cls(system.A, system.B, system.C, system.D, dt)

    # -- checks

    def _need_dt(self, what: str) -> float:
        if self.dt is None:
            raise OptionError(
                f"{what} needs a discrete system; this one is continuous. Call to_discrete(dt)."
            )
        return self.dt

    def _need_stable(self, what: str) -> None:
        poles = self.poles
        worst = int(np.argmax(self._margins(poles)))
        if self._margins(poles)[worst] >= 0:
            hertz = abs(self.continuous_poles[worst]) / (2 * np.pi)
            limit = "real part < 0" if self.dt is None else "magnitude < 1"
            raise UnstableModelError(
                f"{what} needs a stable system ({limit}); the pole {complex(poles[worst]):.6g} "
                f"({hertz:.4g} Hz) is not. Remove it, or identify with stability='project'."
            )


def _matrix(values: ArrayLike, name: str) -> Floats:
    array = np.asarray(values)
    if array.ndim != 2:
        raise OptionError(f"{name} must be a matrix (2 axes); got shape {array.shape}.")
    if array.dtype.kind not in "iuf":
        raise OptionError(f"{name} must be real numbers; got dtype {array.dtype}.")
    if not np.isfinite(array).all():
        raise OptionError(f"{name} holds NaN or infinite values; it must be finite.")
    return array.astype(np.float64)


def _check_shape(name: str, array: Floats, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise OptionError(
            f"{name} must be {shape[0]} × {shape[1]} to fit the other matrices; it is "
            f"{array.shape[0]} × {array.shape[1]}."
        )
