"""ERA and ERA/DC: realizations of pulse responses, free decays and correlations.

Symbols (Juang & Pappa 1985; Juang, Cooper & Wright 1988): H(k) block Hankel matrix of Markov
parameters h(1+k+i+j), U Σ Vᵀ its singular value decomposition, O observability and R
controllability matrix, 𝓗(k) block Hankel of the correlations R_HH(k) = H(k) H(0)ᵀ with lag τ,
ξ further rows and ζ further columns.
"""

from .method import ERA, ERADC
from .models import HankelModels

__all__ = ["ERA", "ERADC", "HankelModels"]
