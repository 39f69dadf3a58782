"""The choice of the form of noise, order by elimination, and what refinement says and keeps."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refining_cases import DT, flat, sensed, shaken, started

import vibrid as vb
from studies.refinement import Case, ambient_case, errors_of, plain, robust, shaker_case
from vibrid.chunks import open_stream
from vibrid.errors import OptionError
from vibrid.identification.noise_forms import _preferred
from vibrid.identification.refining import refine, refined_order
from vibrid.scores import fit_percent, start_samples

# -- the form of noise


def test_unknown_forces_ask_for_innovations(rng: np.random.Generator) -> None:
    """The form is found from unseen halves, and the reason said."""
    for record, form in ((shaken(rng, 4000), "innovations"), (sensed(rng), "output_error")):
        figures = refine(started(record, block_rows=20), record).diagnostics.figures
        assert figures["refinement"] == form
        assert "halves" in figures["refinement_reason"]
        assert set(figures["refinement_errors"]) == {"none", "output_error", "innovations"}


@pytest.mark.parametrize(
    ("errors", "predicted", "form"),
    [
        ((0.50, 0.40, 0.45), (0.3, 0.2), "output_error"),
        ((0.50, 0.45, 0.40), (0.3, 0.2), "innovations"),
        ((0.50, 0.40, 0.401), (0.3, 0.2), "innovations"),
        ((0.50, 0.401, 0.40), (0.2, 0.2), "output_error"),
        ((0.50, 0.45, 0.40), (0.3, np.inf), "output_error"),
        ((0.35, 0.45, 0.40), (0.3, 0.2), "none"),
        ((1e-9, 1e-9, 1e-10), (1e-9, 1e-12), "output_error"),
    ],
)
def test_forms_are_preferred_by_simulation_then_prediction(
    errors: tuple[float, ...], predicted: tuple[float, float], form: str
) -> None:
    """Better simulation wins, prediction breaks ties, a gain that did not settle loses."""
    simulated = dict(zip(("none", "output_error", "innovations"), errors, strict=True))
    ahead = dict(zip(("output_error", "innovations"), predicted, strict=True))
    assert _preferred(simulated, {"none": 1.0, **ahead})[0] == form


def test_outputs_alone_are_refined_by_prediction(rng: np.random.Generator) -> None:
    """What noise drives has no simulation; the message says so when that is asked for."""
    record = shaken(rng, 2000, inputs=0)
    start = started(record)
    assert refine(start, record).diagnostics.figures["refinement"] == "innovations"
    with pytest.raises(OptionError, match="noise drives the structure"):
        refine(start, record, noise="output_error")


def test_short_records_choose_by_criterion(rng: np.random.Generator) -> None:
    """Where halves are too short the information criterion decides, and is named."""
    record = sensed(rng, 100)
    fit = refine(started(record, block_rows=12), record)
    assert "criterion" in fit.diagnostics.figures["refinement_reason"]


# -- order by elimination


def test_order_by_elimination(rng: np.random.Generator) -> None:
    """The true order of a three-mode structure is found; the curve is part of the result."""
    record = sensed(rng, 2000, 3)
    fit = refined_order(open_stream(record), vb.N4SID())
    figures = fit.diagnostics.figures
    assert fit.order == 6
    assert figures["elimination_orders"][0] > 12
    assert len(figures["elimination_costs"]) == len(figures["elimination_orders"])
    curve = dict(figures["held_out_errors"])
    assert curve[6] <= 1.02 * min(curve.values())
    assert "order=6" in figures["choices"][0]
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, 0.01, rtol=0.1)


def test_order_by_elimination_needs_inputs(rng: np.random.Generator) -> None:
    """Without inputs there is no simulation to rank modes by."""
    with pytest.raises(OptionError, match="needs inputs"):
        refined_order(open_stream(shaken(rng, inputs=0)), vb.SSI())


def test_forces_unknown_to_elimination_are_not_fitted() -> None:
    """Elimination fits the motion that unknown forces cause; then the plain order is kept."""
    record = shaken(np.random.default_rng(5), 2000)
    fit = vb.identify(record, refine=True)
    figures = fit.diagnostics.figures
    assert (fit.order, figures["refinement"]) == (4, "innovations")
    assert "elimination went to order" in figures["choices"][-1]
    assert len(figures["held_out_errors"]) == len(dict(figures["held_out_errors"]))
    assert figures["elimination_orders"][0] > 12
    np.testing.assert_allclose(vb.modes_of(fit).damping_ratios, 0.01, rtol=0.4)


# -- what is said and kept


def test_figures_of_other_modes_are_gone(rng: np.random.Generator) -> None:
    """What was measured of the start's modes does not stand beside the refined ones."""
    record = sensed(rng)
    start = started(record)
    fit = refine(start, record, noise="innovations")
    assert "mode_emac_outputs" in start.diagnostics.figures
    assert [name for name in fit.diagnostics.figures if name.startswith("mode_")] == [
        "mode_phase_collinearity"
    ]


