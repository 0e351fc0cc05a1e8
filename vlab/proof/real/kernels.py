"""Compiled loops of a nonlinear state-space model: free run and its derivatives."""

import numpy as np

from vlab.compilation import compiled
from vlab.signals import Array

CHUNK = 256
"""CHUNK [samples]: rows of the Jacobian that enter the normal equations in one product."""
LOST = 1e6
"""LOST [-]: size of a state, in its standard deviations, beyond which a free run has diverged."""


@compiled(nogil=True)
def free_run(
    A: Array, B: Array, C: Array, D: Array, y0: Array, W: Array, V: Array, b: Array, x0: Array, u: Array
) -> Array:
    """Simulate a state-space model from an initial state.

    The model is that of `vlab.proof.real.state_space.Model`.

    Parameters
    ----------
    A, B, C, D, y0, W, V, b : array
        Matrices of the model.
    x0 : (n,) array
        State at the first sample.
    u : (N, m) array
        Inputs.

    Returns
    -------
    (N, p) array
        Outputs; NaN from the sample on at which the run diverges.
    """
    samples, n, p = u.shape[0], A.shape[0], C.shape[0]
    out = np.full((samples, p), np.nan)
    x = x0.copy()
    both = np.empty(n + u.shape[1])
    for k in range(samples):
        out[k] = C @ x + D @ u[k] + y0
        both[:n] = x
        both[n:] = u[k]
        x = A @ x + B @ u[k] + W @ np.tanh(V @ both + b)
        if not np.max(np.abs(x)) < LOST:
            break
    return out


@compiled(nogil=True)
def normal_equations(
    A: Array,
    B: Array,
    C: Array,
    D: Array,
    y0: Array,
    W: Array,
    V: Array,
    b: Array,
    x0: Array,
    u: Array,
    y: Array,
    weight: Array,
) -> tuple[Array, Array, float]:
    """Return the normal equations of a free run with its outputs.

    The parameters are A, B, W, V, b and the initial state, which act through the states, then C, D and y0. Matrices are
    row by row. Derivatives follow the states through the linearised step.

    Parameters
    ----------
    A, B, C, D, y0, W, V, b, x0, u : array
        As in `free_run`.
    y, weight : (N, p) array
        Recorded outputs, and the weights of their errors.

    Returns
    -------
    ((P, P) array, (P,) array, float)
        Matrix, right side, and the sum of squared weighted errors; infinite after divergence.
    """
    samples, m, n, p, h = u.shape[0], u.shape[1], A.shape[0], C.shape[0], W.shape[1]
    at_b, at_w, at_v = n * n, n * n + n * m, n * n + n * m + n * h
    at_bias = at_v + h * (n + m)
    at_x = at_bias + h
    inner = at_x + n
    at_d, at_y = inner + p * n, inner + p * n + p * m
    count = at_y + p
    matrix, right, cost = np.zeros((count, count)), np.zeros(count), 0.0
    S = np.zeros((n, inner))
    for i in range(n):
        S[i, at_x + i] = 1.0
    rows, errors = np.zeros((CHUNK * p, count)), np.zeros(CHUNK * p)
    x, both, filled = x0.copy(), np.empty(n + m), 0
    Vx = np.ascontiguousarray(V[:, :n])
    for k in range(samples):
        e = y[k] - (C @ x + D @ u[k] + y0)
        CS = C @ S
        for i in range(p):
            w = weight[k, i]
            row = rows[filled]
            row[:] = 0.0
            row[:inner] = w * CS[i]
            row[inner + i * n : inner + (i + 1) * n] = w * x
            row[at_d + i * m : at_d + (i + 1) * m] = w * u[k]
            row[at_y + i] = w
            errors[filled] = w * e[i]
            cost += errors[filled] ** 2
            filled += 1
        if filled == CHUNK * p or k == samples - 1:
            matrix += rows[:filled].T @ rows[:filled]
            right += rows[:filled].T @ errors[:filled]
            filled = 0
        both[:n] = x
        both[n:] = u[k]
        t = np.tanh(V @ both + b)
        slope = 1.0 - t * t
        S = (A + (W * slope) @ Vx) @ S
        for i in range(n):
            S[i, i * n : (i + 1) * n] += x
            S[i, at_b + i * m : at_b + (i + 1) * m] += u[k]
            S[i, at_w + i * h : at_w + (i + 1) * h] += t
            for j in range(h):
                S[i, at_v + j * (n + m) : at_v + (j + 1) * (n + m)] += W[i, j] * slope[j] * both
                S[i, at_bias + j] += W[i, j] * slope[j]
        x = A @ x + B @ u[k] + W @ t
        if not np.max(np.abs(x)) < LOST:
            return matrix, right, np.inf
    return matrix, right, cost
