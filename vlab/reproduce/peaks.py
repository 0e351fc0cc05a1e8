"""Peak levels of frequency responses near modes, and their ratios."""

from collections.abc import Sequence

import numpy as np
from scipy.signal import find_peaks

from vlab.errors import BadRecording
from vlab.signals import Array, FrequencyResponse

WIDEST = 0.2
"""WIDEST [-]: relative distance of a peak from its mode, at most half way to the next."""


def peak_ratios(
    analysis: FrequencyResponse,
    experiment: FrequencyResponse,
    analysis_hz: Sequence[float] | Array,
    experiment_hz: Sequence[float] | Array,
) -> Array:
    """Return the ratio of the peak levels of two responses, by mode.

    Ratios use the first output and the first input. Each level is read at its own peak. If damping removes the peak
    of the analysis, both are read at the mode's frequency.

    Parameters
    ----------
    analysis : FrequencyResponse
        Analytical response.
    experiment : FrequencyResponse
        Measured response.
    analysis_hz, experiment_hz : (n_modes,) array
        Natural frequencies without control, ascending [Hz].

    Returns
    -------
    array
        Ratios, (n_modes,).

    Raises
    ------
    BadRecording
        A mode lies outside the lines of its response.
    """
    levels = [peak_levels_near(*pair) for pair in ((analysis, analysis_hz), (experiment, experiment_hz))]
    at_modes = [levels_at(*pair) for pair in ((analysis, analysis_hz), (experiment, experiment_hz))]
    has_peak = np.isfinite(levels[0]) & np.isfinite(levels[1])
    return np.where(has_peak, levels[0] / levels[1], at_modes[0] / at_modes[1])


def levels_at(response: FrequencyResponse, modes_hz: Sequence[float] | Array) -> Array:
    """Return the levels of the first response at some frequencies.

    Parameters
    ----------
    response : FrequencyResponse
        Frequency response.
    modes_hz : sequence of float or array
        Frequencies [Hz].

    Returns
    -------
    array
        Levels, (n_modes,).

    Raises
    ------
    BadRecording
        A mode lies outside the lines of the response.
    """
    freq, modes = response.freq, np.asarray(modes_hz, dtype=float)
    if modes.size and not freq[0] <= modes.min() <= modes.max() <= freq[-1]:
        raise BadRecording(
            f"modes from {modes.min():g} to {modes.max():g} Hz are not all inside the response, {freq[0]:g} to "
            f"{freq[-1]:g} Hz"
        )
    return np.interp(modes, freq, np.abs(response.H[:, 0, 0]))


def peak_levels_near(response: FrequencyResponse, modes_hz: Sequence[float] | Array) -> Array:
    """Return the largest peak of the first response near each mode.

    Parameters
    ----------
    response : FrequencyResponse
        Frequency response.
    modes_hz : sequence of float or array
        Frequencies of the modes [Hz].

    Returns
    -------
    array
        Levels, (n_modes,); NaN without a peak.
    """
    freq, size, modes = response.freq, np.abs(response.H[:, 0, 0]), np.asarray(modes_hz, dtype=float)
    tops = find_peaks(size)[0]
    half_ways = np.concatenate([[-np.inf], (modes[1:] + modes[:-1]) / 2, [np.inf]])
    levels = np.full(modes.size, np.nan)
    for i, hz in enumerate(modes):
        low, high = max((1 - WIDEST) * hz, half_ways[i]), min((1 + WIDEST) * hz, half_ways[i + 1])
        inside = tops[(freq[tops] >= low) & (freq[tops] <= high)]
        if inside.size:
            levels[i] = size[inside].max()
    return levels


def average_error(ratios: Sequence[float] | Array) -> float:
    """Return the mean deviation of ratios from one.

    Tables 2, 10 and 19 to 21 have it in their last row.
    """
    return float(np.mean(np.abs(1 - np.asarray(ratios, dtype=float))))
