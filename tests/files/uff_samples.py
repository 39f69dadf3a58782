"""Data sets 58 made by pyuff, for the tests of the readers."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pyuff

DT = 1 / 64


def uff_set(data: Any, node: int, direction: int, **more: Any) -> dict[str, Any]:
    """Return a data set 58; by default a time signal of acceleration."""
    even = {"abscissa_min": 0.0, "abscissa_inc": DT, "abscissa_spacing": 1}
    fields: dict[str, Any] = {
        **{"func_type": 1, "rsp_node": node, "rsp_dir": direction, "ref_node": 0, "ref_dir": 0},
        **{"id1": "id", "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE"},
        **{"rsp_ent_name": "NONE", "ref_ent_name": "NONE", "load_case_id": 0, "ver_num": 0},
        **{"num_pts": len(data), **even, "z_axis_value": 0.0, "binary": 0},
        **{"abscissa_spec_data_type": 17, "abscissa_axis_units_lab": "s"},
        **{"ordinate_spec_data_type": 12, "ordinate_axis_units_lab": "m/s2"},
        **{"orddenom_spec_data_type": 0, "orddenom_axis_units_lab": "NONE"},
        **{"ord_data_type": 6 if np.iscomplexobj(data) else 4},
    }
    fields = {**fields, **more}
    even_x = fields["abscissa_min"] + fields["abscissa_inc"] * np.arange(len(data))
    x = fields.pop("x", even_x)
    return dict(pyuff.prepare_58(data=data, x=x, **fields))


def write_uff(path: Path, sets: list[dict[str, Any]]) -> None:
    """Write data sets with pyuff to a new file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # it leaves binary files open
        pyuff.UFF(str(path)).write_sets(sets, mode="add")
