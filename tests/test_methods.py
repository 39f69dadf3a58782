"""The contract that every method keeps, on structures with exact answers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import vibrid as vb
from vibrid.chunks import open_stream
from vibrid.excitation import white_noise
from vibrid.methods import METHODS
from vibrid.methods.ssi import KINDS
from vibrid.structures import Structure, chain

Floats = NDArray[np.float64]
EXACT = 1e-8  # relative, promised for noise-free data; measured 1e-12
DT = 0.05


@dataclass(frozen=True)
class Case:
    """A method with what it is fed: forced records or free decays."""

    name: str
    make: Callable[[int], Any]
    forced: bool


def rows(order: int) -> int:
    return max(4, order + 4)


CASES = [
    Case("n4sid-cva", lambda n: vb.N4SID(weighting="cva", block_rows=rows(n)), True),
    Case("n4sid-moesp", lambda n: vb.N4SID(weighting="moesp", block_rows=rows(n)), True),
    Case("n4sid-n4sid", lambda n: vb.N4SID(weighting="n4sid", block_rows=rows(n)), True),
    Case("n4sid-ssarx", lambda n: vb.N4SID(weighting="ssarx", block_rows=rows(n)), True),
    Case("ssi-covariance", lambda n: vb.SSI(kind="covariance", block_rows=rows(n)), False),
    Case("ssi-data", lambda n: vb.SSI(kind="data", block_rows=rows(n)), False),
    Case("ssi-cva", lambda n: vb.SSI(kind="cva", block_rows=rows(n)), False),
    Case("ssi-stochastic", lambda n: vb.SSI(kind="stochastic", block_rows=rows(n)), False),
    Case("okid", lambda n: vb.OKID(observer_order=rows(n)), True),
    Case("okid-eradc", lambda n: vb.OKID(observer_order=rows(n), realization="eradc"), True),
    Case("era", lambda n: vb.ERA(rows=max(20, rows(n))), False),
    Case("eradc", lambda n: vb.ERADC(), False),
]
FORCED = [case for case in CASES if case.forced]
SIZES = [1, 2, 3, 5, 8, 10]


def structure(n_dof: int) -> Structure:
    """Return a chain with modes spread below Nyquist and 1 to 2 % damping."""
    masses = np.linspace(1.0, 1.5, n_dof)
    return chain(masses, np.full(n_dof, 800.0), rayleigh=(0.1, 2e-4))


def record_of(
    n_dof: int, forced: bool, rng: np.random.Generator, forces: str = "one"
) -> tuple[Structure, vb.Record]:
    """Return a noise-free record of accelerations that starts mid-motion."""
    frame = structure(n_dof)
    start = 0.1 * rng.standard_normal(2 * n_dof)
    if not forced:
        return frame, frame.simulate(None, DT, initial_state=start, n_samples=700)
    pushed = frame.dofs[:1] if forces == "one" else frame.dofs
    force = white_noise(3000, len(pushed), rng=rng)
    return frame, frame.simulate(force, DT, forces=pushed, initial_state=start)


def poles_of(frame: Structure) -> Floats:
    return np.sort_complex(frame.poles)


def identified_poles(fit: vb.Fit) -> Floats:
    modes = vb.modes_of(fit)
    return np.sort_complex(np.concatenate([modes.poles, modes.poles.conj()]))


def assert_same_modes(fit: vb.Fit, frame: Structure, tolerance: float = EXACT) -> None:
    modes = vb.modes_of(fit)
    assert modes.n_modes == len(frame.frequencies_hz)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=tolerance)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=tolerance)


@pytest.mark.parametrize("n_dof", SIZES)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_noise_free_recovery(case: Case, n_dof: int, rng: np.random.Generator) -> None:
    """Poles, damping and shapes of chains of 1 to 10 DOF come back exactly."""
    frame, record = record_of(n_dof, case.forced, rng)
    fit = vb.identify(record, case.make(2 * n_dof), order=2 * n_dof)
    assert_same_modes(fit, frame)
    match = vb.mac(vb.modes_of(fit).shapes, frame.shapes)
    np.testing.assert_allclose(np.diag(match), 1, atol=EXACT)


@pytest.mark.parametrize("forces", ["one", "all"])
@pytest.mark.parametrize("n_dof", SIZES)
@pytest.mark.parametrize("case", FORCED, ids=lambda case: case.name)
def test_markov_parameters_are_exact(
    case: Case, n_dof: int, forces: str, rng: np.random.Generator
) -> None:
    """B, C and D with feedthrough come back: Markov parameters of 60 lags."""
    frame, record = record_of(n_dof, True, rng, forces)
    pushed = frame.dofs[:1] if forces == "one" else frame.dofs
    exact = frame.state_space(forces=pushed).to_discrete(DT).markov_parameters(60)
    fit = vb.identify(record, case.make(2 * n_dof), order=2 * n_dof)
    np.testing.assert_allclose(
        fit.model.markov_parameters(60), exact, atol=EXACT * abs(exact).max()
    )


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_offsets_and_initial_states_are_exact(case: Case, rng: np.random.Generator) -> None:
    """A record with offsets that starts mid-motion is reproduced to rounding."""
    frame, record = record_of(3, case.forced, rng)
    moved = vb.Record(
        record.outputs + np.array([5.0, -300.0, 0.02]),
        record.inputs + 7.0 if case.forced else None,
        dt=DT,
        output_channels=record.output_channels,
        input_channels=record.input_channels if case.forced else None,
    )
    fit = vb.identify(moved, case.make(6), order=6)
    assert_same_modes(fit, frame)
    simulated = fit.simulate(
        moved.inputs if case.forced else None,
        fit.initial_states[0],
        n_samples=None if case.forced else moved.n_samples,
    )
    np.testing.assert_allclose(simulated, moved.outputs, atol=EXACT * record.outputs.std())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_order_sweep_equals_single_calls(case: Case, rng: np.random.Generator) -> None:
    """One decomposition gives every order what a decomposition of its own gives."""
    _, clean = record_of(3, case.forced, rng)
    noise = 0.05 * clean.outputs.std() * rng.standard_normal(clean.outputs.shape)
    record = vb.Record(clean.outputs + noise, clean.inputs, dt=DT)
    method = case.make(10)
    shared = method.decompose(record)
    for order in (2, 5, 6, 10):
        one = method.realize(shared, order)
        other = method.realize(method.decompose(record), order)
        np.testing.assert_allclose(one.model.A, other.model.A, atol=1e-9)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_channel_order_and_units_do_not_matter(case: Case, rng: np.random.Generator) -> None:
    """Outputs permuted and in other units give the same poles and the same shapes."""
    _, record = record_of(3, case.forced, rng)
    units = np.array([1e-8, 1.0, 1e5])
    other = vb.Record(record.outputs[:, [2, 0, 1]] * units, record.inputs * 1e4, dt=DT)
    first = vb.modes_of(
        vb.identify(vb.Record(record.outputs, record.inputs, dt=DT), case.make(6), order=6)
    )
    second = vb.modes_of(vb.identify(other, case.make(6), order=6))
    np.testing.assert_allclose(second.poles, first.poles, rtol=EXACT)
    shapes = (second.shapes / units[:, None])[[1, 2, 0]]
    np.testing.assert_allclose(np.diag(vb.mac(shapes, first.shapes)), 1, atol=EXACT)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_gaps_and_several_records_are_exact(case: Case, rng: np.random.Generator) -> None:
    """A record with a NaN gap and a second record are one identification."""
    frame, record = record_of(3, case.forced, rng)
    y = record.outputs.copy()
    y[170] = np.nan
    _, again = record_of(3, case.forced, rng)
    broken = vb.Record(y, record.inputs, dt=DT)
    second = vb.Record(again.outputs, again.inputs, dt=DT)
    fit = vb.identify([broken, second], case.make(6), order=6)
    modes = vb.modes_of(fit)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=EXACT)
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=EXACT)
    assert [(s.record, s.start) for s in fit.segments] == [(0, 0), (0, 171), (1, 0)]
    assert np.isfinite(fit.initial_states).all()


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_memory_mapped_equals_memory(
    case: Case, rng: np.random.Generator, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A record on disk, read in small chunks, gives the model of the record in memory."""
    _, clean = record_of(2, case.forced, rng)
    noise = 0.05 * clean.outputs.std() * rng.standard_normal(clean.outputs.shape)
    whole = vb.Record(clean.outputs + noise, clean.inputs, dt=DT)
    np.save(tmp_path / "y.npy", whole.outputs)
    disk = vb.Record(
        np.load(tmp_path / "y.npy", mmap_mode="r"), whole.inputs if case.forced else None, dt=DT
    )
    expected = vb.identify(whole, case.make(4), order=4, stability="ignore")
    monkeypatch.setattr("vibrid.record.signals.CHUNK_BYTES", 1)
    found = vb.identify(disk, case.make(4), order=4, stability="ignore")
    np.testing.assert_allclose(
        np.sort_complex(found.model.poles), np.sort_complex(expected.model.poles), rtol=1e-10
    )


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_displacements_have_no_feedthrough(case: Case, rng: np.random.Generator) -> None:
    """With displacement sensors D is zero and the modes are exact all the same."""
    frame = structure(3)
    force = white_noise(3000, 1, rng=rng) if case.forced else None
    record = frame.simulate(
        force,
        DT,
        sensors="displacement",
        forces=frame.dofs[:1] if case.forced else (),
        initial_state=np.ones(6) * 0.1,
        n_samples=None if case.forced else 400,
    )
    fit = vb.identify(record, case.make(6), order=6)
    assert_same_modes(fit, frame)
    assert not fit.model.D.any()


