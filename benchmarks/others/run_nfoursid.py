"""nfoursid: PO-MOESP and N4SID."""

from __future__ import annotations

from benchmarks.others.protocol import Data, Task, Work, continuous, main


def n4sid(data: Data) -> Work:
    """Follow its README: subspace_identification, then system_identification."""
    import pandas
    from nfoursid.nfoursid import NFourSID

    u = [f"u{k}" for k in range(data.inputs.shape[1])]
    y = [f"y{k}" for k in range(data.outputs.shape[1])]
    frame = pandas.DataFrame(data.inputs, columns=u).join(pandas.DataFrame(data.outputs, columns=y))

    def run() -> object:
        found = NFourSID(frame, output_columns=y, input_columns=u, num_block_rows=data.block_rows)
        found.subspace_identification()
        return found.system_identification(rank=data.order)

    return Work(run, lambda found: continuous(found[0].a, data.dt))


TASKS = tuple(Task(table, "A, B, C, D, noise covariance", n4sid) for table in ("W1", "W2", "W3"))
NAME = "nfoursid"

if __name__ == "__main__":
    main(TASKS, NAME)
