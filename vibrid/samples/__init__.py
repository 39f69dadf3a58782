"""The embedded real record, for the demo, the documentation and the tests."""

from __future__ import annotations

from importlib import resources

import numpy as np

from ..record import Channel, Record

# (DOF label, sign): three points of one floor, x and y each, as mounted
_MOUNTING = (("1x", -1), ("1y", -1), ("2x", -1), ("2y", -1), ("3x", -1), ("3y", 1))


def timber_building() -> Record:
    """Return 15 minutes of ambient vibration of an eight-storey timber building.

    Six accelerometers at 100 Hz; the unit is not stated by the source and stays empty. The
    published natural frequencies are 1.882, 2.421 and 2.689 Hz. Source, licence and what was
    cut stand in ``timber_building.md`` beside the data.

    Returns
    -------
    Record
        90000 samples of 6 outputs, no inputs, dt = 0.01 s, in memory.

    References
    ----------
    A. Aloisio, D. Pasca, R. Tomasi, M. Fragiacomo, Engineering Structures 213 (2020) 110593,
    doi:10.1016/j.engstruct.2020.110593.

    Examples
    --------
    >>> record = timber_building()
    >>> record.n_samples, record.n_outputs, record.duration
    (90000, 6, 900.0)
    """
    with (resources.files(__package__) / "timber_building.npy").open("rb") as file:
        accelerations = np.load(file, allow_pickle=False)
    channels = [
        Channel(f"acc{k + 1}", "acceleration", dof=dof, sign=sign)
        for k, (dof, sign) in enumerate(_MOUNTING)
    ]
    return Record(accelerations, dt=0.01, output_channels=channels, name="timber building")
