"""Quality of modes: one for exact factors, low for noise modes, as a naive loop counts it."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from known_fits import known_fit

from vibrid.errors import OptionError
from vibrid.files import load, save
from vibrid.fit import Diagnostics
from vibrid.methods import N4SID, SSI
from vibrid.modes import ModeQuality, match_modes, mode_quality, modes_of, quality_of
from vibrid.record import Floats
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain

NAMES = tuple(ModeQuality.__dataclass_fields__)


def proportional() -> Structure:
    """Return three masses with proportional damping: real shapes."""
    return chain([2.0, 1.0, 1.5], [900.0, 700.0, 800.0], damping_ratio=[0.01, 0.02, 0.015])


def sampled(structure: Structure | None = None, forces: Any = ("f1", "f3")) -> StateSpace:
    """Return the displacement model of a structure at 25 Hz."""
    model = (structure or proportional()).state_space("displacement", forces)
    return model.to_discrete(0.04)


def exact_factors(model: StateSpace, rows: int, columns: int) -> tuple[Floats, Floats]:
    """Return [C; CA; …] and [B, AB, …]."""
    powers = [np.linalg.matrix_power(model.A, k) for k in range(max(rows, columns))]
    return (
        np.vstack([model.C @ power for power in powers[:rows]]),
        np.hstack([power @ model.B for power in powers[:columns]]),
    )


def realized(pulses: Floats, order: int, rows: int) -> tuple[StateSpace, Floats, Floats]:
    """Return the ERA model (Juang & Pappa 1985) of pulse responses (n, p, m), and its factors."""
    columns, (p, m) = len(pulses) - rows, pulses.shape[1:]
    both = np.block([[pulses[i + j] for j in range(columns)] for i in range(rows + 1)])
    U, s, Vt = np.linalg.svd(both[:-p], full_matrices=False)
    root = np.sqrt(s[:order])
    observability, controllability = U[:, :order] * root, root[:, None] * Vt[:order]
    A = (U[:, :order] / root).T @ both[p:] @ (Vt[:order].T / root)
    B, C = controllability[:, :m], observability[:p]
    return StateSpace(A, B, C, np.zeros((p, m)), 0.04), observability, controllability


def noisy_realization(
    rng: np.random.Generator, order: int, noise: float
) -> tuple[StateSpace, Floats, Floats]:
    """Return the realization of 120 pulse responses with white noise, and its factors."""
    pulses = sampled().markov_parameters(120)[1:]
    return realized(pulses + noise * pulses.std() * rng.standard_normal(pulses.shape), order, 30)


def by_loops(model: StateSpace, observability: Floats, controllability: Floats) -> dict[str, Any]:
    """Return the indicators from their definitions, one number at a time, frequencies rising."""
    p, m = model.n_outputs, model.n_inputs
    values, vectors = np.linalg.eig(model.A)
    rows, columns = len(observability) // p, controllability.shape[1] // m
    shown, driven = observability @ vectors, np.linalg.solve(vectors, controllability)
    found: dict[str, list[float]] = {name: [] for name in NAMES[:5]}
    chosen = [i for i in range(len(values)) if values[i].imag > 0]
    for i in sorted(chosen, key=lambda i: abs(cmath.log(values[i]))):
        c, b, pole = shown[:, i], driven[i], complex(values[i])
        pure = np.hstack([pole**k * b[:m] for k in range(columns)])
        size = math.sqrt(abs(pure @ pure.conj()) * abs(b @ b.conj()))
        out = extended(c[:p], c[(rows - 1) * p :], pole ** (rows - 1))
        into = extended(b[:m], b[(columns - 1) * m :], pole ** (columns - 1))
        summed = sum(abs(pole) ** k for k in range(rows + columns - 1))
        found["amplitude_coherence"].append(abs(pure @ b.conj()) / size)
        found["emac_outputs"].append(out)
        found["emac_inputs"].append(into)
        found["emac"].append(out * into)
        sizes = float(np.linalg.norm(c[:p]) * np.linalg.norm(b[:m]))
        found["msv"].append(math.sqrt(sizes * summed))
    found["msv"] = [value / max(found["msv"]) for value in found["msv"]]
    return found


def extended(first: Any, last: Any, power: complex) -> float:
    """Return Σ R W |φ|² / Σ |φ|² of one mode."""
    total = 0.0
    for start, end in zip(first, last, strict=True):
        expected = power * start
        ratio = min(abs(end) / abs(expected), abs(expected) / abs(end))
        turned = abs(cmath.phase(end / expected))
        weight = 1 - turned / (math.pi / 4) if turned <= math.pi / 4 else 0.0
        total += ratio * weight * abs(start) ** 2
    return total / float(np.sum(np.abs(first) ** 2))


def rotation(angle: float) -> Floats:
    """Return the matrix with eigenvalues exp(± j angle)."""
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def assert_alike(first: ModeQuality, second: ModeQuality, atol: float = 1e-9) -> None:
    """Compare all indicators."""
    for name in NAMES:
        one, two = getattr(first, name), getattr(second, name)
        np.testing.assert_allclose(one, two, atol=atol, err_msg=name)


# -- known answers


@pytest.mark.parametrize(("rows", "columns"), [(2, 2), (30, 40), (400, 2)])
def test_exact_factors_have_perfect_modes(rows: int, columns: int) -> None:
    """Proportional damping and exact powers of A: every indicator but MSV is 1."""
    model = sampled()
    quality = mode_quality(model, *exact_factors(model, rows, columns))
    for name in set(NAMES) - {"msv"}:
        np.testing.assert_allclose(getattr(quality, name), 1, atol=1e-8, err_msg=name)
    assert quality.msv.max() == 1


def test_indicators_agree_with_their_definitions(rng: np.random.Generator) -> None:
    """A noisy realization of too high an order: the same as numbers counted one by one."""
    model, observability, controllability = noisy_realization(rng, 14, 0.05)
    quality = mode_quality(model, observability, controllability)
    expected = by_loops(model, observability, controllability)
    assert len(quality.emac) == modes_of(model).n_modes > 3
    for name, values in expected.items():
        np.testing.assert_allclose(getattr(quality, name), values, atol=1e-9, err_msg=name)
    collinearity = modes_of(model).phase_collinearity
    np.testing.assert_array_equal(quality.phase_collinearity, collinearity)
    np.testing.assert_array_equal(quality.consistency, quality.emac * collinearity)


def test_turned_and_shrunk_ends_count_as_published() -> None:
    """Last rows 0.8 as large and turned by π/8 give 0.8 · ½; turned by π/2, nothing."""
    model = StateSpace([[0.6, 0.6], [-0.6, 0.6]], np.eye(2), np.eye(2), np.zeros((2, 2)), 0.1)
    for angle, expected in ((0.0, 0.8), (np.pi / 8, 0.4), (-np.pi / 8, 0.4), (np.pi / 2, 0.0)):
        turn = rotation(angle)
        blocks = [np.eye(2), model.A, 0.8 * model.A @ model.A @ turn]
        quality = mode_quality(model, np.vstack(blocks), np.hstack(blocks))
        assert quality.emac_outputs == pytest.approx([expected], abs=1e-12)
        assert quality.emac_inputs == pytest.approx([expected], abs=1e-12)


def test_the_strong_mode_has_the_largest_singular_value() -> None:
    """A mode pushed ten times as hard has √10 times the MSV: sizes of b enter by their root."""
    A = np.zeros((4, 4))
    A[:2, :2] = 0.99 * rotation(1)
    A[2:, 2:] = 0.99 * rotation(2)
    model = StateSpace(A, [[0], [1], [0], [10]], [[1, 0, 1, 0]], [[0]], 0.1)
    quality = mode_quality(model, *exact_factors(model, 5, 5))
    assert quality.msv == pytest.approx([1 / np.sqrt(10), 1])


# -- noise


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_noise_modes_of_a_realization_are_told_apart(seed: int) -> None:
    """Of 20 states from noisy pulses, the three true modes lead in EMAC, CMI and MSV."""
    model, *factors = noisy_realization(np.random.default_rng(seed), 20, 0.03)
    true = match_modes(modes_of(sampled()), modes_of(model), frequency_limit=0.01)[:, 1]
    quality = mode_quality(model, *factors)
    noise = np.setdiff1d(np.arange(len(quality.emac)), true)
    assert (len(true), len(noise) > 3) == (3, True)
    assert quality.emac[true].min() > 0.3 > 0.1 > quality.emac[noise].max()
    assert quality.consistency[true].min() > 3 * quality.consistency[noise].max()
    assert quality.msv[true].min() > 3 * quality.msv[noise].max()
    assert quality.amplitude_coherence[true].min() > 0.98
    assert quality.amplitude_coherence[noise].max() < 0.8


@pytest.mark.parametrize("inputs", [True, False])
def test_noise_modes_of_subspace_methods_are_told_apart(
    rng: np.random.Generator, inputs: bool
) -> None:
    """N4SID and SSI of too high an order: the true modes have the best output EMAC and CMI."""
    structure = proportional()
    forces = rng.standard_normal((6000, 3))
    record = structure.simulate(
        forces, 0.04, sensors="displacement", forces=["f1", "f2", "f3"], noise=0.05, rng=rng
    )
    method: Any = N4SID(block_rows=25) if inputs else SSI(block_rows=25)
    decomposition = method.decompose(record if inputs else record.select(inputs=[]))
    fit = method.realize(decomposition, 16)
    quality = mode_quality(fit, *decomposition.factors(16))
    found = match_modes(modes_of(sampled()), modes_of(fit), mac_limit=0.9)[:, 1]
    noise = np.setdiff1d(np.arange(len(quality.emac)), found)
    assert (len(found), len(noise) > 0) == (3, True)
    for values in (quality.emac_outputs, quality.consistency):
        assert values[found].min() > 0.95
        assert values[noise].max() < 0.9
        assert np.median(values[noise]) < 0.6
    assert np.isnan([quality.emac, quality.msv, quality.amplitude_coherence]).all()


@pytest.mark.parametrize("transition", ["regression", "shift"])
@pytest.mark.parametrize("weighting", ["cva", "moesp", "n4sid"])
def test_subspace_factors_are_in_the_models_coordinates(
    rng: np.random.Generator, weighting: str, transition: str
) -> None:
    """Without noise every weighting and transition gives Γ = [C; CA; …] of its own model."""
    record = proportional().simulate(
        rng.standard_normal((1500, 2)), 0.04, sensors="displacement", forces=["f1", "f3"]
    )
    method = N4SID(weighting=weighting, block_rows=10, transition=transition)
    decomposition = method.decompose(record)
    fit = method.realize(decomposition, 6)
    quality = mode_quality(fit, *decomposition.factors(6))
    np.testing.assert_allclose(quality.emac_outputs, 1, atol=1e-6)


# -- what must change nothing


def test_basis_and_units_change_nothing(rng: np.random.Generator) -> None:
    """Another state basis, units of C, a common unit of the factors: the same quality."""
    model, observability, controllability = noisy_realization(rng, 12, 0.05)
    quality = mode_quality(model, observability, controllability)
    T = rng.standard_normal((12, 12)) + 4 * np.eye(12)
    other = mode_quality(model.transform(T), observability @ T, np.linalg.solve(T, controllability))
    assert_alike(other, quality)
    millimetres = StateSpace(model.A, 1e-3 * model.B, 1e3 * model.C, model.D, model.dt)
    assert_alike(mode_quality(millimetres, observability, controllability), quality)
    assert_alike(mode_quality(model, 1e3 * observability, 1e-3 * controllability), quality)


def test_output_units_change_nothing_of_subspace_methods(rng: np.random.Generator) -> None:
    """One output in millimetres: the factor has each output by its own deviation."""
    record = proportional().simulate(
        rng.standard_normal((2000, 1)),
        0.04,
        sensors="displacement",
        forces=["f1"],
        noise=0.02,
        rng=rng,
    )
    units = np.array([1.0, 1e3, 1.0])
    scaled = replace(record, outputs=record.outputs * units)
    method = N4SID(block_rows=12, transition="shift")
    found = []
    for data in (record, scaled):
        decomposition = method.decompose(data)
        found.append(mode_quality(method.realize(decomposition, 8), *decomposition.factors(8)))
    np.testing.assert_allclose(found[0].emac_outputs, found[1].emac_outputs, atol=1e-6)


# -- edges


def test_what_cannot_be_compared_is_nan() -> None:
    """One block says nothing; without controllability only the outputs' part is known."""
    model = sampled()
    observability, controllability = exact_factors(model, 5, 5)
    single = mode_quality(model, observability[:3], controllability[:, :2])
    assert np.isnan([single.emac_outputs, single.emac_inputs, single.emac]).all()
    assert np.isnan(single.amplitude_coherence).all()
    assert single.msv.max() == 1
    outputs = mode_quality(model, observability)
    assert np.isnan([outputs.emac_inputs, outputs.emac, outputs.msv]).all()
    np.testing.assert_allclose(outputs.consistency, 1, atol=1e-8)
    assert set(outputs.as_figures()) == {
        "mode_emac_outputs",
        "mode_phase_collinearity",
        "mode_consistency",
    }


