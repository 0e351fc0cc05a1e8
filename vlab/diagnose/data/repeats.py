"""Noise between repeats: recordings or periods with equal inputs.

What inputs and motion determine is equal in every repeat, so the difference of two repeats is noise of any colour and
origin. Three parts of the difference are no noise: the transient, the response to what the inputs differ by, and the
response of a structure that changes from repeat to repeat. Free decays are fitted to the difference for the first, the
local rational method removes the other two. The method removes a large part incompletely, so repeats with a large part
are left out. The robust method of periodic testing takes the same differences [1].

References
----------
.. [1] R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., IEEE Press, 2012,
   section 4.3.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.data.free_decay import without_decays
from vlab.diagnose.data.local_rational import noise_lines, spectrum
from vlab.diagnose.settings import NOISE
from vlab.signals import Array, Recording


@dataclass(frozen=True, kw_only=True, eq=False)
class RepeatNoise:
    """Noise of a channel between repeats.

    Parameters
    ----------
    power : (n,) array
        Noise power of the lines from the first line to the Nyquist frequency [squared unit of the channel].
    count : int
        Number of repeats.
    of : str
        ``"recordings"`` or ``"periods"``.
    """

    power: Array
    count: int
    of: Literal["recordings", "periods"]

    def rms(self, thin: int = 1) -> float:
        """Return the noise rms of a thinned record.

        Parameters
        ----------
        thin : int
            Decimation factor.

        Returns
        -------
        float
            Rms [unit of the channel].
        """
        return float(np.sqrt(np.sum(self.power[: max(len(self.power) // thin, 1)])))


def with_repeats(runs: Sequence[Run], others: Sequence[Run] = ()) -> tuple[Run, ...]:
    """Return runs that know the recordings that repeat them.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.
    others : sequence of Run
        Further recordings that may repeat them.

    Returns
    -------
    tuple of Run
        Runs with `Run.repeats`.
    """
    every = [*runs, *others]
    return tuple(
        replace(run, repeats=tuple(other.measured for other in every if other is not run and repeats(run, other)))
        for run in runs
    )


@lru_cache(maxsize=64)
def repeat_noise(run: Run, channel: str) -> RepeatNoise | None:
    """Estimate the noise of a channel from repeats.

    Parameters
    ----------
    run : Run
        Recording, with its repeats.
    channel : str
        Compared channel.

    Returns
    -------
    RepeatNoise or None
        Noise; None without repeats, or with too few lines.
    """
    pairs, count = [(run.measured, other) for other in run.repeats if channel in other.names], len(run.repeats) + 1
    of: Literal["recordings", "periods"] = "recordings"
    if not pairs and channel not in run.unsettled:
        blocks, count = _blocks(run)
        pairs, of = [blocks] if blocks else [], "periods"
    found = [p for one, other in pairs if (p := _power(run, channel, one, other)) is not None]
    if not found:
        return None
    size = min(len(p) for p in found)
    return RepeatNoise(power=np.mean([p[:size] for p in found], axis=0), count=count, of=of)


def _power(run: Run, channel: str, one: Recording, other: Recording) -> Array | None:
    """Return the noise power (n // 2,) of two sections."""
    n = min(len(one), len(other))
    y, z = one[channel][:n], other[channel][:n]
    u, w = (np.column_stack([part[d.channel][:n] for d in run.drives]) for part in (one, other))
    explained = [spectrum(x) for x in (*(0.5 * (u + w)).T, *(u - w).T) if np.ptp(x) > 0]
    apart = (y - z) / np.sqrt(2.0)
    settled = without_decays(apart)
    both = np.column_stack([apart, settled])
    left = [lines for degree in NOISE.degrees if (lines := noise_lines(both, explained, degree=degree)) is not None]
    power = min((2.0 * x / n**2 for lines in left for x in lines[0].T), key=np.sum, default=None)
    return power if power is not None and np.sum(power) > NOISE.least_left * np.mean(settled**2) else None


def repeats(one: Run, other: Run) -> bool:
    """Return whether two open-loop runs have equal inputs, sample by sample.

    Parameters
    ----------
    one, other : Run
        Recordings.

    Returns
    -------
    bool
        False with a law in the loop, or without inputs.
    """
    a, b = one.measured, other.measured
    names = [d.channel for d in one.drives]
    if not names or one.law is not None or other.law is not None or not (a.is_uniform and b.is_uniform):
        return False
    if names != [d.channel for d in other.drives] or abs(a.sample_period / b.sample_period - 1.0) > 1e-6:
        return False
    n = min(len(a), len(b))
    u, w = (np.column_stack([part[name][:n] for name in names]) for part in (a, b))
    return _are_equal(u, w) and not _differ_in_level(u, w)


def _are_equal(u: Array, w: Array) -> bool:
    """Return whether moving inputs (n, k) are equal."""
    size = np.std(u, axis=0)
    moving = np.maximum(size, np.std(w, axis=0)) > 0
    return bool(np.any(moving) and np.all(np.std(u - w, axis=0)[moving] <= NOISE.repeated * size[moving]))


def _differ_in_level(u: Array, w: Array) -> bool:
    """Return whether inputs (n, k) differ by a factor more than otherwise.

    Repeats differ by the noise of measured inputs. A change of level is intended, and changes a nonlinear response.
    """
    u, w = u - u.mean(axis=0), w - w.mean(axis=0)
    factor = float(np.sum(u * w) / np.sum(u * u))
    return bool(np.linalg.norm((factor - 1.0) * u) > np.linalg.norm(w - factor * u))


def _blocks(run: Run) -> tuple[tuple[Recording, Recording] | None, int]:
    """Return two successive sections of whole periods, and the number of periods.

    Samples of the file before the run count where the run itself is too short.
    """
    if not run.drives or not run.measured.is_uniform:
        return None, 0
    names = [d.channel for d in run.drives]
    for record in (run.measured, _longer(run)):
        if record is None:
            continue
        u = np.column_stack([record[name] for name in names])
        period = _period(u)
        if not period:
            continue
        count, end = 1, len(u)
        while (count + 1) * period <= end and _are_equal(
            u[end - count * period : end - (count - 1) * period],
            u[end - (count + 1) * period : end - count * period],
        ):
            count += 1
        length = count // 2 * period
        if length:
            return (record.rows(slice(end - 2 * length, end - length)), record.rows(slice(end - length, end))), count
    return None, 0


def _longer(run: Run) -> Recording | None:
    """Return a run with the samples before it, if on its clock."""
    before, own = run.before, run.measured
    if before is None:
        return None
    time = np.concatenate([before.time, own.time])
    step = np.diff(time)
    if np.ptp(step) > 1e-3 * own.sample_period:
        return None
    return replace(own, time=time, data=np.vstack([before.select(own.names).data, own.data]))


def _period(u: Array) -> int:
    """Return the period of inputs (n, k) [samples], or 0.

    The difference of the inputs and their copies over its expectation for unrelated values has its minimum there. Lags
    within the inputs' correlation time are left out.
    """
    u = u[:, np.ptp(u, axis=0) > 0]
    n = len(u)
    if u.shape[1] == 0 or n < 4:
        return 0
    u = (u - u.mean(axis=0)) / np.std(u, axis=0)
    spectra = np.fft.rfft(u, 2 * n, axis=0)
    common = np.fft.irfft(np.sum(np.abs(spectra) ** 2, axis=1))[: n // 2 + 1]
    energy = np.concatenate([[0.0], np.cumsum(np.sum(u**2, axis=1))])
    lag = np.arange(n // 2 + 1)
    both = energy[n - lag] + energy[n] - energy[lag]
    apart = 1.0 - 2.0 * common / np.maximum(both, 1e-300)
    unrelated = np.flatnonzero(apart > 0.5)
    if unrelated.size == 0:
        return 0
    first = int(unrelated[0])
    return first + int(np.argmin(apart[first:]))
