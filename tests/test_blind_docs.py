"""The worked examples of docs/blind.md run, and give the figures that stand beside them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worked_examples import run

from studies.blind_records import off

START = "Sines on every floor"


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What the examples with synthetic data leave behind."""
    return run(
        "blind.md", START, "A force at one mass", "Ambient vibration", "Any force outside the modes"
    )


@pytest.fixture(scope="module")
def true(names: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """M⁻¹K and M⁻¹D of the examples."""
    structure = names["structure"]
    return (
        np.linalg.solve(structure.mass, structure.stiffness),
        np.linalg.solve(structure.mass, structure.damping),
    )


def test_sines_on_every_floor(names: dict[str, Any]) -> None:
    """Stiffness, damping, frequencies and force of a periodic excitation."""
    found, structure = names["found"], names["structure"]
    np.testing.assert_allclose(off(found.stiffness, structure.stiffness), 1.5e-3, rtol=0.1)
    np.testing.assert_allclose(off(found.damping, structure.damping), 1.8e-3, rtol=0.1)
    np.testing.assert_allclose(found.input_frequencies_hz, [0.9, 3.3, 5.1], atol=2e-4)
    np.testing.assert_allclose(off(found.force, names["force"]), 0.055, rtol=0.1)


def test_force_at_one_mass(names: dict[str, Any], true: tuple[np.ndarray, np.ndarray]) -> None:
    """Free rows, the forced DOF, closure by masses, and where the force begins."""
    rows, whole, structure = names["rows"], names["whole"], names["structure"]
    assert rows.forced_dofs == ("f3",) and np.isnan(rows.normalized_stiffness[2]).all()
    np.testing.assert_allclose(off(rows.normalized_stiffness[:2], true[0][:2]), 2e-4, rtol=0.1)
    np.testing.assert_allclose(off(rows.normalized_damping[:2], true[1][:2]), 6e-3, rtol=0.1)
    np.testing.assert_allclose(off(whole.stiffness, structure.stiffness), 2.7e-4, rtol=0.1)
    assert sum(each.code == "closure" for each in whole.verdict.findings) == 3
    figures = whole.diagnostics.figures
    np.testing.assert_allclose(figures["lowest_force_hz"][2], 0.55, atol=0.01)
    np.testing.assert_allclose(figures["row_misfits"], [0.93, 1.0, 6257], rtol=0.01)


def test_ambient_and_outside_the_modes(
    names: dict[str, Any], true: tuple[np.ndarray, np.ndarray]
) -> None:
    """Errors of both, as said."""
    for name, stiffness, damping in (("ambient", 3.3e-3, 0.068), ("outside", 2.7e-4, 5.8e-3)):
        found = names[name]
        np.testing.assert_allclose(off(found.normalized_stiffness, true[0]), stiffness, rtol=0.1)
        np.testing.assert_allclose(off(found.normalized_damping, true[1]), damping, rtol=0.1)
    force = np.linalg.solve(names["structure"].mass, names["high"].T).T
    np.testing.assert_allclose(off(names["outside"].normalized_force, force), 7e-3, rtol=0.15)


def test_frame_on_a_table(shared_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of the upper floors beside those of the measured table, and the lag."""
    monkeypatch.chdir(shared_data)
    names = run("blind.md", START, "A frame on a table that nobody measured")
    frame = names["frame"]
    assert frame.forced_dofs == ("floor1",) and np.isnan(frame.normalized_stiffness[0]).all()
    with_table = np.array([[-3277.7, 6490.2, -3419.2], [306.4, -3763.6, 3454.8]])
    for found, known in zip(frame.normalized_stiffness[1:], with_table, strict=True):
        assert off(found, known) < 6e-3
    np.testing.assert_allclose(frame.normalized_stiffness[2, 0], 306.4, rtol=0.01)
    np.testing.assert_allclose(frame.diagnostics.figures["row_misfits"], [163, 4.2, 5.0], rtol=0.02)
    said = [each.sentence for each in frame.verdict.findings if each.code == "asymmetric_damping"]
    assert "floor3 lagged 1.89 ms" in said[0]
