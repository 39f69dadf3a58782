"""python-control: the eigensystem realization algorithm."""

from __future__ import annotations

from benchmarks.others.protocol import Data, Task, Work, continuous, main


def era(data: Data) -> Work:
    """Realize with `eigensys_realization`; dt=True leaves B as it is."""
    import control
    import numpy as np

    responses = np.ascontiguousarray(data.responses.transpose(1, 2, 0))
    blocks = data.block_rows

    def run() -> object:
        return control.eigensys_realization(responses, data.order, m=blocks, n=blocks)

    return Work(run, lambda found: continuous(found[0].A, data.dt))


TASKS = (Task("W5 ERA", "A, B, C, D", era),)
NAME = "control"

if __name__ == "__main__":
    main(TASKS, NAME)
