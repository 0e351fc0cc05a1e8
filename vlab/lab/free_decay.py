"""Poles of a free vibration from decaying exponentials, and envelopes.

Sensor c measures x_c(t) = sum over poles of Re(a_kc exp(s_k t)). Variable projection eliminates the a_kc in closed
form, with the Jacobian of Kaufman [1]_. Nonlinear least squares then gives the poles, from predicted start values.
Known further poles (the law's own, higher modes) take part with their a_kc and stay at their prediction.

References
----------
.. [1] L. Kaufman, A variable projection method for solving separable nonlinear least squares problems, BIT 15 (1975)
       49-57.
"""

from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.optimize import least_squares

from vlab.errors import BadRecording
from vlab.signals import Array, ComplexArray, Recording

PER_CYCLE = 10
"""PER_CYCLE [samples]: samples per cycle of the fastest fitted pole. Faster content aliases into the band, in model and
data alike."""
FASTEST = 4.0
"""FASTEST [1]: highest frequency of a known further pole, relative to half the reduced sample rate."""
ORDER = 4
"""ORDER [1]: order of the envelope's low-pass, applied forwards and backwards."""
MOST_GROWTH = 20.0
"""MOST_GROWTH [powers of e]: largest growth of a predicted pole over the recording."""
SETTLING = 1.2
"""SETTLING [periods of the low-pass's corner]: length dropped at both ends of an envelope, for the filter's
transient."""
FLOOR = 0.1
"""FLOOR [1]: smallest used value of an envelope relative to its start. Below it neighbouring modes and noise
dominate."""
SHORTEST = 1.5
"""SHORTEST [cycles]: shortest vibration for a straight-line fit."""
STRAIGHT = 0.03
"""STRAIGHT [1]: largest rms deviation of the envelope's logarithm from a straight line; a larger one indicates several
modes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedPoles:
    """Poles of a free vibration.

    Parameters
    ----------
    s : (n,) complex array
        Poles [rad/s] with positive imaginary parts.
    sd : (n,) array
        Standard deviation of the real parts, from the residual [1/s].
    misfit : float
        Rms residual relative to the signals, with equal weight for each sensor.
    """

    s: ComplexArray
    sd: Array
    misfit: float


def sensor_channels(recording: Recording) -> list[str]:
    """Return the motion channels of a recording.

    Parameters
    ----------
    recording : Recording
        Recording in SI.

    Raises
    ------
    BadRecording
        The recording has no velocity or displacement.
    """
    channels = [c.name for c in recording.channels if c.kind in ("velocity", "displacement")]
    if not channels:
        raise BadRecording(f"the recording has no velocity or displacement (it has {', '.join(recording.names)})")
    return channels


def fit_poles(recording: Recording, start: ComplexArray, others: ComplexArray) -> FittedPoles:
    """Fit poles to a free vibration.

    Parameters
    ----------
    recording : Recording
        Recording from the first sample without excitation.
    start : (n,) complex array
        Predicted values of the fitted poles [rad/s].
    others : (m,) complex array
        Predicted further poles [rad/s].

    Returns
    -------
    FittedPoles
        Poles with standard deviations.

    Raises
    ------
    BadRecording
        No sensor, a signal that is zero, fewer samples than unknowns, or a pole that grows.
    """
    channels = sensor_channels(recording)
    every = max(1, int(recording.rate / (PER_CYCLE * np.abs(start).max() / (2 * np.pi))))
    t = recording.time[::every] - recording.time[0]
    signals = np.column_stack([recording[name][::every] for name in channels])
    scale = np.sqrt(np.mean(signals**2, axis=0))
    if np.any(scale == 0):
        raise BadRecording(f"channel {channels[int(scale.argmin())]!r} is zero throughout: nothing decays there")
    if max(start.real.max(), others.real.max(initial=-np.inf)) * t[-1] > MOST_GROWTH:
        raise BadRecording("a predicted pole grows: the vibration does not decay")
    known = others[np.abs(others.imag) < FASTEST * np.pi * recording.rate / every]
    if len(t) < 4 * (len(start) + len(known)):
        raise BadRecording(f"{len(t)} samples do not determine {len(start) + len(known)} decaying modes; record longer")
    fixed = _orthonormal(_real(np.exp(np.outer(t, known))))
    signals = _without(fixed, signals / scale)
    n, size = len(start), np.abs(start)

    def poles(x: Array) -> ComplexArray:
        return np.asarray(start + size * (x[:n] + 1j * x[n:]))

    def parts(x: Array) -> tuple[ComplexArray, Array, Array, Array]:
        waves = np.exp(np.outer(t, poles(x)))
        Q, R = np.linalg.qr(_without(fixed, _real(waves)))
        left = signals - Q @ (Q.T @ signals)
        return waves, Q, np.linalg.lstsq(R, Q.T @ signals, rcond=None)[0], left

    def residual(x: Array) -> Array:
        return parts(x)[3].ravel()

    def jacobian(x: Array) -> Array:
        waves, Q, amplitude, _ = parts(x)
        columns = []
        for turn in (1.0, 1j):
            for k in range(n):
                moved = size[k] * turn * t * waves[:, k]
                change = _without(fixed, np.outer(moved.real, amplitude[k]) + np.outer(moved.imag, amplitude[n + k]))
                columns.append(-(change - Q @ (Q.T @ change)).ravel())
        return np.column_stack(columns)

    found = least_squares(residual, np.zeros(2 * n), jac=jacobian, x_scale=1e-2, xtol=1e-9, max_nfev=50)
    variance = 2 * found.cost / found.fun.size
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * variance
    return FittedPoles(s=poles(found.x), sd=size * np.sqrt(np.diag(covariance)[:n]), misfit=float(np.sqrt(variance)))


def _real(waves: ComplexArray) -> Array:
    return np.hstack([waves.real, waves.imag])


def _orthonormal(columns: Array) -> Array:
    """Return an orthonormal basis of a column space.

    Directions at rounding level are dropped.
    """
    if not columns.shape[1]:
        return columns
    basis, sizes, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    return np.asarray(basis[:, sizes > 1e-10 * sizes[0]])


def _without(basis: Array, columns: Array) -> Array:
    return columns - basis @ (basis.T @ columns)


def envelope(recording: Recording, channel: str, hz: float, corner_hz: float) -> ComplexArray:
    """Return the complex envelope of a channel, (n_samples,).

    The channel is x = Re(envelope exp(j 2 pi hz t)). A zero-phase low-pass keeps content within `corner_hz`, without
    change to the decay of an exponential.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    channel : str
        Name of the channel.
    hz : float
        Centre frequency [Hz].
    corner_hz : float
        Corner of the low-pass [Hz].
    """
    shifted = 2 * recording[channel] * np.exp(-2j * np.pi * hz * (recording.time - recording.time[0]))
    low_pass = signal.butter(ORDER, corner_hz, fs=recording.rate, output="sos")
    reach = min(len(recording) - 1, round(3 * recording.rate / corner_hz))
    return np.asarray(signal.sosfiltfilt(low_pass, shifted, padtype="even", padlen=reach))


def envelope_decay(recording: Recording, channel: str, hz: float, corner_hz: float) -> float | None:
    """Return the decay rate of an envelope.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    channel : str
        Name of the channel.
    hz : float
        Centre frequency [Hz].
    corner_hz : float
        Corner of the low-pass [Hz].

    Returns
    -------
    float or None
        Negative slope of the envelope's logarithm [1/s]; None without a long enough straight line.
    """
    size, skip = np.abs(envelope(recording, channel, hz, corner_hz)), SETTLING / corner_hz
    t = recording.time - recording.time[0]
    first, last = (int(np.searchsorted(t, at)) for at in (skip, t[-1] - skip))
    shortest = SHORTEST / hz * recording.rate
    if last - first < shortest:
        return None
    below = np.flatnonzero(size[first:last] < FLOOR * size[first])
    last = first + int(below[0]) if below.size else last
    if last - first < shortest:
        return None
    slope, level = np.polyfit(t[first:last], np.log(size[first:last]), 1)
    deviation = np.std(np.log(size[first:last]) - slope * t[first:last] - level)
    return float(-slope) if deviation < STRAIGHT else None
