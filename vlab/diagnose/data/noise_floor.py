"""White noise level of one recorded channel.

The level comes from the spectrum, the innovations or neighbouring samples.

The median Welch spectrum near the Nyquist frequency gives a white level. In low-passed records the lowest flat part of
the spectrum gives that level instead. Response to the inputs at that end of the spectrum is no noise: there the part
that a local rational model of the inputs leaves counts. Two bounds hold for white noise of variance s^2:

    s^2 <= power of the channel without what its inputs explain, at any frequency;
    s^2 <= var(y_t - sum_i a_i y_(t-i) - sum_j b_j u_(t-j)) / (1 + sum_i a_i^2), for any a and b.

In the second, noise and motion are independent, so the noise passes the predictor with the gain in the denominator. The
coefficients are those of the best one-step predictor [1].

Feedback breaks both: a command that answers the present reading holds the noise of the reading. A motion cannot answer
the present command, as velocities and displacements need time. Where the present command still explains most of what
the past leaves, the loop is closed. The remaining bound is the error of a predictor from the past alone, which noise
passes with a gain of at least one:

    s^2 <= var(y_t - sum_i a_i y_(t-i) - sum_j b_j u_(t-j)), i >= 1, j >= 1.

References
----------
.. [1] L. Ljung, *System Identification: Theory for the User*, 2nd ed., Prentice Hall, 1999, sections 4.2 (ARX),
       13.4 (closed loops) and 16.4 (order).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import linalg, signal

from vlab.diagnose.data.local_rational import noise_lines, spectrum
from vlab.diagnose.settings import NOISE
from vlab.signals import Array

FloorSource = Literal["spectrum", "inputs", "innovations", "neighbours", "steps", "least"]


@dataclass(frozen=True, kw_only=True)
class Floor:
    """White noise of a channel.

    Parameters
    ----------
    sigma : float
        Standard deviation of equivalent white noise [unit of the channel].
    rms : float
        Rms after any low-pass of the recording [unit of the channel].
    source : str
        ``"spectrum"``, ``"inputs"`` (spectrum without what the inputs explain), ``"innovations"``, ``"neighbours"``,
        ``"steps"`` of the readings, or ``"least"`` for the smallest noise that is assumed.
    """

    sigma: float
    rms: float
    source: FloorSource


def even_floor(column: Array, inputs: Array | None, *, is_motion: bool = False) -> Floor:
    """Estimate the white noise of an evenly sampled channel.

    Parameters
    ----------
    column : (n,) array
        Channel [SI].
    inputs : (n, k) array or None
        Inputs. Without inputs every floor is noise.
    is_motion : bool
        Whether the channel is a displacement or a velocity, so that it cannot answer the present input.

    Returns
    -------
    Floor
        Noise, at least `NOISE.least_noise` of the channel's rms.
    """
    least = NOISE.least_noise * (float(np.std(column)) or 1.0)
    if len(column) < NOISE.fewest or np.ptp(column) == 0.0:
        return Floor(sigma=least, rms=least, source="least")
    freq, power = _spectrum(column, "mean")
    high = freq > NOISE.noise_band / 2
    if len(column) > NOISE.least_segments * NOISE.segment // 2:
        quiet = _spectrum(column, "median")[1]
        power = quiet if np.median(quiet[high]) < NOISE.bursts * np.median(power[high]) else power
    low = _median_over_mean(len(column))
    level, share = float(np.median(power[high])) / low, 1.0
    source: FloorSource = "spectrum"
    floor = _filtered_floor(power, NOISE.cliff * level)
    if floor is not None and not _is_answer(column, inputs, freq[floor]):
        level, share = float(np.median(power[floor])) / low, floor.stop / len(power)
    else:
        is_answer = _is_answer(column, inputs, freq[high])
        bounds: list[tuple[float, FloorSource]] = [(level, source)]
        is_closed_loop = False
        if is_answer or not _is_flat(power[high], len(power) // NOISE.groups):
            given = _predictor(column, inputs)
            past = _predictor(column, inputs, with_present=False) if is_motion and inputs is not None else given
            is_closed_loop = given.error < (1.0 - NOISE.coherent) * past.error
            bounds.append((2.0 * (past.error if is_closed_loop else given.error / given.gain), "innovations"))
        if is_answer and not is_closed_loop:
            bounds.append((_unexplained(column, inputs), "inputs"))
        level, source = min(bounds)
    grain = grain_of(column) / np.sqrt(12)  # of motion over many steps the rounding is part of the level
    white, rms = (float(max(np.sqrt(part * level / 2), least, grain)) for part in (1.0, share))
    source = "steps" if white == grain else "least" if white == least else source
    return Floor(sigma=white, rms=rms, source=source)


def _spectrum(column: Array, average: str) -> tuple[Array, Array]:
    freq, power = signal.welch(
        column - column.mean(), 1.0, nperseg=min(len(column), NOISE.segment), window="blackmanharris", average=average
    )
    return freq, power


def _median_over_mean(count: int) -> float:
    """Return the median over the mean of a white spectrum.

    Power is chi-squared; Wilson and Hilferty's approximation gives its median.
    """
    segments = max(2 * count // NOISE.segment - 1, 1)
    return (1.0 - 1.0 / (9.0 * segments)) ** 3


def _filtered_floor(power: Array, least: float) -> slice | None:
    """Return the lowest flat bins of a low-passed spectrum (n_bins,), or None.

    The floor lies below every lower frequency, since the recorded motion is above the noise there.
    """
    width = (len(power) - 1) // NOISE.groups  # without the mean
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


def _is_flat(power: Array, width: int) -> bool:
    """Return whether the medians of parts of some bins agree."""
    if width < 1:
        return False
    groups = np.median(power[: len(power) // width * width].reshape(-1, width), axis=1)
    return bool(groups.max() < NOISE.flat * groups.min())


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


def _unexplained(column: Array, inputs: Array | None) -> float:
    """Return the unexplained density at the spectrum's top, or inf."""
    moving = [] if inputs is None else [x for x in inputs.T if np.ptp(x) > 0]
    found = noise_lines(column[:, None], [spectrum(x) for x in moving])
    if found is None:
        return np.inf
    lines = found[0, :, 0]
    high = lines[int(NOISE.noise_band * len(lines)) :]
    return 2.0 * float(np.median(high)) / (len(column) * np.log(2.0))  # a line's power is exponential


