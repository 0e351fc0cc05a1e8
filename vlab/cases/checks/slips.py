"""Which slip of a sign or of a unit a channel's bands show, and whether physics could do the same."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.cases.checks.bands import Bands
from vlab.physics.catalogue import EFFECTS

ALIKE = 0.5
"""Likeness of a band that says which sign it has."""
MOST, FEW = 2.0 / 3.0, 0.1
"""Share of the bands that must say the same, and of those that may say the contrary: between a model's resonance and the thing's."""
CALIBRATION = 2.0
"""Factors nearer to one than this are a calibration, not a unit: nothing is said of them."""
BEYOND_RESONANCE = 2.0
"""Power of the frequency with which a response beyond a resonance goes beside one below it."""
REACH = 1.0 / (1.0 - EFFECTS["lost-stiffness"].parameter("share").high)
"""Largest factor by which an effect of the catalogue changes a response in all bands alike: all of the stiffness but its least share is lost."""
EXACT, NEAR = 0.03, 0.1
"""Log-distance from the factor of a unit, beside what it scatters by from band to band, at which one within `REACH` is believed: physics could
have hit it by chance. And the same of one beyond it, as a share of its own logarithm: nothing else could be so large."""
SMALL = 0.1
"""Share of the recorded power that a model may leave, in most bands, where a slip within `REACH` is believed to be all that is wrong."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """What the bands of a channel say in all recordings.

    Parameters
    ----------
    sign : float
        1, -1, or 0 where the bands do not say.
    log_size : float
        Logarithm of the recorded over the simulated size: the median of bands and recordings.
    scatter : float
        Largest distance of a recording's own median from it.
    spread : float
        Median distance of a recording's bands from their median, in the recording where it is least.
    """

    sign: float
    log_size: float
    scatter: float
    spread: float


def reading(of_runs: Sequence[Bands]) -> Reading | None:
    """Return what a channel's bands say in all runs; None where there are none."""
    if not of_runs:
        return None
    sizes = np.array([float(np.median(b.log_ratio)) for b in of_runs])
    sign = next((s for s in (1.0, -1.0) if all(_has_sign(b, s) for b in of_runs)), 0.0)
    middle = float(np.median(sizes))
    spread = min(float(np.median(np.abs(b.log_ratio - np.median(b.log_ratio)))) for b in of_runs)
    return Reading(sign=sign, log_size=middle, scatter=float(np.max(np.abs(sizes - middle))), spread=spread)


def _has_sign(found: Bands, sign: float) -> bool:
    return found.agreeing(sign, ALIKE) >= MOST and found.agreeing(-sign, ALIKE) <= FEW


def is_turned(of_runs: Sequence[Bands]) -> bool:
    """Return whether a channel runs against the model in all runs, about as much in all bands.

    A model whose resonance lies on the other side of the excited bands runs against the thing as well, but by a size that changes with the
    square of the frequency from band to band.
    """
    return bool(of_runs) and all(_has_sign(b, -1.0) and abs(_slope(b)) < 0.5 * BEYOND_RESONANCE for b in of_runs)


def _slope(found: Bands) -> float:
    """Return the power of the frequency with which the recorded over the simulated size goes."""
    return float(np.polyfit(np.log(found.hz), found.log_ratio, 1)[0])


def slip_of_unit(of_runs: Sequence[Bands], slips: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the unit that a channel is in instead of the one that is said, and by what its numbers are too large, negative where turned.

    Parameters
    ----------
    slips : mapping of str to float
        By unit, by what numbers in it are too large.
    """
    read = reading(of_runs)
    if read is None or read.sign == 0.0 or not slips:
        return None
    unit = min(slips, key=lambda u: abs(np.log(slips[u]) - read.log_size))
    size = float(np.log(slips[unit]))
    far = abs(size) > np.log(REACH)
    reach = NEAR * abs(size) if far else EXACT + read.spread
    if abs(size) < np.log(CALIBRATION) or abs(read.log_size - size) > reach or read.scatter > reach:
        return None
    factor = read.sign * slips[unit]
    if not far and max(b.left(factor) for b in of_runs) > SMALL:
        return None
    return unit, factor


def near_units(read: Reading, slips: Mapping[str, float]) -> list[str]:
    """Return the units that a channel may be in, the nearest first: where the nearest is beyond physics, others within a calibration of what
    physics may make of it."""
    far = {unit: abs(float(np.log(slip)) - read.log_size) for unit, slip in slips.items()}
    order = sorted(far, key=lambda unit: far[unit])
    is_beyond = abs(np.log(slips[order[0]])) > np.log(REACH)
    return [order[0], *(unit for unit in order[1:] if is_beyond and far[unit] < np.log(CALIBRATION))]


def slip_without_sign(of_runs: Sequence[Bands], slips: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the same of a channel whose bands do not say a sign, for the model's resonances lie elsewhere: a size beyond all physics, about
    the same in all bands, is enough to ask."""
    read = reading(of_runs)
    if read is None or read.sign != 0.0 or not slips:
        return None
    unit = min(slips, key=lambda u: abs(np.log(slips[u]) - read.log_size))
    size = float(np.log(slips[unit]))
    spread = max(float(np.median(np.abs(b.log_ratio - size))) for b in of_runs)
    if abs(size) <= np.log(REACH) or max(spread, abs(read.log_size - size), read.scatter) > NEAR * abs(size):
        return None
    return unit, slips[unit]
