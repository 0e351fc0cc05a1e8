"""Variance of frequency responses: measured, guessed from neighbouring lines, or fitted."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.signals import Array, ComplexArray, FrequencyResponse

PROPORTIONAL_ERROR = 0.01
"""PROPORTIONAL_ERROR [1]: relative error of H assumed before a residual exists. The error keeps sharp peaks from
dominating heavily damped modes."""
EXACT = 1e-8
"""EXACT [1]: relative residual below which data count as exact; a smaller residual is rounding."""


def known_variance(used: FrequencyResponse) -> Array | None:
    """Return the measured variance, smoothed over lines.

    Few periods give an uncertain variance, unsuitable as a weight.

    Parameters
    ----------
    used : FrequencyResponse
        Response with or without variance.

    Returns
    -------
    array or None
        Variance of each entry; None without a measured one.
    """
    if not isinstance(used, MeasuredFrequencyResponse) or used.variance is None:
        return None
    H, variance = used.H.reshape(used.freq.size, -1), used.variance.reshape(used.freq.size, -1)
    smooth = noise_model(variance, H)
    spare = max(np.nan_to_num(used.n_averages) - len(used.inputs), 1.0)  # degrees of freedom of each variance
    width = int(min(used.freq.size, np.ceil(80 / spare) + 1))
    return smooth * uniform_filter1d(variance / (smooth + 1e-300), width, axis=0, mode="nearest") + rounding_floor(H)


def roughness(used: FrequencyResponse) -> Array:
    """Return a first guess of the variance from line to line.

    The guess is the distance of each line from the chord of its neighbours.

    Parameters
    ----------
    used : FrequencyResponse
        Response.

    Returns
    -------
    array
        Variance of each entry.
    """
    f, H = used.freq, used.H.reshape(used.freq.size, -1)
    part = ((f[1:-1] - f[:-2]) / (f[2:] - f[:-2]))[:, None]
    apart = np.abs(H[1:-1] - (1 - part) * H[:-2] - part * H[2:]) ** 2 / (1 + part**2 + (1 - part) ** 2)
    additive = np.median(apart, axis=0) / np.log(2)  # median to mean: the square of a complex Gaussian is exponential
    return additive + (PROPORTIONAL_ERROR * np.abs(H)) ** 2 + rounding_floor(H)


def rounding_floor(H: ComplexArray) -> Array:
    """Return the rounding variance, which bounds every weight."""
    power = np.abs(H) ** 2
    return EXACT**2 * (power + 1e-4 * power.mean(axis=0) + 1e-30 * power.max())


def noise_model(squares: Array, H: ComplexArray) -> Array:
    """Fit variance = a + b |H|^2 to squared errors, per column.

    Multiplicative updates minimise the Itakura-Saito distance.

    Parameters
    ----------
    squares : array
        Squared errors, (line, entry).
    H : complex array
        Response, (line, entry).

    Returns
    -------
    array
        Fitted variance, (line, entry).
    """
    level = squares.mean(axis=0)
    y, x = squares / (level + 1e-300), np.abs(H) ** 2
    x = x / (x.mean(axis=0) + 1e-300)
    a, b = np.full(level.shape, 0.5), np.full(level.shape, 0.5)
    for _ in range(60):
        v = a + b * x + 1e-30
        a = a * np.sqrt(np.sum(y / v**2, axis=0) / np.sum(1 / v, axis=0))
        v = a + b * x + 1e-30
        b = b * np.sqrt(np.sum(y * x / v**2, axis=0) / (np.sum(x / v, axis=0) + 1e-30))
    return level * (a + b * x)


def common_weight(variance: Array) -> tuple[Array, Array]:
    """Return line weights and response factors.

    Their products approximate 1 / sqrt(variance).
    """
    size = 1 / np.mean(1 / variance, axis=0)
    return 1 / np.sqrt(np.mean(variance / size, axis=1)), 1 / np.sqrt(size)
