"""Time the Gram engine against a QR of the explicit block Hankel matrix, one BLAS thread.

Run ``python -m benchmarks.bench_gram``; ``--quick`` is short. The explicit matrix is built and
factored on fewer samples and scaled: both are linear in their number. Beside it the floor: one
product of the data with itself, a single lag's worth of work.
"""

from __future__ import annotations

import argparse

import numpy as np
import scipy.linalg as sla
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from benchmarks.timing import peak_megabytes, seconds
from vibrid import Record
from vibrid.chunks import open_stream
from vibrid.gram import factorize, reduce

CASES = ((4, 30, 100_000), (13, 80, 100_000), (10, 80, 200_000), (30, 40, 100_000))
HEADER = (
    "channels rows | samples | Gram+Cholesky s | explicit QR s |  ratio | ours MB | Hankel MB | "
    "one product s"
)


def explicit(z: NDArray[np.float64], n_rows: int) -> None:
    """Build the block Hankel matrix and take its triangle."""
    windows = sliding_window_view(z, n_rows, axis=0).transpose(0, 2, 1)
    sla.qr(windows.reshape(len(windows), -1), mode="r", overwrite_a=True, check_finite=False)


def compare(channels: int, n_rows: int, n_samples: int, peer_samples: int) -> str:
    """Return one line of the table."""
    z = np.random.default_rng(0).standard_normal((n_samples, channels))
    record = Record(z, dt=0.01)
    rows = np.arange(channels * n_rows)

    def ours() -> None:
        stream = open_stream(record)
        factorize(reduce(stream, n_rows), stream, rows)

    spent = seconds(ours, 3)
    theirs = seconds(lambda: explicit(z[:peer_samples], n_rows), 1) * n_samples / peer_samples
    floor = seconds(lambda: z.T @ z, 3)
    hankel = 8e-6 * n_samples * len(rows)
    return (
        f"{channels:8d} {n_rows:4d} | {n_samples:7d} | {spent:15.4f} | {theirs:13.2f} | "
        f"{theirs / spent:6.0f} | {peak_megabytes(ours):7.0f} | {hankel:9.0f} | {floor:.4f}"
    )


def main(arguments: list[str] | None = None) -> None:
    """Print the table; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples")
    quick = parser.parse_args(arguments).quick
    print("CPU seconds, one BLAS thread; the explicit matrix on 5000 samples, scaled")
    print(HEADER)
    with threadpool_limits(limits=1):
        for channels, n_rows, n_samples in CASES[: 2 if quick else None]:
            print(compare(channels, n_rows, n_samples // (10 if quick else 1), 5000))


if __name__ == "__main__":
    main()