def test_progress_is_told_and_can_stop(rng: np.random.Generator) -> None:
    """Every step is reported; an exception there leaves nothing behind."""
    record = shaken(rng, 1000)
    start, told = started(record), []
    refine(start, record, progress=lambda *what: told.append(what))
    assert ("refine", 0, 60) in told

    def stop(what: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    before = flat(start)
    with pytest.raises(KeyboardInterrupt):
        refine(start, record, progress=stop)
    np.testing.assert_array_equal(flat(start), before)


@pytest.mark.parametrize("order", ["auto", 4])
def test_doubts_about_the_data_survive_refinement(order: int | str) -> None:
    """A clipped channel is said with and without elimination, once."""
    record = shaken(np.random.default_rng(0), 1500)
    limit = record.outputs.std()
    clipped = vb.Record(np.clip(record.outputs, -limit, limit), record.inputs, dt=DT)
    found = vb.identify(clipped, order=order, refine=True).diagnostics.findings
    assert [each.code for each in found].count("clipping") == 1


def test_unstable_starts_are_judged_too(rng: np.random.Generator) -> None:
    """A model that was left unstable is refined; it cannot itself be the choice."""
    force, x = rng.standard_normal((600, 1)), np.zeros(601)
    for k in range(600):
        x[k + 1] = 1.003 * x[k] + force[k, 0]
    record = vb.Record(x[:-1, None] + 0.5 * rng.standard_normal((600, 1)), force, dt=DT)
    start = vb.identify(record, order=1, stability="ignore")
    assert start.model.spectral_radius > 1
    fit = refine(start, record)
    assert fit.model.spectral_radius <= 1
    assert fit.diagnostics.figures["refinement"] in ("innovations", "output_error")


@pytest.mark.parametrize("drift", [0.0, 30.0])
def test_modes_given_up_for_drifts_are_said(rng: np.random.Generator, drift: float) -> None:
    """Two states cannot hold a mode and a large drift of two sensors: the mode is gone."""
    record = shaken(rng, 3000, n_dof=1, inputs=0)
    wander = drift * np.cumsum(rng.standard_normal((3000, 1)), axis=0)
    start = started(record, 2, 20)
    fit = refine(start, vb.Record(record.outputs + wander * record.outputs.std(), dt=DT))
    codes = [each.code for each in fit.diagnostics.findings]
    assert codes.count("modes-lost") == (drift > 0)


# -- longer evidence


@pytest.mark.slow
@pytest.mark.parametrize(("case", "limit"), [(shaker_case, 1.2), (ambient_case, 1.3)])
def test_damping_is_as_good_as_the_bound(case: Callable[[], Case], limit: float) -> None:
    """Over 60 seeds robust errors stay within 1.2 (bench) and 1.3 × (ambient) the bound.

    The plain rms of 60 runs is known to 9 %, the robust one (1.48 × median) to 15 %: two of
    these are allowed on top. The deviations reported are the bound to 10 %.
    """
    errors = errors_of(case(), 60)
    assert (robust(errors.refined) < limit * 1.3).all()
    assert (plain(errors.refined) < limit * 1.18).all()
    np.testing.assert_allclose(errors.reported.mean(axis=0), 1, atol=0.1)
    assert robust(errors.start).max() > 1.3


@pytest.mark.slow
def test_subframe_recipe(shared_data: Path) -> None:
    """From the first half: order 30 to 36, 94.7 % of the second (MAP start, not scored)."""
    from scipy.io import loadmat

    raw = loadmat(shared_data / "flexible_subframe.mat")["flexible_structure_dat"]
    record = vb.Record(raw[:, 2:], raw[:, :2], dt=1 / 1024)
    half = record.n_samples // 2
    fit = refined_order(open_stream(record.slice(0, half)), vb.N4SID())
    assert 30 <= fit.order <= 36
    unseen, skipped = record.slice(half, record.n_samples), start_samples(fit.order)
    modelled = fit.simulate_record(unseen)[skipped:]
    assert fit_percent(unseen.outputs[skipped:], modelled).mean() >= 94.7
