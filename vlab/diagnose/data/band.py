"""Band of recorded motion, and signals below a frequency."""

from collections.abc import Sequence

import numpy as np
from scipy import signal

from vlab.diagnose.settings import NOISE, RUNS
from vlab.signals import Array


def fastest(y: Array, h: float, orders: Sequence[int]) -> float:
    """Return the frequency below which nearly all velocity power lies.

    Parameters
    ----------
    y : (n, n_channels) array
        Channels [SI].
    h : float
        Sample period [s].
    orders : sequence of int
        0 displacement, 1 velocity, 2 acceleration.

    Returns
    -------
    float
        Frequency [Hz].
    """
    out = 0.0
    for column, order in zip(y.T, orders, strict=True):
        freq, power = signal.welch(column - column.mean(), 1 / h, nperseg=min(len(column), RUNS.band_segment))
        floor = np.median(power[freq > NOISE.noise_band / (2 * h)]) if freq.size > 8 else 0.0
        power = np.where(power > RUNS.over_floor * floor, power - floor, 0.0) * np.maximum(freq, freq[1]) ** (
            2.0 * (1 - order)
        )
        total = np.cumsum(power)
        if total[-1] > 0:
            out = max(out, float(freq[np.searchsorted(total, RUNS.power_share * total[-1])]))
    return out


def below(values: Array, h: float, band_hz: float) -> Array:
    """Return signals below a frequency, without phase shift.

    Parameters
    ----------
    values : (n, ...) array
        Signals.
    h : float
        Sample period [s].
    band_hz : float
        Frequency of half amplitude [Hz]; the signals are unchanged from the Nyquist frequency on.

    Returns
    -------
    (n, ...) array
        Signals after a Butterworth filter, forwards and backwards.
    """
    if band_hz >= 0.5 / h:
        return values
    sections = signal.butter(RUNS.band_order, band_hz, fs=1 / h, output="sos")
    short = 3 * (2 * len(sections) + 1)
    return np.asarray(signal.sosfiltfilt(sections, values, axis=0, padlen=min(short, len(values) - 1)))
