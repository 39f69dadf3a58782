"""Fixtures: one BLAS thread, a seeded generator, records outside the project, the command's."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from vibrid.excitation import white_noise

os.environ.setdefault("MPLBACKEND", "Agg")  # no window, whatever the machine has
pytest.register_assert_rewrite("cli_cases", "era_cases")  # their asserts tell both sides


@pytest.fixture(scope="session", autouse=True)
def one_blas_thread() -> Iterator[None]:
    """Make times and rounding the same on every number of cores."""
    with threadpool_limits(1, user_api="blas"):
        yield


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator with a fixed seed, new for each test."""
    return np.random.default_rng(20260)


@pytest.fixture(scope="session")
def shared_data(pytestconfig: pytest.Config) -> Path:
    """Return the folder of records that may not be part of the project, or skip."""
    folder = pytestconfig.rootpath.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("needs the records in ../shared/data, which this copy does not have")
    return folder


@pytest.fixture
def warnings_count(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let warnings through, which the command hides from users, so that tests see them."""
    monkeypatch.setenv("VIBRID_DEBUG", "1")


@pytest.fixture(scope="module")
def csv_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a CSV file of 100 s at 20 Hz: force at the top, both accelerations."""
    from cli_cases import FRAME, HEADER  # with the command, which few tests need

    rng = np.random.default_rng(3)
    record = FRAME.simulate(white_noise(2000, rng=rng), 0.05, forces=["f2"], noise=0.01, rng=rng)
    columns = np.column_stack([0.05 * np.arange(2000), record.inputs[:], record.outputs[:]])
    path = tmp_path_factory.mktemp("cli") / "run.csv"
    np.savetxt(path, columns, delimiter=",", header=HEADER, comments="")
    return path
