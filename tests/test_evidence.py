"""Longer evidence: large records, many seeds, large structures."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.structures import chain, shear_frame

pytestmark = pytest.mark.slow


def peak_of_identification(folder: Path, n_samples: int) -> float:
    """Return the peak memory [bytes] of identifying a memory-mapped record."""
    frame = chain(np.ones(4), np.full(4, 1.5e4), damping_ratio=0.01)
    rng = np.random.default_rng(0)
    force = white_noise(n_samples, 4, rng=rng)
    record = frame.simulate(force, 0.01, forces=frame.dofs, noise=0.05, rng=rng)
    np.save(folder / "u.npy", record.inputs)
    np.save(folder / "y.npy", record.outputs)
    del record, force
    mapped = vb.Record(
        np.load(folder / "y.npy", mmap_mode="r"), np.load(folder / "u.npy", mmap_mode="r"), dt=0.01
    )
    tracemalloc.start()
    fit = vb.identify(mapped, vb.N4SID(block_rows=30), order=8)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_allclose(fit.model.frequencies_hz, frame.frequencies_hz, rtol=3e-3)
    return float(peak)


def test_memory_does_not_grow_with_the_record(tmp_path: Path) -> None:
    """Three times the samples on disk need hardly more memory: chunks reach their full size.

    The explicit Hankel matrix would hold 2.3 GB, the record itself 38 MB.
    """
    small = peak_of_identification(tmp_path, 200_000)
    large = peak_of_identification(tmp_path, 600_000)
    assert large < 1.25 * small
    assert large < 100e6


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_shaker_tests_are_unbiased(noise: float) -> None:
    """Over 40 seeds the mean error of f and ζ is within 4 standard errors or 0.2 % and 2 %."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.01)
    frequencies, damping = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        force = white_noise(6000, rng=rng, std=100.0)
        record = frame.simulate(force, 0.02, forces=["f1"], noise=noise, rng=rng)
        modes = vb.modes_of(vb.identify(record, vb.N4SID(block_rows=40), order=8))
        assert modes.n_modes == 4
        frequencies.append(modes.frequencies_hz / frame.frequencies_hz - 1)
        damping.append(modes.damping_ratios / frame.damping_ratios - 1)
    for errors, slack in ((frequencies, 2e-3), (damping, 2e-2)):
        mean = np.abs(np.mean(errors, axis=0))
        error = np.std(errors, axis=0) / np.sqrt(len(errors))
        assert (mean < np.maximum(4 * error, slack)).all()
        assert (mean < 5 * slack).all()


def test_automatic_order_is_right_in_most_seeds() -> None:
    """Of 20 noisy shaker tests, at least 18 get the true order 8, none an unstable model."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.01)
    orders = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        force = white_noise(4000, rng=rng, std=100.0)
        fit = vb.identify(frame.simulate(force, 0.02, forces=["f1"], noise=0.05, rng=rng))
        assert fit.model.is_stable
        orders.append(fit.order)
    assert sum(order == 8 for order in orders) >= 18, orders


@pytest.mark.parametrize("method", [vb.N4SID(weighting="moesp", block_rows=16), None])
def test_large_structures_are_exact(method: vb.N4SID | None) -> None:
    """Thirty DOF, sixty states, noise-free: damping to 1e-8."""
    frame = chain(np.linspace(1, 2, 30), np.full(30, 900.0), rayleigh=(0.05, 2e-4))
    rng = np.random.default_rng(0)
    start = 0.1 * rng.standard_normal(60)
    if method is None:
        record = frame.simulate(None, 0.04, initial_state=start, n_samples=3000)
        fit = vb.identify(record, vb.SSI(kind="data", block_rows=16), order=60)
    else:
        force = white_noise(8000, 3, rng=rng)
        record = frame.simulate(force, 0.04, forces=frame.dofs[:3], initial_state=start)
        fit = vb.identify(record, method, order=60)
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=1e-8)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=1e-8)


def test_ambient_frequencies_over_seeds() -> None:
    """Outputs alone, 20 seeds: every mode among the steady ones, frequencies unbiased."""
    frame = shear_frame(4, 100.0, 2e5, damping_ratio=0.01)
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        force = white_noise(15_000, 4, rng=rng, std=100.0)
        record = frame.simulate(force, 0.02, forces=frame.dofs, noise=0.05, rng=rng)
        modes = vb.modes_of(vb.identify(record.select(inputs=[]), vb.SSI(block_rows=20)))
        nearest = np.abs(modes.frequencies_hz[:, None] - frame.frequencies_hz).argmin(axis=0)
        errors.append(modes.frequencies_hz[nearest] / frame.frequencies_hz - 1)
    assert (np.abs(errors) < 0.01).all()
    error = np.std(errors, axis=0) / np.sqrt(len(errors))
    assert (np.abs(np.mean(errors, axis=0)) < 4 * error).all()
