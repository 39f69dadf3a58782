"""Hammer tests: hits and their faults are found, windows are exact, responses are the system's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vibrid as vb
from vibrid.errors import DataError, OptionError
from vibrid.hammer import (
    exponential_window,
    find_hits,
    force_window,
    hammer_responses,
    hit_segments,
    undo_exponential_window,
)
from vibrid.record import Channel, Record
from vibrid.spectra import invert, next_correlations, undo_wrap
from vibrid.statespace import StateSpace
from vibrid.structures import Structure, chain

DT = 0.01
N = 10_200
TIMES = (2.0, 22.0, 42.0, 62.0, 82.0, 101.5)  # clean, clean, double, clipped, clean, at the end
LIMIT = 120.0  # of the force channel


def structure() -> Structure:
    """Return a chain with modes at 1.4, 3.9 and 5.8 Hz that takes 15 s to come to rest."""
    return chain([1.0, 1.2, 1.1], [400.0, 500.0, 450.0], rayleigh=(0.6, 1e-4))


def pulse(time: float, peak: float, n_samples: int = N, width: int = 8) -> np.ndarray:
    """Return a half sine of `width` samples that begins one after `time`."""
    force = np.zeros(n_samples)
    start = round(time / DT)
    force[start : start + width + 1] = peak * np.sin(np.pi * np.arange(width + 1) / width)
    return force


def true_force() -> np.ndarray:
    """Return five hits and a bounce of 40 % after 60 ms; the fourth exceeds the channel's limit."""
    peaks = (80.0, 100.0, 90.0, 200.0, 70.0, 85.0)
    force = sum(pulse(time, peak) for time, peak in zip(TIMES, peaks, strict=True))
    return np.asarray(force + pulse(TIMES[2] + 0.12, 36.0, width=6))


def measured() -> tuple[Record, np.ndarray]:
    """Return the record of a hammer at f2, its force limited, and the true force."""
    force = true_force()
    record = structure().simulate(force, DT, forces=["f2"], name="plate")
    return Record(
        record.outputs,
        np.minimum(force, LIMIT),
        dt=DT,
        output_channels=record.output_channels,
        input_channels=record.input_channels,
        name="plate",
    ), force


def same_poles(found: np.ndarray, frame: Structure) -> np.ndarray:
    """Return the relative errors of continuous poles [rad/s] of positive frequency."""
    kept = found[found.imag > 0]
    return np.asarray(np.abs(kept[np.argsort(np.abs(kept))] - frame.poles) / np.abs(frame.poles))


# -- hits


def test_hits_and_their_faults_are_found() -> None:
    """Time, peak and fault of each of six hits, and a sentence for each fault."""
    record, _ = measured()
    hits = find_hits(record)
    assert [hit.faults for hit in hits] == [(), (), ("double",), ("clipped",), (), ("short",)]
    peaks = np.add(TIMES, [0.04, 0.04, 0.04, 0.02, 0.04, 0.04])  # where the limiter begins
    np.testing.assert_allclose([hit.peak_sample * DT for hit in hits], peaks)
    np.testing.assert_allclose([hit.peak for hit in hits], [80, 100, 90, LIMIT, 70, 85])
    assert hits[2].second_ratio == pytest.approx(0.4)
    assert hits[2].second_seconds == pytest.approx(0.11)
    assert hits[2].end > round((TIMES[2] + 0.17) / DT)  # the bounce belongs to the pulse
    assert {hit.channel for hit in hits} == {"force_f2"}
    assert [finding.code for finding in hits.findings] == [
        "double hit",
        "clipped force",
        "short decay",
    ]
    assert "a second peak of 40 % 0.11 s later" in str(hits.findings[0])
    assert [round(hit.start * DT) for hit in hits.without("clipped", "short")] == [2, 22, 42, 82]


def test_noise_offset_and_sign_do_not_matter(rng: np.random.Generator) -> None:
    """Forces drawn downwards on an offset, noise of 1 % of the smallest: the same hits."""
    record, _ = measured()
    force = 3.0 - record.inputs + 0.7 * rng.standard_normal(record.inputs.shape)
    noisy = Record(record.outputs, np.maximum(force, 3.0 - LIMIT), dt=DT)
    hits = find_hits(noisy)
    assert [round(hit.peak_sample * DT) for hit in hits] == [2, 22, 42, 62, 82, 102]
    assert (hits[0].faults, hits[2].faults) == ((), ("double",))
    limited = find_hits(noisy, full_scale=LIMIT)
    assert "clipped" in limited[3].faults
    assert "clipped" not in limited[1].faults


