"""SIPPY: N4SID."""

from __future__ import annotations

from benchmarks.others.protocol import Data, Task, Work, continuous, main


def n4sid(data: Data) -> Work:
    """Ask for a fixed order and direct transmission."""
    import numpy as np
    from sippy_unipi import system_identification

    y, u = np.ascontiguousarray(data.outputs.T), np.ascontiguousarray(data.inputs.T)

    def run() -> object:
        return system_identification(
            y,
            u,
            "N4SID",
            tsample=data.dt,
            SS_f=data.block_rows,
            SS_fixed_order=data.order,
            SS_D_required=True,
        )

    return Work(run, lambda model: continuous(model.A, data.dt))


TASKS = tuple(Task(table, "N4SID: A, B, C, D, K", n4sid) for table in ("W1", "W2", "W3"))
NAME = "sippy_unipi"

if __name__ == "__main__":
    main(TASKS, NAME)
