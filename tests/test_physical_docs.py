"""The worked examples of docs/physical.md run, and give the figures that stand beside them."""

from __future__ import annotations

import numpy as np
from known_fits import error
from worked_examples import run

import vibrid as vb
from vibrid.physical import storey_stiffnesses


def test_shaker_test_and_mass_change():
    """M and K within .1 %, R, R* and the chain's R as said; the scale from an added mass."""
    names = run("physical.md", "A shaker test", "Without any input")
    true, found, law = names["structure"], names["found"], names["law"]
    assert max(error(found.mass, true.mass), error(found.stiffness, true.stiffness)) < 1e-3
    np.testing.assert_allclose(error(found.damping, true.damping), 0.027, rtol=0.1)
    np.testing.assert_allclose(error(names["improved"], true.damping), 7e-4, rtol=0.1)
    np.testing.assert_allclose(error(names["chained"].damping, true.damping), 0.013, rtol=0.1)
    np.testing.assert_allclose(
        [law.alpha, law.beta, law.probability], [0.0999, 4.002e-4, 0.95], 0.01
    )
    checks = found.verdict.checks
    np.testing.assert_allclose(
        [checks[name] for name in ("orthogonality", "asymmetry_damping", "poles", "transfer")],
        [7e-4, 0.088, 4e-4, 0.022],
        rtol=0.1,
    )
    np.testing.assert_allclose(names["scale"].mass.diagonal(), [1.96, 1.47, 0.98], atol=0.006)
    np.testing.assert_allclose(error(names["model"].stiffness, true.stiffness), 0.02, rtol=0.1)


def test_frame_on_a_shake_table(shared_data, monkeypatch):
    """Delays, collinearity, storey stiffnesses of the table."""
    monkeypatch.chdir(shared_data)
    names = run("physical.md", "A frame on a shake table")
    found = names["found"]
    np.testing.assert_allclose(1e3 * found.delays.seconds, [0, -0.10, 2.02], atol=0.01)
    np.testing.assert_allclose(vb.mpc(found.shapes), [0.9999, 0.9995, 0.9996], atol=1e-4)
    np.testing.assert_allclose(storey_stiffnesses(found.stiffness), [469, 467, 497], atol=1)
    np.testing.assert_allclose(found.mass_ratios, [1, 1.01, 0.91], atol=0.006)
    np.testing.assert_allclose(1e3 * found.delays.common, 1.2, atol=0.05)
