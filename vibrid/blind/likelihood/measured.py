"""blind_measured(): 𝒦, 𝒟 and ℬ where periodic forces were measured, from both parts of the motion.

The transient gives [𝒦 𝒟] with its covariance, the steady state c_j = G(iν_j) ℬ u_j; together
they are several times more certain than the transient alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike, NDArray

from ...errors import DataError, OptionError, check_choice
from ...exosystem import signal_basis
from ...fit import Diagnostics
from ...modes import Complexes
from ...record import Floats, Record
from ...statespace import HOLDS
from .. import refusals
from ..coordinates import check_independent, dynamic_stiffness, normalized_system
from ..result import BlindFit, BlindVerdict, Refusal, blind_fit, modes_from
from ..sensors import Sensors, forces_of
from .components import Signals
from .data import frequencies_of, most_oscillations, records_of, signals_of
from .division import divide
from .judged import CURES, refused, unexplained
from .modal import condition, modal_estimate, swinging
from .place import Place
from .search import Progress, grow, settle

MISFIT = 1.5  # χ² per degree of freedom of both parts together
MOST_SINES = 40  # of a force whose frequencies are not given
SINGULAR = 1e-12
LACKING = "a transient, or at least n + r / 2 frequencies of r forces"


@dataclass(frozen=True, eq=False)
class Steady:
    """The steady state of all records.

    Attributes
    ----------
    rates : array (n_frequencies,)
        [rad/s].
    motions : complex array (n_records, n, n_frequencies)
        Phasors of the sensors.
    forces : complex array (n_records, r, n_frequencies)
    deviations : array (n_records, n)
        Of the real and of the imaginary part of a sensor's phasor.
    """

    rates: Floats
    motions: Complexes
    forces: Complexes
    deviations: Floats


def blind_measured(
    data: Record | Sequence[Record],
    n_dof: int,
    *,
    input_frequencies_hz: Sequence[float] | None = None,
    hold: str = "band_limited",
    mass: ArrayLike | None = None,
    progress: Progress | None = None,
) -> BlindFit:
    """Return 𝒦, 𝒟 and ℬ = M⁻¹B from the response to measured periodic forces.

    Parameters
    ----------
    data : Record or sequence of Record
        Inputs are the forces.
    n_dof : int
    input_frequencies_hz : sequence of float, optional
        All of the force; read from the inputs when left out.
    hold : "zoh", "foh" or "band_limited"
    mass : float, array (n_dof,) or (n_dof, n_dof), optional

    Returns
    -------
    BlindFit
        Without a transient too, if there are at least n + r / 2 frequencies of r forces.
    """
    check_choice("hold", hold, HOLDS)
    records = records_of(data)
    inputs = _inputs_of(records)
    hertz = _frequencies(inputs, records[0].dt, input_frequencies_hz)
    sensors, signals = signals_of(records, n_dof, hertz.tolist())
    growth = grow(signals, most_oscillations(signals), progress)
    if not growth.explained:
        return unexplained(sensors, growth.place)
    steady = _steady(growth.place, inputs)
    transient, judged = _transient(growth.place, sensors)
    start = _by_rows(steady, sensors.powers) if transient is None else transient[0]
    if start is None:
        return refused(sensors, *refusals.together(judged), (LACKING,))
    joint = _joint(steady, sensors, hold, start, transient)
    if transient is None:  # the steady state alone is enough, if nothing else broke a rule
        judged = judged[0], [each for each in judged[1] if each.rule in ("R2", "R3")]
    return _answer(sensors, np.vstack(inputs), steady, joint, judged, mass)


def _inputs_of(records: Sequence[Record]) -> tuple[Floats, ...]:
    """Return the measured forces of records that go together, in SI."""
    counts = {record.n_inputs for record in records}
    if 0 in counts:
        raise OptionError("Measured forces are the inputs of the record; one has none.")
    if len(counts) > 1:
        raise DataError(f"The records have {sorted(counts)} inputs; select the same from each.")
    return tuple(forces_of(record) for record in records)


def _frequencies(inputs: tuple[Floats, ...], dt: float, given: Sequence[float] | None) -> Floats:
    if given is not None:
        return np.sort(frequencies_of(given, dt))
    signals = Signals(inputs, dt, np.zeros(0))
    growth = grow(signals, MOST_SINES)
    if not growth.explained:
        raise DataError(
            "The measured forces are not a sum of a few sines; identify() takes any force."
        )
    found = growth.place.components
    if not len(found):
        raise DataError("The measured forces hold no sine; identify() takes any force.")
    held = found.held(np.zeros(len(found), dtype=bool), 0.0)
    rates = settle(Place(held, signals)).components.frequencies
    return np.sort(rates) / (2 * np.pi)


def _steady(place: Place, inputs: tuple[Floats, ...]) -> Steady:
    signals = place.signals
    every, deviations = [], []
    for k, u in enumerate(inputs):
        times = signals.dt * np.arange(len(u))
        basis = signal_basis(signals.known / (2 * np.pi), times, offset=True)
        weights = np.linalg.lstsq(basis, u, rcond=None)[0][1:]
        every.append(weights)
        deviations.append(np.sqrt(2 * place.noise(k) / len(u)))
    check_independent(np.vstack(every))
    forces = np.array([(each[0::2] - 1j * each[1::2]).T for each in every])
    motions = np.array([place.known_shapes(k) for k in range(len(inputs))])
    return Steady(signals.known, motions, forces, np.array(deviations))


def _transient(
    place: Place, sensors: Sensors
) -> tuple[tuple[Floats, Floats] | None, refusals.Judged]:
    """Return [𝒦 𝒟] and covariance from the decaying part, None where it does not tell them."""
    n = sensors.setting.n_dof
    if not len(place.components):
        return None, refusals.of_certainty(np.zeros(0), n)
    division = divide(place, n)
    judged = refusals.of_certainty(division.certainty, n)
    if int(division.modes.sum()) < n or any(each.rule == "R1" for each in judged[1]):
        return None, judged
    estimate = modal_estimate(division.place, division.modes, sensors.powers)
    coinciding = refusals.of_condition(estimate.condition())
    if coinciding[1]:
        return None, (judged[0] | coinciding[0], judged[1] + coinciding[1])
    return estimate.normalized(), judged


def _by_rows(steady: Steady, powers: NDArray[np.int64]) -> Floats | None:
    """Return [𝒦 𝒟] by least squares of 𝒦q + 𝒟q̇ − ℬu = −q̈ on the steady state, row by row.

    None where these are too few, or sensors depend on each other.
    """
    s = 1j * steady.rates
    q = np.hstack(list(steady.motions / s ** powers[:, None]))
    s = np.tile(s, len(steady.motions))
    u = np.hstack(list(steady.forces))
    A = np.vstack([q, s * q, -u]).T
    wanted = (-(s**2) * q).T
    both = [np.concatenate([each.real, each.imag]) for each in (A, wanted)]
    size = np.linalg.norm(both[0], axis=0)
    found, _, rank, _ = np.linalg.lstsq(both[0] / size, both[1], rcond=SINGULAR)
    if rank < len(size):
        return None
    return np.asarray((found / size[:, None])[: 2 * len(powers)].T)


@dataclass(frozen=True, eq=False)
class Joint:
    """The joint fit.

    Attributes
    ----------
    P : array (n, 2 n)
        [𝒦 𝒟].
    B : array (n, r)
    covariance : array (2 n² + n r, 2 n² + n r)
        Of the columns of P and of B, stacked.
    misfit : float
        χ² per degree of freedom.
    """

    P: Floats
    B: Floats
    covariance: Floats
    misfit: float

    @property
    def of_matrices(self) -> Floats:
        """Covariance of the columns of P."""
        return self.covariance[: self.P.size, : self.P.size]

    @property
    def of_inputs(self) -> Floats:
        """Covariance of each row of ℬ (n, r, r)."""
        n, r = self.B.shape
        blocks = self.covariance[self.P.size :, self.P.size :].reshape(r, n, r, n)
        return np.asarray(np.einsum("ijkj->jik", blocks))


def _joint(
    steady: Steady,
    sensors: Sensors,
    hold: str,
    start: Floats,
    transient: tuple[Floats, Floats] | None,
) -> Joint:
    """Return the weighted least squares of both parts, by Gauss-Newton."""
    from scipy.optimize import least_squares  # slow to import, and used only here

    n, r = sensors.setting.n_dof, steady.forces.shape[1]
    respond = _responder(steady, sensors, hold)
    B = _inputs(respond(start), steady)
    prior = None if transient is None else _whitener(transient[1])

    def errors(x: Floats) -> Floats:
        P, B = x[: 2 * n * n].reshape(2 * n, n).T, x[2 * n * n :].reshape(r, n).T
        made = respond(P) @ (B @ steady.forces).transpose(0, 2, 1)[..., None]
        off = (made[..., 0].transpose(0, 2, 1) - steady.motions) / steady.deviations[:, :, None]
        parts = [off.real.ravel(), off.imag.ravel()]
        if prior is not None and transient is not None:
            change = (P - transient[0]).ravel(order="F")
            parts.append(sla.solve_triangular(prior, change, lower=True))
        return np.concatenate(parts)

    x = np.concatenate([start.ravel(order="F"), B.ravel(order="F")])
    parts = (start[:, :n], start[:, n:], B)
    scale = np.concatenate([np.repeat(np.linalg.norm(part), part.size) for part in parts])
    found = least_squares(lambda z: errors(z * scale), x / scale, method="lm", xtol=1e-12)
    J = found.jac / scale
    size = np.linalg.norm(J, axis=0)
    V = np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / size / size[:, None]
    values = found.x * scale
    freedom = max(len(found.fun) - len(x), 1)
    return Joint(
        values[: 2 * n * n].reshape(2 * n, n).T,
        values[2 * n * n :].reshape(r, n).T,
        np.asarray(V),
        float(2 * found.cost / freedom),
    )


def _whitener(covariance: Floats) -> Floats:
    size = np.sqrt(np.diag(covariance))
    unit = covariance / size / size[:, None] + SINGULAR * np.eye(len(size))
    return np.asarray(size[:, None] * sla.cholesky(unit, lower=True))


def _responder(steady: Steady, sensors: Sensors, hold: str) -> Callable[[Floats], Complexes]:
    """Return the function from [𝒦 𝒟] to G (n_frequencies, n, n)."""
    n, powers = sensors.setting.n_dof, sensors.powers
    turn = (1j * steady.rates[:, None, None]) ** powers[:, None]

    def smooth(P: Floats) -> Complexes:
        return np.asarray(turn * np.linalg.inv(dynamic_stiffness(P, steady.rates)))

    def held(P: Floats) -> Complexes:
        system = normalized_system(P[:, :n], P[:, n:], powers)
        discrete = system.to_discrete(sensors.setting.dt, hold)
        return np.asarray(discrete.frequency_response(steady.rates / (2 * np.pi)))

    return smooth if hold == "band_limited" else held


def _inputs(G: Complexes, steady: Steady) -> Floats:
    """Return ℬ by least squares of M⁻¹f on the measured forces."""
    f = np.hstack([np.linalg.solve(G, c.T[..., None])[..., 0].T for c in steady.motions])
    u = np.hstack(list(steady.forces))
    both = [np.hstack([each.real, each.imag]) for each in (u, f)]
    return np.asarray(np.linalg.lstsq(both[0].T, both[1].T, rcond=None)[0].T)


def _answer(
    sensors: Sensors,
    inputs: Floats,
    steady: Steady,
    joint: Joint,
    judged: refusals.Judged,
    mass: ArrayLike | None,
) -> BlindFit:
    setting, n = sensors.setting, sensors.setting.n_dof
    poles, shapes, deviations = swinging(joint.P, joint.of_matrices)
    checks, broken = refusals.together(
        judged,
        refusals.of_deviations(joint.P, joint.of_matrices),
        refusals.of_condition(condition(poles, shapes)),
        refusals.of_stiffness(joint.P),
        _of_misfit(joint.misfit),
    )
    damping = checks["damping_deviation"] <= refusals.DAMPING
    names = ("normalized_stiffness", *CURES, "normalized_input")
    determined = {**dict.fromkeys(names, True), "normalized_damping": damping}
    missing = () if damping else (CURES["normalized_damping"],)
    input_std = np.sqrt(np.einsum("ijj->ij", joint.of_inputs))
    force_std = np.sqrt(np.einsum("ijk,jk->i", joint.of_inputs, inputs.T @ inputs) / len(inputs))
    return blind_fit(
        setting,
        joint.P[:, :n],
        joint.P[:, n:] if damping else np.full((n, n), np.nan),
        modes_from(
            poles, shapes, setting, frequencies_std=deviations[0], damping_std=deviations[1]
        ),
        BlindVerdict("periodic", determined, missing, checks, broken, sensors.findings),
        covariance=joint.of_matrices,
        force=inputs @ joint.B.T,
        force_std=force_std,
        phasors=joint.B @ steady.forces,
        input_frequencies_hz=steady.rates / (2 * np.pi),
        normalized_input=joint.B,
        mass=mass,
        diagnostics=Diagnostics({"misfit": joint.misfit, "normalized_input_std": input_std}),
    )


def _of_misfit(misfit: float) -> refusals.Judged:
    checks = {"joint_misfit": misfit}
    if misfit <= MISFIT:
        return checks, []
    sentence = (
        f"Transient and steady state do not go together: χ² is {misfit:.3g} per degree of freedom "
        f"(limit {MISFIT:g})."
    )
    cure = "Check hold= and the units and delays of the forces."
    return checks, [Refusal("R4", sentence, cure, {"joint_misfit": misfit, "limit": MISFIT})]
