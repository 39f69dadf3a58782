"""Three masses under sines, and errors of what is found of them, which tests share."""

from __future__ import annotations

import numpy as np
from known_fits import error

from vibrid.exosystem import augmented_model, phasor_signal
from vibrid.record import Record
from vibrid.structures import chain

FREQUENCIES = np.array([0.7, 1.9, 3.3, 5.1, 6.4])
MASSES = np.array([2.0, 1.5, 1.0])
DT = 0.02


def structure():
    return chain(MASSES, [600.0, 400.0, 300.0], dashpots=[0.6, 0.5, 0.4])


def truth():
    """Return M⁻¹K and M⁻¹D."""
    return structure().stiffness / MASSES[:, None], structure().damping / MASSES[:, None]


def response(
    rng,
    frequencies=FREQUENCIES,
    *,
    hold="band_limited",
    sensors="acceleration",
    n_samples=1500,
    snr=None,
    steady=False,
    amplitude=1.0,
):
    """Return a record under sines on every DOF from an initial displacement, and M⁻¹f.

    The exact free response of structure and force together, in continuous or held time.
    """
    system = structure().state_space(sensors, forces=structure().dofs)
    phasors = amplitude * np.exp(2j * np.pi * rng.uniform(size=(3, len(frequencies))))
    start = np.concatenate([0.1 * rng.standard_normal(3), np.zeros(3)])
    held = hold == "zoh"
    signal, forced = phasor_signal(frequencies, phasors, dt=DT if held else None)
    if steady:
        turn = 2j * np.pi * np.asarray(frequencies)
        start = sum(
            np.linalg.solve(s * np.eye(6) - system.A, system.B @ p).real
            for s, p in zip(turn, phasors.T, strict=True)
        )
    model = augmented_model(system.to_discrete(DT) if held else system, signal)
    model = model if held else model.to_discrete(DT)
    y = model.simulate(initial_state=[*start, *forced], n_samples=n_samples)
    if snr is not None:
        y = y + 10 ** (-snr / 20) * np.sqrt((y**2).mean(axis=0)) * rng.standard_normal(y.shape)
    force = (np.exp(2j * np.pi * DT * np.arange(n_samples)[:, None] * frequencies) @ phasors.T).real
    channels = structure().simulate(None, DT, sensors=sensors, n_samples=4).output_channels
    return Record(y, dt=DT, output_channels=channels), force / MASSES


def errors(found, force):
    K, D = truth()
    damping = found.diagnostics.figures.get("candidate_damping", found.normalized_damping)
    return (
        error(found.normalized_stiffness, K),
        error(damping, D),
        error(found.normalized_force, force),
    )
