"""Quality of modes: whether the data's factors behave as each mode says they must."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..errors import OptionError
from ..fit import Fit
from ..record import Floats
from ..statespace import StateSpace
from .values import Complexes, eigenvectors_of, modes_of

PREFIX = "mode_"  # of the names of these figures in a fit's diagnostics
PHASE_LIMIT = np.pi / 4  # a component that turned by this much counts nothing


@dataclass(frozen=True, eq=False)
class ModeQuality:
    """How well each mode is borne out by the data, in the order of `modes_of`.

    Arrays (n_modes,); all but `msv` between 0 and 1, where 1 is best. NaN is what the method
    cannot give: all but the outputs' part needs a controllability factor, and nothing can
    be compared along a factor of a single block.

    Attributes
    ----------
    amplitude_coherence
        Between the modal amplitudes in the controllability factor and the pure λᵏ b.
    emac_outputs, emac_inputs, emac
        Extended modal amplitude coherence: of the last block of the observability and of
        the controllability factor with what the first one becomes, and the product.
    msv
        Mode singular value, the size of the mode's part in the pulse responses, over the
        largest of them: the strongest mode has 1.
    phase_collinearity
        MPC of the shape, see `mpc`.
    consistency
        Consistent-mode indicator, `emac` times `phase_collinearity`; of a method without
        controllability factor, `emac_outputs` times `phase_collinearity`.
    """

    amplitude_coherence: Floats
    emac_outputs: Floats
    emac_inputs: Floats
    emac: Floats
    msv: Floats
    phase_collinearity: Floats
    consistency: Floats

    def as_figures(self) -> dict[str, Floats]:
        """Return what is known, named for a fit's diagnostics, where `quality_of` finds it."""
        arrays = {PREFIX + each.name: getattr(self, each.name) for each in fields(self)}
        return {name: array for name, array in arrays.items() if not np.isnan(array).all()}


def mode_quality(
    model: StateSpace | Fit,
    observability: Floats,
    controllability: Floats | None = None,
) -> ModeQuality:
    """Compare the factors of the data with the modes of the model made from them.

    Parameters
    ----------
    model : StateSpace or Fit
        Discrete. Its states are those of the factors; of its matrices only A counts, and C
        for the phase collinearity.
    observability : array (rows · n_outputs, n)
        Γ ≈ [C; CA; CA²; …], as the data gave it. Its first block stands for C, so it may be
        in any positive unit per output; the outputs weigh by their size in these units.
    controllability : array (n, columns · n_inputs) or (n, columns, width), optional
        Δ ≈ [B, AB, A²B, …], likewise; its first block stands for B. With three axes where a
        block is not as wide as the model has inputs: of free decays, as wide as their number.

    Returns
    -------
    ModeQuality
        Invariant to the state basis.

    Raises
    ------
    OptionError
        A continuous model; factors whose shapes do not belong to it.
    DataError
        A discrete pole at zero, see `modes_of`.

    Notes
    -----
    With A ψ = λ ψ, Γ ψ = [c₀; c₁; …] and the mode's row of Ψ⁻¹ Δ = [b₀, b₁, …] of p rows and
    q columns of blocks:

    - Modal amplitude coherence (Juang & Pappa 1985): |q̄ q̂ᴴ| / (‖q̄‖ ‖q̂‖) of
      q̂ = [b₀, b₁, …] and q̄ = [b₀, λ b₀, λ² b₀, …].
    - EMAC (Pappa, Elliott & Schenk 1993): for each output R W with the ratio of the smaller
      to the larger of |c_{p−1}| and |λ^{p−1} c₀|, and with W = 1 − |P| / (π/4), not below 0,
      of the angle P between them; weighted over the outputs by |c₀|². For the inputs the
      same of b_{q−1} and λ^{q−1} b₀, weighted by |b₀|². EMAC is the product.
    - Consistent-mode indicator (same authors): EMAC times MPC.
    - Mode singular value (Juang 1994): (|c₀| (1 + |λ| + … + |λ|^{N−1}) |b₀|)^½ over the
      N = p + q − 1 pulse responses that the factors hold.

    A mode that has died out at the end of the factor has little EMAC, however true it is:
    noise is all that is left there. The coherence is the milder measure.

    Poles that coincide without a full set of eigenvectors have no row of Ψ⁻¹ Δ: what needs it
    is NaN.

    Examples
    --------
    >>> model = StateSpace([[0.6, 0.6], [-0.6, 0.6]], [[0], [1]], [[1, 0]], [[0]], 0.1)
    >>> observability = np.vstack([model.C, model.C @ model.A, model.C @ model.A @ model.A])
    >>> mode_quality(model, observability).emac_outputs.round(12).tolist()
    [1.0]
    """
    system = model.model if isinstance(model, Fit) else model
    _check_observability(system, observability)
    vectors = eigenvectors_of(system)
    values = vectors.values
    outputs = _blocks((observability @ vectors.right).T, system.n_outputs)
    emac_outputs = _extended_coherence(outputs, values)
    coherence = emac_inputs = msv = np.full(len(values), np.nan)
    if controllability is not None:
        wide, width = _unfolded(system, controllability)
        inputs = _blocks(vectors.modal_rows(wide), width)
        coherence = _amplitude_coherence(inputs, values)
        emac_inputs = _extended_coherence(inputs, values)
        msv = _mode_singular_values(outputs, inputs, values)
    collinearity = modes_of(model).phase_collinearity
    emac = emac_outputs * emac_inputs
    consistency = (emac_outputs if controllability is None else emac) * collinearity
    return ModeQuality(coherence, emac_outputs, emac_inputs, emac, msv, collinearity, consistency)


