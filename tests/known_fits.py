"""Known structures, fits made of them without identification, and how far matrices are off."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vibrid.fit import Diagnostics, Fit
from vibrid.methods import N4SID
from vibrid.record import Channel, make_channels
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain


def known_fit(
    model: StateSpace,
    outputs: Sequence[Channel | str] | None = None,
    inputs: Sequence[Channel | str] | None = None,
    **fields: Any,
) -> Fit:
    """Return a Fit of this model: no noise, no offsets, unless `fields` say otherwise."""
    n, m, p = model.order, model.n_inputs, model.n_outputs
    values: dict[str, Any] = {
        "kalman_gain": np.zeros((n, p)),
        "innovation_covariance": np.eye(p),
        "initial_states": np.zeros((1, n)),
        "segments": (),
        "input_offset": np.zeros(m),
        "output_offset": np.zeros(p),
        "feedthrough": np.ones(p, dtype=bool),
        "method": N4SID(),
        "order": n,
        "singular_values": np.ones(n),
        "state_covariance": np.eye(n),
        "parameter_covariance": None,
        "diagnostics": Diagnostics(),
        "gram": None,
        **fields,
    }
    return Fit(
        model=model,
        output_channels=make_channels(outputs, p, "y"),
        input_channels=make_channels(inputs, m, "u"),
        **values,
    )


def structure_fit(
    structure: Structure, sensors: Any, forces: Sequence[str] = (), *, base: bool = False
) -> Fit:
    """Return the exact discrete model of a structure, sampled at 100 Hz, with its channels.

    Forces are held (zoh), base motion is band-limited, as `modes_of` takes them.
    """
    exact = structure.state_space(sensors, forces, base)
    record = structure.simulate(
        np.zeros((2 * structure.n_dof, exact.n_inputs)),
        0.01,
        sensors=sensors,
        forces=forces,
        base=base,
    )
    model = exact.to_discrete(0.01, "band_limited" if base else "zoh")
    return known_fit(model, record.output_channels, record.input_channels)


def general(n: int) -> Structure:
    """Return a chain with dashpots that are not proportional to anything."""
    dashpots = 0.3 + 0.5 * np.cos(np.arange(n)) ** 2
    return chain(np.linspace(2.0, 1.0, n), np.linspace(500.0, 800.0, n), dashpots=dashpots)


def proportional(n: int) -> Structure:
    return chain(np.linspace(2.0, 1.0, n), np.linspace(500.0, 700.0, n), rayleigh=(0.1, 4e-4))


def error(found, true) -> float:
    """Return the norm of the difference over that of the truth."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def errors(found, true: Structure) -> list[float]:
    return [
        error(found.mass, true.mass),
        error(found.damping, true.damping),
        error(found.stiffness, true.stiffness),
    ]
