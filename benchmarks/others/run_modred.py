"""modred: the eigensystem realization algorithm."""

from __future__ import annotations

from benchmarks.others.protocol import Data, Task, Work, continuous, main


def era(data: Data) -> Work:
    """Sample in pairs so that the model's step is dt, then ERA with square blocks."""
    import numpy as np
    from modred import ERA, make_sampled_format

    markov = data.responses[1:]
    blocks = data.block_rows

    def run() -> object:
        _, pairs = make_sampled_format(data.dt * np.arange(len(markov)), markov)
        return ERA(verbosity=0).compute_model(pairs, data.order, mc=blocks, mo=blocks)

    return Work(run, lambda model: continuous(model[0], data.dt))


TASKS = (Task("W5 ERA", "A, B, C", era),)
NAME = "modred"

if __name__ == "__main__":
    main(TASKS, NAME)