# -- refusals

BAD = {
    "NaN everywhere": (lambda y: y * np.nan, "every row holds a NaN"),
    "constant": (lambda y: np.c_[y[:, :2], np.full(len(y), 7.0)], "do not move: y3"),
    "short": (lambda y: y[:20], r"needs at least \d+ samples; the record has 20"),
    "infinite": (lambda y: np.where(np.arange(len(y))[:, None] == 30, np.inf, y), "Sample 30"),
    "transposed": (lambda y: y.T, "time is axis 0"),
    "complex": (lambda y: y + 1j, "complex numbers"),
    "text": (lambda y: y.astype(str), "text"),
}


@pytest.mark.parametrize("kind", BAD)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_bad_data_are_refused_by_message(case: Case, kind: str, rng: np.random.Generator) -> None:
    """Data that cannot be identified give a DataError that says what is wrong."""
    change, message = BAD[kind]
    _, record = record_of(3, case.forced, rng)
    with pytest.raises(vb.DataError, match=message):
        y = change(record.outputs)
        u = record.inputs[: len(y)] if case.forced and kind != "transposed" else None
        vb.identify(vb.Record(y, u, dt=DT), case.make(6), order=6)


@pytest.mark.parametrize("order", [0, -2, 1000, 2.5, True, "many"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_impossible_orders_are_refused(case: Case, order: Any, rng: np.random.Generator) -> None:
    """Order 0, negative, fractional or too large is wrong use, with the limit named."""
    _, record = record_of(2, case.forced, rng)
    with pytest.raises(vb.OptionError, match="order"):
        vb.identify(record, case.make(4), order=order)


def test_short_record_message_names_the_cure() -> None:
    """The message holds the numbers: what is needed, what there is, how many rows would do."""
    record = vb.Record(np.random.default_rng(0).standard_normal((300, 3)), dt=1.0)
    with pytest.raises(vb.DataError) as caught:
        vb.identify(record, vb.SSI(block_rows=40), order=4)
    assert str(caught.value) == (
        "block_rows=40 with 3 outputs needs at least 319 samples; the record has 300. Use at "
        "most 37 block rows or a longer record."
    )
    assert vb.SSI(block_rows=37).decompose(record).largest_order > 4


@pytest.mark.parametrize("name", METHODS)
def test_unknown_options_are_errors(name: str) -> None:
    """A misspelt option never passes."""
    with pytest.raises(TypeError, match="blok_rows"):
        METHODS[name](blok_rows=4)
    if "block_rows" in {field.name for field in fields(METHODS[name])}:
        with pytest.raises(vb.OptionError, match="block_rows must be at least 2"):
            METHODS[name](block_rows=1)


def test_misspelt_choices_suggest_the_nearest() -> None:
    """The error names the choices and the nearest one."""
    with pytest.raises(vb.OptionError, match="Did you mean 'moesp'"):
        vb.N4SID(weighting="moseps")


def test_methods_refuse_the_wrong_kind_of_record(rng: np.random.Generator) -> None:
    """N4SID needs inputs, SSI takes none; the error names the other."""
    _, forced = record_of(1, True, rng)
    _, decay = record_of(1, False, rng)
    with pytest.raises(vb.DataError, match="use SSI"):
        vb.identify(decay, vb.N4SID())
    with pytest.raises(vb.DataError, match="use N4SID"):
        vb.identify(forced, vb.SSI())


def test_references_are_a_choice_of_past(rng: np.random.Generator) -> None:
    """Reference channels shrink the past and keep the modes; unknown names are refused."""
    frame, record = record_of(3, False, rng)
    first = record.output_names[0]
    for kind in KINDS:
        method = vb.SSI(kind=kind, block_rows=12, references=(first,))
        assert method.decompose(record).state_map.shape[1] == 12
        assert_same_modes(vb.identify(record, method, order=6), frame)
    with pytest.raises(vb.OptionError, match="No output is called 'top'"):
        vb.identify(record, vb.SSI(references=("top",)))


# -- published reference


def test_slicot_example_to_its_printed_digits(shared_data: Path) -> None:
    """SLICOT's documentation example: singular values, poles, Markov parameters, DC gain."""
    data = np.load(shared_data / "slicot_ib01.npz")
    record = vb.Record(data["y"].T, data["u"].T, dt=1.0)
    method = vb.N4SID(weighting="moesp", block_rows=15, transition="shift")
    fit = vb.identify(record, method, order=4, offset="none")
    printed = [69.8841, 14.9963, 3.6675, 1.9677, 0.3000, 0.2078, 0.1651, 0.1373, 0.1133]
    np.testing.assert_allclose(fit.singular_values[:6], printed[:6], atol=6e-5)
    exact = [0.475801 - 0.199905j, 0.475801 + 0.199905j, 0.745563, 0.961022]
    np.testing.assert_allclose(np.sort_complex(fit.model.poles), exact, atol=1e-6)
    markov = [-0.0041, -0.0004, 0.0007, 0.0740, 0.1251, 0.1405, 0.1313, 0.1109, 0.0881]
    np.testing.assert_allclose(fit.model.markov_parameters(9)[:, 0, 0], markov, atol=3e-3)
    gain = fit.model.frequency_response(np.array([0.0]))[0, 0, 0].real
    np.testing.assert_allclose(gain, 1.0009, rtol=0.06)


# -- statistics


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_errors_shrink_with_the_record(case: Case) -> None:
    """Sixteen times the data quarter the rms frequency error, within a factor of 2."""
    make = noisy_test if case.forced else noisy_response
    spread = []
    for n_samples in (2000, 32_000):
        errors = []
        for seed in range(12):
            frame, record = make(n_samples, np.random.default_rng(seed))
            method = case.make(4)
            if hasattr(method, "transition"):
                method = replace(method, transition="shift")
            if hasattr(method, "observer_order"):
                method = replace(method, observer_order=None)  # a fixed one leaves a bias
            modes = vb.modes_of(vb.identify(record, method, order=4, stability="project"))
            nearest = np.abs(modes.frequencies_hz[:, None] - frame.frequencies_hz).min(axis=0)
            errors.append(nearest / frame.frequencies_hz)
        spread.append(np.sqrt(np.mean(np.square(errors))))
    assert 2 < spread[0] / spread[1] < 8


def noisy_test(n_samples: int, rng: np.random.Generator) -> tuple[Structure, vb.Record]:
    frame = structure(2)
    force = white_noise(n_samples, 1, rng=rng)
    return frame, frame.simulate(force, DT, forces=frame.dofs[:1], noise=0.1, rng=rng)


def noisy_response(n_samples: int, rng: np.random.Generator) -> tuple[Structure, vb.Record]:
    frame = structure(2)
    force = white_noise(n_samples, 2, rng=rng)
    driven = frame.simulate(force, DT, forces=frame.dofs, noise=0.1, rng=rng)
    return frame, driven.select(inputs=[])


def test_decomposition_takes_an_open_stream(rng: np.random.Generator) -> None:
    """`decompose` of a stream or of its record is the same."""
    _, record = record_of(2, True, rng)
    method = vb.N4SID(block_rows=8)
    a = method.decompose(record).singular_values
    b = method.decompose(open_stream(record)).singular_values
    np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_units_do_not_matter_with_noise_either(case: Case, rng: np.random.Generator) -> None:
    """Outputs in units that no power of two relates give the same poles from noisy data."""
    frame = structure(3)
    force = white_noise(4000, 3, rng=rng)
    record = frame.simulate(force, DT, forces=frame.dofs, noise=0.3, rng=rng)
    u = record.inputs if case.forced else None
    poles = []
    for units in (np.ones(3), np.array([1.42, 1.9e3, 0.71e-4])):
        method = case.make(6)
        shared = method.decompose(vb.Record(record.outputs * units, u, dt=DT))
        poles.append(np.sort_complex(method.realize(shared, 6).model.poles))
    np.testing.assert_allclose(poles[1], poles[0], rtol=1e-8)
