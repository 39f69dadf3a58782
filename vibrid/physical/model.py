"""mechanical_model(): mass, damping and stiffness matrices from an identified model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError, check_choice
from ..fit import Fit
from ..modes import Complexes
from ..record import Channel, Floats
from ..statespace import HOLDS, StateSpace
from .delays import Delays, given_delays, sensor_delays
from .deviations import deviations_of, normalized_steps
from .findings import Evidence
from .layout import Labels, Layout, labelled, layout_of
from .masses import given_mass, mass_ratios, symmetric
from .modal import ModalData, Selection, modal_data, select_poles
from .projection import Projection, Topology, project
from .scaling import (
    NODE,
    dof_means,
    drive_point_motion,
    flexibility_of,
    matrices_of,
    normalized_of,
    per_mass,
    scaled_shapes,
)
from .verdict import Verdict, verdict_of


@dataclass(frozen=True, eq=False)
class MechanicalModel:
    """Mass, damping and stiffness of the instrumented DOFs, and how far to trust them.

    What is not determined is NaN; the verdict says why and what would determine it.

    Attributes
    ----------
    mass, damping, stiffness : arrays (n_dof, n_dof)
        M [kg], R [N s/m], K [N/m], symmetric; in consistent units where the channels have
        no units.
    normalized_damping, normalized_stiffness : arrays (n_dof, n_dof)
        M⁻¹R [1/s], M⁻¹K [1/s²].
    dofs : tuple of str
    mass_std, damping_std, stiffness_std : arrays
        Standard deviations, a given mass taken as exact; NaN where not estimated. They are
        estimated of refined fits without a force scale.
    normalized_damping_std, normalized_stiffness_std : arrays
        The same of M⁻¹R and M⁻¹K, from those of the modes taken as independent: within 30 %.
    poles : complex array (n_modes,)
        One of each pair, and overdamped real poles, [rad/s].
    shapes : complex array (n_dof, n_modes)
        Displacement shapes; with a scale they are columns of W, otherwise the largest
        component of each is 1.
    flexibility : array (n_dof, n_dof)
        Static flexibility [m/N] of all physical modes of the model, also those left out of
        a reduced model; NaN without a scale.
    mass_ratios : array (n_dof,)
        Ratios of lumped masses that make K most symmetric, the first 1; NaN where the data
        do not tell them.
    delays : Delays or None
        As estimated; None where there are not two sensors and two modes.
    projection : Projection or None
        Where a structure was asked for.
    units : "SI" or "consistent units"
    verdict : Verdict
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    normalized_damping: Floats
    normalized_stiffness: Floats
    dofs: tuple[str, ...]
    mass_std: Floats
    damping_std: Floats
    stiffness_std: Floats
    poles: Complexes
    shapes: Complexes
    flexibility: Floats
    mass_ratios: Floats
    delays: Delays | None
    projection: Projection | None
    units: str
    verdict: Verdict
    normalized_damping_std: Floats
    normalized_stiffness_std: Floats

    def __repr__(self) -> str:
        return f"<MechanicalModel: {len(self.dofs)} DOFs, {self.verdict}>"

    @property
    def frequencies_hz(self) -> Floats:
        return np.abs(self.poles) / (2 * np.pi)


