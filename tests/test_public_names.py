"""The public names are those that were promised, each can be had, and nothing else leaks."""

from __future__ import annotations

import inspect
from pathlib import Path
from types import ModuleType

import vibrid

# Adding a name here is a decision: it stays.
PROMISED = {
    "BlindFit",
    "Channel",
    "DataError",
    "Diagnostics",
    "ERA",
    "ERADC",
    "FileError",
    "Finding",
    "Fit",
    "FrequencyResponses",
    "ImpulseResponses",
    "MechanicalModel",
    "ModeQuality",
    "Modes",
    "N4SID",
    "OKID",
    "OptionError",
    "PathError",
    "Record",
    "SSI",
    "StateSpace",
    "UnstableModelError",
    "VibridError",
    "estimate_input",
    "exponential_window",
    "find_hits",
    "fir",
    "fit_rayleigh",
    "force_window",
    "frequency_responses",
    "hammer_responses",
    "hit_segments",
    "identify",
    "identify_blind",
    "impulse_responses",
    "load",
    "mac",
    "match_modes",
    "mechanical_model",
    "mode_quality",
    "modes_of",
    "mpc",
    "next_correlations",
    "quality_of",
    "read_record",
    "refine",
    "save",
    "undo_exponential_window",
    "write_record",
}


def test_public_names_are_the_promised_ones() -> None:
    """`__all__` holds what was promised, once each (ruff keeps its order)."""
    assert len(vibrid.__all__) == len(set(vibrid.__all__))
    assert set(vibrid.__all__) == PROMISED


def test_every_public_name_can_be_had() -> None:
    """Names that load when first used are there as well, and `dir` shows them."""
    for name in vibrid.__all__:
        assert getattr(vibrid, name) is not None
    assert set(vibrid.__all__) <= set(dir(vibrid))


def test_nothing_public_is_left_out() -> None:
    """Whatever stands in the namespace without an underscore is in `__all__`, modules apart."""
    stray = {
        name
        for name, value in vars(vibrid).items()
        if not name.startswith("_") and not isinstance(value, ModuleType)
    }
    assert stray - {"annotations"} <= set(vibrid.__all__)


def test_no_module_bears_the_name_of_a_public_function() -> None:
    """`vibrid.identify` is one thing: a function, never also a module."""
    folder = Path(vibrid.__file__).parent
    modules = {path.stem for path in folder.rglob("*.py")}
    modules |= {path.parent.name for path in folder.rglob("__init__.py")}
    functions = {n for n in vibrid.__all__ if inspect.isroutine(getattr(vibrid, n))}
    assert modules & functions == set()
