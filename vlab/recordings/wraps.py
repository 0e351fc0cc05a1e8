"""Jumps of an angle by a full turn, as of atan2 or an absolute encoder.

A wrapped angle stays within one turn T. A step d longer than half a turn is a jump by T if its remainder |d| - T is as
small as the steps beside.
"""

import numpy as np
from numpy.typing import NDArray

from vlab.signals import Array

TURN = 2.0 * np.pi
"""TURN [rad]: a full turn."""
BESIDE = 3
"""BESIDE [steps]: steps before and after a jump that its remainder is compared with; more take in other speeds."""


def wraps(values: Array, turn: float = TURN, *, is_target: bool = False) -> NDArray[np.intp]:
    """Return the samples after which an angle jumps by a full turn.

    The remainder of a jump may be as long as the longest step before and the longest step after together: a speed that
    changes evenly stays below. The remainder of a slow sensor may be one step of its resolution.

    Parameters
    ----------
    values : (n,) array
        Readings without NaN.
    turn : float
        A full turn [unit of the readings].
    is_target : bool
        Whether the angle is an input, which may step by any angle from rest.

    Returns
    -------
    (n_wraps,) array of int
        Index of the last sample before each jump; empty for an angle that exceeds one turn.
    """
    none = np.zeros(0, dtype=np.intp)
    steps = np.diff(values)
    is_jump = np.abs(steps) > 0.5 * turn
    if not is_jump.any():
        return none
    levels = np.diff(np.unique(values))
    rounding = 8 * np.spacing(np.abs(values).max() + turn)
    resolution = float(levels[levels > rounding].min())
    if np.ptp(values) > turn + resolution:
        return none
    left = np.abs(steps - turn * np.sign(steps))
    sizes, ordinary = np.abs(steps[~is_jump]), np.flatnonzero(~is_jump)
    jumps = np.flatnonzero(is_jump & (left > rounding))  # a target that steps by exactly a turn crosses no end
    beside = [
        sizes[max(k - BESIDE, 0) : k].max(initial=0.0) + sizes[k : k + BESIDE].max(initial=0.0)
        for k in np.searchsorted(ordinary, jumps)
    ]
    return jumps[left[jumps] <= np.maximum(beside, 0.0 if is_target else resolution + rounding)]


def unwrapped(values: Array, turn: float = TURN) -> Array:
    """Return an angle without its jumps by a full turn.

    Parameters
    ----------
    values : (n,) array
        Readings, NaN without a reading.
    turn : float
        A full turn [unit of the readings].

    Returns
    -------
    (n,) array
        Readings that step by at most half a turn; NaN stays.
    """
    out = np.array(values, dtype=float)
    is_read = np.isfinite(out)
    out[is_read] = np.unwrap(out[is_read], period=turn)
    return out
