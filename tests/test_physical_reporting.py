"""The printed and the JSON form of a mechanical model."""

from __future__ import annotations

import json

import numpy as np
from known_fits import structure_fit
from rich.console import Console

from vibrid.cli import main
from vibrid.excitation import white_noise
from vibrid.physical import MechanicalModel, fit_rayleigh, mechanical_model
from vibrid.reporting.physical import describe_physical, physical_as_json
from vibrid.structures import chain

TRUE = chain([2.0, 1.5, 1.0], [500.0, 700.0, 600.0], rayleigh=(0.1, 4e-4))


def printed(model: MechanicalModel) -> str:
    console = Console(width=120, no_color=True)
    with console.capture() as captured:
        console.print(describe_physical(model, fit_rayleigh(model)))
    return captured.get()


def test_a_full_model_is_printed():
    """Matrices with units and DOFs, what is determined, the law of damping, the checks."""
    text = printed(mechanical_model(structure_fit(TRUE, "acceleration", ["f1"])))
    for words in ("K stiffness [N/m]", "f3", "1200", "-700", "determined: M, R, K", "explains"):
        assert words in text
    assert "W Wᵀ" in text and "missing" not in text


def test_what_is_missing_is_printed():
    """Without a scale: only the normalized matrices, and what would give the rest."""
    text = printed(mechanical_model(structure_fit(TRUE, "acceleration", base=True)))
    assert "missing: no co-located pair: add a force at f1" in text
    assert "M⁻¹K normalized stiffness [1/s²]" in text and "K stiffness [N/m]" not in text


def test_json_is_json():
    """NaN becomes null, complex pairs of numbers, and the matrices come back."""
    model = mechanical_model(structure_fit(TRUE, "acceleration", ["f1"]))
    facts = json.loads(json.dumps(physical_as_json(model, fit_rayleigh(model)), allow_nan=False))
    np.testing.assert_allclose(facts["stiffness"], TRUE.stiffness, rtol=1e-9, atol=1e-7)
    assert facts["mass_std"][0][0] is None
    assert facts["verdict"]["determined"]["mass"] is True
    assert facts["rayleigh"]["explained"] is True


def test_command_prints_and_says_what_is_missing(tmp_path, capsys, rng):
    """From a file with labels: M, R and K. Without: which options name them, exit status 2."""
    record = TRUE.simulate(white_noise(1500, rng=rng), 0.02, forces=["f3"], noise=0.01, rng=rng)
    columns = np.column_stack([0.02 * np.arange(1500), record.inputs[:], record.outputs[:]])
    header = "time [s],push [N],a1 [m/s2],a2 [m/s2],a3 [m/s2]"
    path = tmp_path / "run.csv"
    np.savetxt(path, columns, delimiter=",", header=header, comments="")
    command = ["physical", str(path), "--inputs", "push", "--order", "6"]
    dofs = ["--dof", "push=f3,a1=f1,a2=f2,a3=f3"]
    assert main([*command, *dofs, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    np.testing.assert_allclose(facts["stiffness"], TRUE.stiffness, atol=10)
    assert main([*command, *dofs, "--mass", "2,1.5"]) == 2
    assert "3 masses" in capsys.readouterr().err
    assert main(command) == 2
    assert "--quantity a1=acceleration --dof a1=f1" in capsys.readouterr().err
