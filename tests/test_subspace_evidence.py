"""Longer evidence for the subspace family: damping bias by Monte Carlo, real records."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import scipy.signal as ss
from numpy.typing import NDArray

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.identification.assessment import assess_last
from vibrid.scores import fit_percent, relative_error
from vibrid.structures import Structure, chain

pytestmark = pytest.mark.slow
Floats = NDArray[np.float64]
DT = 0.05


def damping_errors(fit: vb.Fit, frame: Structure) -> Floats:
    """Return the relative error of each mode's damping ratio; NaN where a mode is missing."""
    modes = vb.modes_of(fit)
    if not modes.n_modes:
        return np.full(len(frame.frequencies_hz), np.nan)
    nearest = np.abs(modes.frequencies_hz[:, None] - frame.frequencies_hz).argmin(axis=0)
    apart = np.abs(modes.frequencies_hz[nearest] / frame.frequencies_hz - 1)
    errors = modes.damping_ratios[nearest] / frame.damping_ratios - 1
    return np.where(apart < 0.1, errors, np.nan)


# -- the automatic transition against the better of the two


def compared(
    make: Callable[[int], tuple[Structure, vb.Record]], rows: int, order: int, count: int
) -> dict[str, Floats]:
    """Return the errors (count, n_modes) of each transition's damping ratios."""
    errors: dict[str, list[Floats]] = {"auto": [], "regression": [], "shift": []}
    for seed in range(count):
        frame, record = make(seed)
        for transition, found in errors.items():
            method = vb.N4SID(block_rows=rows, transition=transition)
            fit = vb.identify(record, method, order=order, stability="project")
            found.append(damping_errors(fit, frame))
    return {name: np.array(found) for name, found in errors.items()}


def spread_of(errors: Floats) -> Floats:
    """Return the robust rms of each mode's errors; infinite where half of them are missing."""
    return np.median(np.where(np.isnan(errors), np.inf, np.abs(errors)), axis=0)


# -- light damping, coloured input


def coloured_test(seed: int, noise: float = 0.2, poles: int = 2) -> tuple[Structure, vb.Record]:
    """Return 1000 samples of a chain with 0.5 % damping under a low-pass force."""
    rng = np.random.default_rng(seed)
    frame = chain([1.0, 1.0, 1.0], [600.0, 600.0, 600.0], damping_ratio=0.005)
    b, a = ss.butter(poles, 0.4)
    force = ss.lfilter(b, a, white_noise(1000, 1, rng=rng), axis=0)
    return frame, frame.simulate(force, 0.02, forces=["f1"], noise=noise, rng=rng)


@pytest.mark.parametrize("poles", [2, 4])
@pytest.mark.parametrize("noise", [0.1, 0.2, 0.3])
def test_light_damping_under_coloured_force_is_nearly_unbiased(noise: float, poles: int) -> None:
    """At 20 block rows the median damping stays within the band of the better estimator.

    A regression alone is several times too high in such cases, shift invariance 4 to 71 %;
    in some of these records noise moves a pole of shift invariance over the unit circle.
    """
    errors = compared(lambda seed: coloured_test(seed, noise, poles), 20, 6, 20)
    assert np.isfinite(errors["auto"]).mean() > 0.95
    bias = np.abs(np.nanmedian(errors["auto"], axis=0))
    assert (bias < [0.71, 0.04, 0.09]).all(), bias
    assert (spread_of(errors["auto"]) <= 1.1 * spread_of(errors["shift"])).all()
    assert (spread_of(errors["regression"]) > 2 * spread_of(errors["auto"])).all()


# -- a structure that noise drives, too


def driven_test(seed: int) -> tuple[Structure, vb.Record]:
    """Return 2000 samples of a chain that unmeasured forces drive half as much as the known."""
    rng = np.random.default_rng(seed)
    frame = chain([1.0, 1.0, 1.0], [600.0, 600.0, 600.0], damping_ratio=0.01)
    forces = white_noise(2000, 3, rng=rng) * [1.0, 0.5, 0.5]
    record = frame.simulate(forces, DT, forces=frame.dofs, noise=0.05, rng=rng)
    return frame, record.select(inputs=[record.input_names[0]])


def test_process_noise_does_not_cost_the_better_estimator() -> None:
    """Both transitions do alike where noise drives the structure, and so does the choice."""
    errors = compared(driven_test, 20, 6, 20)
    better = np.minimum(spread_of(errors["regression"]), spread_of(errors["shift"]))
    assert (spread_of(errors["auto"]) <= 1.2 * better).all()
    assert (np.abs(np.nanmedian(errors["auto"], axis=0)) < 0.25).all()


