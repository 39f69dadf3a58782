"""What is answered and what is refused: excitations that blind identification meets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vibrid as vb
from studies.blind_excitations import BAD, DT, HZ, N, displaced, many_lines, phasors
from studies.blind_records import (
    REFERENCE,
    Case,
    off,
    reference,
    under_noise,
    under_sines,
    uniform_chain,
)
from vibrid.blind import identify_blind
from vibrid.errors import OptionError
from vibrid.excitation import coloured_noise
from vibrid.structures import chain


@pytest.mark.parametrize("name", BAD)
def test_bad_cases_are_refused(name: str, rng: np.random.Generator) -> None:
    """One run at 40 dB of every case that has no answer, as a user would call it."""
    record = BAD[name](rng, 40.0)
    found = identify_blind(record, record.n_outputs)
    assert not found.accepted, str(found.verdict)
    assert np.isnan(found.normalized_stiffness).all()


def test_a_force_free_stretch_is_a_decay(rng: np.random.Generator) -> None:
    """The stretch after a stop answers where the whole record cannot."""
    case = under_noise(REFERENCE, [0, 1, 2], duration=20.0, snr_db=None, rng=rng, dt=DT)
    model = REFERENCE.state_space(forces=REFERENCE.dofs).to_discrete(DT)
    force = case.force @ REFERENCE.mass
    force[len(force) // 2 :] = 0
    y = model.simulate(force)
    found = identify_blind(vb.Record(y, dt=DT), 3, force_free=(10.1, 20.0))
    assert found.accepted and found.verdict.kind == "decay"
    assert off(found.normalized_stiffness, case.stiffness) < 1e-8


def test_a_force_outside_the_modes(rng: np.random.Generator) -> None:
    """Random forces on every DOF from 6 to 10 Hz: their band, if given, tells the modes below."""
    case = under_noise(
        REFERENCE, [0, 1, 2], duration=16.0, snr_db=60, rng=rng, band_hz=(6.0, 10.0), dt=DT
    )
    assert not identify_blind(case.record, 3).accepted
    found = identify_blind(case.record, 3, force_band=(5.9, 10.1))
    assert found.accepted and found.verdict.kind == "out_of_band"
    codes = [each.code for each in found.verdict.findings]
    assert {"tried_periodic", "tried_point"} <= set(codes)
    assert off(found.normalized_stiffness, case.stiffness) < 1e-2
    assert off(found.normalized_force, case.force) < 0.1
    published = identify_blind(case.record, 3, method="subspace", force_band=(5.9, 10.1))
    np.testing.assert_array_equal(published.normalized_stiffness, found.normalized_stiffness)


def test_a_force_among_the_modes_is_refused_with_its_band(rng: np.random.Generator) -> None:
    """Its band changes nothing where it holds modes: the reason is said, and all attempts."""
    record = many_lines(rng, 50.0)
    found = identify_blind(record, 3, force_band=(0.2, 8.1))
    assert not found.accepted and np.isnan(found.normalized_stiffness).all()
    assert found.verdict.rule == "in_band"
    assert "explains the record" in str(found.verdict)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"excitation": "decay"}, "excitation='decay'"),
        ({"excitation": "ambient"}, "excitation='ambient'"),
        ({"force_free": (1.0, 2.0)}, "not both"),
        ({"structure": "chain"}, "leave one out"),
        ({"method": "subspace", "excitation": "point"}, "periodic forces and decays"),
        ({"method": "subspace", "input_frequencies_hz": [1.0]}, "input_frequencies_hz="),
    ],
)
def test_a_band_that_nothing_heeds_is_refused(
    options: dict[str, Any], said: str, rng: np.random.Generator
) -> None:
    """No option is passed over in silence."""
    with pytest.raises(OptionError, match=said):
        identify_blind(many_lines(rng, 50.0), 3, force_band=(0.3, 8.0), **options)


def ambient(duration: float, rng: np.random.Generator) -> tuple[vb.Record, Case]:
    structure = uniform_chain(3)
    n_samples = int(duration * 50)
    force = coloured_noise(n_samples, 0.02, 3, rng=rng, high_hz=10.0)
    record = structure.simulate(
        force, 0.02, forces=structure.dofs, hold="band_limited", noise=0.01, rng=rng
    ).select(inputs=[])
    return record, Case(record, structure, force)


def test_ambient_is_assumed_and_said(rng: np.random.Generator) -> None:
    """SSI with real shapes: M⁻¹K within one per cent, and the assumption is repeated."""
    record, case = ambient(600.0, rng)
    found = identify_blind(record, 3, excitation="ambient")
    assert found.accepted and found.verdict.kind == "ambient"
    assert "broadband forces" in str(found.verdict) and "real shapes" in str(found.verdict)
    assert off(found.normalized_stiffness, case.stiffness) < 1e-2
    assert np.isnan(found.normalized_force).all()


def test_ambient_names_what_stays(rng: np.random.Generator) -> None:
    """One sensor on three modes is refused; two sensors at one place have no structure."""
    record, _ = ambient(120.0, rng)
    found = identify_blind(record.select(outputs=["acceleration_f1"]), 1, excitation="ambient")
    assert not found.accepted and found.verdict.rule == "R2"
    y = np.array(record.outputs)
    y[:, 1] = y[:, 0]
    assert not identify_blind(vb.Record(y, dt=DT), 3, excitation="ambient").accepted


@pytest.mark.slow
@pytest.mark.parametrize("duration", [60.0, 600.0])
def test_ambient_deviations_cover(duration: float) -> None:
    """Fifteen runs: 90 to 100 % of the true entries within two deviations, errors as predicted."""
    scores, errors, predicted = [], [], []
    for seed in range(15):
        record, case = ambient(duration, np.random.default_rng(seed))
        found = identify_blind(record, 3, excitation="ambient")
        if found.accepted:
            wrong = found.normalized_stiffness - case.stiffness
            scores.append(np.abs(wrong / found.normalized_stiffness_std))
            errors.append(np.linalg.norm(wrong))
            predicted.append(np.linalg.norm(found.normalized_stiffness_std))
    assert len(scores) >= 13
    assert np.mean(np.array(scores) < 2) > 0.9
    assert 0.4 < np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(predicted))) < 1.2


def test_ambient_is_never_chosen(rng: np.random.Generator) -> None:
    """The same record without the user's word is refused."""
    record, _ = ambient(120.0, rng)
    found = identify_blind(record, 3)
    assert not found.accepted and found.verdict.rule == "in_band"


