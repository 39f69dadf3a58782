"""The input of a known system from its output: example 4.2 of Han, Bohn & Bauer (2021).

Run `python -m studies.input_estimation`; it takes a minute.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from vibrid import StateSpace, estimate_input
from vibrid.blind.input_estimation import InputEstimate

PAGE = Path(__file__).resolve().parent.parent / "docs" / "studies" / "input_estimation.md"
GAIN = np.array([[1.0], [0.5]])
SYSTEM = StateSpace(np.diag([0.5, 0.6]), GAIN, [[1.0, 1.0]], [[0.0]], 1e-4)  # system (68)
N_SAMPLES = 10_000
BAND_HZ = 50.0
LONGER = 6  # times the record: the signal's own period, so that the piece taken is not periodic
VARIANCES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
SHOWN = 1e-4
SEEDS = 3
KINDS = ("smoother", "filter")
SETTLED = 0.1  # of the record, left out for the filter's error: it begins knowing nothing
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Run:
    """One estimate: relative error, that of the filter after it settled, predicted error."""

    kind: str
    variance: float
    error: float
    settled: float
    predicted: float


def signal(rng: np.random.Generator) -> Floats:
    """Return unit noise band-limited to 50 Hz, a piece of a period six times as long."""
    period = LONGER * N_SAMPLES * SYSTEM.dt
    lines = np.arange(1, int(BAND_HZ * period) + 1)
    phasors = rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))
    spectrum = np.zeros(LONGER * N_SAMPLES // 2 + 1, dtype=np.complex128)
    spectrum[lines] = phasors
    v = np.fft.irfft(spectrum)[:N_SAMPLES]
    return np.asarray(v / v.std())


def outputs(v: Floats, variance: float, rng: np.random.Generator) -> Floats:
    """Return x⁺ = A x + B v + G e, y = C x + e."""
    e = np.sqrt(variance) * rng.standard_normal(len(v))
    both = StateSpace(SYSTEM.A, np.hstack([SYSTEM.B, GAIN]), SYSTEM.C, [[0.0, 1.0]], SYSTEM.dt)
    return both.simulate(np.column_stack([v, e]))


def estimate(v: Floats, variance: float, kind: str, rng: np.random.Generator) -> InputEstimate:
    y = outputs(v, variance, rng)
    return estimate_input(SYSTEM, y, highest_hz=BAND_HZ, kind=kind, kalman_gain=GAIN)


def run(kind: str, variance: float, seed: int) -> Run:
    rng = np.random.default_rng([seed, 42])
    v = signal(rng)
    found = estimate(v, variance, kind, rng)
    off, start = found.inputs[:, 0] - v, int(SETTLED * N_SAMPLES)
    said = start if kind == "filter" else 0
    return Run(
        kind,
        variance,
        float(np.sqrt(np.mean(off**2)) / v.std()),
        float(np.sqrt(np.mean(off[start:] ** 2)) / v.std()),
        float(np.sqrt(np.mean(found.inputs_std[said:, 0] ** 2)) / v.std()),
    )


def plots(folder: Path) -> None:
    """Draw the signal, its estimate and the error over time and over frequency."""
    rng = np.random.default_rng([0, 42])
    v = signal(rng)
    found = estimate(v, SHOWN, "smoother", rng).inputs[:, 0]
    curves = [v, found, found - v]
    window = np.hanning(N_SAMPLES)
    amplitudes = [2 / window.sum() * np.abs(np.fft.rfft(window * each)) for each in curves]
    t, hertz = SYSTEM.dt * np.arange(N_SAMPLES), np.fft.rfftfreq(N_SAMPLES, SYSTEM.dt)
    low = hertz <= 2 * BAND_HZ
    draw(folder / "input_estimation_time.png", ("time [s]", "input", "linear"), t, curves)
    labels = ("frequency [Hz]", "amplitude of the input", "log")
    levels = [each[low] for each in amplitudes]
    draw(folder / "input_estimation_frequency.png", labels, hertz[low], levels)


def draw(path: Path, labels: tuple[str, str, str], x: Floats, curves: list[Floats]) -> None:
    """Write a plot: the input under its estimate, and the error below."""
    figure, (top, bottom) = subplots(2, sharex=True)
    top.plot(x, curves[0], label="true", color="0.6", linewidth=2.5)
    top.plot(x, curves[1], label="estimate", color="C0", linewidth=0.8)
    bottom.plot(x, curves[2], color="C3", linewidth=0.8)
    bottom.set(xlabel=labels[0], xlim=(x[0], x[-1]), ylabel="error")
    top.set(ylabel=labels[1])
    top.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, frameon=False)
    for axes in (top, bottom):
        axes.set_yscale(labels[2])
        axes.grid(alpha=0.3)
    figure.align_ylabels()
    save(figure, path)


def draw_errors(path: Path, runs: list[Run]) -> None:
    """Write a plot of the errors over the noise level."""
    figure, axes = subplots(1)
    for kind, colour in zip(KINDS, ("C0", "C1"), strict=True):
        errors = [medians(runs, kind, variance) for variance in VARIANCES]
        noise = np.sqrt(VARIANCES)
        axes.loglog(noise, [each.settled for each in errors], "o-", color=colour, label=kind)
        said = [each.predicted for each in errors]
        axes.loglog(noise, said, "--", color=colour, label=f"{kind}, predicted")
    axes.set(xlabel="standard deviation of the noise", ylabel="error over the signal's size")
    axes.legend()
    axes.grid(alpha=0.3)
    save(figure, path)


def subplots(rows: int, **options: bool) -> tuple[Any, Any]:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt.subplots(rows, 1, figsize=(7, 4.5), dpi=90, **options)


def save(figure: Any, path: Path) -> None:
    import matplotlib.pyplot as plt

    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)


def medians(runs: list[Run], kind: str, variance: float) -> Run:
    """Return the medians over the seeds of one kind and noise level."""
    chosen = [run for run in runs if (run.kind, run.variance) == (kind, variance)]
    names = ("error", "settled", "predicted")
    return Run(kind, variance, *(float(np.median([getattr(r, n) for r in chosen])) for n in names))


def page(runs: list[Run], seeds: int) -> str:
    head = f"""# The input of a known system, from its output

