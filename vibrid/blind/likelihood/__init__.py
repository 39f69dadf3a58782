"""Blind identification by maximum likelihood: oscillations that decay, and those that do not."""

from .answer import blind_likelihood
from .measured import blind_measured

__all__ = ["blind_likelihood", "blind_measured"]
