"""The two records of `vibrid demo`: a real building, and a simulated shaker test."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..excitation import white_noise
from ..files.survey import survey
from ..identification.assessment import assess_last
from ..record import Record
from ..reporting import Outcome, Reference
from ..samples import timber_building
from ..structures import Structure, shear_frame
from .options import Identifying
from .work import Progress, identify_record

FOLDER = "vibrid-demo"
PUBLISHED_HZ = (1.882, 2.421, 2.689)
FALLBACK_BAND = (0.5, 10.0)

SEED = 20
STOREYS = 4
DAMPING_RATIO = 0.01
NOISE = 0.02
DT = 1 / 64
N_SAMPLES = 9600
USED_SHARE = 0.8

BUILDING = (
    "An eight-storey timber building under ambient vibration: 6 accelerations, no measured "
    "input (Aloisio, Pasca, Tomasi and Fragiacomo, Engineering Structures 213, 2020, 110593)."
)
SHAKER = (
    f"A simulated shaker test: a frame of {STOREYS} storeys, damping ratio "
    f"{100 * DAMPING_RATIO:g} %, white force at the top, accelerations of all floors, "
    f"{100 * NOISE:g} % noise. Identified on the first {100 * USED_SHARE:g} %."
)


def demo_folder() -> Path:
    """Return ./vibrid-demo, or a temporary folder where it cannot be made."""
    folder = Path(FOLDER)
    try:
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError:
        return Path(tempfile.mkdtemp(prefix=f"{FOLDER}-"))


def identify_building(folder: Path, progress: Progress) -> Outcome:
    """Identify the embedded ambient record in the band that the survey suggests."""
    record = timber_building()
    suggested = survey(record).suggested_band_hz
    reason = "(suggested by its spectrum)" if suggested else "(where its modes are known to lie)"
    outcome = identify_record(
        record,
        Identifying(band=suggested or FALLBACK_BAND),
        {},
        folder / "timber_building.vibrid.h5",
        progress,
        band_reason=reason,
    )
    return replace(outcome, reference=Reference("published", np.array(PUBLISHED_HZ)))


def identify_shaker_test(folder: Path, progress: Progress) -> Outcome:
    """Identify the first part of a simulated test and score the rest."""
    frame = _frame()
    record = shaker_test(frame)
    cut = round(USED_SHARE * record.n_samples)
    outcome = identify_record(
        record.slice(0, cut),
        Identifying(),
        {},
        folder / "shaker_test.vibrid.h5",
        progress,
        score_unseen=lambda _, fit: assess_last(fit, record, cut),
        unseen_part=f"the last {100 * (1 - USED_SHARE):.0f} %",
    )
    truth = Reference("true", frame.frequencies_hz, frame.damping_ratios)
    return replace(outcome, reference=truth)


def shaker_test(frame: Structure) -> Record:
    """Return the record of a white force at the top of a frame, always the same."""
    rng = np.random.default_rng(SEED)
    return frame.simulate(
        white_noise(N_SAMPLES, rng=rng, std=100.0),
        DT,
        forces=[frame.dofs[-1]],
        noise=NOISE,
        rng=rng,
        name="simulated shaker test",
    )


def _frame() -> Structure:
    return shear_frame(STOREYS, 500.0, 2e6, damping_ratio=DAMPING_RATIO)