System (68) of Han, Bohn & Bauer (2021), example 4.2: two states, 10 kHz, {N_SAMPLES} samples,
a signal band-limited to {BAND_HZ:g} Hz that is not periodic (a piece of a period six times as
long), noise through the gain of the innovations. `estimate_input` knows the system, its gain and
the band. Root mean square errors over that of the signal, medians of {seeds} seeds.

The smoother uses all samples for each estimate, the filter only those before. The filter
begins without knowledge, so its error is also given after the first tenth of the record.
*Predicted* is what the estimate says of itself, from the noise alone; of the filter after the
first tenth.

Written by `python -m studies.input_estimation`.

| noise variance | smoother | predicted | filter | after a tenth | predicted |
|---:|---:|---:|---:|---:|---:|
"""
    tail = f"""
![Over noise](input_estimation_noise.png)

Smoother and filter after the first tenth.

![Over time](input_estimation_time.png)

![Over frequency](input_estimation_frequency.png)

The smoother at noise variance {SHOWN:g}; amplitudes under a Hann window.
"""
    lines = []
    for variance in VARIANCES:
        smoother, filtered = (medians(runs, kind, variance) for kind in KINDS)
        cells = (
            smoother.error,
            smoother.predicted,
            filtered.error,
            filtered.settled,
            filtered.predicted,
        )
        lines.append(f"| {variance:g} | {' | '.join(f'{each:.2g}' for each in cells)} |\n")
    return head + "".join(lines) + tail


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="records per noise level")
    parser.add_argument("--output", type=Path, default=PAGE, help="page to write")
    options = parser.parse_args()
    with threadpool_limits(1, user_api="blas"):
        runs = [
            run(kind, variance, seed)
            for kind in KINDS
            for variance in VARIANCES
            for seed in range(options.seeds)
        ]
        options.output.parent.mkdir(parents=True, exist_ok=True)
        plots(options.output.parent)
        draw_errors(options.output.parent / "input_estimation_noise.png", runs)
    options.output.write_text(page(runs, options.seeds), encoding="utf-8")
    print(f"{options.output} written")


if __name__ == "__main__":
    main()
