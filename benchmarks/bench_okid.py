"""Time OKID, one BLAS thread: CPU seconds of its parts, and of plain least squares beside it.

Run ``python -m benchmarks.bench_okid``; ``--quick`` is short. Workload: the chain of
`bench_identify` with 3 forces and 10 accelerations; observer order 40, a model of order 20 with
A, B, C, D and K. The peer is what the textbook says: the regressors laid out, `numpy.linalg.lstsq`
(on fewer samples, scaled: it is linear in them) and nothing after it.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from threadpoolctl import threadpool_limits

import vibrid as vb
from benchmarks.bench_identify import record_of
from benchmarks.timing import peak_megabytes, seconds
from vibrid.chunks import open_stream
from vibrid.gram import reduce
from vibrid.markov import joint_markov
from vibrid.methods.era import ERA
from vibrid.methods.okid import OKID
from vibrid.methods.okid.regression import regress

OBSERVER_ORDER, ORDER = 40, 20
PEER_SAMPLES = 6000


def whole(method: OKID, record: vb.Record) -> None:
    """Identify without completing: decompose, then realize one order."""
    method.realize(method.decompose(record), ORDER)


def parts(method: OKID, record: vb.Record, repeats: int) -> list[tuple[str, float]]:
    """Return the seconds of each part, in the order in which they follow each other."""
    stream = open_stream(record)
    mask = np.ones(stream.n_outputs, bool)
    gram = reduce(stream, OBSERVER_ORDER + 1)
    data = regress(stream, gram, OBSERVER_ORDER, mask)
    observer = data.observer(OBSERVER_ORDER)
    models = method.decompose(stream)
    sized = models.method.realization
    n_lags = sized.highest_lag(sized.rows, sized.columns) + 1
    markov = joint_markov(observer, n_lags)[:, :, : stream.n_inputs]
    works = [
        ("walk the data (means, scales)", lambda: open_stream(record)),
        ("Gram", lambda: reduce(stream, OBSERVER_ORDER + 1)),
        ("factor", lambda: regress(stream, gram, OBSERVER_ORDER, mask)),
        ("observer Markov parameters", lambda: replace(data).observer(OBSERVER_ORDER)),
        (f"recursion to {n_lags} lags", lambda: joint_markov(observer, n_lags)),
        ("Hankel factorization", lambda: sized.factor(markov)),
        (f"model of order {ORDER} with K", lambda: replace(models).realize(ORDER)),
    ]
    return [(name, seconds(work, repeats)) for name, work in works]


def regression(record: vb.Record, n_samples: int) -> None:
    """Solve for the observer Markov parameters by `numpy.linalg.lstsq`."""
    z = np.hstack([record.inputs, record.outputs])[:n_samples]
    past = sliding_window_view(z[:-1], OBSERVER_ORDER, axis=0).transpose(0, 2, 1)
    rows = past.reshape(len(past), -1)
    np.linalg.lstsq(
        np.hstack([record.inputs[OBSERVER_ORDER:n_samples], rows]),
        record.outputs[OBSERVER_ORDER:n_samples],
        rcond=None,
    )


def main(arguments: list[str] | None = None) -> None:
    """Print the table; `arguments` as on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the samples")
    share = 10 if parser.parse_args(arguments).quick else 1
    with threadpool_limits(limits=1):
        record = record_of(10, 3, 100_000 // share)
        repeats = 3
        method = OKID(observer_order=OBSERVER_ORDER)
        spent = seconds(lambda: whole(method, record), repeats)
        memory = peak_megabytes(lambda: whole(method, record))
        print(f"CPU seconds, one BLAS thread; 3 in, 10 out, {record.n_samples} samples")
        print(f"{'OKID, A B C D K':32s} | {spent:7.3f} s | {memory:5.0f} MB above the data")
        for name, time in parts(method, record, repeats):
            print(f"  {name:30s} | {time:7.3f} s | {100 * time / spent:3.0f} %")
        eradc = replace(method, realization="eradc")
        print(f"{'with ERA/DC':32s} | {seconds(lambda: whole(eradc, record), repeats):7.3f} s")
        large = replace(method, realization=ERA(rows=100, columns=100))
        blocks = seconds(lambda: whole(large, record), repeats)
        print(f"{'with 100 × 100 blocks':32s} | {blocks:7.3f} s")
        peer_samples = min(PEER_SAMPLES, record.n_samples)
        peer = seconds(lambda: regression(record, peer_samples), 1)
        scaled = peer * record.n_samples / peer_samples
        print(
            f"{'numpy lstsq of the regression':32s} | {scaled:7.3f} s | {scaled / spent:.0f} times"
        )


if __name__ == "__main__":
    main()