# -- a bench test: noise at the sensors alone


def bench_test(seed: int) -> tuple[Structure, vb.Record]:
    """Return 3000 samples of a chain with 0.3 % damping, 5 % noise at the sensors."""
    rng = np.random.default_rng(seed)
    frame = chain(np.ones(4), np.full(4, 16150.0), damping_ratio=0.003)
    force = white_noise(3000, 1, rng=rng)
    return frame, frame.simulate(force, 0.01, forces=["f1"], noise=0.05, rng=rng)


def damping_bound() -> Floats:
    """Return the Cramér-Rao bound of the bench test's damping ratios, relative."""
    frame, record = bench_test(0)
    start = vb.identify(record, vb.N4SID(block_rows=60), order=8)
    refined = vb.modes_of(vb.refine(start, record, noise="output_error"))
    assert refined.damping_std is not None
    return np.asarray(refined.damping_std / frame.damping_ratios)


@pytest.mark.parametrize(("rows", "asked"), [(20, [6, 3.2, 1.9, 1.7]), (60, [3.1, 1.6, 1.6, 1.6])])
def test_bench_tests_reach_the_better_estimator(rows: int, asked: list[float]) -> None:
    """The automatic transition is as good as the better of the two on every mode.

    `asked` is the rms error over the Cramér-Rao bound that the better estimator was seen to reach
    on such a chain; 20 records tell it to two standard deviations of 16 %.
    """
    errors = compared(bench_test, rows, 8, 20)
    rms = {name: np.sqrt(np.nanmean(np.square(each), axis=0)) for name, each in errors.items()}
    better = np.minimum(rms["regression"], rms["shift"])
    assert (rms["auto"] < 1.2 * better + 0.002).all(), rms
    ratios = rms["auto"] / damping_bound()
    assert (ratios < 1.32 * np.array(asked)).all(), ratios


# -- closed loop


def closed_loop(seed: int, n_samples: int, gain: float) -> tuple[Structure, vb.Record]:
    """Return a chain whose second velocity drives its first force, one sample later."""
    frame = chain([1.0, 1.0], [800.0, 800.0], damping_ratio=0.01)
    model = frame.state_space(sensors="velocity", forces=frame.dofs).to_discrete(0.03)
    A, B, C = model.A, model.B, model.C
    rng = np.random.default_rng(seed)
    disturbance = 0.3 * rng.standard_normal((n_samples, 2)) @ B.T
    reference, noise = 0.3 * rng.standard_normal(n_samples), rng.standard_normal((n_samples, 2))
    x, seen = np.zeros(4), 0.0
    u, y = np.zeros((n_samples, 1)), np.zeros((n_samples, 2))
    for t in range(n_samples):
        u[t] = reference[t] + gain * seen
        y[t] = C @ x + 0.002 * noise[t]
        seen = y[t, 1]
        x = A @ x + B[:, 0] * u[t] + disturbance[t]
    channels = [vb.Channel("v1", "velocity"), vb.Channel("v2", "velocity")]
    return frame, vb.Record(y, u, dt=0.03, output_channels=channels)


@pytest.mark.parametrize("weighting", ["auto", "ssarx"])
def test_feedback_does_not_bias_damping(weighting: str) -> None:
    """In closed loop the second damping ratio stays within 3 %, the first within its spread.

    Shift invariance of the projected matrix is 60 % and 470 % too high here.
    """
    errors, biased = [], []
    for seed in range(6):
        frame, record = closed_loop(seed, 40_000, -4.0)
        fit = vb.identify(record, vb.N4SID(weighting=weighting, block_rows=25), order=4)
        assert "feedback" in [finding.code for finding in fit.diagnostics.findings]
        assert fit.diagnostics.figures["transition"] == "regression"
        errors.append(damping_errors(fit, frame))
        if weighting == "auto":
            shift = vb.N4SID(block_rows=25, transition="shift")
            other = vb.identify(record, shift, order=4, stability="project")
            biased.append(damping_errors(other, frame))
    spread = np.std(errors, axis=0) / np.sqrt(len(errors))
    bias = np.abs(np.mean(errors, axis=0))
    assert (bias < np.maximum(3 * spread, 0.03)).all(), (bias, spread)
    assert bias[1] < 0.05
    assert not biased or np.mean(biased, axis=0)[1] > 0.3


