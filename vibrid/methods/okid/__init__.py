"""OKID: observer/Kalman filter identification.

Symbols (Juang, Phan, Horta & Longman 1993; Pappalardo et al. 2022): P observer order, h̄_k
observer Markov parameters, Y_k those of the system, Y°_k those of the observer gain L = −K,
R triangle of the regressors, O observability matrix.
"""

from .method import OKID

__all__ = ["OKID"]
