"""Modal data of a model in physical quantities: poles, displacement shapes, force participation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError, OptionError
from ..modes import Complexes
from ..record import Floats
from ..statespace import StateSpace
from .layout import Layout

Indices = NDArray[np.int64]
RIGID = 1e-4  # of the fastest pole: a slower one is rigid-body motion
NEGATIVE_AXIS = 1e-9  # relative distance from the negative real axis of the discrete plane
UNSTABLE = 1e-9  # |μ| − 1 that is rounding
OUT_OF_PHASE = np.pi / 4  # of a drive-point residue that should be that of a positive mass
WEAK = 0.01  # share of the strongest mode's response below which a mode left out is spurious
MATCH = 0.05  # relative distance within which a frequency asked for is found


@dataclass(frozen=True, eq=False)
class ModalData:
    """Poles and vectors of a model, all in SI (or consistent units) and displacement.

    Poles of a complex pair stand side by side, λ₁, λ₁*, λ₂, λ₂*, …; real ones come last.

    Attributes
    ----------
    poles : complex array (n_poles,)
        Continuous [rad/s].
    shapes : complex array (n_outputs, n_poles)
        Displacement at each used sensor, in the direction of its DOF.
    forces : complex array (n_poles, n_forces)
        Rows of Ψ⁻¹ B_c for the used forces.
    bases : complex array (n_poles, n_bases)
        The same for base accelerations.
    strength : array (n_poles,)
        Share of each pole in the energy of the impulse responses; zero where nothing is known
        to drive the model.
    direct : array (n_outputs, n_forces + n_bases)
        Direct transmission in continuous time.
    """

    poles: Complexes
    shapes: Complexes
    forces: Complexes
    bases: Complexes
    strength: Floats
    direct: Floats

    def take(self, indices: Sequence[int] | Indices) -> ModalData:
        """Return some of the poles, in the order given."""
        k = np.asarray(indices, dtype=np.int64)
        return replace(
            self,
            poles=self.poles[k],
            shapes=self.shapes[:, k],
            forces=self.forces[k],
            bases=self.bases[k],
            strength=self.strength[k],
        )

    @property
    def pairs(self) -> Indices:
        """First index of each complex pair."""
        return np.flatnonzero(self.poles.imag > 0)

    @property
    def reals(self) -> Indices:
        return np.flatnonzero(self.poles.imag == 0)

    def delayed(self, delays: Floats) -> ModalData:
        """Return the data with sensors that lag by `delays` [s] set right."""
        return replace(self, shapes=self.shapes * np.exp(delays[:, None] * self.poles))


def modal_data(
    system: StateSpace, layout: Layout, holds: Sequence[str], drive: Floats
) -> ModalData:
    """Return the modal data of a model.

    Parameters
    ----------
    system : StateSpace
    layout : Layout
    holds : sequence of str
        Of every input of the system.
    drive : array (n, k)
        What drives the states, to tell strong poles from weak ones.

    Raises
    ------
    DataError
        A discrete pole at zero; poles that coincide without a full set of vectors.
    """
    values, vectors = np.linalg.eig(system.A)
    order = _conjugates_together(values)
    values, vectors = values[order].astype(complex), vectors[:, order].astype(complex)
    _check_vectors(values, vectors, system.dt)
    poles = _continuous(values, system.dt)
    solved: Complexes = np.linalg.solve(vectors, np.hstack([system.B, drive]).astype(complex))
    rows, driven = solved[:, : system.n_inputs], solved[:, system.n_inputs :]
    factors, shifts = _input_factors(values, poles, system.dt, holds)
    rows = np.asarray(rows * factors)
    seen = system.C[layout.outputs] @ vectors
    power = poles[None, :] ** layout.powers[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        shapes = layout.output_factors[:, None] * seen / power
    forces = np.asarray(rows[:, layout.forces] / layout.force_factors)
    bases = np.asarray(rows[:, layout.bases] / layout.base_factors)
    strength = _strength(values, system.C @ vectors, driven, system.dt)
    used = np.concatenate([layout.forces, layout.bases])
    sizes = np.concatenate([layout.force_factors, layout.base_factors])
    direct = system.D[layout.outputs] - (seen @ (rows * shifts)).real
    direct = layout.output_factors[:, None] * direct[:, used] / sizes
    return ModalData(poles, shapes, forces, bases, strength, direct)


def _conjugates_together(values: Complexes) -> Indices:
    """Return the order λ₁, λ₁*, λ₂, λ₂*, …, reals last; pairs by |Im|."""
    upper = np.flatnonzero(values.imag > 0)
    upper = upper[np.argsort(np.abs(values[upper].imag), kind="stable")]
    pairs = []
    for k in upper:  # NumPy returns a pair as neighbours, exactly conjugate
        pairs += [int(k), int(k) + 1]
    return np.array([*pairs, *np.flatnonzero(values.imag == 0)], dtype=np.int64)


def _check_vectors(values: Complexes, vectors: Complexes, dt: float | None) -> None:
    if dt is not None and (values == 0).any():
        raise DataError(
            "The model has a discrete pole at zero, a pure delay without a frequency. Use a "
            "lower order."
        )
    if np.linalg.cond(vectors) > 1e13:
        raise DataError(
            "Poles of the model coincide and have no full set of shapes, as of a rigid-body "
            "mode: M, R and K cannot be told from them. Hold the structure by soft springs, or "
            "leave displacement and velocity sensors out."
        )


def _continuous(values: Complexes, dt: float | None) -> Complexes:
    if dt is None:
        return values
    poles = np.asarray(np.log(values) / dt, dtype=np.complex128)
    return np.asarray(np.where(values.imag == 0, _real_poles(values, poles), poles))


def _real_poles(values: Complexes, poles: Complexes) -> Complexes:
    """Return poles whose imaginary part is exactly zero, unless they are beyond Nyquist."""
    return np.asarray(np.where(values.real > 0, poles.real + 0j, poles))


def _input_factors(
    values: Complexes, poles: Complexes, dt: float | None, holds: Sequence[str]
) -> tuple[Complexes, Complexes]:
    """Return what turns rows of Ψ⁻¹ B_d into Ψ⁻¹ B_c, and these into Ψ⁻¹ times the state shift.

    With μ = e^{λ dt}: zoh (μ − 1)/λ; foh adds (μ − 1) times the shift
    ∫ e^{λs}(1 − s/dt) ds; band-limited μ dt, the shift ½ dt. See `statespace.sampling`.
    """
    nothing = np.zeros((len(poles), len(holds)), dtype=np.complex128)
    if dt is None or not holds:
        return nothing + 1, nothing
    held, ramp = dt * _phi(poles * dt, 1), dt * _phi(poles * dt, 2)
    half = np.full_like(poles, dt / 2)
    each = {
        "zoh": (held, 0 * held),
        "foh": (held + (values - 1) * ramp, ramp),
        "band_limited": (values * dt, half),
    }
    factors = [1 / each[hold][0] for hold in holds]
    return np.stack(factors, axis=1), np.stack([each[hold][1] for hold in holds], axis=1)


def _phi(x: Complexes, k: int) -> Complexes:
    """Return Σ xʲ / (j + k)!: (eˣ − 1)/x for k = 1, (eˣ − 1 − x)/x² for k = 2."""
    small = np.abs(x) < 0.5
    near, far = np.where(small, x, 0), np.where(small, 1, x)
    series = sum(near**j / math.factorial(j + k) for j in range(14))
    closed = (np.expm1(far) - (0 if k == 1 else far)) / far**k
    return np.asarray(np.where(small, series, closed))


def _strength(values: Complexes, seen: Complexes, rows: Complexes, dt: float | None) -> Floats:
    """Return the energy of each pole's impulse response, outputs weighted alike."""
    rate = -2 * values.real if dt is None else 1 - np.abs(values) ** 2
    largest = float(np.abs(values).max()) if dt is None else 1.0
    decay = np.maximum(rate, 1e-9 * largest)
    energy = np.abs(seen) ** 2 * (np.sum(np.abs(rows) ** 2, axis=1) / decay)
    total = energy.sum(axis=1, keepdims=True)
    return np.asarray((energy / np.where(total > 0, total, 1)).mean(axis=0))