@dataclass(frozen=True, kw_only=True)
class _Predictor:
    """Best one-step predictor of a channel.

    Parameters
    ----------
    error : float
        Variance of the error, or inf where the record is too short [unit of the channel, squared].
    gain : float
        Variance of the error per variance of white noise of the channel, in an open loop [1].
    """

    error: float
    gain: float = 1.0


def _predictor(column: Array, inputs: Array | None, *, with_present: bool = True) -> _Predictor:
    """Return the best one-step predictor.

    The order minimises Schwarz's criterion. One QR factorisation gives the squared error of every order, as columns are
    sorted by lag.
    """
    part = slice(0, NOISE.most_samples)
    y = column[part] - column[part].mean()
    u = np.zeros((len(y), 0)) if inputs is None else inputs[part] - inputs[part].mean(axis=0)
    u = u[:, np.ptp(u, axis=0) > 0]
    count = u.shape[1]
    present = count if with_present else 0
    most = min(NOISE.most_order, len(y) // (NOISE.samples_per_unknown * (1 + count)))
    size = np.std(y)
    if most < 1 or size == 0.0:
        return _Predictor(error=np.inf)
    now = np.arange(most, len(y))
    y, u = y / size, u / np.std(u, axis=0)
    lags = [part for i in range(1, most + 1) for part in (y[now - i, None], u[now - i])]
    A = np.hstack([u[now, :present], *lags, y[now, None]])
    R = linalg.qr(A, mode="r")[0][: A.shape[1]]
    left = np.cumsum(R[::-1, -1] ** 2)[::-1]  # squared error of the columns before each one
    columns = present + (1 + count) * np.arange(most + 1)
    square = left[columns]
    order = int(np.argmin(len(now) * np.log(np.maximum(square, 1e-300)) + np.log(len(now)) * columns))
    used = columns[order]
    found = linalg.lstsq(R[:used, :used], R[:used, -1])[0] if used else np.zeros(0)
    gain = 1.0 + float(np.sum(found[present :: 1 + count] ** 2))
    return _Predictor(error=float(size**2 * square[order] / (len(now) - used)), gain=gain)


def grain_of(column: Array) -> float:
    """Return the step of a coarsely quantised channel, otherwise 0."""
    steps = np.diff(np.unique(column))
    return float(steps.min()) if 0 < steps.size < len(column) // 4 else 0.0


def uneven_floor(time: Array, column: Array) -> Floor:
    """Estimate the noise at uneven times.

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
    Floor
        Noise, at least `NOISE.least_noise` of the channel's rms.
    """
    least = NOISE.least_noise * float(np.std(column) or 1.0)
    if len(column) < NOISE.fewest_uneven:
        return Floor(sigma=least, rms=least, source="least")
    index = np.arange(2, len(column) - 2)
    near = index[:, None] + np.array([-2, -1, 1, 2])
    t = (time[near] - time[index][:, None]) / (time[-1] / len(time))
    weights = np.ones_like(t)  # Lagrange's polynomials at zero
    for i in range(4):
        for j in range(4):
            if i != j:
                weights[:, i] *= t[:, j] / (t[:, j] - t[:, i])
    left = (column[index] - np.sum(weights * column[near], axis=1)) / np.sqrt(1.0 + np.sum(weights**2, axis=1))
    noise, grain = float(np.median(np.abs(left))) / 0.6745, grain_of(column) / np.sqrt(12)
    level = max(noise, least, grain)
    source: FloorSource = "neighbours" if level == noise else "steps" if level == grain else "least"
    return Floor(sigma=level, rms=level, source=source)
