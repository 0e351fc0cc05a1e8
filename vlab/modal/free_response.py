"""Modal data of free decays and of vibration under unknown forces.

A free decay is a sum of decaying exponentials, so its Laplace transform consists of partial fractions with the poles of
the structure. Correlations of stationary outputs under white forces are such sums over positive lags, too [1]_. Both are
transformed at s = a + j omega under an exponential window, whose decay a is removed from the poles afterwards.

References
----------
.. [1] G. H. James, T. G. Carne, J. P. Lauffer, The natural excitation technique (NExT) for modal parameter extraction
       from operating structures, Modal Analysis 10 (1995) 260-277.
"""

from collections.abc import Sequence

import numpy as np
from scipy import signal as signals
from scipy.ndimage import median_filter

from vlab.errors import BadRecording
from vlab.modal.frf import MeasuredFrequencyResponse
from vlab.modal.recognise import FREE_KINDS, Signal
from vlab.signals import ORDER, Array, ComplexArray, Recording

DECAYED = 0.5
"""DECAYED [1]: largest rms of the last quarter of a free decay, relative to the first quarter. The scatter of a stationary
record stays above; default untested. Raising the value takes more records for free decays."""
LAG_SHARE = 0.125
"""LAG_SHARE [1]: longest possible lag of a correlation relative to the record; default untested."""
SCATTER = 2.0
"""SCATTER [sd]: bound of an autocorrelation's scatter; 95 % of pure scatter lies within."""
BIN = 1.05
"""BIN [1]: frequency ratio of the bins in which peaks are looked for; default untested. Raising the value merges peaks."""
AROUND = 11
"""AROUND [bins]: width of the running median, beside which a bin with a mode stands out; default untested."""
BLOCKS = 10
"""BLOCKS [1]: parts of a stationary record, whose correlations are averaged and give the variance; default untested. Raising
the value shortens the longest lag."""
PEAK = 5.0
"""PEAK [1]: power of a peak relative to the running median. Largest lines of noise in bins differ by less than 3; default
untested. Raising the value narrows the band."""
MARGIN = 1.2
"""MARGIN [1]: end of the band relative to the highest peak."""
LEAST_SAMPLES = 64
"""LEAST_SAMPLES [samples]: shortest record or correlation."""


