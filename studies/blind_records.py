"""Exact records of chains under sums of sines, with a transient: what tests and studies know."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vibrid as vb
from vibrid.mechanics import undamped_modes
from vibrid.structures import Structure, chain

Floats = NDArray[np.float64]
WEAK_BAND = (0.3, 8.0)  # Hz, of random forces
DAMPING = np.array([[1.1, -0.5, 0.0], [-0.5, 0.9, -0.4], [0.0, -0.4, 0.4]])
REFERENCE = chain([2.0, 1.5, 1.0], [600.0, 400.0, 300.0], damping=DAMPING)
SINES_HZ = (0.7, 1.9, 3.3, 5.1, 6.4)


@dataclass(frozen=True, eq=False)
class Case:
    """A record and what is true of it."""

    record: vb.Record
    structure: Structure
    force: Floats  # M⁻¹f

    @property
    def stiffness(self) -> Floats:
        return np.asarray(np.linalg.solve(self.structure.mass, self.structure.stiffness))

    @property
    def damping(self) -> Floats:
        return np.asarray(np.linalg.solve(self.structure.mass, self.structure.damping))


def off(found: Floats, true: Floats) -> float:
    """Return the relative error (Frobenius)."""
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def uniform_chain(n_dof: int) -> Structure:
    """Return unit masses with a first frequency of 1 Hz and 1 to 2 % proportional damping."""
    unit = undamped_modes(np.eye(n_dof), chain(np.ones(n_dof), np.ones(n_dof)).stiffness)[0]
    springs = np.full(n_dof, 1 / unit[0] ** 2)
    w = 2 * np.pi * unit / unit[0]
    ends = np.array([[0.5 / w[0], 0.5 * w[0]], [0.5 / w[-1], 0.5 * w[-1]]])
    alpha, beta = np.linalg.solve(ends, [0.01, 0.02])
    return chain(np.ones(n_dof), springs, rayleigh=(alpha, beta))


def under_sines(
    structure: Structure,
    hertz: Floats,
    phasors: NDArray[np.complex128],
    *,
    dt: float,
    n_samples: int,
    start: Floats | None = None,
    snr_db: float | None = None,
    rng: np.random.Generator | None = None,
    inputs: bool = False,
) -> Case:
    """Return accelerations under Σ Re(p e^{iνt}) on the DOFs, exact between the samples.

    `start` is [q; q̇] at the first sample, None a steady state.
    """
    M, R, K = structure.mass, structure.damping, structure.stiffness
    n, nu = len(M), 2 * np.pi * np.asarray(hertz)
    dynamic = K - nu[:, None, None] ** 2 * M + 1j * nu[:, None, None] * R
    q = np.linalg.solve(dynamic, phasors.T[..., None])[..., 0].T
    t = dt * np.arange(n_samples)
    turns = np.exp(1j * nu[:, None] * t)
    y = ((-(nu**2) * q) @ turns).real
    if start is not None:
        A = np.block(
            [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, R)]]
        )
        poles, V = np.linalg.eig(A)
        steady = np.concatenate([q.real.sum(axis=1), (1j * nu * q).real.sum(axis=1)])
        weights = np.linalg.solve(V, (start - steady).astype(complex))
        y = y + ((V[n:] * poles) @ (weights[:, None] * np.exp(poles[:, None] * t))).real
    y = y.T
    if snr_db is not None and rng is not None:
        y = y + y.std(axis=0) * 10 ** (-snr_db / 20) * rng.standard_normal(y.shape)
    f = (phasors @ turns).real.T
    channels = [
        vb.Channel(f"a{k + 1}", "acceleration", dof=d) for k, d in enumerate(structure.dofs)
    ]
    forces = [vb.Channel(f"u{k + 1}", "force") for k in range(n)] if inputs else None
    record = vb.Record(
        y, f if inputs else None, dt=dt, output_channels=channels, input_channels=forces
    )
    return Case(record, structure, np.linalg.solve(M, f.T).T)


def reference(
    seed: int, snr_db: float | None, *, offset: float = 0.0, n_samples: int = 1500, dt: float = 0.02
) -> Case:
    """Return the reference example: five unit sines on every DOF, displaced at the start."""
    rng = np.random.default_rng(seed)
    phasors = np.exp(1j * rng.uniform(0, 2 * np.pi, (3, len(SINES_HZ))))
    start = np.concatenate([rng.normal(0, 0.1, 3), np.zeros(3)])
    case = under_sines(
        REFERENCE,
        np.array(SINES_HZ),
        phasors,
        dt=dt,
        n_samples=n_samples,
        start=start,
        snr_db=snr_db,
        rng=rng,
    )
    moved = vb.Record(
        case.record.outputs + offset, dt=dt, output_channels=case.record.output_channels
    )
    return Case(moved, case.structure, case.force)


def under_noise(
    structure: Structure,
    forced: list[int],
    *,
    duration: float,
    snr_db: float | None,
    rng: np.random.Generator,
    band_hz: tuple[float, float] = WEAK_BAND,
    dt: float = 0.01,
) -> Case:
    """Return accelerations under random forces within a band: very many sines, from rest."""
    n = structure.n_dof
    count = int(6 * duration * (band_hz[1] - band_hz[0]))
    hertz = rng.uniform(*band_hz, count)
    phasors = np.zeros((n, count), dtype=np.complex128)
    draws = rng.standard_normal((2, len(forced), count))
    phasors[forced] = (draws[0] + 1j * draws[1]) / np.sqrt(count)
    return under_sines(
        structure,
        hertz,
        phasors,
        dt=dt,
        n_samples=int(duration / dt),
        start=np.zeros(2 * n),
        snr_db=snr_db,
        rng=rng,
    )


def under_random_sines(n_dof: int, snr_db: float, seed: int) -> tuple[Case, Floats]:
    """Return 60 s at 100 Hz from rest under n + 2 sines on every DOF, and their frequencies."""
    rng = np.random.default_rng([n_dof, seed])
    structure = uniform_chain(n_dof)
    hertz = np.sort(rng.uniform(0.5, 1.1 * structure.frequencies_hz[-1], n_dof + 2))
    phasors = np.exp(1j * rng.uniform(0, 2 * np.pi, (n_dof, n_dof + 2)))
    start = np.zeros(2 * n_dof)
    case = under_sines(
        structure, hertz, phasors, dt=0.01, n_samples=6000, start=start, snr_db=snr_db, rng=rng
    )
    return case, hertz


def under_measured_force(
    n_dof: int, snr_db: float, rng: np.random.Generator
) -> tuple[Case, Floats]:
    """Return 60 s at 100 Hz from rest under sixteen harmonics of 0.5 Hz on the first DOF."""
    hertz = np.linspace(0.5, 8.0, 16)
    phasors = np.zeros((n_dof, 16), dtype=np.complex128)
    phasors[0] = np.exp(1j * rng.uniform(0, 2 * np.pi, 16))
    case = under_sines(
        uniform_chain(n_dof),
        hertz,
        phasors,
        dt=0.01,
        n_samples=6000,
        start=np.zeros(2 * n_dof),
        snr_db=snr_db,
        rng=rng,
        inputs=True,
    )
    return Case(case.record.select(inputs=["u1"]), case.structure, case.force), hertz


def decay(n_dof: int, snr_db: float, seed: int) -> Case:
    """Return a free decay after velocity impulses, 60 s at 100 Hz."""
    rng = np.random.default_rng(seed)
    start = np.concatenate([np.zeros(n_dof), rng.standard_normal(n_dof)])
    nothing = np.zeros((n_dof, 1), dtype=np.complex128)
    return under_sines(
        uniform_chain(n_dof),
        np.array([1.0]),
        nothing,
        dt=0.01,
        n_samples=6000,
        start=start,
        snr_db=snr_db,
        rng=rng,
    )


def held_reference(seed: int) -> Case:
    """Return the reference example with forces held between the samples, without noise."""
    case = reference(seed, None)
    model = REFERENCE.state_space(forces=REFERENCE.dofs).to_discrete(case.record.dt)
    start = np.concatenate([np.random.default_rng([seed, 1]).normal(0, 0.1, 3), np.zeros(3)])
    held = vb.Record(model.simulate(case.force @ REFERENCE.mass, start), dt=case.record.dt)
    return Case(held, REFERENCE, case.force)


def two_forces(snr_db: float | None, rng: np.random.Generator) -> Case:
    """Return five masses, forces on the second and the last, 20 s."""
    return under_noise(uniform_chain(5), [1, 4], duration=20.0, snr_db=snr_db, rng=rng)