def mechanical_model(
    fit_or_model: Fit | StateSpace,
    *,
    outputs: Labels = None,
    inputs: Labels = None,
    hold: str | None = None,
    mass: ArrayLike | None = None,
    structure: Topology | str | None = None,
    delays: bool | Mapping[str, float] = False,
    frequencies_hz: Sequence[float] | None = None,
) -> MechanicalModel:
    """Return mass, damping and stiffness matrices of the instrumented DOFs.

    All of M, R and K follow when every DOF carries a sensor or an actuator and one DOF both
    (MKR; De Angelis et al. 2002, Pappalardo et al. 2022). With sensors alone, at every DOF,
    M⁻¹K and M⁻¹R follow, and the matrices themselves where the masses are known.

    Parameters
    ----------
    fit_or_model : Fit or StateSpace
        Discrete or continuous.
    outputs, inputs : sequence of Channel or of names, optional
        Channels of a StateSpace, or to replace those of a fit; names select some.
    hold : "zoh", "foh" or "band_limited", optional
        How the inputs move between samples; by default forces are held (zoh) and measured
        base accelerations band-limited.
    mass : float, array (n_dof,) or (n_dof, n_dof), optional
        Known: the total, one a DOF, or the matrix [kg].
    structure : Topology or "symmetric", "diagonal", "chain", optional
        Return the nearest positive (semi)definite matrices of this structure.
    delays : bool or mapping of output name to seconds
        Whether sensor delays, which are always estimated, are set right; or the delays.
    frequencies_hz : sequence of float, optional
        The modes to use, where the automatic choice (see Notes) is not the right one.

    Returns
    -------
    MechanicalModel

    Raises
    ------
    OptionError
        Channels without quantity or DOF, no co-located pair where the sensors do not cover
        all DOFs, units that do not go together, options that do not fit.
    DataError
        A rigid-body mode, no oscillating pole, a structure that the data do not determine.

    Notes
    -----
    Discrete poles and participations go to continuous time exactly for the hold; then
    eq. (119)-(123) of Pappalardo et al. 2022 with plain transposes, the sensor's row and the
    actuator's column at each co-located DOF. Several pairs count together, by least squares.

    Poles kept: as many pairs as DOFs. Dropped are poles at the Nyquist frequency, unstable
    ones, real ones (unless they complete the pairs exactly, as overdamped modes do), pairs
    whose drive-point response is not that of a positive mass, then the weakest.

    More modes than DOFs give a reduced model of the strongest modes on the instrumented
    DOFs (De Angelis et al. 2002; Luş et al. 2003), fewer the matrices of the subspace of
    the shapes; the verdict says so.

    References
    ----------
    De Angelis, Luş, Betti, Longman, Extracting physical parameters of mechanical models from
    identified state-space representations, J. Appl. Mech. 69 (2002), 617-625.
    Luş, De Angelis, Betti, A new approach for reduced order modeling of mechanical systems
    using vibration measurements, J. Appl. Mech. 70 (2003), 715-723.

    Examples
    --------
    >>> from vibrid.mechanics import mechanical_state_space
    >>> M, R, K = [[2.0, 0], [0, 1.0]], [[0.3, -0.1], [-0.1, 0.1]], [[500.0, -200], [-200, 200]]
    >>> sensors = [("acceleration", 0), ("acceleration", 1)]
    >>> model = mechanical_state_space(M, R, K, sensors=sensors, forces=[0]).to_discrete(0.01)
    >>> outputs = [Channel(f"a{k}", "acceleration", dof=f"f{k}") for k in (1, 2)]
    >>> found = mechanical_model(model, outputs=outputs, inputs=[Channel("f", "force", dof="f1")])
    >>> found.stiffness.round(6)
    array([[ 500., -200.],
           [-200.,  200.]])
    """
    system, output_channels, input_channels = labelled(fit_or_model, outputs, inputs)
    layout = layout_of(output_channels, input_channels)
    _check_scale(layout)
    holds = _holds(hold, input_channels)
    data = modal_data(system, layout, holds, _drive(fit_or_model))
    selection = select_poles(data, layout, system.dt, frequencies_hz)
    estimated, seconds = _delays(selection.data, layout, delays)
    selection = Selection(
        selection.data.delayed(seconds), selection.dropped, selection.left_out.delayed(seconds)
    )
    known = None if mass is None else given_mass(mass, layout.n_dof)
    topology = None if structure is None else Topology.of(structure)
    evidence = Evidence(layout, selection, estimated, seconds, isinstance(delays, Mapping), known)
    if evidence.scaled:
        return _with_scale(evidence, topology)
    found = _without_scale(evidence, topology)
    return found if topology is not None else _with_deviations(found, fit_or_model, evidence)


def _holds(hold: str | None, channels: Sequence[Channel]) -> list[str]:
    if hold is not None:
        check_choice("hold", hold, HOLDS)
        return [hold] * len(channels)
    return ["band_limited" if c.quantity == "base_acceleration" else "zoh" for c in channels]


def _drive(model: Fit | StateSpace) -> Floats:
    """Return what drives the states: all inputs, or the innovations of an output-only fit."""
    system = model.model if isinstance(model, Fit) else model
    if isinstance(model, Fit) and not system.n_inputs:
        return model.kalman_gain
    return system.B


def _check_scale(layout: Layout) -> None:
    if len(layout.unseen) and not len(layout.pairs):
        raise OptionError(
            f"The layout has {layout.missing_pair()}; without one, sensors must be at all DOFs. "
            "Or leave the forces out with inputs=[] for M⁻¹K and M⁻¹R of the sensors' DOFs."
        )


def _delays(
    data: ModalData, layout: Layout, wanted: bool | Mapping[str, float]
) -> tuple[Delays | None, Floats]:
    """Return the estimate, and what is to be set right."""
    pairs, none = data.pairs, np.zeros(len(layout.outputs))
    estimated = None
    if len(pairs) > 1 and len(none) > 1:
        drives = data.forces if data.forces.size else data.bases
        estimated = sensor_delays(
            data.shapes[:, pairs], data.poles[pairs], layout.output_channels, drives[pairs]
        )
    if isinstance(wanted, Mapping):
        return estimated, given_delays(wanted, layout.output_channels)
    if not isinstance(wanted, bool):
        raise OptionError(f"delays must be True, False or {{name: seconds}}; got {wanted!r}.")
    if not wanted:
        return estimated, none
    if estimated is None:
        raise OptionError("Sensor delays need at least two sensors and two modes to be estimated.")
    common = estimated.common if len(layout.pairs) else 0.0  # without a scale nothing feels it
    return estimated, estimated.seconds + common


