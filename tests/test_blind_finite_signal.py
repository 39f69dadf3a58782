"""Blind identification under forces that are not periodic: outside the modes, or at rest."""

from __future__ import annotations

import numpy as np
import pytest
from blind_cases import DT, errors, response, structure, truth
from known_fits import error

from vibrid.blind.finite_signal import blind_finite_signal
from vibrid.errors import OptionError
from vibrid.record import Record


def random_response(rng, low, high, **options):
    """Return a record under 90 incommensurable sines in a band."""
    return response(rng, np.sort(rng.uniform(low, high, 90)), amplitude=0.2, **options)


def test_a_force_outside_the_modes(rng):
    """Modes at 1.4 to 4.4 Hz, random force from 6 to 10 Hz: 𝒦, 𝒟 and the force."""
    record, force = random_response(rng, 6.0, 10.0, n_samples=800)
    found = blind_finite_signal(record, 3, force_band=(5.9, 10.1))
    assert found.verdict.kind == "out_of_band"
    assert (np.array(errors(found, force)) < [1e-7, 1e-5, 1e-5]).all()


def test_a_force_outside_the_modes_with_noise(rng):
    """60 dB."""
    record, force = random_response(rng, 6.0, 10.0, n_samples=800, snr=60)
    found = blind_finite_signal(record, 3, force_band=(5.9, 10.1))
    assert (np.array(errors(found, force)) < [1e-3, 0.1, 0.1]).all()


def test_a_band_from_zero_is_a_basis_of_dependent_lines():
    """Lines so dense that singular values do not converge; the modes lie within: refused."""
    record, _ = random_response(np.random.default_rng(5), 6.0, 10.0, n_samples=800, snr=60)
    assert not blind_finite_signal(record, 3, force_band=(0.0, 10.1)).accepted


def test_a_force_in_the_band_of_the_modes_is_refused(rng):
    """With its band given or not, the reason is said."""
    record, _ = random_response(rng, 0.3, 6.0, snr=50)
    for band in (None, (0.3, 6.0)):
        found = blind_finite_signal(record, 3, force_band=band)
        assert not found.accepted and np.isnan(found.normalized_damping).all()
        assert "in_band" in [each.rule for each in found.verdict.refusals]
    assert "explains the record with any" in str(blind_finite_signal(record, 3).verdict)


def test_a_stretch_without_force(rng):
    """Noise until 10 s, then a free decay."""
    free = structure().simulate(None, DT, initial_state=[0.1, 0.0, -0.1, 0, 0, 0], n_samples=1500)
    y = np.vstack([rng.standard_normal((500, 3)), free.outputs])
    record = Record(y, dt=DT, output_channels=free.output_channels)
    found = blind_finite_signal(record, 3, force_free=(10.0, 40.0))
    K, D = truth()
    assert found.verdict.kind == "force_free"
    assert error(found.normalized_stiffness, K) < 1e-11
    assert error(found.normalized_damping, D) < 1e-9
    assert found.normalized_force.shape == y.shape and np.isnan(found.normalized_force).all()
    with pytest.raises(OptionError, match="not both"):
        blind_finite_signal(record, 3, force_free=(10.0, 40.0), force_band=(6.0, 9.0))
