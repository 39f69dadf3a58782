"""The kernel that N4SID and SSI share: from the factor of a Gram to models of every order.

Symbols (Van Overschee & De Moor 1996; Pappalardo et al. 2022, section 3.2): U_f, Y_f future
inputs and outputs, W_p past samples, R upper triangle of the Hankel rows [U_f; W_p; Y_f],
Γ observability matrix, J state map with x(t) = J W_p(t), T triangle of the state regression.
"""

from .layout import Layout
from .models import Subspace, assemble
from .result import subspace_fit
from .states import (
    covariance_states,
    oblique_states,
    projected_states,
    whitened_by_regression,
)

__all__ = [
    "Layout",
    "Subspace",
    "assemble",
    "covariance_states",
    "oblique_states",
    "projected_states",
    "subspace_fit",
    "whitened_by_regression",
]
