"""Time ERA on ten outputs and three inputs, Hankel 100 × 100 blocks, one BLAS thread.

Run ``python -m benchmarks.bench_era``; ``--quick`` is short. Beside it python-control's
``control.era`` where it is installed, and as a floor NumPy's singular value decomposition of
the same Hankel matrix, laid out beforehand. With and without noise, because the spectra differ;
without, the orders end at the rank, 20.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from vibrid.methods.era import ERA, ERADC
from vibrid.record import ImpulseResponses
from vibrid.structures import chain

ORDER, ORDERS = 20, range(2, 62, 2)
DT = 0.01
HEADER = "case                          |  median ms | shortest ms | poles off by"


def responses(blocks: int, noise: float) -> tuple[ImpulseResponses, NDArray[Any]]:
    """Return pulse responses of a chain of ten masses to three forces, and its poles."""
    frame = chain(np.ones(10), np.full(10, 16_000.0), damping_ratio=0.01)
    model = frame.state_space(forces=list(frame.dofs[:3])).to_discrete(DT)
    h = model.markov_parameters(2 * blocks + 1)
    h = h + noise * h.std() * np.random.default_rng(0).standard_normal(h.shape)
    return ImpulseResponses(h, dt=DT), model.poles


def spent(work: Callable[[], Any], repeats: int) -> tuple[float, float, Any]:
    """Return median and shortest CPU milliseconds, and the last result."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        times.append(1e3 * (time.process_time() - start))
    return float(np.median(times)), min(times), result


def line(
    name: str, work: Callable[[], Any], repeats: int, poles: NDArray[Any], of: Callable[..., Any]
) -> str:
    """Return one line of the table."""
    median, shortest, result = spent(work, repeats)
    found = of(result)
    off = "" if found is None else f"{np.abs(found[:, None] - poles).min(axis=0).max():12.1e}"
    return f"{name:29s} | {median:10.1f} | {shortest:11.1f} | {off}"


def compare(blocks: int, noise: float, repeats: int) -> list[str]:
    """Return the lines of one signal-to-noise ratio."""
    data, poles = responses(blocks, noise)
    era = ERA(rows=blocks, columns=blocks)
    correlating = ERADC(rows=max(2, blocks // 10), columns=blocks)
    h = data.values
    hankel = np.block([[h[1 + i + j] for j in range(blocks)] for i in range(blocks)])

    def one(method: Any) -> Any:
        return method.realize(method.decompose(data), ORDER)

    def many() -> Any:
        decomposition = era.decompose(data)
        possible = [order for order in ORDERS if order <= decomposition.largest_order]
        return [era.realize(decomposition, order) for order in possible][ORDER // 2 - 1]

    def eigenvalues(fit: Any) -> Any:
        return fit.model.poles

    lines = [
        line("vibrid ERA, one order", lambda: one(era), repeats, poles, eigenvalues),
        line("vibrid ERA, orders 2 to 60", many, repeats, poles, eigenvalues),
        line("vibrid ERADC, one order", lambda: one(correlating), repeats, poles, eigenvalues),
    ]
    if find_spec("control"):
        from control import eigensys_realization

        stacked = np.ascontiguousarray(h.transpose(1, 2, 0))
        lines.append(
            line(
                "python-control, one order",
                lambda: eigensys_realization(stacked, ORDER, m=blocks, n=blocks, dt=DT),
                repeats,
                poles,
                lambda found: np.linalg.eigvals(found[0].A),
            )
        )
    lines.append(
        line(
            "NumPy SVD of the Hankel alone",
            lambda: np.linalg.svd(hankel, full_matrices=False),
            repeats,
            poles,
            lambda found: None,
        )
    )
    return lines


def main(arguments: list[str] | None = None) -> None:
    """Print the tables; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="30 blocks, 3 runs")
    quick = parser.parse_args(arguments).quick
    blocks, repeats = (30, 3) if quick else (100, 15)
    print(f"CPU milliseconds, one BLAS thread, order {ORDER}, {blocks} × {blocks} blocks of 10 × 3")
    with threadpool_limits(limits=1):
        for noise in (0.0, 0.05):
            print(f"noise {100 * noise:g} % of the responses' rms\n{HEADER}")
            print("\n".join(compare(blocks, noise, repeats)))


if __name__ == "__main__":
    main()
