"""koma: covariance-driven stochastic subspace identification."""

from __future__ import annotations

from typing import Any

from benchmarks.others.protocol import Data, Task, Work, main


def covariance(data: Data) -> Work:
    """Poles and shapes of every order, without weighting."""
    from koma.oma import covssi

    orders = list(data.about["orders"])

    def run() -> Any:
        return covssi(
            data.outputs,
            1 / data.dt,
            data.block_rows,
            orders,
            showinfo=False,
            return_flat=False,
            discard_conjugates=False,
        )

    return Work(run, lambda found: found[0][orders.index(data.order)])


TASKS = (Task("W4 covariance", "30 orders, modes of each", covariance),)
NAME = "koma-python"

if __name__ == "__main__":
    main(TASKS, NAME)
