"""Markov parameters of the three kinds, and the recursions between them.

Symbols: h_k system, h̄_k observer, Y°_k observer-gain Markov parameters; Ā = A + L C.
**Sign**: the observer gain of the OKID literature is L = −K, where K is the Kalman (predictor)
gain of innovations models, so Ā = A − K C and the output columns of h̄_k are +C Ā^(k−1) K.

Arrays are indexed by lag: entry k belongs to lag k, entry 0 to the present sample.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .errors import OptionError, check_whole
from .record import Floats
from .statespace import StateSpace


def system_markov(observer: ArrayLike, n_lags: int) -> Floats:
    """Return the system Markov parameters that follow from the observer's.

    Parameters
    ----------
    observer : array (P + 1, n_outputs, n_inputs + n_outputs)
        h̄_0 = [D, 0], h̄_k = [C Ā^(k−1) (B + L D), −C Ā^(k−1) L], with L = −K; zero beyond the
        observer order P.
    n_lags : int
        How many are wanted, D included; may exceed P.

    Returns
    -------
    array (n_lags, n_outputs, n_inputs)
        D, C B, C A B, …

    Notes
    -----
    h_k = h̄_k¹ + Σ_{i=1}^{min(k,P)} h̄_i² h_{k−i}, h̄_k = [h̄_k¹, h̄_k²]: (40) of Pappalardo et al.
    (2022), whose Ȳ^II is −h̄²; Juang, Phan, Horta & Longman (1993).

    Examples
    --------
    >>> model = StateSpace([[0.5]], [[1.0]], [[2.0]], [[3.0]], 1.0)
    >>> observer = model_observer_markov(model, [[0.25]], 2)  # A − K C = 0: deadbeat
    >>> system_markov(observer, 4)[:, 0, 0]
    array([3. , 2. , 1. , 0.5])
    """
    h = _observer(observer)
    return joint_markov(h, n_lags)[:, :, : h.shape[2] - h.shape[1]]


def gain_markov(observer: ArrayLike, n_lags: int) -> Floats:
    """Return the observer-gain Markov parameters Y°_k = C A^(k−1) L, with L = −K.

    Parameters
    ----------
    observer : array (P + 1, n_outputs, n_inputs + n_outputs)
        As in `system_markov`.
    n_lags : int
        How many are wanted, the zero of lag 0 included; may exceed P.

    Returns
    -------
    array (n_lags, n_outputs, n_outputs)
        0, C L, C A L, …

    Notes
    -----
    Y°_k = −h̄_k² + Σ_{i=1}^{min(k−1,P)} h̄_i² Y°_{k−i}: (41) of Pappalardo et al. (2022).

    Examples
    --------
    >>> model = StateSpace([[0.5]], [[1.0]], [[2.0]], [[3.0]], 1.0)
    >>> observer = model_observer_markov(model, [[0.25]], 2)
    >>> gain_markov(observer, 4)[:, 0, 0]
    array([ 0.   , -0.5  , -0.25 , -0.125])
    """
    h = _observer(observer)
    return joint_markov(h, n_lags)[:, :, h.shape[2] - h.shape[1] :]


def joint_markov(
    observer: ArrayLike, n_lags: int, residual_weights: ArrayLike | None = None
) -> Floats:
    """Return [h_k, Y°_k] of every lag by one recursion.

    Parameters
    ----------
    observer, n_lags : as in `system_markov`
    residual_weights : array (P, n_outputs, n_outputs), optional
        C_1, …, C_P of y(t) = … + e(t) + Σ C_k e(t−k), where past residuals were regressors.

    Returns
    -------
    array (n_lags, n_outputs, n_inputs + n_outputs)
        [D, 0], [C B, C L], [C A B, C A L], … with L = −K.

    Notes
    -----
    With Y°_0 = −I both recursions are one, M_k = [h̄_k¹, −C_k] + Σ_{i=1}^{min(k,P)} h̄_i² M_{k−i};
    −Y°_k is the response of the outputs to e.
    """
    h = _observer(observer)
    check_whole("n_lags", n_lags, 1)
    P, p, m = len(h) - 1, h.shape[1], h.shape[2] - h.shape[1]
    driven = np.zeros((n_lags, p, m + p))
    known = min(n_lags, P + 1)
    driven[:known, :, :m] = h[:known, :, :m]
    driven[0, :, m:] = -np.eye(p)
    if residual_weights is not None:
        driven[1:known, :, m:] = -_responses("residual_weights", residual_weights)[: known - 1]
    joint = _autoregress(h[1:, :, m:], driven)
    joint[0, :, m:] = 0
    return joint


def observer_markov(system: ArrayLike, gain: ArrayLike) -> Floats:
    """Return the observer Markov parameters that follow from the system's and the gain's.

    The inverse of `system_markov` and `gain_markov`.

    Parameters
    ----------
    system : array (n_lags, n_outputs, n_inputs)
        D, C B, C A B, …
    gain : array (n_lags, n_outputs, n_outputs)
        0, C L, C A L, … with L = −K; entry 0 is not read.

    Returns
    -------
    array (n_lags, n_outputs, n_inputs + n_outputs)
        [D, 0], h̄_1, …; nothing is assumed of lags beyond.

    Examples
    --------
    >>> model = StateSpace([[0.5]], [[1.0]], [[2.0]], [[3.0]], 1.0)
    >>> observer = model_observer_markov(model, [[0.1]], 6)
    >>> back = observer_markov(system_markov(observer, 6), gain_markov(observer, 6))
    >>> bool(np.allclose(back, observer))
    True
    """
    h, gains = _responses("system", system), _responses("gain", gain)
    n_lags, p = h.shape[:2]
    if gains.shape != (n_lags, p, p):
        raise OptionError(
            f"gain must have shape {(n_lags, p, p)} to belong to system parameters of shape "
            f"{h.shape}; got {gains.shape}."
        )
    # transposed, both are recursions in Y°: h̄_k²ᵀ = −Y°_kᵀ + Σ Y°_iᵀ h̄_{k−i}²ᵀ, with h̄_0² = −I
    driven = np.zeros((n_lags, p, p))
    driven[0] = -np.eye(p)
    corrections = _autoregress(gains[1:].transpose(0, 2, 1), driven).transpose(0, 2, 1)
    inputs = h.copy()
    for k in range(1, n_lags):
        inputs[k] -= np.einsum("iab,ibc->ac", corrections[1 : k + 1], h[k - 1 :: -1][:k])
    corrections[0] = 0
    return np.concatenate([inputs, corrections], axis=2)


def model_observer_markov(model: StateSpace, kalman_gain: ArrayLike, n_lags: int) -> Floats:
    """Return the observer Markov parameters of a model with Kalman gain K = −L.

    Parameters
    ----------
    model : StateSpace
    kalman_gain : array (n, n_outputs)
    n_lags : int
        How many, that of lag 0 included.

    Returns
    -------
    array (n_lags, n_outputs, n_inputs + n_outputs)
        [D, 0], then [C Ā^(k−1) (B − K D), C Ā^(k−1) K] with Ā = A − K C.
    """
    K = _gain(model, kalman_gain)
    p = model.n_outputs
    predictor = StateSpace(
        model.A - K @ model.C,
        np.hstack([model.B - K @ model.D, K]),
        model.C,
        np.hstack([model.D, np.zeros((p, p))]),
        model.dt,
    )
    return predictor.markov_parameters(n_lags)


def model_gain_markov(model: StateSpace, kalman_gain: ArrayLike, n_lags: int) -> Floats:
    """Return 0, C L, C A L, … of a model with Kalman gain K = −L.

    Returns
    -------
    array (n_lags, n_outputs, n_outputs)
    """
    K, p = _gain(model, kalman_gain), model.n_outputs
    return StateSpace(model.A, -K, model.C, np.zeros((p, p)), model.dt).markov_parameters(n_lags)


def _autoregress(weights: Floats, driven: Floats) -> Floats:
    """Return M_k = driven_k + Σ_{i=1}^{min(k,P)} weights_{i−1} M_{k−i}.

    One product a lag: the youngest P parameters, oldest first, lie under each other already.
    """
    P, p, _ = weights.shape
    rows = np.ascontiguousarray(weights[::-1].transpose(1, 0, 2)).reshape(p, P * p)
    n_lags, _, columns = driven.shape
    joint = np.ascontiguousarray(driven).reshape(n_lags * p, columns)
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable observer; the caller sees
        for k in range(1, n_lags):
            used = min(k, P)
            joint[k * p : (k + 1) * p] += rows[:, (P - used) * p :] @ joint[(k - used) * p : k * p]
    return joint.reshape(n_lags, p, columns)


def _observer(observer: ArrayLike) -> Floats:
    h = _responses("observer", observer)
    if h.shape[2] < h.shape[1]:
        raise OptionError(
            f"observer must have n_inputs + n_outputs columns, at least its {h.shape[1]} rows; "
            f"got shape {h.shape}."
        )
    return h


def _responses(name: str, values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 3 or 0 in array.shape[:2]:
        raise OptionError(
            f"{name} must have shape (n_lags, n_outputs, columns); got {array.shape}."
        )
    return array


def _gain(model: StateSpace, kalman_gain: ArrayLike) -> Floats:
    K = np.asarray(kalman_gain, dtype=np.float64)
    if K.shape != (model.order, model.n_outputs):
        raise OptionError(
            f"kalman_gain must have shape {(model.order, model.n_outputs)}; got {K.shape}."
        )
    return K
