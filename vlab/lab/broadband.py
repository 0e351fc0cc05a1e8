"""Broadband signals: multisines, pseudo-random noise, noise bursts, sweeps."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vlab.errors import BadExperiment
from vlab.signals import Array

GROUP = 4
"""GROUP [1]: number of odd lines per omitted line of an odd multisine. The omitted lines, drawn at random, show
distortion."""
MOST_LINES = 1e6
"""MOST_LINES [1]: largest number of lines of a multisine. The value allows a period of four and a half hours in the
widest default band."""
RAMP = 0.05
"""RAMP [1]: share of a burst for fading in and out, which keeps the burst in its band."""


@dataclass(frozen=True, kw_only=True)
class Banded:
    """A signal with a level, band and seed.

    Parameters
    ----------
    level : float
        Amplitude in the actuator's unit, rms or peak as the signal states.
    low_hz, high_hz : float
        Band [Hz].
    seed : int
        Seed of the random draws.
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
    """Equal sines with random phases at all lines [rms level].

    The signal is periodic and fills its band [1]_ (chapter 2).

    Parameters
    ----------
    period_s : float
        Period [s]; the lines are multiples of its inverse.
    odd : bool
        Whether only odd lines are excited, with one line of every four omitted at random. Even and odd distortion then
        show on the free lines. The omitted lines depend on band and period alone, so realisations with different seeds
        share them.

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
        """Signal description for the recording."""
        return {"signal": "periodic", "period_s": self.period_s}

    def sample(self, time: Array) -> Array:
        """Return the signal.

        Parameters
        ----------
        time : array
            Times [s].

        Returns
        -------
        array
            Signal in the actuator's unit, (n_times,).
        """
        time = np.asarray(time, dtype=float)
        if time.size > 2 and self._divides(time):
            return self._one_period(time)
        phase = 2 * np.pi * time / self.period_s
        out = np.zeros_like(phase)
        for line, amplitude, start in zip(self._lines, self._amplitude, self._phase, strict=True):
            out += amplitude * np.sin(line * phase + start)
        return out

    def _divides(self, time: Array) -> bool:
        """Return whether even samples divide the period.

        The step must also resolve every line.
        """
        step = (time[-1] - time[0]) / (time.size - 1)
        count = self.period_s / step
        even = np.abs(np.diff(time) - step).max() < 1e-9 * self.period_s
        return bool(even and abs(count - round(count)) < 1e-6 and 2 * self._lines.max() < round(count))

    def _one_period(self, time: Array) -> Array:
        """Return the signal on even times by inverse FFT."""
        count = round(self.period_s * (time.size - 1) / (time[-1] - time[0]))
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        start = 2 * np.pi * self._lines * time[0] / self.period_s + self._phase
        spectrum[self._lines] = self._amplitude / 2 * count * np.exp(1j * (start - np.pi / 2))
        return np.resize(np.fft.irfft(spectrum, count), time.size)


def _without_detection_lines(odd: Array) -> Array:
    """Omit one of every `GROUP` odd lines.

    The draw depends on the lines only.
    """
    rng = np.random.default_rng([GROUP, len(odd)])
    skipped = [int(rng.integers(first, min(first + GROUP, len(odd)))) for first in range(0, len(odd), GROUP)]
    return np.delete(odd, skipped)


@dataclass(frozen=True, kw_only=True)
class PseudoRandom(Multisine):
    """Periodic Gaussian noise [rms level].

    A multisine with amplitudes from a Rayleigh distribution.
    """

    def _spectrum(self, rng: np.random.Generator, count: int) -> Array:
        amplitude = rng.rayleigh(size=count)
        return np.asarray(amplitude * self.level / np.sqrt(np.sum(amplitude**2) / 2))


@dataclass(frozen=True, kw_only=True)
class BurstRandom(Banded):
    """Bursts of new noise in every block [rms level in a burst].

    A response that decays within its block needs no window and has no leakage.

    Parameters
    ----------
    block_s : float
        Length of a block [s]; its inverse is the line spacing.
    share : float
        Duration of the burst as a share of the block, in (0, 1].
    """

    block_s: float = 20.0
    share: float = 0.4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.share <= 1:
            raise BadExperiment(f"a burst takes a share of its block in (0, 1], not {self.share}")
        self._noise(0)  # raises for blocks without a line in the band

    @property
    def period_s(self) -> None:
        """None: every burst is new."""

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""
        return {"signal": "burst", "block_s": self.block_s}

    def _noise(self, block: int) -> PseudoRandom:
        seed = int(np.random.default_rng([self.seed, block]).integers(2**32))
        return PseudoRandom(
            level=self.level, low_hz=self.low_hz, high_hz=self.high_hz, seed=seed, period_s=self.block_s
        )

    def sample(self, time: Array) -> Array:
        """Return the signal.

        Parameters
        ----------
        time : array
            Times [s].

        Returns
        -------
        array
            Signal in the actuator's unit, (n_times,).
        """
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
    """Periodic linear sine sweep over the band [peak level].

    Parameters
    ----------
    period_s : float
        Duration of one sweep [s].
    """

    period_s: float = 60.0

    @property
    def facts(self) -> dict[str, Any]:
        """Description of the signal with its band, for the recording."""
        return {"signal": "periodic", "period_s": self.period_s, "band_hz": [self.low_hz, self.high_hz]}

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.mod(np.asarray(time, dtype=float), self.period_s)
        cycles = self.low_hz * t + (self.high_hz - self.low_hz) * t**2 / (2 * self.period_s)
        return np.asarray(self.level * np.sin(2 * np.pi * cycles))
