"""pyOMA2: stochastic subspace identification by covariances and by projection."""

from __future__ import annotations

import functools
from typing import Any

from benchmarks.others.protocol import Data, Task, Work, main


def ssi(data: Data, method: str) -> Work:
    """Hankel matrix, models of every order, poles of every order, no criteria applied."""
    import numpy as np
    from pyoma2.functions.ssi import SSI_fast, SSI_poles, build_hank

    y = np.ascontiguousarray(data.outputs.T)
    orders = data.about["orders"]
    largest, step = orders[-1], orders[1] - orders[0]

    def run() -> Any:
        hankel, _ = build_hank(Y=y, Yref=y, br=data.block_rows, method=method)
        observability, A, C, _ = SSI_fast(hankel, data.block_rows, largest, step=step)
        return SSI_poles(observability, A, C, largest, data.dt, step=step, HC=False)

    return Work(run, lambda found: found[3][:, data.order // step])


TASKS = tuple(
    Task(table, f"{method}: 30 orders, modes of each", functools.partial(ssi, method=method))
    for table, method in (
        ("W4 covariance", "cov_R"),
        ("W4 covariance", "cov"),
        ("W4 data-driven", "dat"),
    )
)
NAME = "pyOMA-2"

if __name__ == "__main__":
    main(TASKS, NAME)