def quality_of(fit: Fit) -> ModeQuality:
    """Return the quality of a fit's modes as its diagnostics tell it, also after save and load.

    The phase collinearity is always there. What the method did not give is NaN, and so is
    all else where the model no longer has as many modes as when it was judged.
    """
    known = fit.diagnostics.figures
    collinearity = modes_of(fit).phase_collinearity
    unknown = np.full(len(collinearity), np.nan)
    arrays = {}
    for each in fields(ModeQuality):
        array = np.asarray(known.get(PREFIX + each.name, unknown), dtype=np.float64)
        arrays[each.name] = array if array.shape == unknown.shape else unknown
    return ModeQuality(**{**arrays, "phase_collinearity": collinearity})


def _check_observability(system: StateSpace, observability: Floats) -> None:
    if system.dt is None:
        raise OptionError(
            "The quality of modes is judged in samples, and the model is continuous; give the "
            "discrete model that came with the factors."
        )
    n, p, shape = system.order, system.n_outputs, np.shape(observability)
    if len(shape) != 2 or shape[1] != n or shape[0] == 0 or shape[0] % p:
        raise OptionError(
            f"observability must have {n} columns, one for each state, and a multiple of {p} "
            f"rows, one for each output; got shape {shape}."
        )


def _unfolded(system: StateSpace, controllability: Floats) -> tuple[Floats, int]:
    """Return the factor with two axes, checked, and the width of its blocks."""
    shape = np.shape(controllability)
    width = shape[2] if len(shape) == 3 else system.n_inputs
    columns = int(np.prod(shape[1:]))
    if len(shape) not in (2, 3) or shape[0] != system.order or not width or columns % width:
        raise OptionError(
            f"controllability must have {system.order} rows, one for each state, and a multiple "
            f"of {system.n_inputs} columns, one for each input, or be (states, columns, width) "
            f"of blocks of another width; got shape {shape}."
        )
    if columns == 0:
        raise OptionError("controllability must hold at least one block; it has no columns.")
    return np.asarray(controllability).reshape(system.order, columns), width


def _blocks(modal: Complexes, width: int) -> Complexes:
    """Return rows (n_modes, count · width) as blocks (n_modes, count, width).

    In units of the largest, which cancel everywhere: squares must not overflow.
    """
    largest = np.abs(modal).max(initial=0.0)
    scaled = modal / largest if largest > 0 else modal
    return np.asarray(scaled.reshape(len(modal), modal.shape[1] // width, width))


def _extended_coherence(blocks: Complexes, values: Complexes) -> Floats:
    """Return the EMAC of blocks (n_modes, count, width) that should be the first times λᵏ."""
    first, last, steps = blocks[:, 0], blocks[:, -1], blocks.shape[1] - 1
    weights = np.abs(first) ** 2
    total = weights.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        # by logarithms, because λ to the length of the factor may overflow
        gained = np.log(np.abs(last)) - np.log(np.abs(first))
        ratio = np.exp(-np.abs(gained - steps * np.log(np.abs(values))[:, None]))
        turned = np.angle(last * first.conj()) - steps * np.angle(values)[:, None]
        turned = np.abs(np.angle(np.exp(1j * turned)))
        each = ratio * np.clip(1 - turned / PHASE_LIMIT, 0, None)
        mean = np.where(weights > 0, weights * each, 0 * weights).sum(axis=1) / total
    return np.asarray(np.where((total > 0) & (steps > 0), mean, np.nan))


def _amplitude_coherence(blocks: Complexes, values: Complexes) -> Floats:
    """Return the coherence of blocks (n_modes, count, width) with the first times λᵏ."""
    count = blocks.shape[1]
    steps = np.arange(count)
    # the size of the whole history does not count: let a growing one end at 1
    exponents = np.where(np.abs(values)[:, None] > 1, steps - (count - 1), steps)
    pure = (values[:, None] ** exponents)[:, :, None] * blocks[:, :1]
    cross = np.abs(np.sum(pure.conj() * blocks, axis=(1, 2)))
    size = np.sqrt(
        np.sum(np.abs(pure) ** 2, axis=(1, 2)) * np.sum(np.abs(blocks) ** 2, axis=(1, 2))
    )
    known = (size > 0) & (count > 1)
    return np.asarray(np.divide(cross, size, out=np.full(len(values), np.nan), where=known))


def _mode_singular_values(outputs: Complexes, inputs: Complexes, values: Complexes) -> Floats:
    """Return the size of each mode's part in the pulse responses, over the largest."""
    if len(values) == 0:
        return np.zeros(0)
    count = outputs.shape[1] + inputs.shape[1] - 1
    sizes = np.linalg.norm(outputs[:, 0], axis=1), np.linalg.norm(inputs[:, 0], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        logarithm = np.log(sizes[0]) + np.log(sizes[1]) + _log_geometric_sum(values, count)
        known = np.where(np.isnan(logarithm), -np.inf, logarithm)
        return np.asarray(np.exp((logarithm - known.max()) / 2))


def _log_geometric_sum(values: Complexes, count: int) -> Floats:
    """Return log(1 + |λ| + … + |λ|^(count−1)), also where the sum itself overflows."""
    growth = np.log(np.abs(values))
    decay = -np.abs(growth)
    # turned round, the sum of a growing mode decays: |λ|^(count−1) stands before it
    ahead = np.where(growth > 0, (count - 1) * growth, 0)
    decay = np.where(decay == 0, -np.finfo(float).tiny, decay)
    return np.asarray(ahead + np.log(np.expm1(count * decay) / np.expm1(decay)))
