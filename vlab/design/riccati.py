"""Optimal regulators and filters from Riccati equations, with reasons for failure."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from vlab.design.weights import checked_weight
from vlab.errors import BadDesign
from vlab.signals import Array

REACH = 1e-8
"""REACH [1]: smallest share of a mode's eigenvector that an input drives or an output measures. A smaller share
loses half of the digits."""
ALIKE = 1e-7
"""ALIKE [1]: relative distance below which poles coincide and their eigenvectors are judged together."""
RESIDUAL = 1e-6
"""RESIDUAL [1]: largest relative residual of a solved Riccati equation."""
ON_LIMIT = 1e-12
"""ON_LIMIT [1]: distance from the stability limit, relative to the largest pole, below which a pole is on the limit.
Rounding has the same size."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Regulator:
    """Regulator u = -F x, optimal for Q and R.

    Parameters
    ----------
    F : (n_inputs, n_states) array
        Gain (4.5).
    S : (n_states, n_states) array
        Riccati solution (4.6); x_0^T S x_0 is the index (4.7).
    """

    F: Array
    S: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class KalmanFilter:
    """Kalman filter with a prescribed stability margin.

    x_est' = A x_est + B u + K (y - C x_est).

    Parameters
    ----------
    K : (n_states, n_outputs) array
        Gain (4.10).
    S : (n_states, n_states) array
        Riccati solution (4.9).
    alpha : float
        Margin [1/s]: the poles of A - K C lie left of -alpha.
    """

    K: Array
    S: Array
    alpha: float


def lqr(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike) -> Regulator:
    """Return the linear quadratic regulator: (4.4)-(4.6).

    The index is the integral of x^T Q x + u^T R u [1]_. The gain is F = R^-1 B^T S, with A^T S + S A - S B R^-1 B^T S +
    Q = 0.

    Parameters
    ----------
    A, B : (n_states, n_states), (n_states, n_inputs) array
        System matrices.
    Q, R : (n_states, n_states), (n_inputs, n_inputs) array
        Weights; Q >= 0, R > 0.

    Returns
    -------
    Regulator
        Gain and Riccati solution.

    Raises
    ------
    BadDesign
        Sizes do not fit, Q is indefinite, R is not positive definite, or an unstable mode is uncontrollable. Or Q does
        not observe a mode on the stability limit.

    References
    ----------
    .. [1] B. D. O. Anderson and J. B. Moore, Optimal Control: Linear Quadratic Methods, Prentice-Hall, 1990.
    """
    a, b = _system(A, B, "B")
    q = checked_weight(Q, "the state weight Q", definite=False)
    r = checked_weight(R, "the control weight R", definite=True)
    if q.shape != a.shape or len(r) != b.shape[1]:
        raise BadDesign(f"Q {q.shape} and R {r.shape} do not fit {len(a)} states and {b.shape[1]} inputs")
    for pole in unreachable(a, b):
        raise BadDesign(
            f"the pair (A, B) cannot be stabilised: no input moves the mode at {_named(pole)}; damp it, leave it out of "
            "the model, or put a coil where it moves"
        )
    S = _solve(
        a, b, q, r, "regulator", "Q does not see a mode on the stability limit, or the weights differ too much in size"
    )
    return Regulator(F=linalg.solve(r, b.T @ S, assume_a="pos"), S=S)


def kalman_filter(A: ArrayLike, C: ArrayLike, V1: ArrayLike, V2: ArrayLike, alpha: float = 0.0) -> KalmanFilter:
    """Return the Kalman filter of (4.9) and (4.10).

    The poles lie left of -alpha [1/s]. The margin comes from A + alpha I in place of A in the Riccati equation [1]_.

    Parameters
    ----------
    A : array_like
        System matrix, (n_states, n_states).
    C : array_like
        Output matrix, (n_outputs, n_states).
    V1 : (n_states, n_states) array
        Intensity of the state excitation; symmetric, >= 0.
    V2 : (n_outputs, n_outputs) array
        Intensity of the measurement noise; symmetric, > 0.
    alpha : float
        Stability margin [1/s].

    Returns
    -------
    KalmanFilter
        Gain and Riccati solution.

    Raises
    ------
    BadDesign
        Sizes do not fit, V1 is indefinite, V2 is not positive definite, or a mode damped less than alpha is
        unobservable.

    References
    ----------
    .. [1] B. D. O. Anderson and J. B. Moore, Optimal Control: Linear Quadratic Methods, Prentice-Hall, 1990.
    """
    c = np.asarray(C, dtype=float)
    if c.ndim != 2:
        raise BadDesign(f"C of shape {c.shape} is no matrix")
    a, ct = _system(A, c.T, "C^T")
    v1 = checked_weight(V1, "the excitation intensity V1", definite=False)
    v2 = checked_weight(V2, "the measurement noise V2", definite=True)
    if v1.shape != a.shape or len(v2) != len(c):
        raise BadDesign(f"V1 {v1.shape} and V2 {v2.shape} do not fit {len(a)} states and {len(c)} outputs")
    if not (np.isfinite(alpha) and alpha >= 0):
        raise BadDesign(f"the stability margin alpha = {alpha} 1/s is not zero or a positive number")
    shifted = a.T + alpha * np.eye(len(a))
    for pole in unreachable(shifted, ct):
        raise BadDesign(
            f"the pair (A + alpha I, C) is not detectable: no sensor sees the mode at {_named(pole - alpha)}, and it decays "
            f"more slowly than alpha = {alpha:g} 1/s; lower alpha, leave it out of the model, or put a sensor where it moves"
        )
    S = _solve(
        shifted,
        ct,
        v1,
        v2,
        "filter",
        "V1 does not excite a mode at the margin, or the intensities differ too much in size",
    )
    return KalmanFilter(K=linalg.solve(v2, ct.T @ S, assume_a="pos").T, S=S, alpha=float(alpha))


