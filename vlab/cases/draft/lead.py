"""Lead of one column over another."""

import numpy as np
from scipy import signal

from vlab.signals import Array


def leads(one: Array, other: Array) -> bool | None:
    """Return whether one column is ahead of another.

    Parameters
    ----------
    one, other : (n,) array
        Samples at the same times.

    Returns
    -------
    bool or None
        By the lag of the largest correlation, or else by exactly repeated values; None if neither tells.
    """
    if one.size != other.size or not (np.isfinite(one).all() and np.isfinite(other).all()):
        return None
    a, b = one - one.mean(), other - other.mean()
    along = signal.correlate(b, a, mode="full", method="auto")
    lag = int(np.argmax(along)) - (a.size - 1)
    if lag != 0:
        return lag > 0
    held = [int(np.count_nonzero(np.diff(values) == 0.0)) for values in (one, other)]
    return None if held[0] == held[1] else held[0] > held[1]
