"""Growth of small errors along a motion.

Along an unstable or chaotic motion a small error grows exponentially. A simulation then departs from the recording with
the true law as well. Such a recording is divided into parts, each with an initial state of its own.
"""

import numpy as np

from vlab.diagnose.predictors.trajectory import TimeVaryingSystem
from vlab.diagnose.settings import ERROR_GROWTH, PROBLEM, VALIDATION


def error_growth(system: TimeVaryingSystem, count: int) -> float:
    """Return the growth of position errors over a part.

    The growth over a part is the largest norm of the transition matrix from positions to positions. Positions count
    relative to their range of motion, so units do not matter.

    Parameters
    ----------
    system : TimeVaryingSystem
        Linear system along the motion.
    count : int
        Number of equal parts.

    Returns
    -------
    float
        Median growth over the parts, at least 1.
    """
    nv = system.M.shape[1]
    moved = np.ptp(np.cumsum(system.motion.v, axis=0), axis=0)  # ranges of motion, up to the sample period
    scale = np.where(moved > 0, moved, max(float(moved.max(initial=0.0)), 1.0))
    growths = []
    for part in np.array_split(system.A, count):
        transition, largest = np.eye(2 * nv), 1.0
        for step in part:
            with np.errstate(over="ignore", invalid="ignore"):
                transition = step @ transition
            if not np.all(np.isfinite(transition)):
                largest = np.inf
                break
            largest = max(largest, float(np.linalg.norm(transition[:nv, :nv] * scale[None, :] / scale[:, None], 2)))
        growths.append(largest)
    return float(np.median(growths))


def parts_within_growth(system: TimeVaryingSystem) -> int:
    """Return the number of parts in which errors grow little.

    A recording stays whole while the allowed model error does not grow to the size of the motion.

    Parameters
    ----------
    system : TimeVaryingSystem
        Linear system along the motion.

    Returns
    -------
    int
        Number of parts; 1 along a stable motion.
    """
    count, growth = 1, error_growth(system, 1)
    if growth * PROBLEM.model_error < 1.0:
        return count
    while growth > ERROR_GROWTH.most and len(system.A) >= (count + 1) * VALIDATION.least_part:
        count += 1
        growth = error_growth(system, count)
    return count