def free_signal(recording: Recording, outputs: Sequence[str], *, kind: str | None = None) -> Signal:
    """Return whether a recording without input is a free decay or stationary.

    Parameters
    ----------
    recording : Recording
        Recording in SI.
    outputs : sequence of str
        Names of the sensors.
    kind : str or None
        ``"free"`` or ``"ambient"``, if known.

    Returns
    -------
    Signal
        Kind of the recording.

    Raises
    ------
    BadRecording
        Another kind is given, which needs an input.
    """
    if kind in FREE_KINDS:
        return Signal(kind=kind)
    if kind is not None:
        raise BadRecording(
            f"a test by {kind} excitation needs an input; name one with --input (channels: {', '.join(recording.names)})"
        )
    y = _fluctuations(recording, outputs)
    quarter = max(1, len(y) // 4)
    size = y.std(axis=0)
    first, last = (np.sqrt(np.mean((part[:, size > 0] / size[size > 0]) ** 2)) for part in (y[:quarter], y[-quarter:]))
    return Signal(kind="free" if last < DECAYED * first else "ambient", is_recognised=True)


def estimate_free_response(
    recording: Recording, signal: Signal, *, outputs: Sequence[str], end_level: float, segment_s: float | None = None
) -> MeasuredFrequencyResponse:
    """Return transforms of a free decay or of correlations.

    All sensors are brought to the highest derivative among them, where initial values are constants over frequency.

    Parameters
    ----------
    recording : Recording
        Recording in SI; a free decay starts with the first sample.
    signal : Signal
        Kind of the recording.
    outputs : sequence of str
        Names of the sensors.
    end_level : float
        Value of the exponential window at the end.
    segment_s : float or None
        Length of a decay, or longest lag of the correlations [s].

    Returns
    -------
    MeasuredFrequencyResponse
        One column for a decay; one column per reference sensor for correlations.

    Raises
    ------
    BadRecording
        The recording is uneven, too short, or without motion.
    """
    if not recording.is_uniform:
        raise BadRecording("a test without input needs even samples; resample the recording")
    dt, y = 1 / recording.rate, _fluctuations(recording, outputs)
    if not np.any(y):
        raise BadRecording(f"the sensors do not move ({', '.join(outputs)}); nothing to test")
    length = len(y) if signal.kind == "free" else _longest_lag(y)
    length = round(segment_s / dt) if segment_s is not None else length
    if not LEAST_SAMPLES <= length <= len(y):
        raise BadRecording(
            f"{length} samples of {len(y)} are used; accepted: at least {LEAST_SAMPLES}, up to all; record longer or change --segment"
        )
    order = np.array([ORDER.get(recording.channels[recording.index(name)].kind, 0) for name in outputs])
    names: tuple[str, ...] = ("release",) if signal.kind == "free" else tuple(outputs)
    if signal.kind == "free":
        parts = [y[:length, :, None]]
    else:
        length = min(length, len(y) // (2 * BLOCKS))
        parts = [_correlations(block, length) for block in np.array_split(y, BLOCKS)]
    decay = -np.log(end_level) / (length * dt)
    each = np.stack([_transformed(part, decay, dt, order) for part in parts])
    H, count = each.mean(axis=0), len(parts)
    keep = slice(1, _last_line(H) + 1)
    variance = None if count < 2 else each.var(axis=0, ddof=1)[keep] / count
    return MeasuredFrequencyResponse(
        freq=np.fft.rfftfreq(length, dt)[keep],
        H=H[keep],
        outputs=tuple(outputs),
        inputs=names,
        variance=variance,
        n_averages=float(count),
        resolution_hz=decay / np.pi,
        added_decay=decay,
    )


def _transformed(part: Array, decay: float, dt: float, order: Array) -> ComplexArray:
    """Return the Laplace transform, (n_lines, n_outputs, n_columns).

    The transform is taken at the decay of the window and in the highest derivative.
    """
    windowed = part * np.exp(-decay * dt * np.arange(len(part)))[:, None, None]
    H = dt * (np.fft.rfft(windowed, axis=0) - windowed[0] / 2)  # trapezoidal rule
    s = decay + 2j * np.pi * np.fft.rfftfreq(len(part), dt)
    return np.asarray(H * s[:, None, None] ** (order.max() - order)[None, :, None])


def _fluctuations(recording: Recording, outputs: Sequence[str]) -> Array:
    """Return samples without their mean in the last half, (n_samples, n_outputs)."""
    y = np.stack([recording[name] for name in outputs], axis=1)
    return np.asarray(y - y[len(y) // 2 :].mean(axis=0))


def _longest_lag(y: Array) -> int:
    """Return the last lag at which an autocorrelation exceeds its scatter.

    The variance of the scatter is (2/N) sum rho^2 (Bartlett).
    """
    n, most, longest = len(y), int(LAG_SHARE * len(y)), LEAST_SAMPLES
    for one in y.T[y.std(axis=0) > 0]:
        rho = signals.correlate(one, one, mode="full", method="fft")[n - 1 : n - 1 + most]
        rho = rho / rho[0]
        beyond = np.flatnonzero(np.abs(rho) > SCATTER * np.sqrt(2 * np.sum(rho**2) / n))
        gap = np.flatnonzero(np.diff(beyond) > most // 20)  # after a gap, scatter alone exceeds the bound
        longest = max(longest, int(beyond[gap[0]] if gap.size else beyond[-1]))
    return longest


def _correlations(y: Array, length: int) -> Array:
    """Return correlations of outputs with references, (n_lags, n_outputs, n_outputs)."""
    n, count = len(y), y.shape[1]
    scaled = y / np.where(y.std(axis=0) > 0, y.std(axis=0), 1.0)  # references of one size
    out = np.empty((length, count, count))
    for i in range(count):
        for j in range(count):
            whole = signals.correlate(y[:, i], scaled[:, j], mode="full", method="fft")
            out[:, i, j] = whole[n - 1 : n - 1 + length] / (n - np.arange(length))
    return out


def _last_line(H: ComplexArray) -> int:
    """Return the band's last line, above the highest peak."""
    each = np.sum(np.abs(H) ** 2, axis=2)
    power = np.sum(each / np.maximum(each.max(axis=0), np.finfo(float).tiny), axis=1)
    lines = np.arange(1, len(power))
    bins = np.floor(np.log(lines) / np.log(BIN)).astype(int)
    starts = np.flatnonzero(np.diff(bins, prepend=-1))
    level = np.log(np.maximum.reduceat(power[1:], starts) + np.finfo(float).tiny)
    peaks = np.flatnonzero(level - median_filter(level, size=AROUND, mode="nearest") > np.log(PEAK))
    last = lines[starts[peaks[-1]]] if peaks.size else lines[-1]
    return int(min(MARGIN * BIN * last, lines[-1]))
