"""mdof: SRIM, ERA and OKID."""

from __future__ import annotations

from typing import Any

from benchmarks.others.protocol import Data, Task, Work, continuous, main


def _signals(data: Data) -> tuple[Any, Any]:
    import numpy as np

    return np.ascontiguousarray(data.inputs.T), np.ascontiguousarray(data.outputs.T)


def srim(data: Data) -> Work:
    """Its default method, with B and D by output-error minimization."""
    import mdof

    u, y = _signals(data)

    def run() -> Any:
        return mdof.system(u, y, dt=data.dt, horizon=data.block_rows, order=data.order)

    return Work(run, lambda model: continuous(model[0], data.dt))


def srim_states(data: Data) -> Work:
    """A and C alone."""
    from mdof.realize import srim as realize

    u, y = _signals(data)

    def run() -> Any:
        return realize(u, y, horizon=data.block_rows, order=data.order, find="AC")

    return Work(run, lambda model: continuous(model[0], data.dt))


def era(data: Data) -> Work:
    """Realize impulse responses."""
    import numpy as np
    from mdof.realize import era as realize

    responses = np.ascontiguousarray(data.responses.transpose(1, 2, 0))
    blocks = data.block_rows

    def run() -> Any:
        return realize(responses, horizon=blocks, nc=blocks, order=data.order)

    return Work(run, lambda model: continuous(model[0], data.dt))


def okid(data: Data) -> Work:
    """OKID-ERA: as many Markov parameters as the observer has."""
    import mdof

    u, y = _signals(data)

    def run() -> Any:
        return mdof.system(
            u,
            y,
            dt=data.dt,
            method="okid-era",
            m=data.about["observer_order"],
            order=data.order,
        )

    return Work(run, lambda model: continuous(model[0], data.dt))


TASKS = (
    Task("W1", "SRIM: A, C", srim_states),
    Task("W1", "SRIM: A, B, C, D", srim),
    Task("W2", "SRIM: A, C", srim_states),
    Task("W2", "SRIM: A, B, C, D", srim),
    Task("W3", "SRIM: A, C", srim_states),
    Task("W5 ERA", "A, B, C, D", era),
    Task("W5 OKID", "A, B, C, D", okid),
)
NAME = "mdof"

if __name__ == "__main__":
    main(TASKS, NAME)
