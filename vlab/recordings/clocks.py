"""Channels with times of their own, on the clock of a recording.

Robot logs hold commands at one rate and readings at another. A reading is kept at the sample nearest to its own time,
by a straight line between readings. All other samples of that channel have no reading. A held input takes its mean over
each step of the clock: the impulse of every step is exact, and a change between two samples keeps its time in the mean.
"""

from dataclasses import dataclass

import numpy as np

from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class OnClock:
    """A channel on a clock.

    Parameters
    ----------
    values : (n,) array
        Value at each sample.
    is_known : (n,) array of bool
        Samples at which an input is known.
    is_read : (n,) array of bool
        Samples with a reading.
    """

    values: Array
    is_known: Array
    is_read: Array


def reading_on(clock: Array, own: Array, values: Array) -> OnClock:
    """Return readings on a clock.

    Parameters
    ----------
    clock : (n,) array
        Times of the samples [s], increasing.
    own : (k,) array
        Times of the readings [s], increasing.
    values : (k,) array
        Readings.

    Returns
    -------
    OnClock
        Samples nearest to a reading, within half a step, are read.
    """
    after = np.clip(np.searchsorted(clock, own), 1, len(clock) - 1)
    nearest = np.where(own - clock[after - 1] <= clock[after] - own, after - 1, after)
    half = 0.5 * (clock[after] - clock[after - 1])
    is_read = np.zeros(len(clock), dtype=bool)
    is_read[nearest[np.abs(own - clock[nearest]) <= half * (1 + 1e-9)]] = True
    return OnClock(values=np.interp(clock, own, values), is_known=np.ones(len(clock), dtype=bool), is_read=is_read)


def held_on(clock: Array, own: Array, values: Array) -> OnClock:
    """Return a held input on a clock, as means over the steps.

    Parameters
    ----------
    clock : (n,) array
        Times of the samples [s], increasing.
    own : (k,) array
        Times at which the input changes [s], increasing.
    values : (k,) array
        Value from each of these times on.

    Returns
    -------
    OnClock
        Means from each sample to the next; samples before the first time are not known.
    """
    start = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(own))])
    at = np.clip(np.searchsorted(own, clock, side="right") - 1, 0, None)
    integral = start[at] + values[at] * (clock - own[at])
    means = np.append(np.diff(integral) / np.diff(clock), values[at[-1]])
    is_known = clock >= own[0] - 1e-9 * max(1.0, abs(float(own[0])))
    return OnClock(values=means, is_known=is_known, is_read=is_known)


def line_on(clock: Array, own: Array, values: Array) -> OnClock:
    """Return a smooth input on a clock, by straight lines.

    Parameters
    ----------
    clock : (n,) array
        Times of the samples [s], increasing.
    own : (k,) array
        Times of the values [s], increasing.
    values : (k,) array
        Values.

    Returns
    -------
    OnClock
        Samples outside the times are not known.
    """
    is_known = (clock >= own[0]) & (clock <= own[-1])
    return OnClock(values=np.interp(clock, own, values), is_known=is_known, is_read=is_known)


def filled(values: Array) -> tuple[Array, Array]:
    """Return values with straight lines across NaN, and the mask of readings.

    Parameters
    ----------
    values : (n,) array
        Readings, NaN without a reading.

    Returns
    -------
    tuple of ((n,) array, (n,) array of bool)
        Values without NaN, and samples with a reading.
    """
    is_read = np.isfinite(values)
    index = np.arange(len(values))
    return np.interp(index, index[is_read], values[is_read]), is_read


def held(values: Array) -> tuple[Array, Array]:
    """Return values that stand across NaN, and the mask of known samples.

    Parameters
    ----------
    values : (n,) array
        Values of an input, NaN where a cell is blank.

    Returns
    -------
    tuple of ((n,) array, (n,) array of bool)
        Last value before each sample, and samples from the first value on.
    """
    is_read = np.isfinite(values)
    last = np.maximum.accumulate(np.where(is_read, np.arange(len(values)), -1))
    return values[np.maximum(last, 0)], last >= 0
