"""Sign and unit mistakes visible in a channel's bands.

The module decides also whether an effect of the catalogue could cause the same.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.cases.checks.bands import Bands
from vlab.physics.catalogue import EFFECTS

ALIKE = 0.5
"""ALIKE [1]: smallest likeness at which a band determines the sign."""
MOST, FEW = 2.0 / 3.0, 0.1
"""MOST [1]: smallest share of bands with the same sign.
FEW [1]: largest share of bands with the opposite sign, as between a model's resonance and the structure's."""
CALIBRATION = 2.0
"""CALIBRATION [1]: largest factor that counts as a calibration error instead of a unit mistake."""
BEYOND_RESONANCE = 2.0
"""BEYOND_RESONANCE [1]: exponent of frequency in the ratio of a response above to one below resonance."""
REACH = 1.0 / (1.0 - EFFECTS["lost-stiffness"].parameter("share").high)
"""REACH [1]: largest broadband factor of a response by an effect of the catalogue, at the largest stiffness loss."""
EXACT, NEAR = 0.03, 0.1
"""EXACT [1]: log-distance from a unit's factor, beside the scatter over bands, at which a unit within `REACH` is
accepted.
NEAR [1]: same for a unit beyond `REACH`, as a share of the factor's logarithm. Within `REACH` physics could match a
factor by chance; beyond `REACH` nothing else could."""
SMALL = 0.1
"""SMALL [1]: largest residual share, in most bands, with which a unit mistake within `REACH` explains a channel
alone."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """Sign and amplitude ratio of a channel in all recordings.

    Parameters
    ----------
    sign : float
        1, -1, or 0 if the bands leave the sign open.
    log_size : float
        Logarithm of recorded over simulated amplitude, median of bands and recordings.
    scatter : float
        Largest distance of a recording's median from `log_size`.
    spread : float
        Median distance of a recording's bands from their median, in the recording with the smallest.
    """

    sign: float
    log_size: float
    scatter: float
    spread: float


def reading(of_runs: Sequence[Bands]) -> Reading | None:
    """Return sign and amplitude ratio of a channel.

    Parameters
    ----------
    of_runs : sequence of Bands
        Bands of each run.

    Returns
    -------
    Reading or None
        None without bands.
    """
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
    """Return whether a channel has the opposite sign everywhere.

    The amplitude ratio must be nearly constant over the bands. A model with its resonance on the other side of the
    excited bands also has the opposite sign. Its amplitude ratio, however, changes with the square of the frequency.
    """
    return bool(of_runs) and all(_has_sign(b, -1.0) and abs(_slope(b)) < 0.5 * BEYOND_RESONANCE for b in of_runs)


def _slope(found: Bands) -> float:
    """Return the frequency exponent of the amplitude ratio."""
    return float(np.polyfit(np.log(found.hz), found.log_ratio, 1)[0])


def slip_of_unit(of_runs: Sequence[Bands], slips: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the true unit of a mislabelled channel.

    Parameters
    ----------
    of_runs : sequence of Bands
        Bands of each run.
    slips : mapping of str to float
        Ratio of numbers as read to true numbers, by true unit.

    Returns
    -------
    tuple of (str, float) or None
        Unit and ratio, negative for the opposite sign; None without a mistake.
    """
    read = reading(of_runs)
    if read is None or read.sign == 0.0 or not slips:
        return None
    unit = near_units(read, slips)[0]
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
    """Return the candidate units, nearest first.

    If the nearest unit is beyond physics, all units within a calibration of physics are candidates.
    """
    far = {unit: abs(float(np.log(slip)) - read.log_size) for unit, slip in slips.items()}
    order = sorted(far, key=lambda unit: far[unit])
    is_beyond = abs(np.log(slips[order[0]])) > np.log(REACH)
    return [order[0], *(unit for unit in order[1:] if is_beyond and far[unit] < np.log(CALIBRATION))]


def slip_without_sign(of_runs: Sequence[Bands], slips: Mapping[str, float]) -> tuple[str, float] | None:
    """Return the unit of a mislabelled channel without a sign.

    The model's resonances are elsewhere and leave the sign open. An amplitude beyond all physics, nearly constant over
    the bands, suffices for a question to the user.

    Parameters
    ----------
    of_runs : sequence of Bands
        Bands of each run.
    slips : mapping of str to float
        Ratio of numbers as read to true numbers, by true unit.

    Returns
    -------
    tuple of (str, float) or None
        Unit and ratio; None without a mistake.
    """
    read = reading(of_runs)
    if read is None or read.sign != 0.0 or not slips:
        return None
    unit = near_units(read, slips)[0]
    size = float(np.log(slips[unit]))
    spread = max(float(np.median(np.abs(b.log_ratio - size))) for b in of_runs)
    if abs(size) <= np.log(REACH) or max(spread, abs(read.log_size - size), read.scatter) > NEAR * abs(size):
        return None
    return unit, slips[unit]
