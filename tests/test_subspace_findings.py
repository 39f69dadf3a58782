"""What the subspace family says of data: feedback, poor channels, doubtful transitions."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from subspace_cases import DT, codes, coloured, noisy_chain

import vibrid as vb
from vibrid.excitation import white_noise
from vibrid.methods.subspace.feedback import feedback_of
from vibrid.structures import chain

# -- feedback


def test_feedback_is_rarely_seen_where_there_is_none() -> None:
    """Open loop with process noise, white and coloured forces: no alarm in 40 records."""
    smallest = 1.0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        frame = chain(np.ones(2), np.full(2, 600.0), damping_ratio=0.01)
        force = white_noise(1500, 2, rng=rng)
        if seed % 2:
            force[1:] += 0.9 * force[:-1]
        whole = frame.simulate(force, DT, forces=frame.dofs, noise=0.1, rng=rng)
        shared = vb.N4SID(block_rows=15).decompose(whole.select(inputs=["force_f1"]))
        feedback = feedback_of(shared.factor.triangle, shared.layout, shared.n_columns)
        assert feedback is not None and feedback.noise > 0.05
        assert not feedback.suspected
        smallest = min(smallest, feedback.probability)
    assert smallest > 1e-4


def test_feedback_switches_to_regression(rng: np.random.Generator) -> None:
    """A force that follows the outputs is found, and said; explicit options stay."""
    frame = chain([1.0], [600.0], damping_ratio=0.02)
    model = frame.state_space(sensors="velocity", forces=["f1"]).to_discrete(DT)
    A, B, C, x, seen = model.A, model.B, model.C, np.zeros(2), 0.0
    u, y, e = np.zeros((6000, 1)), np.zeros((6000, 1)), rng.standard_normal((6000, 2))
    for t in range(len(u)):
        u[t] = 0.5 * e[t, 0] - 2 * seen
        y[t] = seen = (C @ x).item() + 1e-4 * e[t, 1]
        x = A @ x + B[:, 0] * (u[t] + e[t, 1])
    record = vb.Record(y, u, dt=DT)
    fit = vb.identify(record, vb.N4SID(block_rows=15), order=2)
    assert "feedback" in codes(fit)
    assert (fit.method.transition, fit.method.completion) == ("regression", "prediction")
    assert "feedback" in fit.diagnostics.figures["choices"][-1]
    kept = vb.identify(record, vb.N4SID(block_rows=15, transition="shift"), order=2)
    assert kept.method.transition == "shift" and "feedback" in codes(kept)


# -- poor data are named


def with_inputs(record: vb.Record, inputs: Any) -> vb.Record:
    return vb.Record(record.outputs, inputs, dt=record.dt)


def test_a_clean_test_has_no_findings(rng: np.random.Generator) -> None:
    """White independent forces, living sensors: nothing to say about the data."""
    fit = vb.identify(noisy_chain(rng), vb.N4SID(block_rows=15), order=6)
    said = set(codes(fit))
    assert not said & {"excitation", "collinear-inputs", "clipping", "dead-channel", "feedback"}
    assert "near-nyquist" not in said


def test_too_few_sines_are_said(rng: np.random.Generator) -> None:
    """Three sines excite order 6 of the 20 block rows; the finding holds both numbers."""
    frame = chain([1.0, 1.0], [600.0, 600.0], damping_ratio=0.01)
    t = np.arange(3000) * DT
    force = np.sum([np.sin(2 * np.pi * f * t + f) for f in (1.1, 2.3, 4.7)], axis=0)[:, None]
    record = frame.simulate(force, DT, forces=["f1"], noise=0.05, rng=rng)
    fit = vb.identify(record, vb.N4SID(block_rows=10), order=4, stability="project")
    finding = next(each for each in fit.diagnostics.findings if each.code == "excitation")
    assert "rank 6 of the 20" in finding.sentence


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_collinear_inputs_are_named(noise: float, rng: np.random.Generator) -> None:
    """Two of three inputs that (nearly) follow from each other, even by a filter."""
    record = noisy_chain(rng)
    u = record.inputs
    echo = np.convolve(u[:, 0], [1.0, 0.4])[: len(u)] + noise * rng.standard_normal(len(u))
    fit = vb.identify(
        with_inputs(record, np.c_[u, echo]), vb.N4SID(block_rows=10), order=6, stability="project"
    )
    finding = next(each for each in fit.diagnostics.findings if each.code == "collinear-inputs")
    assert "u1" in finding.sentence and "u3" in finding.sentence
    assert "u2" not in finding.sentence


def test_clipped_dead_and_folded_channels_are_named(rng: np.random.Generator) -> None:
    """Each defect is found in the channel that has it, and in no other."""
    record = noisy_chain(rng, 6000)
    y = record.outputs / record.outputs.std(axis=0)
    y[:, 0] = np.clip(y[:, 0], -1.2, 1.2)
    stuck = np.repeat(rng.standard_normal(300), 20)
    nyquist = np.cumprod(np.full(6000, -1.0)) * (1 + 0.1 * rng.standard_normal(6000))
    table = np.c_[y, stuck, nyquist + 0.1 * rng.standard_normal(6000)]
    names = ["clipped", "good", "fine", "stuck", "fast"]
    broken = vb.Record(table, record.inputs, dt=DT, output_channels=names)
    fit = vb.identify(broken, vb.N4SID(block_rows=10), order=8, stability="project")
    said = {finding.code: finding.sentence for finding in fit.diagnostics.findings}
    assert said["clipping"].startswith("clipped rest")  # and not what is stuck
    assert said["dead-channel"].startswith("stuck hardly")
    assert said["near-nyquist"].startswith("fast:")


def test_a_filled_gap_is_named(rng: np.random.Generator) -> None:
    """An output that keeps one value for a while is named; a force that rests is not."""
    record = noisy_chain(rng, 6000)
    y, u = np.array(record.outputs), np.array(record.inputs)
    y[2000:2400, 1] = 0
    u[:3000, 0] = 0
    names = ["whole", "filled", "sound"]
    torn = vb.Record(y, u, dt=DT, output_channels=names)
    fit = vb.identify(torn, vb.N4SID(block_rows=10), order=6, stability="project")
    said = {finding.code: finding.sentence for finding in fit.diagnostics.findings}
    assert said["stuck-channel"].startswith("filled keeps one value")
    assert "6.67 % of the samples" in said["stuck-channel"]
    assert "dead-channel" not in said


def test_a_weak_channel_among_its_kind_is_named(rng: np.random.Generator) -> None:
    """An accelerometer that gives a millionth of what the others give is dead."""
    record = noisy_chain(rng)
    channels = [vb.Channel(f"a{k}", "acceleration", "m/s²") for k in range(3)]
    weak = vb.Record(record.outputs * [1, 1e-6, 1], record.inputs, dt=DT, output_channels=channels)
    fit = vb.identify(weak, vb.N4SID(block_rows=10), order=6)
    said = {finding.code: finding.sentence for finding in fit.diagnostics.findings}
    assert said["dead-channel"].startswith("a1 hardly")


# -- doubtful transitions


def test_a_better_transition_just_outside_the_circle_is_not_dropped_in_silence() -> None:
    """Reflected it is taken where that was asked for; else a finding names pole and gain."""
    record, method = coloured(3), vb.N4SID(block_rows=20)
    stable = vb.identify(record, method, order=6)
    said = {finding.code: str(finding) for finding in stable.diagnostics.findings}
    assert stable.model.is_stable and stable.diagnostics.figures["transition"] == "regression"
    assert "shift invariance is unstable (a pole has magnitude 1.0" in said["unstable-alternative"]
    assert 'stability="project"' in said["unstable-alternative"]
    taken = vb.identify(record, method, order=6, stability="project")
    assert taken.diagnostics.figures["transition"] == "shift" and "projected" in codes(taken)
    errors = [fit.diagnostics.figures["simulation_error"] for fit in (taken, stable)]
    assert errors[0] < 0.32 < 0.5 < errors[1]


@pytest.mark.parametrize(
    ("transition", "severity", "said"),
    [
        ("regression", "doubt", 'Use about 1\\d\\d block_rows, or transition="shift"'),
        ("auto", "note", "shift invariance, which does not suffer, was taken"),
    ],
)
def test_a_short_horizon_names_the_number_and_the_limit(
    transition: str, severity: str, said: str
) -> None:
    """rho(A-KC)^s, the limit 0.01 and the cure, for every estimator it biases."""
    method = vb.N4SID(block_rows=20, transition=transition)
    fit = vb.identify(coloured(0), method, order=6, stability="project")
    finding = next(each for each in fit.diagnostics.findings if each.code == "short-horizon")
    memory = fit.diagnostics.figures["predictor_memory"]
    assert finding.severity == severity
    pattern = rf"rho\(A-KC\)\^s is {memory:.2g} after s = 20 past rows \(limit 0.01\).*{said}"
    assert re.search(pattern, str(finding))


def test_a_regression_that_both_agree_with_is_a_note(rng: np.random.Generator) -> None:
    """Where shift invariance finds the same damping, the short horizon did no harm."""
    fit = vb.identify(noisy_chain(rng, 6000), vb.N4SID(block_rows=40), order=6)
    said = {finding.code: finding for finding in fit.diagnostics.findings}
    assert "damping-doubt" not in said
    assert said["short-horizon"].severity == "note"
