"""Signals that fill a band: multisines, pseudo-random noise, bursts of noise, sweeps."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vlab.errors import BadExperiment
from vlab.signals import Array

GROUP = 4
"""Odd lines of which one, drawn at random, is left out of an odd multisine to detect distortion."""
MOST_LINES = 1e6
"""Of a multisine: four hours and a half of period in the widest band by default; more only fill the memory."""
RAMP = 0.05
"""Share of a burst over which it is faded in and out, so that it stays in its band."""


@dataclass(frozen=True, kw_only=True)
class Banded:
    """A signal with a level, a band and a seed.

    Parameters
    ----------
    level : float
        Size in the unit of the actuator; the signal says whether it is an rms or a peak.
    low_hz, high_hz : float
        The band [Hz].
    seed : int
        Of whatever is drawn at random.
    """

    level: float = 0.1
    low_hz: float = 0.5
    high_hz: float = 60.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not (np.isfinite([self.level, self.low_hz, self.high_hz]).all() and self.level >= 0):
            raise BadExperiment(f"the excitation level {self.level} is not a finite number of at least zero")
        if not 0 < self.low_hz < self.high_hz:
            raise BadExperiment(f"the band {self.low_hz:g} to {self.high_hz:g} Hz is not 0 < low < high")


@dataclass(frozen=True, kw_only=True)
class Multisine(Banded):
    """Sines at all lines of a band with equal amplitude and random phase [rms level] [1]_ (chapter 2).

    Parameters
    ----------
    period_s : float
        One period; the lines are its multiples of 1/period.
    odd : bool
        Only odd lines, with one line of every four left out at random, so that even and odd distortion show in between.
        Which lines those are follows from the band and the period alone: realisations that differ in the seed share them.

    References
    ----------
    .. [1] R. Pintelon, J. Schoukens, *System Identification: A Frequency Domain Approach*, 2nd ed., 2012.
    """

    period_s: float = 20.0
    odd: bool = False
    _lines: Array = field(init=False, repr=False, compare=False)
    _amplitude: Array = field(init=False, repr=False, compare=False)
    _phase: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (np.isfinite(self.period_s) and self.period_s > 0):
            raise BadExperiment(f"the period {self.period_s} s is not a positive number")
        if (self.high_hz - self.low_hz) * self.period_s > MOST_LINES:
            raise BadExperiment(
                f"a period of {self.period_s:g} s has more than {MOST_LINES:g} lines between {self.low_hz:g} and {self.high_hz:g} Hz; "
                "shorten it or narrow the band"
            )
        rng = np.random.default_rng(self.seed)
        lines = np.arange(int(np.ceil(self.low_hz * self.period_s)), int(np.floor(self.high_hz * self.period_s)) + 1)
        if self.odd:
            lines = _without_detection_lines(lines[lines % 2 == 1])
        if len(lines) == 0:
            raise BadExperiment(
                f"no line of 1/{self.period_s:g} Hz lies between {self.low_hz:g} and {self.high_hz:g} Hz; lengthen the period"
            )
        object.__setattr__(self, "_lines", lines)
        object.__setattr__(self, "_phase", rng.uniform(0, 2 * np.pi, len(lines)))
        object.__setattr__(self, "_amplitude", self._spectrum(rng, len(lines)))

    def _spectrum(self, rng: np.random.Generator, count: int) -> Array:
        return np.full(count, self.level * np.sqrt(2 / count))

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "periodic", "period_s": self.period_s}

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        time = np.asarray(time, dtype=float)
        if time.size > 2 and self._divides(time):
            return self._one_period(time)
        phase = 2 * np.pi * time / self.period_s
        out = np.zeros_like(phase)
        for line, amplitude, start in zip(self._lines, self._amplitude, self._phase, strict=True):
            out += amplitude * np.sin(line * phase + start)
        return out

    def _divides(self, time: Array) -> bool:
        """Whether the times are even and a period is a whole number of steps that holds all lines."""
        step = (time[-1] - time[0]) / (time.size - 1)
        count = self.period_s / step
        even = np.abs(np.diff(time) - step).max() < 1e-9 * self.period_s
        return bool(even and abs(count - round(count)) < 1e-6 and 2 * self._lines.max() < round(count))

    def _one_period(self, time: Array) -> Array:
        """Return the signal on even times from one inverse Fourier transform, repeated."""
        count = round(self.period_s * (time.size - 1) / (time[-1] - time[0]))
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        start = 2 * np.pi * self._lines * time[0] / self.period_s + self._phase
        spectrum[self._lines] = self._amplitude / 2 * count * np.exp(1j * (start - np.pi / 2))
        return np.resize(np.fft.irfft(spectrum, count), time.size)


def _without_detection_lines(odd: Array) -> Array:
    """Leave one of every `GROUP` odd lines out; the draw depends on the lines only."""
    rng = np.random.default_rng([GROUP, len(odd)])
    skipped = [int(rng.integers(first, min(first + GROUP, len(odd)))) for first in range(0, len(odd), GROUP)]
    return np.delete(odd, skipped)


@dataclass(frozen=True, kw_only=True)
class PseudoRandom(Multisine):
    """Periodic Gaussian noise [rms level]: as a multisine, with amplitudes drawn from a Rayleigh distribution."""

    def _spectrum(self, rng: np.random.Generator, count: int) -> Array:
        amplitude = rng.rayleigh(size=count)
        return np.asarray(amplitude * self.level / np.sqrt(np.sum(amplitude**2) / 2))


@dataclass(frozen=True, kw_only=True)
class BurstRandom(Banded):
    """Noise that is on for a share of every block and new in each [rms level while it is on].

    The response that has died out by the end of a block was wholly measured in it: no window is needed, and nothing
    leaks.

    Parameters
    ----------
    block_s : float
        Length of a block; the spacing of the lines is its inverse.
    share : float
        Share of a block during which the noise is on, in (0, 1].
    """

    block_s: float = 20.0
    share: float = 0.4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.share <= 1:
            raise BadExperiment(f"a burst takes a share of its block in (0, 1], not {self.share}")
        self._noise(0)  # refuses blocks without a line in the band

    @property
    def period_s(self) -> None:
        """Every burst is another one."""

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "burst", "block_s": self.block_s}

    def _noise(self, block: int) -> PseudoRandom:
        seed = int(np.random.default_rng([self.seed, block]).integers(2**32))
        return PseudoRandom(
            level=self.level, low_hz=self.low_hz, high_hz=self.high_hz, seed=seed, period_s=self.block_s
        )

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.asarray(time, dtype=float)
        out = np.zeros_like(t)
        number = np.floor(t / self.block_s).astype(int)
        length = self.share * self.block_s
        for block in np.unique(number):
            here = number == block
            local = t[here] - block * self.block_s
            edge = np.minimum(local, length - local) / (RAMP * length)  # 0 at the ends of the burst, 1 after the ramp
            gate = np.where(edge > 0, 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1.0)), 0.0)
            out[here] = gate * self._noise(int(block)).sample(local)
        return out


@dataclass(frozen=True, kw_only=True)
class Sweep(Banded):
    """A sine whose frequency rises linearly over the band and starts again [peak level].

    Parameters
    ----------
    period_s : float
        Duration of one sweep.
    """

    period_s: float = 60.0

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "periodic", "period_s": self.period_s}

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.mod(np.asarray(time, dtype=float), self.period_s)
        cycles = self.low_hz * t + (self.high_hz - self.low_hz) * t**2 / (2 * self.period_s)
        return np.asarray(self.level * np.sin(2 * np.pi * cycles))
