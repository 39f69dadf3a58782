"""Mass, stiffness and damping in physical coordinates, with a verdict."""

from .delays import Delays, sensor_delays
from .mass_change import MassChange, mass_change
from .masses import mass_ratios, storey_stiffnesses
from .model import MechanicalModel, mechanical_model
from .projection import Projection, Topology
from .rayleigh import Rayleigh, fit_rayleigh, shape_complexity
from .verdict import Verdict

__all__ = [
    "Delays",
    "MassChange",
    "MechanicalModel",
    "Projection",
    "Rayleigh",
    "Topology",
    "Verdict",
    "fit_rayleigh",
    "mass_change",
    "mass_ratios",
    "mechanical_model",
    "sensor_delays",
    "shape_complexity",
    "storey_stiffnesses",
]
