"""vibrid itself, by the same protocol: method, sizes and order given."""

from __future__ import annotations

from functools import partial
from typing import Any

from benchmarks.others.protocol import Data, Task, Work, main


def _record(data: Data, mapped: bool = False) -> Any:
    import vibrid as vb

    inputs = data.array("inputs", mapped) if data.about["n_inputs"] else None
    return vb.Record(data.array("outputs", mapped), inputs, dt=data.dt)


def _poles(fit: Any) -> Any:
    import vibrid as vb

    return vb.modes_of(fit).poles


def full(data: Data, mapped: bool = False) -> Work:
    """A, B, C, D, K, offsets and initial states: what identify() returns."""
    import vibrid as vb

    record, method = _record(data, mapped), vb.N4SID(block_rows=data.block_rows)
    return Work(lambda: vb.identify(record, method, order=data.order), _poles)


def mapped(data: Data) -> Work:
    """The same from memory-mapped files, read in chunks."""
    return full(data, mapped=True)


def realized(data: Data, mapped: bool = False, **options: Any) -> Work:
    """A, B, C, D, K from the Gram matrix: no further pass over the data."""
    import vibrid as vb

    record, method = _record(data, mapped), vb.N4SID(block_rows=data.block_rows, **options)
    return Work(lambda: method.realize(method.decompose(record), data.order), _poles)


def mapped_realized(data: Data) -> Work:
    """The same from memory-mapped files, read in chunks."""
    return realized(data, mapped=True)


def moesp(data: Data) -> Work:
    """The same with weighting and transition given: no second model to compare with."""
    return realized(data, weighting="moesp", transition="shift")


def sweep(data: Data, kind: str) -> Work:
    """SSI at every order, from one decomposition."""
    import vibrid as vb

    record, method = _record(data), vb.SSI(kind=kind, block_rows=data.block_rows)

    def run() -> dict[int, Any]:
        shared = method.decompose(record)
        return {order: method.realize(shared, order) for order in data.about["orders"]}

    return Work(run, lambda fits: _poles(fits[data.order]))


def sweep_with_modes(data: Data, kind: str) -> Work:
    """The same, and the modes of every model."""
    import vibrid as vb

    models = sweep(data, kind).run

    def run() -> dict[int, Any]:
        return {order: vb.modes_of(fit) for order, fit in models().items()}

    return Work(run, lambda modes: modes[data.order].poles)


def era(data: Data) -> Work:
    """ERA with square blocks."""
    import vibrid as vb

    responses = vb.ImpulseResponses(data.responses, dt=data.dt)
    method = vb.ERA(rows=data.block_rows, columns=data.block_rows)
    return Work(lambda: method.realize(method.decompose(responses), data.order), _poles)


def era_identify(data: Data) -> Work:
    """The same through identify(), which also judges the fit."""
    import vibrid as vb

    responses = vb.ImpulseResponses(data.responses, dt=data.dt)
    method = vb.ERA(rows=data.block_rows, columns=data.block_rows)
    return Work(lambda: vb.identify(responses, method, order=data.order), _poles)


def _okid(data: Data) -> Any:
    """Return OKID with a Hankel matrix of as many blocks as the observer has."""
    import vibrid as vb

    blocks = data.about["observer_order"]
    return vb.OKID(observer_order=blocks, realization=vb.ERA(rows=blocks, columns=blocks))


def okid(data: Data) -> Work:
    """OKID with ERA, from the record to A, B, C, D and gain."""
    record, method = _record(data), _okid(data)
    return Work(lambda: method.realize(method.decompose(record), data.order), _poles)


def okid_identify(data: Data) -> Work:
    """The same through identify(), which fits B, D, offsets and initial states to the data."""
    import vibrid as vb

    record, method = _record(data), _okid(data)
    return Work(lambda: vb.identify(record, method, order=data.order), _poles)


FULL = "identify: A, B, C, D, K, offsets, initial states"
REALIZED = "decompose and realize: A, B, C, D, K"
MOESP = "decompose and realize, MOESP by shift invariance: A, B, C, D, K"
MODELS = "30 orders: A, C, K"
MODES = "30 orders: A, C, K, modes of each"
TASKS = (
    Task("W1", FULL, full),
    Task("W1", REALIZED, realized),
    Task("W1", MOESP, moesp),
    Task("W2", FULL, full),
    Task("W2", REALIZED, realized),
    Task("W2", MOESP, moesp),
    Task("W3", FULL + "; from mapped files", mapped),
    Task("W3", REALIZED + "; from mapped files", mapped_realized),
    Task("W4 covariance", MODES, partial(sweep_with_modes, kind="covariance")),
    Task("W4 covariance", MODELS, partial(sweep, kind="covariance")),
    Task("W4 data-driven", MODES, partial(sweep_with_modes, kind="data")),
    Task("W4 data-driven", MODELS, partial(sweep, kind="data")),
    Task("W5 ERA", "decompose and realize: A, B, C, D", era),
    Task("W5 ERA", "identify: A, B, C, D and findings", era_identify),
    Task("W5 OKID", "decompose and realize: A, B, C, D, K", okid),
    Task("W5 OKID", "identify: A, B, C, D, K, offsets, initial states", okid_identify),
)
NAME = "vibrid"

if __name__ == "__main__":
    main(TASKS, NAME)