@dataclass(frozen=True, eq=False)
class Selection:
    """Which poles stand for the structure, and why the others do not.

    Attributes
    ----------
    data : ModalData
        Of the kept poles, frequencies ascending.
    dropped : tuple of str
        A sentence for each pole or pair left out.
    left_out : ModalData
        Pairs that are as strong and as physical as those kept, but more than the DOFs.
    """

    data: ModalData
    dropped: tuple[str, ...]
    left_out: ModalData


def select_poles(
    data: ModalData,
    layout: Layout,
    dt: float | None,
    frequencies_hz: Sequence[float] | None,
) -> Selection:
    """Choose the poles of the structure, as many pairs as there are instrumented DOFs.

    1. Poles at the Nyquist frequency and unstable ones are dropped.
    2. Real poles are kept only where they complete the pairs to the number of DOFs exactly
       (overdamped modes); otherwise they are dropped.
    3. Of more pairs than DOFs, those whose drive-point response is not that of a positive
       mass (more than 45° off) are dropped, then the weakest ones by their share in the
       energy of the impulse responses.

    `frequencies_hz` replaces 3 and names the pairs to keep.

    Raises
    ------
    DataError
        A rigid-body mode; no oscillating pole at all.
    OptionError
        A frequency that the model does not have.
    """
    dropped: list[str] = []
    keep = _stable(data, dt, dropped)
    data = data.take(keep)
    _refuse_rigid(data)
    pairs, reals = list(data.pairs), list(data.reals)
    wanted = layout.n_dof
    left_out: list[int] = []
    if frequencies_hz is not None:
        chosen = _named(data, frequencies_hz)
        others = [k for k in pairs if k not in chosen]
        dropped += [_of_pair(data, k, "not asked for") for k in others]
        left_out = _further(data, chosen, others, layout)
        pairs = chosen
    elif len(pairs) > wanted:
        if not data.strength.any():
            raise OptionError(
                f"The model has {len(pairs)} modes for {wanted} DOFs and no inputs that tell "
                "the strong ones; choose them with frequencies_hz."
            )
        pairs, left_out = _strongest(data, pairs, layout, dropped)
    overdamped = reals if len(reals) == 2 * (wanted - len(pairs)) else []
    if not overdamped:
        dropped += [f"real pole {data.poles[k].real:.4g} rad/s" for k in reals]
    pairs.sort(key=lambda k: abs(data.poles[k]))
    kept = [index for k in pairs for index in (k, k + 1)]
    if not kept and not overdamped:
        raise DataError(
            "The model has no stable pole that oscillates; no structure can be read from it. "
            "Use a higher order."
        )
    others = [index for k in left_out for index in (k, k + 1)]
    return Selection(data.take([*kept, *overdamped]), tuple(dropped), data.take(others))