# -- real records, raw data; figures of Sima (SLICOT Working Note 2000-4)

REAL = {
    "robot_arm": (1, 1, 4, "moesp", 60, 0.0360),
    "evaporator": (3, 3, 4, "moesp", 20, 0.489),
    "dryer": (1, 1, 4, "moesp", 20, 0.015),
    "flutter": (1, 1, 6, "cva", 20, 0.237),
}


def daisy(folder: Path, name: str) -> vb.Record:
    table = np.loadtxt(folder / f"{name}.dat")
    m, p = REAL[name][:2]
    return vb.Record(table[:, -p:], table[:, -p - m : -p], dt=1.0)


def output_error(fit: vb.Fit, record: vb.Record) -> float:
    return relative_error(record.outputs, fit.simulate_record(record, "least_squares"))


@pytest.mark.parametrize("name", REAL)
def test_real_records_reach_the_published_errors(name: str, shared_data: Path) -> None:
    """Same order, raw data, initial state by least squares: no worse than the published error."""
    *_, order, weighting, rows, published = REAL[name]
    record = daisy(shared_data, name)
    fit = vb.identify(record, vb.N4SID(weighting, rows), order, offset="none")
    assert output_error(fit, record) <= published


@pytest.mark.parametrize("offset", ["none", "estimate"])
@pytest.mark.parametrize("name", REAL)
def test_automatic_choices_reach_the_published_errors(
    name: str, offset: str, shared_data: Path
) -> None:
    """Horizon, weighting and order left out, or the order given: within a factor of 1.05."""
    *_, order, _, _, published = REAL[name]
    record = daisy(shared_data, name)
    for asked in (order, "auto"):
        fit = vb.identify(record, order=asked, offset=offset)
        assert fit.model.is_stable
        assert output_error(fit, record) <= 1.05 * published, (asked, fit.order)


@pytest.mark.parametrize("offset", ["none", "estimate"])
def test_robot_arm_is_stable_at_every_order(offset: str, shared_data: Path) -> None:
    """Orders 2 to 12 with "project"; with "raise" a stable model or the error."""
    record = daisy(shared_data, "robot_arm")
    for order in range(2, 13):
        for weighting in ("cva", "moesp", "n4sid"):
            method = vb.N4SID(weighting, block_rows=20)
            fit = vb.identify(record, method, order, offset=offset, stability="project")
            assert fit.model.is_stable
            try:
                assert vb.identify(record, method, order, offset=offset).model.is_stable
            except vb.UnstableModelError as error:
                assert "magnitude" in str(error) and "Hz" in str(error)


def subframe(folder: Path) -> vb.Record:
    from scipy.io import loadmat

    table = loadmat(folder / "flexible_subframe.mat")["flexible_structure_dat"]
    return vb.Record(table[:, 2:], table[:, :2], dt=1 / 1024)


def test_subframe_order_20_explains_its_record(shared_data: Path) -> None:
    """28 accelerations by 20 states: mean fit at least 64 %; 53.7 to 56.5 % elsewhere."""
    record = subframe(shared_data)
    fit = vb.identify(record, vb.N4SID("moesp", block_rows=50), order=20)
    modelled = fit.simulate_record(record, "least_squares")
    assert fit_percent(record.outputs, modelled).mean() >= 64.0


def test_subframe_unseen_half_is_simulated(shared_data: Path) -> None:
    """Identified on the first half, order 44; the state carried over to the second."""
    record = subframe(shared_data)
    cut = record.n_samples // 2
    fit = vb.identify(record.slice(0, cut), vb.N4SID("cva", block_rows=30), order=44)
    unseen = assess_last(fit, record, cut)
    assert unseen.rule == "state carried over"
    assert unseen.fit_percent.mean() >= 94.0


def test_subframe_automatic_choices_come_within_a_point(shared_data: Path) -> None:
    """Horizon left out at order 20; horizon and order left out for the unseen half."""
    record = subframe(shared_data)
    fit = vb.identify(record, order=20)
    modelled = fit.simulate_record(record, "least_squares")
    assert fit_percent(record.outputs, modelled).mean() >= 63.0
    cut = record.n_samples // 2
    half = vb.identify(record.slice(0, cut))
    assert half.model.is_stable
    assert assess_last(half, record, cut).fit_percent.mean() >= 93.0
