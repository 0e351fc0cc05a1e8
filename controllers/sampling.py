"""Exact discretisation of a continuous system with hold and delay.

The matrix exponential of an augmented matrix gives the integrals [1]_.

References
----------
.. [1] C. F. Van Loan, Computing integrals involving the matrix exponential, IEEE Transactions on Automatic Control 23
       (1978) 395-404.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from vlab.errors import BadController

Array = NDArray[np.float64]


def delay_split(delay_samples: float) -> tuple[int, float]:
    """Split a delay into whole samples and a rest in [0, 1).

    A delay just below a whole number by rounding counts as whole.
    """
    whole = int(np.floor(delay_samples + 1e-9))
    return whole, max(delay_samples - whole, 0.0)


def hold(A: Any, B: Any, duration: float) -> tuple[Array, Array]:
    """Return exp(A T) and the integral of exp(A t) B over T.

    Both describe the step of x' = A x + B u under a held input. The matrix exponential is a Pade approximant with
    scaling and squaring. A may be singular, unlike in (5.3) and (5.11), which are the same integral.

    Parameters
    ----------
    A, B : (n, n), (n, n_inputs) array
        System matrices.
    duration : float
        T [s].

    Returns
    -------
    tuple of (array, array)
        Transition matrix and input matrix.
    """
    A, B = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    n = len(A)
    block = np.zeros((n + B.shape[1],) * 2)
    block[:n, :n], block[:n, n:] = A, B
    out = linalg.expm(block * duration)
    return out[:n, :n], out[:n, n:]


def sample_with_delay(A: Any, B: Any, C: Any, *, rate: float, delay_samples: float = 0.0) -> tuple[Array, Array, Array]:
    """Return the discrete system from commands u_k to samples y_k.

    The continuous system is x' = A x + B w, y = C x. The input w is the staircase of the commands, late by
    `delay_samples` periods. A fraction of a sample puts the step inside the period; its share is exact.

    Parameters
    ----------
    A, B, C : array
        Matrices of the continuous system.
    rate : float
        Sample rate [Hz].
    delay_samples : float
        Delay from a sample to its output [samples].

    Returns
    -------
    A, B, C : array
        Matrices for z = [x, u_(k-1), u_(k-2), ...], with as many past commands as the delay needs. y_k does not depend
        on u_k.

    Raises
    ------
    BadController
        The rate or delay is invalid.
    """
    if not (np.isfinite(rate) and rate > 0 and np.isfinite(delay_samples) and delay_samples >= 0):
        raise BadController(f"a rate of {rate} Hz with a delay of {delay_samples} samples makes no sense")
    B, C = np.asarray(B, dtype=float), np.asarray(C, dtype=float)
    whole, late = delay_split(delay_samples)
    n, n_inputs = B.shape
    transition, full = hold(A, B, 1.0 / rate)
    newer = hold(A, B, (1.0 - late) / rate)[1] if late > 0 else full  # share of u_(k-whole)
    lags = whole + (late > 0)
    size = n + lags * n_inputs
    Ad, Bd, Cd = np.zeros((size, size)), np.zeros((size, n_inputs)), np.zeros((len(C), size))
    Ad[:n, :n], Cd[:, :n] = transition, C

    def past(lag: int) -> slice:
        return slice(n + (lag - 1) * n_inputs, n + lag * n_inputs)

    if late > 0:
        Ad[:n, past(whole + 1)] = full - newer
    if whole > 0:
        Ad[:n, past(whole)] = newer
    else:
        Bd[:n] = newer
    if lags > 0:
        Bd[past(1)] = np.eye(n_inputs)
    for lag in range(2, lags + 1):
        Ad[past(lag), past(lag - 1)] = np.eye(n_inputs)
    return Ad, Bd, Cd