def unreachable(A: ArrayLike, B: ArrayLike) -> list[complex]:
    """Return the unstable poles of A that B does not move.

    Poles have Re s >= 0 and Im s >= 0; none means a stabilisable pair. The test of Popov, Belevitch and Hautus finds a
    left eigenvector orthogonal to B. The states are balanced first.

    Parameters
    ----------
    A, B : (n_states, n_states), (n_states, n_inputs) array
        System matrices.

    Returns
    -------
    list of complex
        Poles [rad/s].
    """
    a, b = _system(A, B, "B")
    balanced, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    s, left = linalg.eig(balanced, left=True, right=False)
    size = np.linalg.norm(b / scale[:, None])
    limit = 1e-10 * max(float(np.abs(s).max(initial=0.0)), 1e-300)
    out = []
    for group in _coinciding(s, np.flatnonzero((s.real >= -limit) & (s.imag >= 0))):
        if len(group) == 1:
            directions = left[:, group]
        else:  # eigenvectors of coincident poles are arbitrary, and too few for a defective pole: use their space
            U, values, _ = np.linalg.svd(balanced - s[group[0]] * np.eye(len(a)))
            directions = U[:, values <= max(ALIKE * values[0], values[-1])]
        moved = directions.conj().T @ (b / scale[:, None])
        if len(moved) > moved.shape[1] or np.linalg.svd(moved, compute_uv=False)[-1] <= REACH * size:
            out.append(complex(s[group[0]]))
    return out


def _coinciding(s: Array, chosen: Array) -> Iterator[list[int]]:
    order = sorted(chosen.tolist(), key=lambda i: (abs(s[i]), s[i].real))
    group: list[int] = []
    for i in order:
        if group and abs(s[i] - s[group[-1]]) > ALIKE * max(abs(s[i]), 1e-300):
            yield group
            group = []
        group.append(i)
    if group:
        yield group


def _system(A: Any, B: Any, name: str) -> tuple[Array, Array]:
    a, b = np.asarray(A, dtype=float), np.asarray(B, dtype=float)
    if a.ndim != 2 or a.shape[0] != a.shape[1] or not a.size or not np.all(np.isfinite(a)):
        raise BadDesign(f"A of shape {a.shape} is not a finite square matrix")
    if b.ndim != 2 or len(b) != len(a) or b.shape[1] == 0 or not np.all(np.isfinite(b)):
        raise BadDesign(f"{name} of shape {b.shape} is not a finite matrix of {len(a)} rows, one a state")
    return a, b


def _solve(a: Array, b: Array, q: Array, r: Array, what: str, cause: str) -> Array:
    try:
        S = linalg.solve_continuous_are(a, b, q, r)
    except (linalg.LinAlgError, ValueError) as error:
        raise BadDesign(f"the Riccati equation of the {what} has no stabilising solution: {cause} ({error})") from error
    S = (S + S.T) / 2
    gain = linalg.solve(r, b.T @ S, assume_a="pos")
    terms = (a.T @ S, S @ b @ gain, q)
    residual = np.abs(terms[0] + terms[0].T - terms[1] + terms[2]).max()
    poles = np.linalg.eigvals(a - b @ gain)
    is_stable = poles.real.max() < -ON_LIMIT * np.abs(poles).max()
    if not residual <= RESIDUAL * max(np.abs(term).max() for term in terms) or not is_stable:
        raise BadDesign(f"the Riccati equation of the {what} has no stabilising solution: {cause}")
    return S


def _named(pole: complex) -> str:
    growth = f"{pole.real:.3g} 1/s"
    return f"{abs(pole) / (2 * np.pi):.4g} Hz (Re s = {growth})"