def test_two_hammers_and_their_crosstalk() -> None:
    """Each hit is its own hammer's; what leaks into the other channel is said, not counted."""
    force = np.stack([pulse(2.0, 80.0), pulse(52.0, 90.0)], axis=1)
    leaky = force + 0.05 * pulse(2.0, 80.0)[:, None] * [0, 1]
    record = Record(np.zeros((N, 1)), leaky, dt=DT, input_channels=["a", "b"])
    hits = find_hits(record, threshold=0.02)
    assert [hit.channel for hit in hits] == ["a", "b"]
    assert [finding.code for finding in hits.findings] == ["crosstalk"]
    assert [hit.channel for hit in find_hits(record, "b")] == ["b"]


def test_gaps_end_hits() -> None:
    """A gap inside a pulse cuts it; a gap in a decay ends it."""
    record, _ = measured()
    y = record.outputs.copy()
    y[204] = np.nan
    y[3000] = np.nan
    hits = find_hits(Record(y, record.inputs, dt=DT))
    cut = [hit for hit in hits if "cut" in hit.faults]
    assert len(cut) == 2  # one on each side of the gap
    assert all(hit.piece == (0, 204) or hit.piece == (205, 3000) for hit in cut)
    assert [hit.stop for hit in hits if 2000 < hit.start < 3000] == [3000]


def test_what_is_no_hit_is_refused(rng: np.random.Generator) -> None:
    """Noise, no input, unknown names, thresholds and faults."""
    y = rng.normal(size=5000)
    with pytest.raises(DataError, match="No hit in u1"):
        find_hits(Record(y, rng.normal(size=5000), dt=DT))
    with pytest.raises(OptionError, match="no inputs"):
        find_hits(Record(y, dt=DT))
    record, _ = measured()
    with pytest.raises(OptionError, match="No input is called 'hammer'"):
        find_hits(record, "hammer")
    with pytest.raises(OptionError, match="between 0 and 1"):
        find_hits(record, threshold=2)
    with pytest.raises(OptionError, match="Did you mean 'double'"):
        hit_segments(record, accept=["doubles"])
    with pytest.raises(DataError, match="None of the 6 hits is free of faults"):
        hit_segments(record, find_hits(record, decay_seconds=30))


# -- segments


def test_segments_are_the_records_own_samples() -> None:
    """Clean hits only, eight samples before the pulse, up to the next."""
    record, _ = measured()
    segments = hit_segments(record)
    assert [part.name for part in segments] == [
        "plate, hit of force_f2 at 2.04 s",
        "plate, hit of force_f2 at 22.04 s",
        "plate, hit of force_f2 at 82.04 s",
    ]
    first = 201 - 8
    np.testing.assert_array_equal(
        segments[0].outputs, record.outputs[first : first + segments[0].n_samples]
    )
    assert first + segments[0].n_samples == 2201 - 8
    assert segments[0].output_channels == record.output_channels
    assert len(hit_segments(record, accept=["double", "short"])) == 5
    short = hit_segments(record, length=3.0, pre_trigger=0.5)
    assert {part.n_samples for part in short} == {300}
    assert short[0].inputs[:50].max() == 0 < short[0].inputs[50, 0]
    early = hit_segments(record, pre_trigger=30.0)  # not before the record, nor into another hit
    assert [part.n_samples for part in early] == [2193, 4193 - 208, 10143 - 6208]


def test_segments_identify_the_structure() -> None:
    """Hits that begin in motion or bounce are as good as any; a clipped one is not."""
    record, _ = measured()
    segments = hit_segments(record, accept=["double", "short"], length=5.0)
    fit = vb.identify(segments, vb.N4SID(block_rows=10), order=6)
    assert same_poles(fit.model.continuous_poles, structure()).max() < 1e-8


def test_baseline_is_that_before_the_pulse() -> None:
    """Offsets of all channels vanish; without a sample before there is no baseline."""
    record, _ = measured()
    moved = Record(record.outputs + 2.0, record.inputs - 5.0, dt=DT)
    parts = hit_segments(moved, remove_baseline=True)
    np.testing.assert_allclose(parts[0].outputs, hit_segments(record)[0].outputs, atol=1e-12)
    np.testing.assert_allclose(parts[0].inputs, hit_segments(record)[0].inputs, atol=1e-12)
    with pytest.raises(OptionError, match=r"no sample before the hit at 2\.04 s"):
        hit_segments(moved, remove_baseline=True, pre_trigger=0)


