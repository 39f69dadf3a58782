"""Structure: M, R, K with exact modes and exact simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, check_choice, check_names, check_positive
from ..mechanics import MOTIONS, check_matrices, mechanical_state_space
from ..record import Channel, Floats, Quantity, Record
from ..statespace import StateSpace, as_inputs, sampled_response

Sensors = str | Sequence[Channel | tuple[str, str]]
UNITS = {"displacement": "m", "velocity": "m/s", "acceleration": "m/s2"}
SYMMETRY = 1e-9  # relative to the largest entry


@dataclass(frozen=True, eq=False, init=False)
class Structure:
    """Hold a linear structure M q̈ + R q̇ + K q = f.

    Parameters
    ----------
    mass, damping, stiffness : arrays (n_dof, n_dof)
        M [kg], R [N s/m], K [N/m]; M and K symmetric.
    dofs : tuple of str
        Labels of the degrees of freedom; f1, f2, … by default.

    Raises
    ------
    OptionError
        Matrices that do not fit or are not symmetric; labels that do not fit.

    Examples
    --------
    >>> mass_on_spring = Structure([[1.0]], [[0.1]], [[1.0]])
    >>> mass_on_spring.damping_ratios
    array([0.05])
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    dofs: tuple[str, ...] = ()

    def __init__(
        self,
        mass: ArrayLike,
        damping: ArrayLike,
        stiffness: ArrayLike,
        dofs: Sequence[str] = (),
    ) -> None:
        M, R, K = check_matrices(mass, damping, stiffness)
        for name, matrix in (("mass", M), ("stiffness", K)):
            skew = np.abs(matrix - matrix.T).max()
            if skew > SYMMETRY * np.abs(matrix).max():
                raise OptionError(f"The {name} matrix must be symmetric; it is off by {skew:.3g}.")
        labels = tuple(dofs) or tuple(f"f{k + 1}" for k in range(len(M)))
        if len(labels) != len(M) or len(set(labels)) != len(labels):
            raise OptionError(
                f"dofs must be {len(M)} different labels; got {', '.join(map(str, labels))}."
            )
        for field, value in zip(
            ("mass", "damping", "stiffness", "dofs"), (M, R, K, labels), strict=True
        ):
            object.__setattr__(self, field, value)

    # -- exact answers

    @property
    def n_dof(self) -> int:
        return len(self.mass)

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Continuous poles [rad/s], one of each complex pair, by |λ|.

        Real poles (overdamped or rigid-body motion) do not oscillate and are left out.
        """
        return self._modes()[0]

    @property
    def frequencies_hz(self) -> Floats:
        """Natural frequencies |λ| / 2π, ascending [Hz]."""
        return np.abs(self.poles) / (2 * np.pi)

    @property
    def damping_ratios(self) -> Floats:
        """Damping ratios −Re λ / |λ|, in the order of `frequencies_hz`."""
        poles = self.poles
        return np.asarray(-poles.real / np.abs(poles))

    @property
    def shapes(self) -> NDArray[np.complex128]:
        """Displacement shapes (n_dof, n_modes), the largest component of each 1."""
        return self._modes()[1]

    def _modes(self) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        values, vectors = np.linalg.eig(self.state_space("displacement").A)
        # A double pole at zero (rigid body) splits by √eps: that is not an oscillation.
        found = np.flatnonzero(values.imag > 1e-7 * np.abs(values).max())
        found = found[np.argsort(np.abs(values[found]), kind="stable")]
        shapes = vectors[: self.n_dof, found]
        largest = np.abs(shapes).argmax(axis=0)
        shapes = shapes / shapes[largest, np.arange(len(found))]
        return values[found].astype(np.complex128), shapes.astype(np.complex128)

    # -- models and records

    def state_space(
        self,
        sensors: Sensors = "acceleration",
        forces: Sequence[str] = (),
        base: ArrayLike | bool = False,
        absolute: bool = True,
    ) -> StateSpace:
        """Return the continuous model, states [q; q̇].

        Parameters
        ----------
        sensors : str, or sequence of Channel or (quantity, dof label)
            A quantity (displacement, velocity, acceleration) means a sensor at every DOF.
        forces : sequence of str
            Labels of the DOFs with a force input.
        base : bool or array (n_dof,)
            Whether a base acceleration is the last input; an array is its influence vector.
        absolute : bool
            Whether acceleration sensors include the base's.
        """
        rows = [
            (channel.quantity, self.dofs.index(cast(str, channel.dof)), channel.sign)
            for channel in self._channels(sensors)
        ]
        return mechanical_state_space(
            self.mass,
            self.damping,
            self.stiffness,
            sensors=rows,
            forces=self._numbers(forces),
            base=base,
            absolute=absolute,
        )

    def simulate(
        self,
        inputs: ArrayLike | None,
        dt: float,
        *,
        sensors: Sensors = "acceleration",
        forces: Sequence[str] = (),
        base: ArrayLike | bool = False,
        absolute: bool = True,
        hold: str = "zoh",
        initial_state: ArrayLike | None = None,
        noise: float = 0.0,
        rng: np.random.Generator | None = None,
        n_samples: int | None = None,
        name: str = "",
    ) -> Record:
        """Return the exact record of the structure under inputs that move as `hold` says.

        Parameters
        ----------
        inputs : array (n_samples, n_inputs) or (n_samples,), or None
            One column a force, in the order of `forces`, then the base acceleration. None is a
            free decay of `n_samples`.
        dt : float
            Sampling interval [s].
        sensors, forces, base, absolute
            As in `state_space`.
        hold : "zoh", "foh" or "band_limited"
            How the inputs move between samples; see `statespace.sampled_response`.
        initial_state : array (2 n_dof,), optional
            [q; q̇] at the first sample; at rest by default.
        noise : float
            Standard deviation of white noise on each output, relative to the output's own.
        rng : numpy Generator
            Needed for noise.

        Returns
        -------
        Record
            Channels carry quantity, unit (SI) and DOF.

        Raises
        ------
        OptionError
            Inputs that do not fit the forces, noise without rng, unknown labels.
        DataError
            No steady response to a band-limited input; inputs that are not finite.
        """
        model = self.state_space(sensors, forces, base, absolute)
        if inputs is not None and not model.n_inputs:
            raise OptionError("inputs act nowhere: name DOFs in forces=[…], or set base=True.")
        u = as_inputs(inputs, n_samples, model.n_inputs)
        y = sampled_response(model, u, dt, hold, initial_state)
        return Record(
            _with_noise(y, noise, rng),
            u,
            dt=dt,
            output_channels=self._channels(sensors),
            input_channels=self._input_channels(forces, base),
            name=name,
        )

    # -- labels

    def _channels(self, sensors: Sensors) -> list[Channel]:
        if isinstance(sensors, str):
            sensors = [(sensors, dof) for dof in self.dofs]
        channels = [each if isinstance(each, Channel) else _channel(*each) for each in sensors]
        for channel in channels:
            check_choice(f"quantity of sensor {channel.name!r}", channel.quantity, MOTIONS)
            if channel.dof is None or channel.delay:
                raise OptionError(
                    f"Sensor {channel.name!r} needs a dof and no delay to be simulated; got "
                    f"dof={channel.dof!r}, delay={channel.delay!r}."
                )
            check_names("DOF", [channel.dof], self.dofs)
        return channels

    def _input_channels(self, forces: Sequence[str], base: ArrayLike | bool) -> list[Channel]:
        channels = [Channel(f"force_{dof}", "force", "N", dof) for dof in forces]
        if base is not False:
            channels.append(Channel("base_acceleration", "base_acceleration", "m/s2"))
        return channels

    def _numbers(self, forces: Sequence[str]) -> list[int]:
        if isinstance(forces, str):
            raise OptionError(f"forces must be a list of DOF labels; write [{forces!r}].")
        check_names("DOF", forces, self.dofs)
        return [self.dofs.index(dof) for dof in forces]


def _channel(quantity: str, dof: str) -> Channel:
    check_choice("the quantity of a sensor", quantity, MOTIONS)
    return Channel(f"{quantity}_{dof}", cast(Quantity, quantity), UNITS[quantity], dof)


def _with_noise(y: Floats, noise: float, rng: np.random.Generator | None) -> Floats:
    if noise == 0:
        return y
    check_positive("noise", noise)
    if rng is None:
        raise OptionError("Noise needs rng, a numpy Generator: rng=np.random.default_rng(1).")
    return np.asarray(y + noise * y.std(axis=0) * rng.standard_normal(y.shape))
