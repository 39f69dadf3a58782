"""The workloads: shaker tests of a chain of masses, made from a seed, with their true poles."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vibrid import Record
from vibrid.structures import Structure, chain

DT = 0.01
NOISE = 0.05  # of each output's standard deviation
SEED = 20240501
SPRING = 16150.0  # N/m on 1 kg: modes up to 40 Hz
TOP_SPRING = 4000.0  # joins the tenth mass to the ground: lowest mode 4.7 Hz
OBSERVER_ORDER = 40
ORDERS = tuple(range(2, 62, 2))
QUICK = {"W1": 4, "W2": 20, "W3": 100, "W4": 20, "W5": 5}  # times less data


@dataclass(frozen=True)
class Table:
    """One comparison: what is asked of everyone, on which data set."""

    name: str
    data: str
    asked: str


TABLES = (
    Table("W1", "W1", "1 input, 3 outputs, 4096 samples, 15 block rows, order 6"),
    Table("W2", "W2", "3 inputs, 10 outputs, 100 000 samples, 40 block rows, order 20"),
    Table("W3", "W3", "as W2, with a million samples"),
    Table(
        "W4 covariance",
        "W4",
        "output-only: 10 outputs, 200 000 samples, 40 block rows, orders 2, 4 … 60 "
        "by covariances; accuracy at order 20",
    ),
    Table(
        "W4 data-driven",
        "W4",
        "the same by projection of the data",
    ),
    Table("W5 ERA", "W5", "impulse responses, 10 × 3, Hankel matrix of 100 × 100 blocks, order 20"),
    Table("W5 OKID", "W2", "the data of W2, observer order 40, then ERA at order 20"),
)


def structure(n_dof: int) -> Structure:
    """Return the chain: 1 % damping, modes of 4.7 to 40 Hz when it has ten masses."""
    springs = np.full(n_dof, SPRING)
    ends = [TOP_SPRING] if n_dof == 10 else []
    return chain(np.ones(n_dof), np.append(springs, ends), damping_ratio=0.01)


def _shaker(n_dof: int, n_inputs: int, n_samples: int) -> Record:
    rng = np.random.default_rng(SEED)
    frame = structure(n_dof)
    forces = rng.standard_normal((n_samples, n_inputs))
    return frame.simulate(forces, DT, forces=frame.dofs[:n_inputs], noise=NOISE, rng=rng)


def _record(folder: Path, n_dof: int, n_inputs: int, n_samples: int) -> dict[str, Any]:
    record = _shaker(n_dof, n_inputs, n_samples)
    np.save(folder / "inputs.npy", record.inputs)
    np.save(folder / "outputs.npy", record.outputs)
    np.save(folder / "truth.npy", structure(n_dof).poles)
    return {"n_inputs": n_inputs, "order": 2 * n_dof}


def small(folder: Path, share: int) -> dict[str, Any]:
    """W1."""
    return _record(folder, 3, 1, 4096 // share) | {"block_rows": 15 if share == 1 else 8}


def large(folder: Path, share: int) -> dict[str, Any]:
    """W2."""
    sizes = {"block_rows": 40, "observer_order": OBSERVER_ORDER}
    return _record(folder, 10, 3, 100_000 // share) | sizes


def huge(folder: Path, share: int) -> dict[str, Any]:
    """W3."""
    return _record(folder, 10, 3, 1_000_000 // share) | {"block_rows": 40}


def ambient(folder: Path, share: int) -> dict[str, Any]:
    """W4: white forces on every mass, not recorded."""
    about = _record(folder, 10, 10, 200_000 // share)
    (folder / "inputs.npy").unlink()
    return about | {"n_inputs": 0, "block_rows": 40, "orders": ORDERS}


def responses(folder: Path, share: int) -> dict[str, Any]:
    """W5: 201 impulse responses from lag 0, with noise."""
    rng = np.random.default_rng(SEED)
    frame, blocks = structure(10), 100 // share
    model = frame.state_space("acceleration", frame.dofs[:3]).to_discrete(DT)
    exact = model.markov_parameters(2 * blocks + 1)
    noise = rng.standard_normal(exact.shape) * exact[1:].std(axis=0)
    np.save(folder / "responses.npy", exact + NOISE * noise)
    np.save(folder / "truth.npy", frame.poles)
    return {"n_inputs": 3, "order": 20, "block_rows": blocks}


DATA: dict[str, Callable[[Path, int], dict[str, Any]]] = {
    "W1": small,
    "W2": large,
    "W3": huge,
    "W4": ambient,
    "W5": responses,
}


def write(name: str, folder: Path, quick: bool = False) -> Path:
    """Write the files of data set `name` into its own folder, unless this file made them."""
    target = folder / (f"{name}-quick" if quick else name)
    about, origin = target / "about.json", hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    if about.exists() and json.loads(about.read_text(encoding="utf-8"))["origin"] == origin:
        return target
    target.mkdir(parents=True, exist_ok=True)
    share = QUICK[name] if quick else 1
    described = DATA[name](target, share) | {"dt": DT, "seed": SEED, "origin": origin}
    about.write_text(json.dumps(described), encoding="utf-8")
    return target
