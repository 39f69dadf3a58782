"""Cramér-Rao bounds, from the true system: of frequencies and damping ratios, of M⁻¹K and M⁻¹D."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import vibrid as vb
from studies.blind_records import Case
from vibrid.blind.likelihood.components import Components, Signals
from vibrid.blind.likelihood.modal import modal_estimate
from vibrid.blind.likelihood.place import Place
from vibrid.kalman import riccati_gain
from vibrid.statespace import StateSpace

Floats = NDArray[np.float64]
GRID = 2**13  # angles of the half circle
NOTHING = 1e-11  # relative eigenvalue of the information of what changes nothing


def shaker_bound(model: StateSpace, record: vb.Record, noise_std: Floats) -> tuple[Floats, Floats]:
    """Return the bounds of a test with known inputs and white noise on the sensors.

    Unknown are every mode's frequency, damping ratio, input and output vectors, D, initial
    state and offsets; the record holds the true inputs.

    Returns
    -------
    frequencies [Hz], damping_ratios : array (n_modes,)
    """
    from scipy.signal import lfilter

    dt, u = model.dt or 1.0, np.asarray(record.inputs)
    values, vectors = np.linalg.eig(model.A)
    modal = np.linalg.inv(vectors) @ model.B
    pairs = np.flatnonzero(values.imag > 0)
    pairs = pairs[np.argsort(np.abs(np.log(values[pairs])))]
    rates = np.log(values[pairs]) / dt
    start = np.zeros(len(pairs), complex)
    parts = [
        np.abs(rates),
        -rates.real / np.abs(rates),
        modal[pairs],
        (model.C @ vectors)[:, pairs],
    ]
    parts += [model.D, start]

    def response(w: Floats, zeta: Floats, b: Floats, c: Floats, D: Floats, x0: Floats) -> Floats:
        y = u @ D.T
        for k, pole in enumerate(np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w * dt)):
            x = lfilter([0, 1], [1, -pole], u @ b[k]) + x0[k] * pole ** np.arange(len(u))
            y = y + 2 * (x[:, None] * c[:, k]).real
        return y / noise_std

    columns = [np.tile(each, len(u)) for each in np.diag(1 / noise_std)]
    for number, part in reversed(list(enumerate(parts))):
        for place in reversed(list(np.ndindex(part.shape))):
            for turn in (1, 1j) if np.iscomplexobj(part) else (1,):
                step = 1e-6 * max(abs(part[place]), 1e-3)
                ends = []
                for sign in (-1, 1):
                    moved = [each.copy() for each in parts]
                    moved[number][place] += sign * step * turn
                    ends.append(response(*moved))
                columns.insert(0, (ends[1] - ends[0]).ravel() / (2 * step))
    bound = _deviations(np.array(columns))
    n = len(pairs)
    return bound[:n] / (2 * np.pi), bound[n : 2 * n]


def ambient_bound(model: StateSpace, n_samples: int, noise_std: Floats) -> tuple[Floats, Floats]:
    """Return the bounds of outputs that unknown white inputs of unit variance drive.

    Unknown are the poles, output and gain vectors of the innovations model y = H(q) e. With
    derivatives T of H the information is N / 2π ∫ tr(Λ⁻¹ H⁻¹ T_i Λ T_jᴴ H⁻ᴴ) dω (Whittle 1953).

    Parameters
    ----------
    model : StateSpace
        Discrete, true, from the white inputs to the outputs.
    n_samples : int
    noise_std : array (p,)
        Of white noise on the sensors.

    Returns
    -------
    frequencies [Hz], damping_ratios : array (n_modes,)
    """
    A, B, C, D, dt = model.A, model.B, model.C, model.D, model.dt or 1.0
    found = riccati_gain(A, C, B @ B.T, D @ D.T + np.diag(noise_std**2), B @ D.T)
    assert found is not None
    K, innovation = found
    root = np.linalg.cholesky(innovation)
    values, vectors = np.linalg.eig(A)
    pairs = np.flatnonzero(values.imag > 0)
    pairs = pairs[np.argsort(np.abs(np.log(values[pairs])))]
    mu, c, k = values[pairs], (C @ vectors)[:, pairs].T, np.linalg.solve(vectors, K + 0j)[pairs]
    z = np.exp(1j * np.pi * (np.arange(GRID) + 0.5) / GRID)
    identity = np.eye(len(C))
    H = identity + C @ np.linalg.solve(z[:, None, None] * np.eye(len(A)) - A, K + 0j)
    left = np.linalg.solve(root, np.linalg.inv(H))
    rates = np.log(mu) / dt
    size = np.abs(rates)
    zeta = -rates.real / size
    across = np.sqrt(1 - zeta**2)
    by_size = mu * dt * (-zeta + 1j * across)
    by_zeta = mu * dt * size * (-1 - 1j * zeta / across)
    parts: list[tuple[int, NDArray[np.complex128]]] = []
    columns: list[Floats] = []
    for j, pole in enumerate(mu):
        once, mirrored = 1 / (z - pole), 1 / (np.conj(z) - pole)
        shape = np.outer(c[j], k[j])
        parts += [(2, by_size[j] * shape), (2, by_zeta[j] * shape)]
        parts += [(1, t * np.outer(row, k[j])) for row in identity for t in (1, 1j)]
        parts += [(1, t * np.outer(c[j], row)) for row in identity for t in (1, 1j)]
        for power, X in parts[-2 - 4 * len(C) :]:
            T = np.multiply.outer(once**power, X) + np.multiply.outer(mirrored**power, X).conj()
            columns.append((left @ T @ root).ravel().view(float))
    inverse = _deviations(np.array(columns)) / np.sqrt(n_samples / GRID)
    table = inverse.reshape(len(mu), -1)
    return table[:, 0] / (2 * np.pi), table[:, 1]


def blind_bound(case: Case, hertz: Floats, *, known: bool, real: bool) -> tuple[float, float]:
    """Return the bounds of 𝒦 and 𝒟 from accelerations under sines, relative (Frobenius).

    The amplitudes and the noise are those that a fit at the true poles and frequencies finds, so
    the noise should be little; the bound grows in proportion to it.

    Parameters
    ----------
    case : Case
    hertz : array (n_frequencies,)
        Of the sines.
    known : bool
        Whether they need not be estimated.
    real : bool
        Whether the shapes are known to be real.
    """
    n, poles = case.structure.n_dof, case.structure.poles
    rates = np.concatenate([poles.imag, [] if known else 2 * np.pi * hertz])
    modes = np.arange(len(rates)) < n
    decays = np.where(modes, np.resize(-poles.real, len(rates)), 0)
    given = 2 * np.pi * hertz if known else np.zeros(0)
    signals = Signals((np.asarray(case.record.outputs),), case.record.dt, given)
    free = Components(rates, decays, modes, np.zeros_like(modes), np.zeros((1, len(rates))))
    place = Place(free, signals)
    if real:
        phases = 0.5 * np.angle(np.sum(place.shapes(0) ** 2, axis=0)) * modes
        place = Place(Components(rates, decays, modes, modes, phases[None]), signals)
    variances = np.diag(modal_estimate(place, modes, np.full(n, 2)).normalized()[1])
    halves = np.sqrt([variances[: n * n].sum(), variances[n * n :].sum()])
    return (
        float(halves[0] / np.linalg.norm(case.stiffness)),
        float(halves[1] / np.linalg.norm(case.damping)),
    )


def _deviations(J: Floats) -> Floats:
    """Return the root of the diagonal of (J Jᵀ)⁺."""
    size = np.linalg.norm(J, axis=1)
    unit = J / size[:, None]
    inverse = np.linalg.pinv(unit @ unit.T, rcond=NOTHING, hermitian=True)
    return np.asarray(np.sqrt(np.diag(inverse)) / size)
