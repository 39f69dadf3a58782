"""PSSID and blind identification by stochastic subspaces (Han, Bohn & Bauer 2021), corrected."""

from .algorithms import blind_subspace

__all__ = ["blind_subspace"]