def test_models_without_modes_have_empty_quality() -> None:
    """Real poles only: arrays of length zero and no figures."""
    model = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)
    quality = mode_quality(model, *exact_factors(model, 3, 3))
    assert {getattr(quality, name).shape for name in NAMES} == {(0,)}
    assert quality.as_figures() == {}


def test_long_factors_of_fast_growing_modes_do_not_overflow() -> None:
    """Of λ = 3 exp(j), 1500 rows overflow as a power; MSV and EMAC stay numbers."""
    A = np.zeros((4, 4))
    A[:2, :2] = 3 * rotation(1)
    A[2:, 2:] = 0.9 * rotation(2)
    model = StateSpace(A, np.ones((4, 1)), np.ones((1, 4)), [[0.0]], 0.1)
    short = mode_quality(model, *exact_factors(model, 30, 30))
    for name in ("amplitude_coherence", "emac", "phase_collinearity"):
        np.testing.assert_allclose(getattr(short, name), 1, atol=1e-8, err_msg=name)
    long = mode_quality(model, np.ones((1500, 4)), np.ones((4, 1500)))
    assert np.isfinite([long.emac, long.msv, long.amplitude_coherence]).all()
    assert long.msv.tolist() == [1, 0]
    assert long.emac.max() < 1e-3


