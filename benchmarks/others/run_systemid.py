"""systemID: ERA and OKID.

Release 25.0.5 cannot be imported: it asks for systemID.functions, which it does not contain.
Its modules work, so they are loaded without the packages around them.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import types
from pathlib import Path
from typing import Any

from benchmarks.others.protocol import Data, Task, Work, continuous, main


def _function(name: str) -> Any:
    """Return the function of systemID.core.algorithms that has a module of its own name."""
    if "systemID" not in sys.modules:
        _load_bare()
    return getattr(importlib.import_module(f"systemID.core.algorithms.{name}"), name)


def _load_bare() -> None:
    """Stand in for the packages, so that their own __init__ does not run."""
    found = importlib.util.find_spec("systemID")
    if found is None or not found.submodule_search_locations:
        raise ModuleNotFoundError("No module named 'systemID'")
    place = Path(found.submodule_search_locations[0])
    for package in ("systemID", "systemID.core", "systemID.core.algorithms"):
        bare = types.ModuleType(package)
        bare.__path__ = [str(place.joinpath(*package.split(".")[1:]))]
        sys.modules[package] = bare


def era(data: Data) -> Work:
    """Realize impulse responses."""
    realize = _function("eigensystem_realization_algorithm")
    blocks, markov = data.block_rows, list(data.responses)
    return Work(
        lambda: realize(markov, data.order, p=blocks, q=blocks),
        lambda found: continuous(found["A"](0), data.dt),
    )


def okid(data: Data) -> Work:
    """Observer Markov parameters, Markov parameters to twice the order, ERA."""
    import numpy as np

    observe = _function("observer_kalman_identification_algorithm_with_observer")
    recover = _function("markov_parameters_from_observer_markov_parameters")
    realize = _function("eigensystem_realization_algorithm")
    u = np.ascontiguousarray(data.inputs.T)[:, :, None]
    y = np.ascontiguousarray(data.outputs.T)[:, :, None]
    blocks = data.about["observer_order"]

    def run() -> Any:
        found = observe(u, y, observer_order=blocks, stable_order=blocks)
        markov = recover(found["observer_markov_parameters"], 2 * blocks + 2)
        return realize(markov["markov_parameters"], data.order, p=blocks, q=blocks)

    return Work(run, lambda found: continuous(found["A"](0), data.dt))


COMPUTES = "A, B, C, D (its modules; the package as released does not import)"
TASKS = (Task("W5 ERA", COMPUTES, era), Task("W5 OKID", COMPUTES, okid))
NAME = "systemID"

if __name__ == "__main__":
    main(TASKS, NAME)
