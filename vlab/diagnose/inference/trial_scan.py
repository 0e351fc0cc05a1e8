"""Trial values of parameters whose likelihood has narrow or distant peaks.

A fit finds a delay only from a start within a fraction of a cycle, and a velocity limit only from its order of
magnitude. The screening is linear and cheap, so it evaluates a whole range of values:

- delays up to the range of the effect, at a fraction of the shortest recorded cycle;
- whole sample periods of a hold;
- limits from the slowest to the steepest motion of the command;
- steps of a converter, down to the smallest that some hundred trials reach;
- positions over which a force repeats, at half a period over the whole travel;
- resonances of one period in a recording up to the highest recorded frequency, at their half-power bandwidth.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vlab.diagnose.settings import TRIAL_SCAN
from vlab.physics.effect import Parameter
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scales of the recordings at a location.

    Parameters
    ----------
    step : float
        Sample period [s].
    duration : float
        Length of the longest run [s].
    highest_hz : float
        Frequency below which nearly all recorded power lies [Hz].
    span : float
        Largest range of the commands, in their unit.
    steepest : float
        Largest slope of the commands, in their unit per second.
    largest : float
        Largest magnitude of the commands, in their unit.
    travel : float
        Half of the range of the displacement, at most half a revolution [m or rad].
    """

    step: float
    duration: float
    highest_hz: float
    span: float = 0.0
    steepest: float = 0.0
    largest: float = 0.0
    travel: float = 0.0


def scan_values(parameter: Parameter, scales: Scales) -> Array:
    """Return the trial values of a scanned parameter besides its grid.

    Parameters
    ----------
    parameter : Parameter
        Parameter with `scan`.
    scales : Scales
        Scales of the recordings.

    Returns
    -------
    (n,) array
        Values in ascending order [SI].
    """
    if parameter.scan == "delay":
        # a mismatch of half the spacing turns the highest frequency by an eighth of a cycle
        top = scales.highest_hz if scales.highest_hz > 0 else 0.5 / scales.step
        spacing = max(TRIAL_SCAN.cycle / top, 0.5 * scales.step)
        return spacing * np.arange(1, int(parameter.high / spacing) + 1)
    if parameter.scan == "period":
        most = int(parameter.high / scales.step)
        counts = np.unique(np.linspace(2, most, min(max(most - 1, 0), TRIAL_SCAN.most)).round())
        return counts[counts >= 2] * scales.step
    if parameter.scan == "step":
        # a rounding error is a periodic function of command over step: evenly spaced inverse steps shift it evenly
        return scales.largest / (TRIAL_SCAN.cycle * np.arange(TRIAL_SCAN.most, 1.0 / TRIAL_SCAN.cycle - 1.0, -1))
    if parameter.scan == "pitch":
        # the phase is free, so half the spacing shifts the force by an eighth of a period at both ends; the force on a
        # shaft that turns has a whole number of periods in a revolution, which the spacing meets
        inverse = np.arange(1.0 / parameter.high, 1.0 / parameter.low + 0.5 * TRIAL_SCAN.cycle, TRIAL_SCAN.cycle)
        return scales.travel / inverse[::-1]
    if parameter.scan == "slope":
        low, high = scales.span / max(scales.duration, 1e-300), scales.steepest
        if not 0.0 < low < high:
            return np.zeros(0)
        count = 1 + int(np.ceil(np.log(high / low) / np.log(TRIAL_SCAN.ratio)))
        return np.geomspace(low, high, count)[:-1]
    if parameter.scan == "resonance":
        low = max(parameter.low, 1.0 / max(scales.duration, 1e-300))
        high = min(parameter.high, scales.highest_hz if scales.highest_hz > 0 else 0.5 / scales.step)
        count = 1 + int(np.ceil(np.log(max(high / low, 1.0)) / np.log1p(2.0 * TRIAL_SCAN.damping_ratio)))
        return np.geomspace(low, max(high, low), count)
    return np.zeros(0)


def between_values(parameter: Parameter, values: Sequence[float], scales: Scales) -> Array:
    """Return finer trial values about the best ones of a scan.

    A rounding error is a sawtooth, whose correlation 1 - 6 s (1 - s) at a shift of s cycles falls faster than a cosine's.
    Between the values of a scan it may be far below, so steps are refined until it is no less.

    Parameters
    ----------
    parameter : Parameter
        Parameter with `scan`.
    values : sequence of float
        Best values of the scan.
    scales : Scales
        Scales of the recordings.

    Returns
    -------
    (n,) array
        Values in ascending order [SI]; none for other scans than those of steps.
    """
    if parameter.scan != "step" or not values:
        return np.zeros(0)
    kept = np.cos(np.pi * TRIAL_SCAN.cycle)  # correlation of a cosine at half the spacing
    spacing = 1.0 - np.sqrt(1.0 - 2.0 / 3.0 * (1.0 - kept))
    half = int(np.ceil(0.5 * TRIAL_SCAN.cycle / spacing))
    inverse = scales.largest / np.array(values)
    return np.unique(scales.largest / (inverse[:, None] + spacing * np.arange(-half, half + 1)))


def best_values(values: Array, gains: Callable[[Sequence[float]], Sequence[float]]) -> list[float]:
    """Return the values at the largest local maxima of a gain.

    Parameters
    ----------
    values : (n,) array
        Values in ascending order.
    gains : callable
        Returns the gains of some values. Few values at a time bound the memory.

    Returns
    -------
    list of float
        Values, the best first.
    """
    size = TRIAL_SCAN.columns
    found = [np.asarray(gains(values[i : i + size].tolist()), dtype=float) for i in range(0, len(values), size)]
    if not found:
        return []
    gain = np.concatenate([[-np.inf], *found, [-np.inf]])
    peaks = np.flatnonzero((gain[1:-1] > 0) & (gain[1:-1] >= gain[:-2]) & (gain[1:-1] >= gain[2:]))
    order = peaks[np.argsort(-gain[1:-1][peaks], kind="stable")]
    return [float(values[i]) for i in order[: TRIAL_SCAN.kept]]