@pytest.mark.parametrize(
    ("excitation", "options"),
    [
        ("point", {"hold": "zoh"}),
        ("point", {"input_frequencies_hz": np.array([1.0, 2.0])}),
        ("base", {"structure": "chain"}),
        ("decay", {"input_frequencies_hz": [1.0]}),
        ("periodic", {"ungrounded": ["f1"]}),
        ("ambient", {"ungrounded": ["f1"]}),
        ("decay", {"input_frequencies_hz": [1.0], "method": "subspace"}),
    ],
)
def test_options_without_a_use_are_refused(excitation: str, options: dict[str, Any]) -> None:
    """No option is passed over in silence, whatever the excitation."""
    with pytest.raises(OptionError, match=f"{next(iter(options))}=.* is not used with"):
        identify_blind(reference(0, 60).record, 3, excitation=excitation, **options)


def test_nothing_at_all_is_refused() -> None:
    """An empty list of records is an error in words."""
    for excitation in ("auto", "point", "ambient", "decay"):
        with pytest.raises(OptionError, match="empty"):
            identify_blind([], 3, excitation=excitation)


def test_options_may_be_arrays() -> None:
    """Frequencies, bands and stretches from numpy."""
    record = reference(0, 60).record
    assert identify_blind(record, 3, input_frequencies_hz=HZ).accepted
    decay = under_sines(
        REFERENCE,
        np.array([1.0]),
        np.zeros((3, 1), dtype=np.complex128),
        dt=DT,
        n_samples=N,
        start=np.array([0.1, -0.05, 0.08, 0, 0, 0]),
        snr_db=60.0,
        rng=np.random.default_rng(0),
    )
    assert identify_blind(decay.record, 3, force_free=np.array([0.1, 20.0])).accepted
    assert not identify_blind(record, 3, excitation="point", force_band=np.array([0.3, 8])).accepted


def test_a_decay_that_is_none_is_doubted() -> None:
    """Sines in what was said to be a decay are found and said."""
    found = identify_blind(reference(0, 60).record, 3, excitation="decay")
    assert any(each.code == "not_a_decay" for each in found.verdict.findings)