def _with_scale(evidence: Evidence, topology: Topology | None) -> MechanicalModel:
    data, layout = evidence.selection.data, evidence.layout
    W = scaled_shapes(data, layout)
    raw = matrices_of(W, data.poles)
    projection = None
    if topology is not None or evidence.mass is not None:
        shape = topology or Topology(mass="symmetric")
        projection = project(W, data.poles, shape, layout.dofs, scaled=True, mass=evidence.mass)
    M, R, K = raw if projection is None else _matrices(projection)
    complete = W.shape[1] == 2 * layout.n_dof or projection is not None
    normalized = per_mass(M, R, K) if complete else normalized_of(W, data.poles)
    flexibility = flexibility_of(W, data.poles) + _further_flexibility(evidence)
    return _finished(evidence, W, (M, R, K), normalized, flexibility, projection, raw)


def _further_flexibility(evidence: Evidence) -> Floats | float:
    """Return that of the modes left out; NaN where the scale of one cannot be told."""
    others, layout = evidence.selection.left_out, evidence.layout
    if not len(others.poles):
        return 0.0
    if drive_point_motion(others, layout).min() < NODE:
        return np.nan
    return flexibility_of(scaled_shapes(others, layout), others.poles)


def _without_scale(evidence: Evidence, topology: Topology | None) -> MechanicalModel:
    data, layout = evidence.selection.data, evidence.layout
    shapes = dof_means(data.shapes, layout.sensor_dofs, layout.n_dof)
    shapes = shapes / shapes[np.abs(shapes).argmax(axis=0), np.arange(shapes.shape[1])]
    normalized = normalized_of(shapes, data.poles)
    unknown = np.full((layout.n_dof, layout.n_dof), np.nan)
    raw = matrices = (unknown, unknown, unknown)
    M = _mass_matrix(evidence.mass, normalized[1], topology)
    if M is not None:
        raw = M, M @ normalized[0], M @ normalized[1]
        matrices = M, symmetric(raw[1]), symmetric(raw[2])
    projection = None
    if topology is not None:
        projection = project(
            shapes, data.poles, topology, layout.dofs, scaled=False, mass=evidence.mass
        )
        M, R, K = matrices = _matrices(projection)
        normalized = per_mass(M, R, K)
    return _finished(evidence, shapes, matrices, normalized, unknown, projection, raw)


def _with_deviations(
    found: MechanicalModel, model: Fit | StateSpace, evidence: Evidence
) -> MechanicalModel:
    """Return the model with standard deviations, where the fit knows those of its modes."""
    poles = evidence.selection.data.poles
    both = np.repeat(found.shapes, 2, axis=1)
    both[:, 1::2] = both[:, 1::2].conj()
    steps = normalized_steps(model, evidence.layout, both, poles)
    if steps is None:
        return found
    if np.isfinite(found.mass).all():
        found = replace(
            found,
            mass_std=np.zeros_like(found.mass),
            damping_std=deviations_of(steps[0], found.mass),
            stiffness_std=deviations_of(steps[1], found.mass),
        )
    return replace(
        found,
        normalized_damping_std=deviations_of(steps[0]),
        normalized_stiffness_std=deviations_of(steps[1]),
    )


def _mass_matrix(
    mass: Floats | None, normalized_stiffness: Floats, topology: Topology | None
) -> Floats | None:
    """Return all of M: as given, or a total shared out by the ratios that the data tell."""
    if mass is None or mass.ndim == 2:
        return mass
    ratios = mass_ratios(normalized_stiffness)
    if np.isnan(ratios).any() and topology is not None:
        return None  # the structure may tell what symmetry alone does not
    if np.isnan(ratios).any():
        raise OptionError(
            "The data do not tell the ratios of the masses, so that a total is not enough; give "
            "mass= one a DOF or as a matrix."
        )
    return np.diag(ratios * (float(mass) / ratios.sum()))


def _matrices(projection: Projection) -> tuple[Floats, Floats, Floats]:
    return projection.mass, projection.damping, projection.stiffness


def _finished(
    evidence: Evidence,
    shapes: Complexes,
    matrices: tuple[Floats, Floats, Floats],
    normalized: tuple[Floats, Floats],
    flexibility: Floats,
    projection: Projection | None,
    raw: tuple[Floats, Floats, Floats],
) -> MechanicalModel:
    data, layout = evidence.selection.data, evidence.layout
    ratios = mass_ratios(normalized_of(shapes, data.poles)[1])
    verdict = verdict_of(evidence, shapes, matrices, normalized, ratios, projection, raw)
    one_each = [*data.pairs, *data.reals]
    unknown = np.full((layout.n_dof, layout.n_dof), np.nan)
    return MechanicalModel(
        *matrices,
        *normalized,
        layout.dofs,
        unknown,
        unknown,
        unknown,
        data.poles[one_each],
        shapes[:, one_each],
        flexibility,
        ratios,
        evidence.delays,
        projection,
        layout.units,
        verdict,
        unknown,
        unknown,
    )
