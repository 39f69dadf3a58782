"""Excitations of the reference system that have no answer, and two on the border."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import vibrid as vb
from studies.blind_records import REFERENCE, SINES_HZ, under_noise, under_sines
from vibrid.structures import chain

Floats = NDArray[np.float64]
HZ = np.array(SINES_HZ)
DT, N = 0.02, 1500


def phasors(rng: np.random.Generator, count: int, n_dof: int = 3) -> NDArray[np.complex128]:
    return np.asarray(np.exp(1j * rng.uniform(0, 2 * np.pi, (n_dof, count))))


def displaced(rng: np.random.Generator, n_dof: int = 3) -> Floats:
    return np.concatenate([rng.normal(0, 0.1, n_dof), np.zeros(n_dof)])


def no_transient(rng: np.random.Generator, snr_db: float) -> vb.Record:
    return under_sines(
        REFERENCE, HZ, phasors(rng, 5), dt=DT, n_samples=N, snr_db=snr_db, rng=rng
    ).record


def long_after_the_start(rng: np.random.Generator, snr_db: float) -> vb.Record:
    """40 s after the start: what is left of the slowest mode is e^{−1.7}, under the noise later."""
    case = under_sines(
        REFERENCE,
        HZ,
        phasors(rng, 5),
        dt=DT,
        n_samples=N + 2000,
        start=displaced(rng),
        snr_db=snr_db,
        rng=rng,
    )
    return case.record.slice(2000)


def rigid_body(rng: np.random.Generator, snr_db: float) -> vb.Record:
    free = chain([2.0, 1.5, 1.0], [0.0, 400.0, 300.0], dashpots=[0.0, 0.5, 0.4])
    # a soft spring of 1e-6 N/m stands for none: the simulation needs a steady state
    soft = chain([2.0, 1.5, 1.0], [1e-6, 400.0, 300.0], damping=free.damping)
    start = displaced(rng)
    start[:3] -= start[:3].mean()
    return under_sines(
        soft, HZ, phasors(rng, 5), dt=DT, n_samples=N, start=start, snr_db=snr_db, rng=rng
    ).record


def thirty_sines(rng: np.random.Generator, snr_db: float) -> vb.Record:
    hertz = np.sort(rng.uniform(0.3, 8, 30))
    return under_sines(
        REFERENCE,
        hertz,
        phasors(rng, 30),
        dt=DT,
        n_samples=N,
        start=displaced(rng),
        snr_db=snr_db,
        rng=rng,
    ).record


def many_lines(rng: np.random.Generator, snr_db: float) -> vb.Record:
    return under_noise(
        REFERENCE, [0, 1, 2], duration=30.0, snr_db=snr_db, rng=rng, band_hz=(0.3, 8.0), dt=DT
    ).record


def white_forces(rng: np.random.Generator, snr_db: float) -> vb.Record:
    """They reach the Nyquist frequency: above the modes all sensors show a floor that is force."""
    force = rng.standard_normal((N, 3))
    y = REFERENCE.simulate(force, DT, forces=REFERENCE.dofs).outputs
    return vb.Record(y + y.std(axis=0) * 10 ** (-snr_db / 20) * rng.standard_normal(y.shape), dt=DT)


def force_jump(rng: np.random.Generator, snr_db: float) -> vb.Record:
    """The forces' phases change in the middle, and the motion goes on from where it was."""
    model = REFERENCE.state_space(forces=REFERENCE.dofs)
    t = DT * np.arange(N)
    turns = np.exp(2j * np.pi * HZ[:, None] * t)
    first, second = ((phasors(rng, 5) @ turns).real.T for _ in range(2))
    force = np.where(t[:, None] < t[N // 2], first, second)
    y = model.to_discrete(DT, hold="foh").simulate(force, displaced(rng))
    return vb.Record(y + y.std(axis=0) * 10 ** (-snr_db / 20) * rng.standard_normal(y.shape), dt=DT)


def too_few_sensors(rng: np.random.Generator, snr_db: float) -> vb.Record:
    case = under_sines(
        REFERENCE,
        HZ,
        phasors(rng, 5),
        dt=DT,
        n_samples=N,
        start=displaced(rng),
        snr_db=snr_db,
        rng=rng,
    )
    return case.record.select(outputs=["a1", "a3"])


def at_a_mode(rng: np.random.Generator, snr_db: float) -> vb.Record:
    """The third sine is exactly at the second mode."""
    return _beside_the_mode(rng, snr_db, 0.0)


def one_line_off_a_mode(rng: np.random.Generator, snr_db: float) -> vb.Record:
    """The third sine is one line of the spectrum, 1 / T, above the second mode."""
    return _beside_the_mode(rng, snr_db, 1 / (DT * N))


def _beside_the_mode(rng: np.random.Generator, snr_db: float, distance: float) -> vb.Record:
    hertz = HZ.copy()
    hertz[2] = REFERENCE.frequencies_hz[1] + distance
    return under_sines(
        REFERENCE,
        hertz,
        phasors(rng, 5),
        dt=DT,
        n_samples=N,
        start=displaced(rng),
        snr_db=snr_db,
        rng=rng,
    ).record


NEITHER = {"a sine at f₂": at_a_mode, "a sine at f₂ + 1/T": one_line_off_a_mode}
BAD = {
    "no transient": no_transient,
    "40 s after the start": long_after_the_start,
    "rigid-body mode": rigid_body,
    "30 sines": thirty_sines,
    "400 lines": many_lines,
    "white forces": white_forces,
    "force jump": force_jump,
    "2 sensors on 3 DOF": too_few_sensors,
}