def test_repeated_poles_keep_their_quality(rng: np.random.Generator) -> None:
    """Two equal oscillators have modes as good as one; a defective pair has none of the rest."""
    one = np.array([[0.6, 0.6], [-0.6, 0.6]])
    T = rng.standard_normal((4, 4))
    A = np.linalg.solve(T, np.kron(np.eye(2), one) @ T)
    model = StateSpace(A, rng.standard_normal((4, 2)), rng.standard_normal((2, 4)), np.eye(2), 1.0)
    quality = mode_quality(model, *exact_factors(model, 6, 6))
    np.testing.assert_allclose(quality.emac, 1, atol=1e-8)
    A = np.block([[one, np.eye(2)], [np.zeros((2, 2)), one]])
    model = StateSpace(A, np.ones((4, 1)), np.eye(4), np.zeros((4, 1)), 1.0)
    quality = mode_quality(model, *exact_factors(model, 6, 6))
    assert np.isnan([quality.amplitude_coherence, quality.emac_inputs, quality.msv]).all()
    np.testing.assert_allclose(quality.emac_outputs, 1, atol=1e-6)


def test_blocks_may_be_wider_or_narrower_than_the_inputs() -> None:
    """Free decays: initial states stand for B, in a factor with three axes."""
    model = sampled()
    observability, controllability = exact_factors(model, 5, 8)
    silent = StateSpace(model.A, np.zeros((6, 0)), model.C, np.zeros((3, 0)), model.dt)
    quality = mode_quality(silent, observability, controllability.reshape(6, 8, 2))
    assert_alike(quality, mode_quality(model, observability, controllability))
    with pytest.raises(OptionError, match=r"multiple of 0 columns.*\(states, columns, width\)"):
        mode_quality(silent, observability, controllability)