# -- windows


def test_force_window_removes_what_is_no_pulse(rng: np.random.Generator) -> None:
    """Zero between pulses, the force less its median within; outputs stay."""
    record, _ = measured()
    clean = force_window(record)
    np.testing.assert_allclose(clean.inputs, record.inputs, atol=1e-12)
    noise = 0.3 * rng.standard_normal(record.inputs.shape)
    noisy = Record(record.outputs, record.inputs + noise + 7.0, dt=DT)
    windowed = force_window(noisy)
    np.testing.assert_array_equal(windowed.outputs, record.outputs)
    inside = windowed.inputs != 0
    assert 6 * 6 <= inside.sum() <= 7 * 12
    assert inside[record.inputs > 2].all()
    np.testing.assert_allclose(windowed.inputs[inside], (record.inputs + noise)[inside], atol=0.02)


def test_force_window_makes_noisy_decays_better(rng: np.random.Generator) -> None:
    """With noise in the force channel, responses from windowed forces are nearer the truth."""
    record, _ = measured()
    noisy = Record(
        record.outputs, record.inputs + 0.3 * rng.standard_normal(record.inputs.shape), dt=DT
    )
    parts = hit_segments(noisy, find_hits(noisy, full_scale=LIMIT), length=18.0)
    model = structure().state_space("acceleration", ["f2"]).to_discrete(DT)

    def error(segments: list[Record]) -> float:
        found = hammer_responses(segments)
        kept = found.frequencies_hz < 10
        expected = model.frequency_response(found.frequencies_hz[kept])
        return float(np.linalg.norm(found.values[kept] - expected) / np.linalg.norm(expected))

    assert error([force_window(part) for part in parts]) < 0.3 * error(list(parts))


def test_damping_is_exact_after_an_exponential_window() -> None:
    """Poles, B and D of three-second segments, whose decays are cut, to 1e-8."""
    record, _ = measured()
    rate = np.log(100) / 3
    parts = [exponential_window(part, rate) for part in hit_segments(record, length=3.0)]
    fit = vb.identify(parts, vb.N4SID(block_rows=10), order=6, offset="none")
    assert same_poles(fit.model.continuous_poles, structure()).min() > 1e-3
    undone = undo_exponential_window(fit, rate)
    assert same_poles(undone.model.continuous_poles, structure()).max() < 1e-8
    model = structure().state_space("acceleration", ["f2"]).to_discrete(DT)
    np.testing.assert_allclose(
        undone.model.markov_parameters(200), model.markov_parameters(200), atol=1e-8
    )
    assert undone.diagnostics.findings[-1].code == "exponential window"
    modes = vb.modes_of(undone)
    np.testing.assert_allclose(modes.damping_ratios, structure().damping_ratios, rtol=1e-7)


def test_the_window_is_undone_in_either_time_domain() -> None:
    """Undoing commutes with sampling."""
    model = structure().state_space("displacement", ["f1"])
    undone = undo_exponential_window(model, 0.7)
    np.testing.assert_allclose(undone.poles - model.poles, 0.7, atol=1e-10)
    discrete = undo_exponential_window(model.to_discrete(DT), 0.7)
    np.testing.assert_allclose(
        np.sort_complex(discrete.continuous_poles), np.sort_complex(undone.poles), atol=1e-9
    )
    with pytest.raises(OptionError, match="rate must be positive"):
        undo_exponential_window(model, 0.0)


# -- frequency responses


def realized(pulses: np.ndarray, order: int) -> StateSpace:
    """Return the model of pulse responses by a plain Hankel matrix (Ho & Kalman, 1966)."""
    rows, (_, p, m) = 40, pulses.shape
    hankel = np.block([[pulses[1 + i + j] for j in range(rows)] for i in range(rows + 1)])
    U, s, Vt = np.linalg.svd(hankel[:-p], full_matrices=False)
    root = np.sqrt(s[:order])
    left, right = U[:, :order] * root, root[:, None] * Vt[:order]
    A = (U[:, :order].T / root[:, None]) @ hankel[p:] @ (Vt[:order].T / root)
    return StateSpace(A, right[:, :m], left[:p], pulses[0], DT)