def test_methods_agree_without_noise() -> None:
    """The published subspace method and maximum likelihood give the same matrices."""
    case = reference(3, None)
    found = [identify_blind(case.record, 3, method=name) for name in ("ml", "subspace")]
    assert off(found[0].normalized_stiffness, found[1].normalized_stiffness) < 1e-8


def test_input_at_a_frequency_of_the_structure(rng: np.random.Generator) -> None:
    """A sine exactly at the second mode is no obstacle without noise."""
    hertz = np.array([0.7, REFERENCE.frequencies_hz[1], 5.1])
    case = under_sines(REFERENCE, hertz, phasors(rng, 3), dt=DT, n_samples=N, start=displaced(rng))
    found = identify_blind(case.record, 3)
    assert found.accepted
    assert off(found.normalized_stiffness, case.stiffness) < 1e-8


def test_what_cannot_be_tried_is_a_note() -> None:
    """A clipped record has no quiet band for point forces; the refusal of the sines stands."""
    rng = np.random.default_rng(1)
    frame = chain([2.0, 1.5, 1.0], [600.0, 400.0, 300.0], damping_ratio=0.01)
    case = under_sines(
        frame,
        HZ,
        phasors(rng, 5),
        dt=DT,
        n_samples=2 * N,
        start=displaced(rng),
        snr_db=40.0,
        rng=rng,
    )
    y = case.record.outputs
    y = np.clip(y, *np.quantile(y, [0.02, 0.98]))
    found = identify_blind(vb.Record(y, dt=DT), 3)
    assert [each.rule for each in found.verdict.refusals] == ["R4"]
    assert "could not be tried" in str(found.verdict.findings[-1])


@pytest.mark.slow
@pytest.mark.parametrize("snr_db", [50.0, 30.0])
@pytest.mark.parametrize("name", BAD)
def test_no_bad_case_is_ever_accepted(name: str, snr_db: float) -> None:
    """Four seeded runs of each; the study has all twenty."""
    for seed in range(4):
        record = BAD[name](np.random.default_rng([seed, 77]), snr_db)
        found = identify_blind(record, record.n_outputs)
        assert not found.accepted, f"{name}, run {seed}: {found.verdict}"


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 3.0])
@pytest.mark.parametrize("snr_db", [50.0, 30.0])
def test_good_cases_are_answered(offset: float, snr_db: float) -> None:
    """At least 9 of 10 runs (binomial band of 19 in 20), with errors as predicted."""
    accepted = 0
    for seed in range(10):
        case = reference(seed, snr_db, offset=offset)
        found = identify_blind(case.record, 3)
        if found.accepted:
            accepted += 1
            error = np.linalg.norm(found.normalized_stiffness - case.stiffness)
            assert error < 4 * np.linalg.norm(found.normalized_stiffness_std)
    assert accepted >= 9


def test_modes_outside_the_band_take_one_record() -> None:
    """With several records, or too short a one, the third way is left out, and that is said."""
    rng = np.random.default_rng(0)
    case = under_noise(
        REFERENCE, [0, 1, 2], duration=16.0, snr_db=60, rng=rng, band_hz=(6.0, 10.0), dt=DT
    )
    wide = (0.5, 20.0)  # more lines than a short record bears
    for data, band, why in (
        ([case.record, case.record], (5.9, 10.1), "one record"),
        (case.record.slice(0, 400), wide, "too few"),
    ):
        found = identify_blind(data, 3, force_band=band)
        assert not found.accepted
        said = [each.sentence for each in found.verdict.findings if each.code == "untried_band"]
        assert len(said) == 1 and why in said[0]


@pytest.mark.parametrize("method", ["ml", "subspace"])
@pytest.mark.parametrize(
    ("given", "why"),
    [
        (1.0, "list of numbers"),
        ([30.0], "Nyquist frequency 25 Hz; got 30"),
        ([np.nan], "got nan"),
        ([1.0, 1.0], "twice"),
    ],
)
def test_frequencies_that_do_not_fit(method: str, given: Any, why: str) -> None:
    """Both methods, and measured forces, refuse the same frequencies in the same words."""
    record = reference(0, 60).record
    forced = vb.Record(record.outputs, record.outputs[:, :1], dt=DT)
    for each in (record, forced):
        with pytest.raises(OptionError, match=why):
            identify_blind(each, 3, method=method, input_frequencies_hz=given)