@pytest.mark.parametrize(
    ("rows", "columns", "message"),
    [
        (np.ones((4, 6)), None, r"6 columns.*multiple of 3 rows.*\(4, 6\)"),
        (np.ones((6, 5)), None, r"6 columns.*\(6, 5\)"),
        (np.ones((0, 6)), None, r"multiple of 3 rows"),
        (np.ones((6, 6)), np.ones((6, 3)), r"6 rows.*multiple of 2 columns.*\(6, 3\)"),
        (np.ones((6, 6)), np.ones((5, 4)), r"6 rows.*\(5, 4\)"),
        (np.ones((6, 6)), np.ones((6, 0)), r"no columns"),
    ],
)
def test_factors_of_another_model_are_refused(rows: Any, columns: Any, message: str) -> None:
    """Shapes that cannot belong to the model: the message has the shape and the rule."""
    with pytest.raises(OptionError, match=message):
        mode_quality(sampled(), rows, columns)


def test_a_continuous_model_is_refused() -> None:
    """Factors are made of powers of a discrete A."""
    with pytest.raises(OptionError, match="discrete"):
        mode_quality(proportional().state_space("displacement"), np.ones((6, 6)))


# -- in the diagnostics of a fit


def test_quality_is_read_back_from_a_saved_fit(tmp_path: Path) -> None:
    """Figures in the diagnostics survive a file; the order of modes is that of modes_of."""
    model = sampled()
    quality = mode_quality(model, *exact_factors(model, 6, 6))
    fit = known_fit(model, diagnostics=Diagnostics(quality.as_figures()))
    assert_alike(quality_of(load(save(fit, tmp_path / "fit.h5"))), quality, atol=0)


def test_a_fit_without_figures_has_its_collinearity() -> None:
    """Nothing was judged, or the model has other modes since: NaN but for the shapes."""
    fit = known_fit(sampled())
    stale = replace(fit, diagnostics=Diagnostics({"mode_emac": np.ones(2)}))
    for each in (fit, stale):
        quality = quality_of(each)
        assert np.isnan([quality.emac, quality.emac_outputs, quality.msv]).all()
        np.testing.assert_allclose(quality.phase_collinearity, 1, atol=1e-8)