def test_frequency_responses_of_dead_decays_are_exact() -> None:
    """Three hits from rest, long enough to die: the sampled system's own response, coherent."""
    force = pulse(0.5, 90.0, 6000) + pulse(30.5, 70.0, 6000, width=11)
    record = structure().simulate(force, DT, forces=["f2"])
    found = hammer_responses(hit_segments(record))
    model = structure().state_space("acceleration", ["f2"]).to_discrete(DT)
    expected = model.frequency_response(found.frequencies_hz)
    kept = found.frequencies_hz < 20  # the hammer's force has its first zero at 19 Hz
    np.testing.assert_allclose(
        found.values[kept], expected[kept], atol=2e-4 * np.abs(expected).max()
    )  # what is left of the first decay after 30 s
    assert found.coherence is not None
    assert found.coherence[kept][30:].min() > 0.999  # below 1 Hz there is hardly any response
    assert found.output_channels == record.output_channels
    assert hammer_responses(hit_segments(record)[:1]).coherence is None


def test_two_hammers_give_a_matrix() -> None:
    """One hit of each of two hammers is enough without noise; one alone is not."""
    force = np.zeros((8000, 2))
    force[100:103, 0] = [5.0, 9.0, 3.0]
    force[4100:4103, 1] = [4.0, 8.0, 3.0]
    record = structure().simulate(force, DT, forces=["f1", "f3"])
    parts = hit_segments(record)
    found = hammer_responses(parts)
    model = structure().state_space("acceleration", ["f1", "f3"]).to_discrete(DT)
    expected = model.frequency_response(found.frequencies_hz)
    np.testing.assert_allclose(found.values, expected, atol=1e-4 * np.abs(expected).max())
    with pytest.raises(DataError, match="2 hammers need at least as many hits"):
        hammer_responses(parts[:1])
    with pytest.raises(OptionError, match="n_samples must be"):
        hammer_responses(parts, n_samples=100)


def test_from_hits_to_the_system_by_frequency_responses() -> None:
    """Short segments, exponential window, inverse transform, realization, both corrections."""
    force = np.zeros(3000)
    force[[20, 21, 22]] = [5.0, 9.0, 3.0]  # no zero below the Nyquist frequency
    record = structure().simulate(force, DT, forces=["f2"])
    rate = np.log(1e12) / 8  # at 8 s the end is rounding, so that the test is of the algebra
    windowed = exponential_window(hit_segments(record, length=8.0)[0], rate)
    inverted = invert(hammer_responses(windowed)).responses
    model = realized(inverted.values, 6)
    model = undo_exponential_window(undo_wrap(model, len(inverted.values)), rate)
    assert same_poles(model.continuous_poles, structure()).max() < 1e-7
    truth = structure().state_space("acceleration", ["f2"]).to_discrete(DT)
    np.testing.assert_allclose(
        model.markov_parameters(300), truth.markov_parameters(300), atol=1e-7
    )
    assert inverted.output_channels == record.output_channels


def test_segments_keep_labels_for_shapes() -> None:
    """Quantity, DOF and sign go through windows and averages."""
    labels = [Channel("a", "acceleration", "m/s2", dof="p1", sign=-1)]
    force = pulse(2.0, 50.0)
    record = Record(np.zeros((N, 1)), force, dt=DT, output_channels=labels)
    part = exponential_window(force_window(hit_segments(record)[0]), 1.0)
    assert part.output_channels == tuple(labels)


def test_records_on_disk_are_cut_as_in_memory(tmp_path: Path) -> None:
    """Hits are found and segments read without the whole; windows want memory and say so."""
    record, _ = measured()
    paths = [tmp_path / "y.npy", tmp_path / "u.npy"]
    for path, values in zip(paths, (record.outputs, record.inputs), strict=True):
        np.save(path, values)
    y, u = (np.load(path, mmap_mode="r") for path in paths)
    on_disk = Record(y, u, dt=DT)
    for part, other in zip(hit_segments(on_disk), hit_segments(record), strict=True):
        assert part.is_in_memory
        np.testing.assert_array_equal(part.outputs, other.outputs)
    with pytest.raises(OptionError, match="in_memory"):
        exponential_window(on_disk, 1.0)
    found = next_correlations(on_disk, "y2", n_lags=100)[0]
    expected = next_correlations(record, "acceleration_f2", n_lags=100)[0]
    np.testing.assert_array_equal(found.outputs, expected.outputs)
