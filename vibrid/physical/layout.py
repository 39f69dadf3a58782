"""Layout: which channel stands at which degree of freedom."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import OptionError, check_names
from ..fit import Fit
from ..mechanics import MOTIONS
from ..record import Channel, Floats
from ..statespace import StateSpace
from .units import si_factors

POWERS = {quantity: power for power, quantity in enumerate(MOTIONS)}  # of λ, by sensor
SHOWN = 3  # sentences on channels in a message
Labels = Sequence[Channel | str] | None


@dataclass(frozen=True, eq=False)
class Layout:
    """Sensors and actuators by degree of freedom.

    Attributes
    ----------
    dofs : tuple of str
        In order of appearance: sensors first, then actuators.
    outputs, forces, bases : int arrays
        Columns of the model that are used.
    sensor_dofs, force_dofs : int arrays
        The DOF of each used output and force, as an index into `dofs`.
    powers : int array
        0, 1, 2 for displacement, velocity, acceleration, one a used output.
    output_factors, force_factors, base_factors : arrays
        Sign times the factor into SI.
    units : "SI" or "consistent units"
    output_channels : tuple of Channel
        The used ones.
    ignored : tuple of str
        A sentence for each channel that says nothing here.
    """

    dofs: tuple[str, ...]
    outputs: NDArray[np.int64]
    forces: NDArray[np.int64]
    bases: NDArray[np.int64]
    sensor_dofs: NDArray[np.int64]
    force_dofs: NDArray[np.int64]
    powers: NDArray[np.int64]
    output_factors: Floats
    force_factors: Floats
    base_factors: Floats
    units: str
    output_channels: tuple[Channel, ...]
    ignored: tuple[str, ...]

    @property
    def n_dof(self) -> int:
        return len(self.dofs)

    @property
    def pairs(self) -> NDArray[np.int64]:
        """DOFs with both a sensor and a force."""
        return np.intersect1d(self.sensor_dofs, self.force_dofs)

    @property
    def unseen(self) -> NDArray[np.int64]:
        """DOFs without a sensor."""
        return np.setdiff1d(np.arange(self.n_dof), self.sensor_dofs)

    def missing_pair(self) -> str:
        """Return what a co-located pair would take."""
        advice = []
        if self.sensor_dofs.size:
            advice.append(f"a force at {self.dofs[self.sensor_dofs[0]]}")
        if self.force_dofs.size:
            advice.append(f"an accelerometer at {self.dofs[self.force_dofs[0]]}")
        return f"no co-located pair: add {' or '.join(advice)}"


def layout_of(outputs: Sequence[Channel], inputs: Sequence[Channel]) -> Layout:
    """Return the layout that the channels describe.

    Raises
    ------
    OptionError
        No output is a displacement, velocity or acceleration with a DOF; units that do not
        go together.
    """
    ignored = [_useless(c, "output", MOTIONS) for c in outputs]
    ignored += [_useless(c, "input", ("force", "base_acceleration")) for c in inputs]
    seen = [k for k, c in enumerate(outputs) if not ignored[k]]
    driven = [k for k in range(len(inputs)) if not ignored[len(outputs) + k]]
    reasons = tuple(sentence for sentence in ignored if sentence)
    if not seen:
        raise OptionError(
            f"Physical coordinates need sensors with a quantity and a DOF; {_some(reasons)}. "
            "Give outputs=[Channel(name, 'acceleration', dof='f1'), …]."
        )
    forces = [k for k in driven if inputs[k].quantity == "force"]
    bases = [k for k in driven if inputs[k].quantity == "base_acceleration"]
    used = [outputs[k] for k in seen] + [inputs[k] for k in forces + bases]
    factors, units = si_factors(used)
    factors = factors * [channel.sign for channel in used]
    labels = [str(channel.dof) for channel in used[: len(seen) + len(forces)]]
    dofs = tuple(dict.fromkeys(labels))
    places = np.array([dofs.index(label) for label in labels], dtype=np.int64)
    p, f = len(seen), len(seen) + len(forces)
    return Layout(
        dofs,
        np.array(seen, dtype=np.int64),
        np.array(forces, dtype=np.int64),
        np.array(bases, dtype=np.int64),
        places[:p],
        places[p:],
        np.array([POWERS[outputs[k].quantity] for k in seen], dtype=np.int64),
        factors[:p],
        factors[p:f],
        factors[f:],
        units,
        tuple(used[:p]),
        reasons,
    )


def labelled(
    model: Fit | StateSpace, outputs: Labels, inputs: Labels
) -> tuple[StateSpace, tuple[Channel, ...], tuple[Channel, ...]]:
    """Return the model with the channels that are meant: relabelled, or some by name.

    Raises
    ------
    OptionError
        A StateSpace without channels; names that are not there; the wrong number of Channels.
    """
    if isinstance(model, Fit):
        system = model.model
        own_outputs, own_inputs = model.output_channels, model.input_channels
    else:
        system = model
        _need_channels(outputs, "outputs")
        own_outputs = ()
        own_inputs = ()
        if system.n_inputs and inputs is None:
            inputs = [Channel(f"u{k + 1}") for k in range(system.n_inputs)]
    rows, out_channels = _chosen("outputs", outputs, own_outputs, system.n_outputs)
    columns, in_channels = _chosen("inputs", inputs, own_inputs, system.n_inputs)
    chosen = StateSpace(
        system.A,
        system.B[:, columns],
        system.C[rows],
        system.D[np.ix_(rows, columns)],
        system.dt,
    )
    return chosen, out_channels, in_channels


def _need_channels(labels: Labels, what: str) -> None:
    if labels is None or any(isinstance(each, str) for each in labels):
        raise OptionError(
            f"A StateSpace says nothing of its channels; give {what}=[Channel(name, quantity, "
            "dof=…), …], one for each, and the same for its inputs."
        )


def _chosen(
    what: str, labels: Labels, own: tuple[Channel, ...], count: int
) -> tuple[list[int], tuple[Channel, ...]]:
    if labels is None:
        return list(range(count)), own
    labels = [labels] if isinstance(labels, str) else labels
    if not len(labels):
        return [], ()
    if all(isinstance(each, Channel) for each in labels):
        channels = tuple(each for each in labels if isinstance(each, Channel))
        if len(channels) != count:
            raise OptionError(
                f"{what} must be {count} channels, one for each of the model's, or names of "
                f"some; got {len(channels)}."
            )
        return list(range(count)), channels
    names = [each if isinstance(each, str) else each.name for each in labels]
    known = [channel.name for channel in own]
    check_names("channel", names, known)
    twice = [name for name in dict.fromkeys(names) if names.count(name) > 1]
    if twice:
        raise OptionError(f"{what} names {twice[0]!r} twice; name each channel once.")
    rows = [known.index(name) for name in names]
    given = {each.name: each for each in labels if isinstance(each, Channel)}
    return rows, tuple(given.get(name, own[row]) for name, row in zip(names, rows, strict=True))


def _some(sentences: Sequence[str]) -> str:
    more = f"; and {len(sentences) - SHOWN} more" if len(sentences) > SHOWN else ""
    return "; ".join(sentences[:SHOWN]) + more


def _useless(channel: Channel, side: str, quantities: Sequence[str]) -> str:
    """Return why a channel cannot be used, or nothing."""
    if channel.quantity not in quantities:
        return (
            f"{side} {channel.name!r} has the quantity {channel.quantity!r}, not "
            f"{' or '.join(quantities)}"
        )
    if channel.dof is None and channel.quantity != "base_acceleration":
        return f"{side} {channel.name!r} ({channel.quantity}) has no dof"
    return ""
