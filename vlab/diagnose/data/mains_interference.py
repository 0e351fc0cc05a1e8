"""Mains hum: lines at 50 or 60 Hz and their multiples, found in the recordings before any model is asked.

Hum has the mains' frequency, a steady amplitude and a phase of its own in every recording, and no input has a line there.
It is benign where it is small: the lines are taken off before the search and count as noise in the verdict. Where it is a
good part of a channel it is an effect of its own, `mains-hum`, with its amplitude from the recordings to fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from vlab.cases.channel_map import Run, compared_names
from vlab.diagnose.data.quality import marked
from vlab.diagnose.settings import INTERFERENCE
from vlab.signals import Array

BLACKMAN_HARRIS = np.array([0.35875, -0.48829, 0.14128, -0.01168])
"""Window of four cosines, side lobes at -92 dB (Harris, On the use of windows for harmonic analysis, 1978); evaluated at the
time stamps as they are."""


@dataclass(frozen=True, kw_only=True)
class MainsInterference:
    """The hum on one channel.

    Parameters
    ----------
    channel : str
        Its name.
    frequency : float
        Of the mains [Hz], as the longest recording has it.
    harmonics : tuple of int
        The multiples that stand out.
    rms : float
        Of all its lines over all recordings [SI unit of the channel].
    share : float
        The same over the channel's rms about its mean.
    """

    channel: str
    frequency: float
    harmonics: tuple[int, ...]
    rms: float = 0.0
    share: float = 0.0

    def on(self, run: Run) -> Array:
        """Return the hum in a run as its own samples have it, (n,)."""
        time = run.measured.time - run.measured.time[0]
        out = np.zeros(len(time))
        for k in self.harmonics:
            band = _Band.of(time, run.measured[self.channel], k * self.frequency)
            frequency = band.peak(INTERFERENCE.spread_hz)
            out += (band.amplitude(frequency) * np.exp(2j * np.pi * frequency * time)).real
        return out

    def expected(self, run: Run) -> Array:
        """Return the hum in a run with the size found elsewhere: of its own samples only the phases are used."""
        own = self.on(run)
        size = float(np.sqrt(np.mean(own**2)))
        return own * (self.rms / size) if size > 0 else own


@dataclass(frozen=True, kw_only=True, eq=False)
class _Band:
    """A narrow band of a signal, moved to zero frequency and thinned; windowed so that far lines do not leak in."""

    centre: float
    time: Array
    values: Array  # complex, their sum is the mean of the windowed signal
    seconds: float

    @classmethod
    def of(cls, time: Array, values: Array, centre: float) -> "_Band":
        window = BLACKMAN_HARRIS @ np.cos(2 * np.pi * np.arange(4)[:, None] * time / time[-1]) * np.gradient(time)
        x = (values - values.mean()) * window / window.sum() * np.exp(-2j * np.pi * centre * time)
        block = np.floor(time * INTERFERENCE.blocks_hz).astype(int)
        inside, thinned = (
            time * INTERFERENCE.blocks_hz - block,
            np.zeros(block[-1] + INTERFERENCE.overlap, dtype=complex),
        )
        for k in range(INTERFERENCE.overlap):  # windows that overlap add up to one everywhere
            share = BLACKMAN_HARRIS @ np.cos(2 * np.pi * np.arange(4)[:, None] * (inside + k) / INTERFERENCE.overlap)
            part = x * share / (INTERFERENCE.overlap * BLACKMAN_HARRIS[0])
            sums = np.bincount(block, part.real) + 1j * np.bincount(block, part.imag)
            thinned[INTERFERENCE.overlap - 1 - k : INTERFERENCE.overlap - 1 - k + len(sums)] += sums
        middles = (np.arange(len(thinned)) + 1.0 - INTERFERENCE.overlap / 2) / INTERFERENCE.blocks_hz
        return cls(centre=centre, time=middles, values=thinned, seconds=float(time[-1]))

    def amplitudes(self, frequencies: Array) -> Array:
        """Return complex amplitudes at frequencies near the centre."""
        turn = np.exp(-2j * np.pi * (np.atleast_1d(frequencies)[:, None] - self.centre) * self.time)
        return np.asarray(2.0 * (turn @ self.values))

    def amplitude(self, frequency: float) -> complex:
        return complex(self.amplitudes(np.array([frequency]))[0])

    def peak(self, spread: float) -> float:
        """Return the frequency of the largest amplitude around the centre."""
        fine = self.centre + np.arange(-spread, spread, 0.1 / self.seconds)
        return float(fine[int(np.argmax(np.abs(self.amplitudes(fine))))])

    def stands_out(self, frequency: float) -> bool:
        around = np.abs(self.amplitudes(frequency + np.array(INTERFERENCE.neighbours) / self.seconds)) ** 2
        return bool(abs(self.amplitude(frequency)) ** 2 > INTERFERENCE.stands_out * np.median(around))


def find_mains_interference(runs: Sequence[Run]) -> tuple[MainsInterference, ...]:
    """Return the hum on the compared channels of some runs: lines that stand out in more than half of them."""
    out = []
    for channel in compared_names(runs):
        options = []
        for nominal in INTERFERENCE.mains_hz:
            lines = {
                k: [f for run in runs if (f := _line(run, channel, k * nominal)) is not None]
                for k in INTERFERENCE.harmonics
            }
            found = {k: at for k, at in lines.items() if len(at) > 0.5 * len(runs)}
            if found:
                frequency = float(np.median(np.concatenate([np.array(at) / k for k, at in found.items()])))
                options.append(
                    _sized(MainsInterference(channel=channel, frequency=frequency, harmonics=tuple(found)), runs)
                )
        if options:
            out.append(max(options, key=lambda interference: interference.rms))
    return tuple(out)


def remove_mains_interference(run: Run, interferences: Sequence[MainsInterference]) -> Run:
    """Return a run with the hum taken off its channels; a limit that samples stand at is none without it, so these are marked before."""
    if not interferences:
        return run
    run = marked(run)
    data = run.measured.data.copy()
    for interference in interferences:
        data[:, run.measured.index(interference.channel)] -= interference.on(run)
    return replace(run, measured=replace(run.measured, data=data))


def _sized(interference: MainsInterference, runs: Sequence[Run]) -> MainsInterference:
    rms = float(np.sqrt(np.mean([np.mean(interference.on(run) ** 2) for run in runs])))
    whole = float(np.sqrt(np.mean([np.var(run.measured[interference.channel]) for run in runs])))
    return replace(interference, rms=rms, share=rms / whole if whole > 0 else 0.0)


def _line(run: Run, channel: str, nominal: float) -> float | None:
    """Return the frequency of a line near a nominal one that stands out, is steady and is not driven; None without one."""
    time, values = run.measured.time - run.measured.time[0], run.measured[channel]
    h = float(np.median(np.diff(time)))
    if nominal > INTERFERENCE.highest / h or time[-1] * nominal < INTERFERENCE.least_cycles or np.ptp(values) == 0.0:
        return None
    band = _Band.of(time, values, nominal)
    frequency = band.peak(INTERFERENCE.spread_hz)
    if not band.stands_out(frequency) or not _is_steady(time, values, frequency):
        return None
    driven = any(_Band.of(time, run.measured[d.channel], nominal).stands_out(frequency) for d in run.drives)
    return None if driven or _is_harmonic(run, time, frequency) else frequency


def _is_harmonic(run: Run, time: Array, frequency: float) -> bool:
    """Return whether a line is a multiple of the one line that a drive is: what is nonlinear answers a sine there."""
    for drive in run.drives:
        values = run.measured[drive.channel]
        if np.ptp(values) == 0.0:
            continue  # an actuator at rest, which has no line
        freq, power = signal.periodogram(values - values.mean(), 1.0 / float(np.median(np.diff(time))), window="hann")
        top = int(np.argmax(power))
        if power[max(top - 2, 0) : top + 3].sum() < INTERFERENCE.one_line * power.sum():
            continue
        order = round(frequency / max(freq[top], freq[1]))
        if order >= 2 and abs(frequency - order * freq[top]) < (order + 1) * freq[1]:
            return True
    return False


def _is_steady(time: Array, values: Array, frequency: float) -> bool:
    found = []
    for part in np.array_split(np.arange(len(time)), INTERFERENCE.quarters):
        t0 = time[part[0]]
        band = _Band.of(time[part] - t0, values[part], frequency)
        found.append(
            band.amplitude(frequency) * np.exp(-2j * np.pi * frequency * t0)
        )  # counted from the record's start
    scatter = float(np.sqrt(np.mean(np.abs(found - np.mean(found)) ** 2)))
    return scatter < INTERFERENCE.steady * float(np.abs(np.mean(found)))
