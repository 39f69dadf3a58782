"""SLICOT through ctrlsys: IB01AD, IB01BD, IB01CD, each documented by SLICOT itself."""

from __future__ import annotations

from typing import Any

from benchmarks.others.protocol import Data, Task, Work, continuous, main


class Slicot:
    """The three drivers on one data set, by Cholesky of the Gram matrix, without batches."""

    def __init__(self, data: Data) -> None:
        import numpy as np

        self.u, self.y = np.asfortranarray(data.inputs), np.asfortranarray(data.outputs)
        self.blocks, self.order = data.block_rows, data.order

    @property
    def sizes(self) -> tuple[int, int]:
        return self.u.shape[1], self.y.shape[1]

    def model(self, method: str, job: str, gain: str) -> Any:
        """Return A, C, B, D, Q, Ry, S, K: `job` "C" or "A", `gain` "K" or "N"."""
        import ctrlsys

        m, p = self.sizes
        _, triangle, _, _, failed = ctrlsys.ib01ad(
            method, "C", "N", "O", "N", "N", self.blocks, m, p, self.u, self.y, 0.0, -1.0
        )
        check("IB01AD", failed)
        found = ctrlsys.ib01bd(
            method, job, gain, self.blocks, self.order, m, p, len(self.u), triangle, 0.0
        )
        check("IB01BD", found[-1])
        return found

    def with_inputs(self, A: Any, C: Any) -> Any:
        """Return x0, B, D by least squares on the whole record; IB01CD overwrites the data."""
        import ctrlsys
        import numpy as np

        m, p = self.sizes
        B, D = np.zeros((self.order, m), order="F"), np.zeros((p, m), order="F")
        found = ctrlsys.ib01cd(
            "X", "C", "D", self.order, m, p, A, B, C, D, self.u.copy("F"), self.y.copy("F"), 0.0
        )
        check("IB01CD", found[-1])
        return found


def check(routine: str, failed: int) -> None:
    """Raise what SLICOT returns as a number."""
    if failed:
        raise RuntimeError(f"{routine} returned INFO = {failed}")


def n4sid_states(data: Data) -> Work:
    """A and C alone."""
    slicot = Slicot(data)
    return Work(lambda: slicot.model("N", "C", "N"), lambda found: continuous(found[0], data.dt))


def moesp(data: Data) -> Work:
    """Everything from the triangular factor, by MOESP."""
    slicot = Slicot(data)
    return Work(lambda: slicot.model("M", "A", "K"), lambda found: continuous(found[0], data.dt))


def n4sid(data: Data) -> Work:
    """A, C, K by N4SID; B, D and the initial state by least squares on the data."""
    slicot = Slicot(data)

    def run() -> Any:
        found = slicot.model("N", "C", "K")
        slicot.with_inputs(found[0].copy(order="F"), found[1].copy(order="F"))
        return found

    return Work(run, lambda found: continuous(found[0], data.dt))


TASKS = tuple(
    Task(table, computes, prepare)
    for table in ("W1", "W2", "W3")
    for computes, prepare in (
        ("N4SID: A, C", n4sid_states),
        ("MOESP: A, B, C, D, K from the triangular factor", moesp),
        ("N4SID: A, C, K; B, D, initial state by least squares", n4sid),
    )
)
NAME = "ctrlsys"

if __name__ == "__main__":
    main(TASKS, NAME)
