"""Correction of time stamps: inputs of the past and skewed readings."""

from dataclasses import replace

import numpy as np

from vlab.cases.description import RecordingTable
from vlab.errors import BadCase
from vlab.signals import Array, Recording

TAPS = 16
"""TAPS [samples]: samples on each side of an interpolated value."""
BETA = 6.0
"""BETA [1]: shape of the interpolator's Kaiser window; the response is flat within 0.1 % up to 0.9 of half the sample
rate."""


def in_time(whole: Recording, table: RecordingTable) -> Recording:
    """Return a recording with inputs and readings at their time stamps.

    Parameters
    ----------
    whole : Recording
        Recording as read.
    table : RecordingTable
        Description of the recording.

    Returns
    -------
    Recording
        Recording with zero skew; inputs hold from their sample onwards.

    Raises
    ------
    BadCase
        A skew of a sample or more, or of rows with uneven time stamps.
    """
    columns = dict(zip(table.channel_names, table.channel, strict=True))
    past = [name for name, c in columns.items() if c.input and c.hold == "past"]
    skewed = [name for name, c in columns.items() if c.delay_s]
    if not past and not skewed:
        return whole
    data = whole.data.copy()
    for i in (whole.index(name) for name in past):
        data[:-1, i] = data[1:, i]
    for name in skewed:
        samples = columns[name].delay_s * whole.rate if whole.is_uniform else np.inf
        if not abs(samples) < 1.0:
            raise BadCase(
                f"{table.file}: delay_s = {columns[name].delay_s:g} of {name!r} is "
                + (
                    f"{samples:.3g} samples; less than one is an instrument's skew, more"
                    if whole.is_uniform
                    else "no skew of even stamps, it"
                )
                + " is an effect: state it as sensor-delay in [[model.effect]]"
            )
        data[:, whole.index(name)] = between_samples(whole[name], samples)
    return replace(whole, data=data)


def between_samples(column: Array, later: float) -> Array:
    """Return a column shifted by part of a sample.

    A windowed ideal interpolator with ends reflected about their values.

    Parameters
    ----------
    column : array
        Signal, (n,).
    later : float
        Shift [samples], less than one.

    Returns
    -------
    array
        Shifted signal, (n,).
    """
    n = min(TAPS, len(column) - 1)
    padded = np.concatenate([2.0 * column[0] - column[n:0:-1], column, 2.0 * column[-1] - column[-2 : -n - 2 : -1]])
    at = np.arange(-n, n + 1) - later
    taps = np.sinc(at) * np.i0(BETA * np.sqrt(np.clip(1.0 - (at / (n + 1.0)) ** 2, 0.0, None)))
    return np.convolve(padded, (taps / taps.sum())[::-1], mode="valid")
