"""Noise of recorded channels, from the spectrum or from neighbouring samples.

The median Welch spectrum near the Nyquist frequency gives a white level. In low-passed records the lowest flat part of
the spectrum gives that level instead.
"""

from collections.abc import Sequence

import numpy as np
from scipy import signal

from vlab.cases.channel_map import Run
from vlab.diagnose.settings import NOISE
from vlab.signals import Array


def noise_level(column: Array, inputs: Array | None = None) -> float:
    """Estimate the standard deviation of a channel's white noise.

    The level is that of the upper end of the spectrum. In a low-passed record the level is that of the floor below the
    filter's corner.

    Parameters
    ----------
    column : (n,) array
        Channel [SI].
    inputs : (n, k) array or None
        Inputs; a floor coherent with the inputs is response. Without inputs every floor is noise.

    Returns
    -------
    float
        Standard deviation [unit of the channel].
    """
    return _noise(column, inputs)[0]


def noise_levels(run: Run, names: Sequence[str]) -> Array:
    """Return the noise levels (n_names,) of a run's channels."""
    return np.array([level for level, _ in _noises(run, names)])


def noise_rms(run: Run, names: Sequence[str]) -> Array:
    """Return the noise rms (n_names,) of a run's channels, after any low-pass."""
    return np.array([rms for _, rms in _noises(run, names)])


def _noises(run: Run, names: Sequence[str]) -> list[tuple[float, float]]:
    measured, out = run.measured, []
    inputs = np.column_stack([measured[drive.channel] for drive in run.drives]) if run.drives else None
    for name in names:
        read, column = measured.is_read(name), measured[name]
        if measured.is_uniform and read.all():
            out.append(_noise(column, inputs))
        else:
            noise = uneven_noise(measured.time[read], column[read])
            out.append((noise, noise))
    return out


def _noise(column: Array, inputs: Array | None) -> tuple[float, float]:
    """Return a channel's standard deviation of equivalent white noise, and its noise rms."""
    least = NOISE.least_noise * (float(np.std(column)) or 1.0)
    if len(column) < 64:
        return least, least
    freq, power = _spectrum(column, "mean")
    high = freq > NOISE.noise_band / 2
    if len(column) > NOISE.least_segments * NOISE.segment // 2:
        quiet = _spectrum(column, "median")[1]
        power = quiet if np.median(quiet[high]) < NOISE.bursts * np.median(power[high]) else power
    level, share = float(np.median(power[high])), 1.0
    floor = _filtered_floor(power, NOISE.cliff * level)
    if floor is not None and not _is_answer(column, inputs, freq[floor]):
        level, share = float(np.median(power[floor])), floor.stop / len(power)
    grain = _grain(column) / np.sqrt(12)
    white, rms = (float(np.hypot(max(np.sqrt(part * level / 2), least), grain)) for part in (1.0, share))
    return white, rms


def _spectrum(column: Array, average: str) -> tuple[Array, Array]:
    freq, power = signal.welch(
        column - column.mean(), 1.0, nperseg=min(len(column), NOISE.segment), window="blackmanharris", average=average
    )
    return freq, power


def _filtered_floor(power: Array, least: float) -> slice | None:
    """Return the bins of the lowest flat part of a low-passed spectrum (n_bins,), or None.

    The floor lies below every lower frequency, since the recorded motion is above the noise there.
    """
    width = len(power) // NOISE.groups
    if width < 2:
        return None
    groups = np.median(power[1 : 1 + width * NOISE.groups].reshape(NOISE.groups, width), axis=1)
    for stop in range(NOISE.groups, NOISE.flat_groups, -1):
        flat = groups[stop - NOISE.flat_groups : stop]
        if flat.min() > least and flat.max() < NOISE.flat * flat.min():
            level = float(np.median(flat))
            is_lowest = bool(np.all(groups[: stop - NOISE.flat_groups] > level / NOISE.flat))
            falls = bool(np.all(groups[stop:] < NOISE.flat * level))
            if is_lowest and falls and power.max() > NOISE.heard * level:
                return slice(1 + width * (stop - NOISE.flat_groups), 1 + width * stop)
            return None
    return None


def _is_answer(column: Array, inputs: Array | None, band: Array) -> bool:
    """Return whether the inputs explain a channel in a band [cycles/sample]."""
    if inputs is None:
        return False
    inputs = inputs[:, np.ptp(inputs, axis=0) > 0]
    count = inputs.shape[1]
    length = min(NOISE.segment, 2 * len(column) // (NOISE.least_segments * count + 1)) if count else 0
    if length < 4 / (band[-1] - band[0]):
        return count > 0  # too short to resolve the band
    parts = np.column_stack([inputs, column])
    freq, S = signal.csd(parts.T[:, None], parts.T[None], 1.0, nperseg=length, window="hann")
    inside = (freq >= band[0]) & (freq <= band[-1])
    S = np.moveaxis(S[..., inside], -1, 0)
    cross, own = S[:, :count, count], S[:, :count, :count]
    own = own + 1e-9 * np.trace(own, axis1=1, axis2=2).real[:, None, None] * np.eye(count)
    explained = np.einsum("fi,fi->f", cross.conj(), np.linalg.solve(own, cross[..., None])[..., 0]).real
    return bool(np.median(explained / S[:, count, count].real) > NOISE.coherent)


def _grain(column: Array) -> float:
    """Return the step of a coarsely quantised channel, otherwise 0."""
    steps = np.diff(np.unique(column))
    return float(steps.min()) if 0 < steps.size < len(column) // 4 else 0.0


def uneven_noise(time: Array, column: Array) -> float:
    """Estimate the noise of a smooth channel at uneven times.

    Every sample is compared with the cubic through its four neighbours. The median of the differences is robust to
    jumps.

    Parameters
    ----------
    time : (n,) array
        Time stamps [s].
    column : (n,) array
        Channel [SI].

    Returns
    -------
    float
        Standard deviation [unit of the channel].
    """
    if len(column) < 16:
        return NOISE.least_noise * float(np.std(column) or 1.0)
    index = np.arange(2, len(column) - 2)
    near = index[:, None] + np.array([-2, -1, 1, 2])
    t = (time[near] - time[index][:, None]) / (time[-1] / len(time))
    weights = np.ones_like(t)  # Lagrange's polynomials at zero
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= t[:, j] / (t[:, j] - t[:, i])
    left = (column[index] - np.sum(weights * column[near], axis=1)) / np.sqrt(1.0 + np.sum(weights**2, axis=1))
    noise = max(float(np.median(np.abs(left))) / 0.6745, NOISE.least_noise * float(np.std(column) or 1.0))
    return float(np.hypot(noise, _grain(column) / np.sqrt(12)))
