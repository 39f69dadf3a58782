"""ERA of records: free decays, ambient vibration and responses to measured inputs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from era_cases import DT, EXACT, assert_same_modes, fitted, naive_era, structure

from vibrid.chunks import open_stream
from vibrid.errors import DataError, OptionError
from vibrid.excitation import white_noise
from vibrid.methods.era import ERA, ERADC
from vibrid.modes import mac, modes_of
from vibrid.record import Record
from vibrid.structures import chain

# -- free decays


def decay(n_dof: int, rng: np.random.Generator, n_samples: int = 500) -> Record:
    start = 0.1 * rng.standard_normal(2 * n_dof)
    return structure(n_dof).simulate(None, DT, initial_state=start, n_samples=n_samples)


@pytest.mark.parametrize("offset", ["estimate", "mean", "none"])
@pytest.mark.parametrize("n_records", [1, 3])
@pytest.mark.parametrize("method", [ERA(), ERA(rows=20, columns=60), ERADC()], ids=str)
def test_decays_are_realized_exactly(
    method: Any, n_records: int, offset: str, rng: np.random.Generator
) -> None:
    """Decays share A and C; each is reproduced from the initial state that is returned."""
    records = [decay(3, rng) for _ in range(n_records)]
    if offset == "mean":
        records = [Record(each.outputs - each.outputs.mean(axis=0), dt=DT) for each in records[:1]]
        offset = "estimate"
    decomposition = method.decompose(records, offset=offset)
    assert decomposition.rank_limited
    fit = method.realize(decomposition, 6)
    assert_same_modes(fit, structure(3))
    assert len(fit.initial_states) == len(records)
    for record, state in zip(records, fit.initial_states, strict=True):
        again = fit.simulate(None, state, n_samples=record.n_samples)
        np.testing.assert_allclose(again, record.outputs, atol=EXACT * record.outputs.std())
    assert np.diag(mac(modes_of(fit).shapes, structure(3).shapes)) == pytest.approx(1, abs=EXACT)


def test_decays_in_pieces_and_in_noise(rng: np.random.Generator) -> None:
    """A gap starts another decay; noise of 1 % leaves damping within some percent."""
    record = decay(2, rng, 800)
    y = record.outputs + 0.01 * record.outputs.std() * rng.standard_normal(record.outputs.shape)
    y[90] = np.nan
    decomposition = ERA().decompose(Record(y, dt=DT))
    assert decomposition.method.responses == "decay"
    fit = ERA().realize(decomposition, 4)
    assert_same_modes(fit, structure(2), 0.05)
    assert np.isfinite(fit.initial_states).all()
    assert fit.initial_states.shape == (2, 4)
    values = [decomposition.criterion(order)[0] for order in range(1, 12)]
    assert 1 + int(np.argmin(values)) == 4


def test_decay_of_many_columns_equals_the_explicit_hankel_matrix(rng: np.random.Generator) -> None:
    """Poles from the triangle are those of a full decomposition of the data matrix."""
    record = decay(2, rng, 200)
    y = record.outputs + 0.02 * record.outputs.std() * rng.standard_normal(record.outputs.shape)
    stream = open_stream(Record(y, dt=DT), "none")
    fit = fitted(ERA(rows=10, responses="decay"), stream, 4)
    h = np.concatenate(
        [np.zeros((1, 2, 1)), (y * stream.output_balance / stream.output_scale)[:, :, None]]
    )
    A, _, _ = naive_era(h, 10, 190, 4)
    np.testing.assert_allclose(
        np.sort_complex(fit.model.poles), np.sort_complex(np.linalg.eigvals(A)), rtol=1e-8
    )


def test_undamped_and_growing_motion_is_a_decay() -> None:
    """Noise-free free motion has a rank, so it needs no decay to be taken for one."""
    for pole in (0.0, 0.02):
        t = DT * np.arange(400)
        y = np.exp(pole * t) * np.cos(12.0 * t)
        decomposition = ERA().decompose(Record(y, dt=DT))
        assert decomposition.method.responses == "decay"
        fit = ERA().realize(decomposition, 2)
        np.testing.assert_allclose(fit.model.continuous_poles.real, pole, atol=1e-9)
        np.testing.assert_allclose(np.abs(fit.model.continuous_poles.imag), 12.0, rtol=1e-9)


def test_too_short_a_decay_is_refused(rng: np.random.Generator) -> None:
    """The message names the rows, the samples and the most rows."""
    with pytest.raises(DataError, match=r"rows=60 needs a decay of at least 62 samples.*58 rows"):
        ERA(rows=60, responses="decay").decompose(decay(2, rng, 60))


# -- ambient vibration


def ambient(rng: np.random.Generator, n_samples: int = 20_000) -> Record:
    frame = structure(3)
    force = white_noise(n_samples, 3, rng=rng)
    clean = frame.simulate(force, DT, forces=list(frame.dofs))
    noise = 0.2 * clean.outputs.std(axis=0) * rng.standard_normal(clean.outputs.shape)
    return Record(clean.outputs + noise, dt=DT)


@pytest.mark.parametrize("references", [None, ("y1", "y3")])
@pytest.mark.parametrize("method", [ERA, ERADC])
def test_ambient_record(
    method: Callable[..., Any], references: tuple[str, ...] | None, rng: np.random.Generator
) -> None:
    """Correlations give the modes within their spread, a stable predictor that predicts."""
    chosen = method(references=references)
    record = ambient(rng)
    decomposition = chosen.decompose(record)
    assert decomposition.method.responses == "correlations"
    assert "ambient" in decomposition.reasons[0]
    fit = chosen.realize(decomposition, 6)
    modes, frame = modes_of(fit), structure(3)
    np.testing.assert_allclose(modes.frequencies_hz, frame.frequencies_hz, rtol=5e-3)
    # 1000 s hold 11 bandwidths of the first mode: its damping is good to a third
    np.testing.assert_allclose(modes.damping_ratios, frame.damping_ratios, rtol=0.5)
    assert np.diag(mac(modes.shapes, frame.shapes)).min() > 0.99
    errors = (record.outputs - fit.predict(record))[200:]
    assert (errors.var(axis=0) < 0.6 * record.outputs.var(axis=0)).all()
    np.testing.assert_allclose(
        np.diag(np.cov(errors.T)), np.diag(fit.innovation_covariance), rtol=0.25
    )


def test_forcing_what_a_record_is_taken_for(rng: np.random.Generator) -> None:
    """`responses` overrides the judgement, and refuses what cannot be."""
    record = ambient(rng, 2000)
    assert ERA(responses="decay").decompose(record).method.responses == "decay"
    with pytest.raises(OptionError, match="needs inputs"):
        ERA(responses="fir").decompose(record)
    forced = Record(record.outputs[:, :1], record.outputs[:, 1:2], dt=DT)
    with pytest.raises(OptionError, match="outputs alone; the record has 1 inputs"):
        ERA(responses="decay").decompose(forced)
    with pytest.raises(OptionError, match="No output is called 'y9'"):
        ERA(responses="correlations", references=("y9",)).decompose(record)


# -- inputs


def test_forced_record_by_finite_impulse_responses(rng: np.random.Generator) -> None:
    """A well damped structure's responses die within the lags and are realized."""
    frame = chain([1.0, 1.2], [800.0, 800.0], damping_ratio=0.1)
    record = frame.simulate(white_noise(2500, rng=rng), DT, forces=["f1"])
    fit = fitted(ERA(), record, 4)
    assert_same_modes(fit, frame, 1e-3)
    assert fit.diagnostics.figures["fir_truncation"] < 1e-3


def test_responses_that_are_cut_off_are_told(rng: np.random.Generator) -> None:
    """Too few lags for light damping is a warning."""
    frame = structure(2)
    record = frame.simulate(white_noise(3000, rng=rng), DT, forces=["f1"])
    fit = fitted(ERA(rows=20, columns=20), record, 4)
    assert "responses-cut-off" in [finding.code for finding in fit.diagnostics.findings]