def _stable(data: ModalData, dt: float | None, dropped: list[str]) -> list[int]:
    keep = []
    for k, pole in enumerate(data.poles):
        beyond = dt is not None and abs(abs(pole.imag) * dt - np.pi) < NEGATIVE_AXIS
        growing = pole.real * (dt or 1 / max(abs(pole), 1e-300)) > UNSTABLE
        if not (beyond or growing):
            keep.append(k)
        elif pole.imag >= 0:
            reason = "on the negative real axis" if beyond else "unstable"
            dropped.append(_of_pair(data, k, reason))
    return keep


def _of_pair(data: ModalData, k: int, reason: str) -> str:
    pole = data.poles[k]
    return f"{abs(pole) / 2 / np.pi:.4g} Hz, damping ratio {-pole.real / abs(pole):.3g}: {reason}"


def _refuse_rigid(data: ModalData) -> None:
    if not len(data.poles):
        return
    size = np.abs(data.poles)
    if size.min() < RIGID * size.max():
        raise DataError(
            f"The model has a pole at {size.min() / 2 / np.pi:.2g} Hz beside others up to "
            f"{size.max() / 2 / np.pi:.4g} Hz: a rigid-body mode (or drift), for which K is "
            "singular and shapes coincide. Use accelerometers only, which do not see it, "
            "detrend the record, or hold the structure by soft springs."
        )


def _named(data: ModalData, frequencies_hz: Sequence[float]) -> list[int]:
    values = np.asarray(frequencies_hz)
    if values.ndim != 1 or not values.size or values.dtype.kind not in "iuf":
        raise OptionError(
            f"frequencies_hz must be a list of frequencies [Hz]; got {frequencies_hz!r}."
        )
    chosen: list[int] = []
    pairs = data.pairs
    own = np.abs(data.poles[pairs]) / (2 * np.pi)
    for hertz in values:
        gap = np.abs(own - hertz)
        if not len(own) or not gap.min() <= MATCH * abs(hertz):
            shown = ", ".join(f"{each:.4g}" for each in own)
            raise OptionError(f"The model has no mode at {hertz:g} Hz; it has {shown} Hz.")
        nearest = int(pairs[int(np.argmin(gap))])
        if nearest in chosen:
            raise OptionError(
                f"Two of the frequencies asked for mean the mode at "
                f"{abs(data.poles[nearest]) / 2 / np.pi:.4g} Hz; name each mode once."
            )
        chosen.append(nearest)
    return chosen


def _strongest(
    data: ModalData, pairs: list[int], layout: Layout, dropped: list[str]
) -> tuple[list[int], list[int]]:
    """Return the pairs to keep, as many as DOFs, and those that may be further modes."""
    off = _drive_point_phase(data, layout)
    physical = [k for k in pairs if off[k] <= OUT_OF_PHASE]
    if len(physical) >= layout.n_dof:
        dropped += [
            _of_pair(data, k, f"drive-point phase {np.degrees(off[k]):.0f}° off")
            for k in pairs
            if k not in physical
        ]
        pairs = physical
    pairs = sorted(pairs, key=lambda k: -data.strength[k])
    kept, others = pairs[: layout.n_dof], pairs[layout.n_dof :]
    strongest = data.strength[kept[0]]
    dropped += [
        _of_pair(data, k, f"weaker ({data.strength[k] / strongest:.2g} of the strongest)")
        for k in others
    ]
    return kept, _further(data, kept, others, layout)


def _further(data: ModalData, kept: list[int], others: list[int], layout: Layout) -> list[int]:
    """Return those of the others that are modes of the structure too, not weak and physical."""
    least = WEAK * max(data.strength[k] for k in kept)
    off = _drive_point_phase(data, layout)
    return [k for k in others if data.strength[k] > least and off[k] <= OUT_OF_PHASE]


def _drive_point_phase(data: ModalData, layout: Layout) -> Floats:
    """Return how far drive-point residues turn from −j, that of a positive mass [rad]."""
    off = np.zeros(len(data.poles))
    for s, dof in enumerate(layout.sensor_dofs):
        for a in np.flatnonzero(layout.force_dofs == dof):
            turned = np.abs(np.angle(1j * data.shapes[s] * data.forces[:, a]))
            off = np.maximum(off, np.where(data.poles.imag > 0, turned, 0))
    return off
