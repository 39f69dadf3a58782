"""What is answered and what is refused: excitations that blind identification meets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from blind_records import (
    REFERENCE,
    SINES_HZ,
    Case,
    off,
    reference,
    under_noise,
    under_sines,
    uniform_chain,
)

import vibrid as vb
from vibrid.blind import identify_blind
from vibrid.errors import OptionError
from vibrid.excitation import coloured_noise
from vibrid.structures import chain

HZ = np.array(SINES_HZ)
DT, N = 0.02, 1500


def phasors(rng: np.random.Generator, count: int, n_dof: int = 3) -> np.ndarray:
    return np.exp(1j * rng.uniform(0, 2 * np.pi, (n_dof, count)))


def displaced(rng: np.random.Generator, n_dof: int = 3) -> np.ndarray:
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


BAD = {
    "no transient": no_transient,
    "40 s after the start": long_after_the_start,
    "rigid-body mode": rigid_body,
    "30 sines": thirty_sines,
    "400 lines": many_lines,
    "force jump": force_jump,
    "2 sensors on 3 DOF": too_few_sensors,
}


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
        ({"method": "subspace", "input_frequencies_hz": [1.0]}, "not both"),
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
    """SSI with real shapes: M⁻¹K within per cents, and the assumption is repeated."""
    record, case = ambient(600.0, rng)
    found = identify_blind(record, 3, excitation="ambient")
    assert found.accepted and found.verdict.kind == "ambient"
    assert any(each.code == "ambient_assumed" for each in found.verdict.findings)
    assert off(found.normalized_stiffness, case.stiffness) < 3e-2
    assert np.isnan(found.normalized_force).all()


def test_ambient_is_never_chosen(rng: np.random.Generator) -> None:
    """The same record without the user's word is refused."""
    record, _ = ambient(120.0, rng)
    found = identify_blind(record, 3)
    assert not found.accepted and found.verdict.rule == "in_band"


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
