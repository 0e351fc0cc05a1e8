"""Impulses of dry friction by projected sweeps, and dense algebra."""

import numpy as np

from vlab.proof.generator.compilation import compiled
from vlab.signals import Array

SWEEPS, CLOSED = 200, 1e-14
"""SWEEPS, CLOSED [-]: most sweeps for the impulses of friction, and relative change that ends them."""


@compiled
def within(x: float, low: float, high: float) -> float:
    """Return a number moved into a range."""
    return min(max(x, low), high)


@compiled
def inverse(A: Array, n: int, out: Array) -> None:
    """Write the inverse of a positive definite matrix, by Cholesky's factor; A is overwritten."""
    for j in range(n):
        for i in range(j, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = np.sqrt(total) if i == j else total / A[j, j]
    for c in range(n):
        for i in range(n):
            total = 1.0 if i == c else 0.0
            for k in range(i):
                total -= A[i, k] * out[k, c]
            out[i, c] = total / A[i, i]
        for i in range(n - 1, -1, -1):
            total = out[i, c]
            for k in range(i + 1, n):
                total -= A[k, i] * out[k, c]
            out[i, c] = total / A[i, i]


@compiled
def rub(v: Array, most: Array, less: Array, W: Array, impulse: Array, n: int) -> None:
    """Add the impulses of dry friction to the rates, by projected sweeps."""
    for i in range(n):
        impulse[i] = within(impulse[i], -most[i], less[i])
        if impulse[i] != 0.0:
            for k in range(len(v)):
                v[k] += W[k, i] * impulse[i]
    for _ in range(SWEEPS):
        worst = 0.0
        for i in range(n):
            if most[i] > 0.0 or less[i] > 0.0:
                new = within(impulse[i] - v[i] / W[i, i], -most[i], less[i])
                change = new - impulse[i]
                if change != 0.0:
                    worst = max(worst, abs(change) / max(most[i], less[i]))
                    impulse[i] = new
                    for k in range(len(v)):
                        v[k] += W[k, i] * change
        if worst <= CLOSED:
            return
