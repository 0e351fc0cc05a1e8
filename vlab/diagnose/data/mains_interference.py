"""Mains interference at 50 or 60 Hz and multiples, without a model.

Interference has a steady amplitude, a free phase in every recording and no counterpart in an input. Small lines are
subtracted before the search and count as noise in the verdict. Large lines are an effect, `mains-hum`, whose amplitude
is fitted.

References
----------
F. J. Harris, On the use of windows for harmonic analysis with the discrete Fourier transform, Proc. IEEE 66 (1978)
51-83.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import signal

from vlab.cases.channel_map import Run, compared_names
from vlab.diagnose.data.quality import marked
from vlab.diagnose.settings import INTERFERENCE
from vlab.parallel import side_by_side
from vlab.signals import Array, Recording, sample_period

BLACKMAN_HARRIS = np.array([0.35875, -0.48829, 0.14128, -0.01168])
"""BLACKMAN_HARRIS [1]: cosine coefficients of the four-term window with side lobes at -92 dB (Harris 1978)."""


@dataclass(frozen=True, kw_only=True)
class MainsInterference:
    """Interference on one channel.

    Parameters
    ----------
    channel : str
        Channel.
    frequency : float
        Mains frequency [Hz], median over the recordings.
    harmonics : tuple of int
        Detected multiples of the mains frequency.
    rms : float
        Rms of all lines over all recordings [SI unit of the channel].
    share : float
        The rms over the channel's rms about its mean.
    """

    channel: str
    frequency: float
    harmonics: tuple[int, ...]
    rms: float = 0.0
    share: float = 0.0

    def on(self, run: Run) -> Array:
        """Estimate the interference in a run.

        Parameters
        ----------
        run : Run
            Recording.

        Returns
        -------
        (n,) array
            Interference [SI unit of the channel].
        """
        time = run.measured.time - run.measured.time[0]
        out = np.zeros(len(time))
        for k in self.harmonics:
            band = _Band.of(time, run.measured[self.channel], k * self.frequency)
            frequency = band.peak(INTERFERENCE.spread_hz)
            out += (band.amplitude(frequency) * np.exp(2j * np.pi * frequency * time)).real
        return out

    @property
    def line(self) -> str:
        """Note on a benign interference."""
        lines = " and ".join(f"{k * self.frequency:.2f}" for k in self.harmonics)
        return f"{self.channel}: mains interference at {lines} Hz, {100 * self.share:.2g} % of its rms; removed before the search"

    def expected(self, run: Run) -> Array:
        """Return a run's interference (n,), scaled to the overall rms.

        Only the phases come from the run's own samples.
        """
        own = self.on(run)
        size = float(np.sqrt(np.mean(own**2)))
        return own * (self.rms / size) if size > 0 else own


@dataclass(frozen=True, kw_only=True, eq=False)
class _Band:
    """Demodulated and decimated narrow band of a windowed signal."""

    centre: float
    time: Array
    values: Array  # complex; the sum is the mean of the windowed signal
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
        for k in range(INTERFERENCE.overlap):  # overlapping windows sum to one
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
        """Return the frequency of the largest amplitude about the centre."""
        fine = self.centre + np.arange(-spread, spread, 0.1 / self.seconds)
        return float(fine[int(np.argmax(np.abs(self.amplitudes(fine))))])

    def stands_out(self, frequency: float) -> bool:
        around = np.abs(self.amplitudes(frequency + np.array(INTERFERENCE.neighbours) / self.seconds)) ** 2
        return bool(abs(self.amplitude(frequency)) ** 2 > INTERFERENCE.stands_out * np.median(around))


def find_mains_interference(runs: Sequence[Run]) -> tuple[MainsInterference, ...]:
    """Detect mains interference on the compared channels.

    Parameters
    ----------
    runs : sequence of Run
        Recordings.

    Returns
    -------
    tuple of MainsInterference
        Lines found in more than half of the recordings.
    """
    found = side_by_side(lambda channel: _interference(runs, channel), compared_names(runs))
    return tuple(interference for interference in found if interference is not None)


def _interference(runs: Sequence[Run], channel: str) -> MainsInterference | None:
    """Return the loudest interference on a channel, or None."""
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
    return max(options, key=lambda interference: interference.rms, default=None)


def remove_mains_interference(run: Run, interferences: Sequence[MainsInterference]) -> Run:
    """Subtract mains interference from a run.

    Samples at a sensor limit are marked first, since the subtraction hides the limit.

    Parameters
    ----------
    run : Run
        Recording.
    interferences : sequence of MainsInterference
        Interference of the channels.

    Returns
    -------
    Run
        Recording without the interference.
    """
    if not interferences:
        return run
    run = marked(run)
    clean = [_without(replace(run, measured=m), interferences) for m in (run.measured, *run.repeats)]
    return replace(run, measured=clean[0], repeats=tuple(clean[1:]))


def _without(run: Run, interferences: Sequence[MainsInterference]) -> Recording:
    data = run.measured.data.copy()
    for interference in interferences:
        if interference.channel in run.measured.names:
            data[:, run.measured.index(interference.channel)] -= interference.on(run)
    return replace(run.measured, data=data)


def _sized(interference: MainsInterference, runs: Sequence[Run]) -> MainsInterference:
    rms = float(np.sqrt(np.mean([np.mean(interference.on(run) ** 2) for run in runs])))
    whole = float(np.sqrt(np.mean([np.var(run.measured[interference.channel]) for run in runs])))
    return replace(interference, rms=rms, share=rms / whole if whole > 0 else 0.0)


def _line(run: Run, channel: str, nominal: float) -> float | None:
    """Return the frequency [Hz] of a steady undriven line, or None."""
    time, values = run.measured.time - run.measured.time[0], run.measured[channel]
    h = sample_period(time)
    if nominal > INTERFERENCE.highest / h or time[-1] * nominal < INTERFERENCE.least_cycles or np.ptp(values) == 0.0:
        return None
    band = _Band.of(time, values, nominal)
    frequency = band.peak(INTERFERENCE.spread_hz)
    if not band.stands_out(frequency) or not _is_steady(time, values, frequency):
        return None
    driven = any(_Band.of(time, run.measured[d.channel], nominal).stands_out(frequency) for d in run.drives)
    return None if driven or _is_harmonic(run, time, frequency) else frequency


def _is_harmonic(run: Run, time: Array, frequency: float) -> bool:
    """Return whether a line is a harmonic of a sinusoidal drive.

    A nonlinear structure responds at harmonics of its drive.
    """
    for drive in run.drives:
        values = run.measured[drive.channel]
        if np.ptp(values) == 0.0:
            continue  # an actuator at rest has no line
        freq, power = signal.periodogram(values - values.mean(), 1.0 / sample_period(time), window="hann")
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
        )  # phase relative to the record's start
    scatter = float(np.sqrt(np.mean(np.abs(found - np.mean(found)) ** 2)))
    return scatter < INTERFERENCE.steady * float(np.abs(np.mean(found)))
