"""Incoherent noise of a residual, by the local rational method.

Missing physics is a function of inputs and motion. Noise is the part that neither explains: of one sensor, common to
sensors, or of an input through the structure. `vlab.diagnose.data.local_rational` gives the equation.
"""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from vlab.cases.channel_map import Run
from vlab.diagnose.data.local_rational import noise_lines, nonlinear_spectra, spectrum
from vlab.diagnose.settings import RESIDUAL_NOISE
from vlab.signals import ORDER, Array


def incoherent_rms(run: Run, channels: Sequence[str], residuals: Array, noise_free: Array | None = None) -> Array:
    """Estimate the rms of the noise in residuals.

    Parameters
    ----------
    run : Run
        Recording whose inputs and compared channels explain the coherent part.
    channels : sequence of str
        Channels of the residuals.
    residuals : (n, n_channels) array
        Recorded minus simulated values [SI].
    noise_free : (n, n_channels) array, optional
        Difference of two simulations of the channels [SI]. The share of it that the method cannot explain is the bias of
        the method, such as of many inputs in a short recording.

    Returns
    -------
    (n_channels,) array
        Rms [unit of the channel]. Zero for uneven times, too few samples, or noise above a tenth of the motion.
    """
    if not run.measured.is_uniform:
        return np.zeros(len(channels))
    signals = residuals if noise_free is None else np.hstack([residuals, noise_free])
    powers = _unexplained(run, signals)
    out = np.zeros(len(channels))
    for i, channel in enumerate(channels):
        residual, power = residuals[:, i], powers[:, i]
        squares = 2.0 * float(np.sum(power)) + min(float(np.mean(residual)) ** 2, _of_mean(power))
        squares = min(squares, float(np.mean(residual**2)))
        if noise_free is not None:
            missed = 2.0 * float(np.sum(powers[:, len(channels) + i]))
            squares = _without_bias(run, channel, squares, residual, noise_free[:, i], missed)
        rms = float(np.sqrt(squares))
        if np.ptp(residual) > 0 and RESIDUAL_NOISE.least_snr * rms <= float(np.std(run.measured[channel])):
            out[i] = rms
    return out


def _without_bias(run: Run, channel: str, squares: float, residual: Array, noise_free: Array, missed: float) -> float:
    """Return the noise power beside the coherent part that the method misses.

    Beside noise of power n, the method misses the share b of a coherent part of power m. The squares are then b m + n,
    and the variance of the residual is m + n. The share is `missed` over the variance of the noise-free signal.
    """
    spread, variance = float(np.var(noise_free)), float(np.var(residual))
    if spread <= np.finfo(float).eps * float(np.var(run.measured[channel])):  # rounding
        return squares
    b = min(missed / spread, 1.0)
    beside = max(squares - b * variance, 0.0)
    return min(beside / max(1.0 - b, np.finfo(float).eps), squares)


def _unexplained(run: Run, signals: Array) -> Array:
    """Return the unexplained power (n_lines, n_signals).

    Neither inputs nor motion explain the part. Of several motions, the one that explains a signal best counts. The
    result has no lines where there are too few.
    """
    inputs = [spectrum(run.measured[drive.channel]) for drive in run.drives]
    inputs = [x for x in inputs if np.any(x)]
    motions = [run.measured.index(c.channel) for c in run.compared if np.ptp(run.measured[c.channel]) > 0]
    lines = noise_lines(signals, inputs, [_nonlinear(run, column) for column in motions]) if motions else None
    if lines is None:
        return np.zeros((0, signals.shape[1]))
    best = np.argmin(lines.sum(axis=1), axis=0)
    return np.asarray(lines[best, :, np.arange(signals.shape[1])].T / len(signals) ** 2)


def _of_mean(power: Array) -> float:
    """Return the 95 % quantile of the noise in the squared mean.

    Noise as red as a random walk, of power 1/f^2, is assumed. The mean stands at half of the first line's frequency,
    and its square is chi-squared with one degree of freedom.

    Parameters
    ----------
    power : (n,) array
        Noise power on the lines from the first.
    """
    first = power[: RESIDUAL_NOISE.first_lines]
    return (
        float(stats.chi2.ppf(0.95, 1)) * 4.0 * 2.0 * float(np.mean(first * np.arange(1, len(first) + 1) ** 2))
        if len(first)
        else 0.0
    )


def is_gaussian(residuals: Array, false_alarm_rate: float) -> bool:
    """Return whether residuals may be stationary Gaussian noise.

    Surrogates with the spectra of the residuals and random phases are such noise [1]_. Bursts, steps and modulation raise
    the kurtosis of the residuals above that of all surrogates. The phases are common to all channels, which keeps their
    coherence.

    Parameters
    ----------
    residuals : (n, n_channels) array
        Residuals at even times, in comparable units.
    false_alarm_rate : float
        Probability of a negative answer for such noise [1].

    Returns
    -------
    bool
        False if the kurtosis exceeds that of all surrogates.

    References
    ----------
    .. [1] J. Theiler et al., Testing for nonlinearity in time series: the method of surrogate data, Physica D 58 (1992)
       77-94.
    """
    x = residuals - residuals.mean(axis=0)
    if len(x) < 3 or not np.any(x):
        return True
    spectra, phases = np.fft.rfft(x, axis=0), np.random.default_rng(0)
    largest = 0.0
    for _ in range(int(np.ceil(1.0 / false_alarm_rate)) - 1):
        turn = np.exp(2j * np.pi * phases.random(len(spectra)))
        largest = max(largest, _kurtosis(np.fft.irfft(spectra * turn[:, None], len(x), axis=0)))
    return _kurtosis(x) <= largest


def _kurtosis(x: Array) -> float:
    """Return the mean square of the channels' power over its squared mean."""
    power = np.sum(x**2, axis=1)
    return float(np.mean(power**2) / np.mean(power) ** 2)


def noise_share(residual: Array, linear: Sequence[Array], nonlinear: Sequence[Array] = ()) -> float | None:
    """Return the noise share of a residual's rms about its mean.

    Parameters
    ----------
    residual : (n,) array
        Residual.
    linear, nonlinear : sequence of (n // 2 + 1,) complex arrays
        Explanatory spectra X and Z.

    Returns
    -------
    float or None
        Share from 0 to 1; None where the record has too few lines.
    """
    noise = noise_lines(residual[:, None], linear, [nonlinear])
    total = float(np.sum(np.abs(spectrum(residual)) ** 2))
    return None if noise is None or total == 0 else float(np.sqrt(np.sum(noise) / total))


def _nonlinear(run: Run, column: int) -> list[Array]:
    """Return spectra of nonlinear functions of a run's column."""
    order = ORDER.get(run.measured.channels[column].kind, 0)
    return nonlinear_spectra(run.measured.data[:, column], order, run.measured.sample_period)
