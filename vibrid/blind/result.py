"""BlindFit: what identification without measured forces returns. A refusal is a value too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError
from ..fit import Diagnostics, Finding
from ..modes import Complexes, Modes
from ..physical.masses import given_mass, mass_ratios
from ..record import Channel, Floats

RULES = {
    "R1": "as many modes decay within the record as there are sensors",
    "R2": "no more modes decay than there are sensors",
    "R3": "nothing grows",
    "R4": "what the model leaves is as small inside the band as outside",
    "R5": "no other division into forces and modes explains the record about as well",
    "R6": "the predicted deviations of the matrices are small",
    "R7": "M⁻¹K has positive real eigenvalues, and its equations are well conditioned",
    "R8": "a constant offset is taken out",
    "in_band": "the force is limited in band, in time or in place, so that the data tell it",
    "sensors": "each degree of freedom has one sensor",
}


@dataclass(frozen=True, eq=False)
class Refusal:
    """One rule that the data break.

    Attributes
    ----------
    rule : str
        A key of `RULES`.
    sentence : str
        What was seen, with the number and the limit.
    cure : str
    figures : mapping of name to number
        What the sentence rests on.
    """

    rule: str
    sentence: str
    cure: str = ""
    figures: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise OptionError(f"rule must be one of {', '.join(RULES)}; got {self.rule!r}.")

    def __str__(self) -> str:
        return f"{self.rule}: {self.sentence} {self.cure}".strip()


@dataclass(frozen=True, eq=False)
class BlindVerdict:
    """What is known, what is missing, and why an answer was refused.

    Attributes
    ----------
    kind : str
        The excitation that the answer rests on: "periodic", "point", "base", "ambient",
        "decay", "out_of_band", "force_free" or "none".
    determined : mapping of name to bool
        normalized_stiffness, normalized_damping, normalized_force, normalized_input.
    missing : tuple of str
        What would have to be added for the rest.
    checks : mapping of name to number
        The figures of all rules, kept or broken.
    refusals : tuple of Refusal
    findings : tuple of Finding
    assumed : tuple of str
        What the answer rests on and these data could not have refuted.
    """

    kind: str
    determined: Mapping[str, bool]
    missing: tuple[str, ...] = ()
    checks: Mapping[str, float] = field(default_factory=dict)
    refusals: tuple[Refusal, ...] = ()
    findings: tuple[Finding, ...] = ()
    assumed: tuple[str, ...] = ()

    @property
    def accepted(self) -> bool:
        """Whether no rule refuses the answer."""
        return not self.refusals

    @property
    def rule(self) -> str:
        """The first rule that refuses, or nothing."""
        return self.refusals[0].rule if self.refusals else ""

    def __str__(self) -> str:
        if self.refusals:
            return "refused, " + "; ".join(str(each) for each in self.refusals)
        known = [name for name, is_known in self.determined.items() if is_known]
        resting = f"; assumed: {'; '.join(self.assumed)}" if self.assumed else ""
        return f"{self.kind}: determined are {', '.join(known) or 'none'}{resting}"


@dataclass(frozen=True, eq=False)
class BlindFit:
    """M⁻¹K, M⁻¹D and the unknown force, and how far to trust them.

    What is not determined is NaN; the verdict says why. A refusal has NaN matrices,
    `verdict.accepted` False, and the best candidate among the figures of `diagnostics`
    (`candidate_stiffness`, `candidate_damping`, …).

    Attributes
    ----------
    normalized_stiffness, normalized_damping : arrays (n_dof, n_dof)
        𝒦 = M⁻¹K [1/s²] and 𝒟 = M⁻¹D [1/s].
    normalized_stiffness_std, normalized_damping_std : arrays (n_dof, n_dof)
        Standard deviations; NaN where not estimated.
    modes : Modes
        Of the structure; shapes are displacements at the DOFs.
    normalized_force : array (n_samples, n_dof)
        M⁻¹f [m/s²] at the samples; NaN where not determined. Several records follow each other.
    normalized_force_std : array (n_dof,)
        Root mean square of its expected error [m/s²]; NaN where not estimated.
    force_phasors : complex array (n_records, n_dof, n_frequencies)
        Of periodic forces, M⁻¹f(t) = Σ Re(p_k e^{2πi f_k t}), t = 0 at each record's start.
    normalized_input : array (n_dof, n_inputs)
        ℬ = M⁻¹B where the inputs were measured; (n_dof, 0) elsewhere.
    input_frequencies_hz : array (n_frequencies,)
        Of periodic forces, ascending.
    forced_dofs : tuple of str
        Where forces act, as far as the data tell; all DOFs where they do not.
    dofs : tuple of str
        Labels in the order of the rows.
    mass : array (n_dof, n_dof) or None
        M [kg] where it was given.
    parameter_covariance : array (2 n_dof², 2 n_dof²) or None
        Of vec [𝒦 𝒟] (columns stacked), where estimated.
    dt : float
        Sampling interval [s].
    units : "SI" or "consistent units"
    verdict : BlindVerdict
    diagnostics : Diagnostics
    """

    normalized_stiffness: Floats
    normalized_damping: Floats
    normalized_stiffness_std: Floats
    normalized_damping_std: Floats
    modes: Modes
    normalized_force: Floats
    normalized_force_std: Floats
    force_phasors: Complexes
    normalized_input: Floats
    input_frequencies_hz: Floats
    forced_dofs: tuple[str, ...]
    dofs: tuple[str, ...]
    mass: Floats | None
    parameter_covariance: Floats | None
    dt: float
    units: str
    verdict: BlindVerdict
    diagnostics: Diagnostics

    def __repr__(self) -> str:
        return f"<BlindFit: {len(self.dofs)} DOFs, {self.verdict}>"

    @property
    def n_dof(self) -> int:
        return len(self.dofs)

    @property
    def accepted(self) -> bool:
        """Whether no rule refuses the answer."""
        return self.verdict.accepted

    @property
    def stiffness(self) -> Floats | None:
        """K = M 𝒦 [N/m]; None without a mass."""
        return None if self.mass is None else self.mass @ self.normalized_stiffness

    @property
    def damping(self) -> Floats | None:
        """D = M 𝒟 [N s/m]; None without a mass."""
        return None if self.mass is None else self.mass @ self.normalized_damping

    @property
    def force(self) -> Floats | None:
        """f = M (M⁻¹f) [N] at the samples (n_samples, n_dof); None without a mass."""
        return None if self.mass is None else self.normalized_force @ self.mass.T


@dataclass(frozen=True, eq=False)
class Setting:
    """What every blind result repeats of the data.

    Attributes
    ----------
    channels : tuple of Channel
        One a DOF, in the order of the rows.
    dofs : tuple of str
    dt : float
    n_samples : int
    units : "SI" or "consistent units"
    """

    channels: tuple[Channel, ...]
    dofs: tuple[str, ...]
    dt: float
    n_samples: int
    units: str

    @property
    def n_dof(self) -> int:
        return len(self.dofs)


def blind_fit(
    setting: Setting,
    normalized_stiffness: Floats,
    normalized_damping: Floats,
    modes: Modes,
    verdict: BlindVerdict,
    *,
    covariance: Floats | None = None,
    stiffness_std: Floats | None = None,
    damping_std: Floats | None = None,
    force: Floats | None = None,
    force_std: Floats | None = None,
    phasors: Complexes | None = None,
    input_frequencies_hz: ArrayLike = (),
    normalized_input: Floats | None = None,
    forced_dofs: Sequence[str] | None = None,
    mass: ArrayLike | None = None,
    diagnostics: Diagnostics | None = None,
) -> BlindFit:
    """Return a BlindFit; what is left out is NaN or empty.

    A covariance of vec [𝒦 𝒟] gives the standard deviations that are not given themselves.
    A refused verdict turns matrices and forces into NaN and keeps the matrices as candidates
    among the figures. Phasors (n_dof, n_frequencies) are those of one record.

    Raises
    ------
    OptionError
        A mass that does not fit, or a total whose ratios 𝒦 does not tell.
    """
    n, known = setting.n_dof, diagnostics or Diagnostics()
    own = _deviations(covariance, n)
    if not verdict.accepted:
        known = known.joined(
            {"candidate_stiffness": normalized_stiffness, "candidate_damping": normalized_damping}
        )
        verdict = replace(verdict, determined=dict.fromkeys(verdict.determined, False))
        normalized_stiffness = normalized_damping = stiffness_std = damping_std = _nothing(n, n)
        force = phasors = covariance = normalized_input = mass = None
    frequencies = np.asarray(input_frequencies_hz, dtype=np.float64)
    if phasors is None:
        phasors = np.full((n, len(frequencies)), complex(np.nan, np.nan))
    return BlindFit(
        normalized_stiffness,
        normalized_damping,
        own[0] if stiffness_std is None else stiffness_std,
        own[1] if damping_std is None else damping_std,
        modes,
        _nothing(setting.n_samples, n) if force is None else force,
        _nothing(n) if force_std is None or force is None else force_std,
        phasors if phasors.ndim == 3 else phasors[None],
        np.zeros((n, 0)) if normalized_input is None else normalized_input,
        frequencies,
        setting.dofs if forced_dofs is None else tuple(forced_dofs),
        setting.dofs,
        None if mass is None else known_mass(mass, normalized_stiffness),
        covariance,
        setting.dt,
        setting.units,
        verdict,
        known,
    )


def known_mass(mass: ArrayLike, normalized_stiffness: Floats) -> Floats:
    """Return M (n, n) of masses, a matrix, or a total shared out by the symmetry of M 𝒦."""
    matrix = given_mass(mass, len(normalized_stiffness))
    if matrix.ndim == 2:
        return matrix
    ratios = mass_ratios(normalized_stiffness)
    if np.isnan(ratios).any():
        raise OptionError(
            "The data do not tell the ratios of the masses, so that a total is not enough; give "
            "mass= one a DOF or as a matrix."
        )
    return np.diag(ratios * (float(matrix) / ratios.sum()))


def modes_from(
    poles: Complexes,
    shapes: Complexes,
    setting: Setting,
    *,
    frequencies_std: Floats | None = None,
    damping_std: Floats | None = None,
) -> Modes:
    """Return Modes of poles (one of each pair) and displacement shapes (n_dof, n_modes)."""
    order = np.argsort(np.abs(poles), kind="stable")
    poles, shapes = poles[order], shapes[:, order]
    size = shapes[np.abs(shapes).argmax(axis=0), np.arange(len(poles))]
    stds = [
        _nothing(len(poles)) if each is None else each[order]
        for each in (frequencies_std, damping_std)
    ]
    participation = np.zeros((len(poles), 0), dtype=np.complex128)
    reals = np.zeros(0, dtype=np.complex128)
    shapes = shapes / np.where((size == 0) | np.isnan(size), 1, size)
    return Modes(poles, shapes, participation, reals, setting.channels, stds[0], stds[1])


def _deviations(covariance: Floats | None, n: int) -> tuple[Floats, Floats]:
    if covariance is None:
        return _nothing(n, n), _nothing(n, n)
    stds = np.sqrt(np.diag(covariance)).reshape(2 * n, n).T
    return stds[:, :n], stds[:, n:]


def _nothing(*shape: int) -> Floats:
    return np.full(shape, np.nan)
