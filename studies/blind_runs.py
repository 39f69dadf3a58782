"""Single runs of the studies of blind identification: one record each, and what is said of it."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from studies.blind_excitations import BAD, NEITHER
from studies.blind_records import (
    SINES_HZ,
    Case,
    decay,
    held_reference,
    off,
    reference,
    two_forces,
    under_measured_force,
    under_noise,
    under_random_sines,
    uniform_chain,
)
from studies.bounds import blind_bound
from studies.rows import Row
from vibrid.blind import BlindFit, blind_likelihood, blind_rows, identify_blind
from vibrid.blind.coordinates import normalized_matrices
from vibrid.blind.likelihood import blind_measured

RIGHT = 0.02  # of a frequency
QUIET_DB = 100  # signal over noise where the bound is taken; it is in proportion to the noise
HERTZ = np.array(SINES_HZ)
GOOD = {"good": 0.0, "offset": 3.0}  # m/s²
FREE = [0, 2, 3]  # DOFs of two_forces() without a force
Floats = NDArray[np.float64]


def grid_run(n_dof: int, snr_db: float, method: str, known: bool, seed: int) -> Row:
    """Return what one record says."""
    case, hertz = under_random_sines(n_dof, snr_db, seed)
    started = time.process_time()
    fit = identify_blind(
        case.record, n_dof, method=method, input_frequencies_hz=hertz.tolist() if known else None
    )
    spent = {"fit_seconds": time.process_time() - started}
    quiet, _ = under_random_sines(n_dof, QUIET_DB, seed)
    limits = bounds_at(snr_db, quiet, hertz, known=known, real=method == "ml")
    shapes = {"shapes": fit.diagnostics.figures.get("shapes")}
    return {**findings(fit, case), **limits, **shapes, **spent}


def findings(fit: BlindFit, case: Case) -> Row:
    """Return the errors of an answer, also of one that the rules refuse."""
    f, true = np.sort(fit.modes.frequencies_hz), case.structure.frequencies_hz
    right = len(f) == len(true) and bool(np.abs(f / true - 1).max() < RIGHT)
    K, D = candidates(fit)
    return {
        "accepted": fit.accepted,
        "right": right,
        "stiffness": off(K, case.stiffness),
        "damping": off(D, case.damping),
    }


def candidates(fit: BlindFit) -> tuple[Floats, Floats]:
    """Return 𝒦 and 𝒟 that the modes say, refused or left out as too uncertain; NaN without."""
    n, modes = fit.n_dof, fit.modes
    if len(modes.poles) != n:
        return np.full((n, n), np.nan), np.full((n, n), np.nan)
    return normalized_matrices(modes.poles, modes.shapes, np.zeros(n, dtype=np.int64))


def bounds_at(snr_db: float, quiet: Case, hertz: Floats, *, known: bool, real: bool) -> Row:
    """Return the Cramér-Rao bound of a draw, from the same draw with little noise."""
    scale = 10 ** ((QUIET_DB - snr_db) / 20)
    stiffness, damping = blind_bound(quiet, hertz, known=known, real=real)
    return {"stiffness_bound": scale * stiffness, "damping_bound": scale * damping}


def reference_run(snr_db: float, seed: int) -> Row:
    """Return the reference example, order and frequencies unknown, shapes free."""
    case = reference(seed, snr_db)
    fit = blind_likelihood(case.record, 3, shapes="free")
    quiet = reference(seed, QUIET_DB)
    row = findings(fit, case) | {"force": off(fit.normalized_force, case.force)}
    row |= bounds_at(snr_db, quiet, HERTZ, known=False, real=False)
    return row | calibration(fit, case)


def calibration(fit: BlindFit, case: Case) -> Row:
    """Return errors over their predicted deviations: of the whole (Frobenius), of each entry."""
    row: Row = {}
    stds = fit.normalized_stiffness_std, fit.normalized_damping_std
    true = case.stiffness, case.damping
    names = "stiffness", "damping"
    for name, X, X0, std in zip(names, candidates(fit), true, stds, strict=True):
        row[f"{name}_ratio"] = float(np.linalg.norm(X - X0) / np.linalg.norm(std))
        row[f"{name}_scores"] = (np.abs(X - X0) / std).ravel().tolist()
    return row


def errors(fit: BlindFit, case: Case) -> Row:
    """Return the errors of what is answered; NaN where nothing is."""
    return {
        "accepted": fit.accepted,
        "stiffness": off(fit.normalized_stiffness, case.stiffness),
        "damping": off(fit.normalized_damping, case.damping),
    }


def with_force(fit: BlindFit, case: Case) -> Row:
    return errors(fit, case) | {"force": off(fit.normalized_force, case.force)}


def exact_run(snr_db: float | None, seed: int) -> Row:
    """Return the reference example with an offset."""
    case = reference(seed, snr_db, offset=3.0)
    return with_force(identify_blind(case.record, 3), case)


def held_run(seed: int) -> Row:
    """Return the reference example under held forces."""
    case = held_reference(seed)
    return with_force(identify_blind(case.record, 3, hold="zoh"), case)


def shapes_run(seed: int) -> Row:
    """Return which shapes the reference system is given at 40 dB; its damping is general."""
    fit = identify_blind(reference(seed, 40).record, 3)
    return {"shapes": fit.diagnostics.figures.get("shapes")}


def excitation_run(name: str, snr_db: float, seed: int) -> Row:
    """Return what becomes of an excitation, without a word more than the number of DOFs."""
    if name in GOOD:
        case = reference(seed, snr_db, offset=GOOD[name])
        fit = identify_blind(case.record, 3)
        return {"accepted": fit.accepted, "rules": rules(fit), **calibration(fit, case)}
    record = {**BAD, **NEITHER}[name](np.random.default_rng([seed, 77]), snr_db)
    fit = identify_blind(record, record.n_outputs)
    return {"accepted": fit.accepted, "rules": rules(fit)}


def rules(fit: BlindFit) -> list[str]:
    return [each.rule for each in fit.verdict.refusals]


def rows_run(snr_db: float | None, seed: int) -> Row:
    """Return the rows of five masses under two random forces."""
    case = two_forces(snr_db, np.random.default_rng([seed, 5]))
    fit = blind_rows(case.record, 5)
    return {
        "accepted": fit.accepted,
        "told": fit.forced_dofs == ("f2", "f5"),
        "stiffness": off(fit.normalized_stiffness[FREE], case.stiffness[FREE]),
    }


def measured_run(seed: int) -> Row:
    """Return five masses under one measured force, 40 dB: transient and steady state together."""
    case, hertz = under_measured_force(5, 40, np.random.default_rng([seed, 7]))
    fit = blind_measured(case.record, 5, input_frequencies_hz=hertz.tolist())
    return errors(fit, case) | {"input": off(fit.normalized_input, np.eye(5)[:, :1])}


def decay_run(seed: int) -> Row:
    """Return the free decay of eight masses, 40 dB."""
    case = decay(8, 40, seed)
    return errors(identify_blind(case.record, 8, excitation="decay"), case)


def everywhere_run(excitation: str, snr_db: float, seed: int) -> Row:
    """Return what is said of random forces among the modes on every DOF."""
    rng = np.random.default_rng([seed, 8])
    case = under_noise(uniform_chain(3), [0, 1, 2], duration=30.0, snr_db=snr_db, rng=rng)
    fit = identify_blind(case.record, 3, excitation=excitation)
    matrices = np.hstack([fit.normalized_stiffness, fit.normalized_damping, fit.normalized_force.T])
    nothing = bool(np.isnan(matrices).all())
    return {
        "accepted": fit.accepted,
        "nothing": nothing and not fit.accepted,
        "said": "in_band" in rules(fit),
    }


def base_run(told: bool, seed: int) -> Row:
    """Return what is said of k₁ under base motion, also where the masses are told."""
    rng = np.random.default_rng([seed, 9])
    case = under_noise(uniform_chain(3), [0], duration=60.0, snr_db=50, rng=rng)
    words = {"mass": np.ones(3), "ungrounded": ["f1", "f2", "f3"]} if told else {}
    fit = identify_blind(case.record, 3, excitation="base", **words)  # type: ignore[arg-type]
    K = fit.normalized_stiffness
    return {
        "accepted": fit.accepted,
        "k1": bool(np.isfinite(K[0, 0])),
        "said": fit.accepted and any("k₁" in each for each in fit.verdict.missing),
    }
