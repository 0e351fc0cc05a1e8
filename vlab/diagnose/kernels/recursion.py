"""Blocked linear recursions of many short states over many samples.

A loop of 2 sqrt(n) steps replaces one of n steps.
"""

import numpy as np

from vlab.signals import Array


def states_of(step: Array, drive: Array, start: Array) -> Array:
    """Return the states x(0) = start, x(k+1) = x(k) step + drive(k).

    About sqrt(n) blocks of sqrt(n) samples are integrated side by side from zero. The final state of every block passes
    to the next by the power of the step, and its free response is added.

    Parameters
    ----------
    step : (g, s, s) array
        Step matrix of every group, acting on rows from the right.
    drive : (n, g, r, s) array
        Input of r states in every group.
    start : (g, r, s) array
        Initial states.

    Returns
    -------
    (n, g, r, s) array
        States before every sample.
    """
    n, g, r, s = drive.shape
    size = max(1, round(np.sqrt(n)))
    count = -(-n // size)
    padded = np.zeros((count * size, g, r, s), dtype=drive.dtype)
    padded[:n] = drive
    blocks = padded.reshape(count, size, g, r, s).transpose(1, 2, 0, 3, 4).reshape(size, g, count * r, s)
    out, x = np.empty_like(blocks), np.zeros((g, count * r, s), dtype=drive.dtype)
    for j in range(size):
        out[j] = x
        x = np.matmul(x, step) + blocks[j]
    handed, power = x.reshape(g, count, r, s), np.linalg.matrix_power(step, size)
    first, x = np.empty((g, count, r, s), dtype=drive.dtype), start
    for k in range(count):
        first[:, k] = x
        x = np.matmul(x, power) + handed[:, k]
    x = first.reshape(g, count * r, s)
    for j in range(size):
        out[j] += x
        x = np.matmul(x, step)
    return out.reshape(size, g, count, r, s).transpose(2, 0, 1, 3, 4).reshape(count * size, g, r, s)[:n]
