"""Options of the commands that go beyond a model: physical coordinates, unknown forces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from cyclopts import Group, Parameter

from ..blind import BlindFit, identify_blind
from ..errors import OptionError
from ..fit import Fit
from ..identification.choice import Progress
from ..mechanics import MOTIONS
from ..physical import MechanicalModel, mechanical_model
from ..record import Record
from .options import Names, help_of, split_names

PHYSICAL = Group("Physical coordinates", sort_key=4)
BLIND = Group("Blind identification", sort_key=4)


@Parameter(name="*", group=PHYSICAL)
@dataclass(frozen=True)
class Physical:
    """How matrices are made from a model."""

    mass: Annotated[
        Names,
        help_of(
            "Known masses [kg]: the total, or one a DOF as a,b,c in the order printed. "
            "Default: none."
        ),
    ] = ()
    structure: Annotated[
        str | None,
        help_of("Nearest matrices that are symmetric, diagonal (M) or a chain. Default: as found."),
    ] = None
    delays: Annotated[
        bool, help_of("Set the delays of sensors right as estimated. Default: report them only.")
    ] = False
    hold: Annotated[
        str | None,
        help_of(
            "How inputs move between samples: zoh, foh or band_limited. Default: zoh for forces, "
            "band_limited for base motion and after --band."
        ),
    ] = None
    modes: Annotated[
        Names, help_of("Frequencies [Hz] of the modes to use, a,b,c. Default: chosen.")
    ] = ()

    def of(self, fit: Fit, filtered: bool) -> MechanicalModel:
        """Return the mechanical model of a fit."""
        _check_labels(fit)
        masses = numbers("mass", self.mass)
        return mechanical_model(
            fit,
            hold=self.hold or ("band_limited" if filtered else None),
            mass=(masses[0] if len(masses) == 1 else masses) if masses else None,
            structure=self.structure,
            delays=self.delays,
            frequencies_hz=numbers("modes", self.modes) or None,
        )


def _check_labels(fit: Fit) -> None:
    """Raise `OptionError`, in words of the command line, where no output has a motion and DOF."""
    if any(c.quantity in MOTIONS and c.dof is not None for c in fit.output_channels):
        return
    name = fit.output_channels[0].name
    raise OptionError(
        "Physical coordinates need to know what each channel measures, and where. Give, for each, "
        f"--quantity {name}=acceleration --dof {name}=f1 (forces too, --quantity NAME=force), or "
        "--channels FILE; a saved model keeps the labels that it was identified with."
    )


@Parameter(name="*", group=BLIND)
@dataclass(frozen=True)
class Blind:
    """What is known of the forces and of the structure."""

    excitation: Annotated[
        str,
        help_of(
            "What moves the structure: auto, periodic, decay, point, base (unmeasured base motion) "
            "or ambient (an assumption, never chosen by itself)."
        ),
    ] = "auto"
    blind_method: Annotated[
        str, Parameter(name="--blind-method"), help_of("ml (maximum likelihood) or subspace.")
    ] = "ml"
    input_frequencies: Annotated[
        Names, help_of("Frequencies [Hz] of a periodic force, all of them, a,b,c. Default: found.")
    ] = ()
    hold: Annotated[
        str, help_of("How the force moves between samples: band_limited, zoh or foh.")
    ] = "band_limited"
    mass: Annotated[
        Names,
        help_of(
            "Known masses [kg]: the total, one a DOF as a,b,c, or a whole matrix row by row. "
            "Default: none."
        ),
    ] = ()
    structure: Annotated[
        str | None, help_of("Nearest matrices that are symmetric, diagonal (M) or a chain.")
    ] = None
    shapes: Annotated[
        str, help_of("auto, free, or real (proportional damping: D is then far more certain).")
    ] = "auto"
    force_band: Annotated[
        Names,
        help_of(
            "Band of a force that is not periodic [Hz], low,high: modes may lie in it where some "
            "DOFs are not forced. Default: as the record shows."
        ),
    ] = ()
    force_free: Annotated[Names, help_of("A stretch without force [s], start,stop.")] = ()
    ungrounded: Annotated[
        Names, help_of("DOFs without a spring to the ground, which close a forced row.")
    ] = ()

    def of(self, record: Record, n_dof: int, progress: Progress | None) -> BlindFit:
        """Return the blind identification of a record."""
        return identify_blind(
            record,
            n_dof,
            excitation=self.excitation,
            method=self.blind_method,
            input_frequencies_hz=numbers("input-frequencies", self.input_frequencies) or None,
            hold=self.hold,
            mass=_mass(numbers("mass", self.mass), n_dof),
            structure=self.structure,
            shapes=self.shapes,
            force_band=_pair("force-band", self.force_band),
            force_free=_pair("force-free", self.force_free),
            ungrounded=split_names(self.ungrounded) or (),
            progress=progress,
        )


def _mass(values: list[float], n_dof: int) -> float | list[float] | list[list[float]] | None:
    """Return a total, masses or, of n_dof² numbers, a matrix; None where nothing was given."""
    if len(values) < 2:
        return values[0] if values else None
    if len(values) != n_dof**2:
        return values
    return [values[k : k + n_dof] for k in range(0, len(values), n_dof)]


def _pair(option: str, texts: Names) -> tuple[float, float] | None:
    """Return two numbers, or None where nothing was given."""
    values = numbers(option, texts)
    if values and len(values) != 2:
        raise OptionError(f"--{option} must be two numbers, a,b; got {len(values)}.")
    return (values[0], values[1]) if values else None


def numbers(option: str, texts: Names) -> list[float]:
    """Return the numbers of a,b,c or of a repeated option."""
    words = split_names(texts) or []
    try:
        return [float(word) for word in words]
    except ValueError:
        raise OptionError(f"--{option} must be numbers, a,b,c; got {', '.join(words)}.") from None
