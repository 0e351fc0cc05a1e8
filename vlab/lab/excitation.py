"""Excitation signals. Each is a function of time alone, drawn once from its seed.

The signal is added to the command of one actuator behind the converter's filter, where the laboratory added it
(Figure 21), so one coil both controls and excites.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Protocol

import numpy as np

from vlab.errors import BadExperiment, unknown_name
from vlab.signals import Array


class Excitation(Protocol):
    """A signal over time.

    Parameters
    ----------
    level : float
        Its size in the actuator's unit; rms for random signals and multisines, peak for the others, the static force
        for a release.
    """

    @property
    def level(self) -> float:
        """Size of the signal."""

    @property
    def period_s(self) -> float | None:
        """Period of a periodic signal [s], else None."""

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""


@dataclass(frozen=True, kw_only=True)
class _Banded:
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
class Multisine(_Banded):
    """Sines at all lines of a band with equal amplitude and random phase [1]_ (chapter 2).

    Parameters
    ----------
    period_s : float
        One period; the lines are its multiples of 1/period.
    odd : bool
        Only odd lines, with one line of every four left out at random, so that even and odd distortion show in between.

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
        rng = np.random.default_rng(self.seed)
        lines = np.arange(int(np.ceil(self.low_hz * self.period_s)), int(np.floor(self.high_hz * self.period_s)) + 1)
        if self.odd:
            lines = lines[lines % 2 == 1]
            groups = np.arange(len(lines)) // 4
            skipped = {
                int(rng.choice(np.flatnonzero(groups == g))) for g in range(groups.max() + 1 if len(groups) else 0)
            }
            lines = np.delete(lines, sorted(skipped))
        if len(lines) == 0:
            raise BadExperiment(
                f"no line of 1/{self.period_s:g} Hz lies between {self.low_hz:g} and {self.high_hz:g} Hz; lengthen the period"
            )
        object.__setattr__(self, "_lines", lines)
        object.__setattr__(self, "_phase", rng.uniform(0, 2 * np.pi, len(lines)))
        object.__setattr__(self, "_amplitude", self._spectrum(rng, len(lines)))

    def _spectrum(self, rng: np.random.Generator, count: int) -> Array:
        return np.full(count, self.level * np.sqrt(2 / count))

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


@dataclass(frozen=True, kw_only=True)
class PseudoRandom(Multisine):
    """Periodic Gaussian noise: as a multisine, with amplitudes drawn from a Rayleigh distribution."""

    def _spectrum(self, rng: np.random.Generator, count: int) -> Array:
        amplitude = rng.rayleigh(size=count)
        return np.asarray(amplitude * self.level / np.sqrt(np.sum(amplitude**2) / 2))


@dataclass(frozen=True, kw_only=True)
class Sweep(_Banded):
    """A sine whose frequency rises linearly over the band and starts again [peak level].

    Parameters
    ----------
    period_s : float
        Duration of one sweep.
    """

    period_s: float = 60.0

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.mod(np.asarray(time, dtype=float), self.period_s)
        cycles = self.low_hz * t + (self.high_hz - self.low_hz) * t**2 / (2 * self.period_s)
        return np.asarray(self.level * np.sin(2 * np.pi * cycles))


@dataclass(frozen=True, kw_only=True)
class SteppedSine(_Banded):
    """A sine that dwells at one frequency after another, phase-continuous [peak level].

    Parameters
    ----------
    steps : int
        Number of frequencies, evenly spaced over the band.
    dwell_s : float
        Time at each.
    """

    steps: int = 20
    dwell_s: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps < 1 or not self.dwell_s > 0:
            raise BadExperiment(f"{self.steps} steps of {self.dwell_s} s make no stepped sine")

    @property
    def period_s(self) -> None:
        """A stepped sine runs once."""

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.asarray(time, dtype=float)
        step = np.clip((t / self.dwell_s).astype(int), 0, self.steps - 1)
        freq = np.linspace(self.low_hz, self.high_hz, self.steps)
        begun = np.concatenate([[0.0], np.cumsum(freq[:-1] * self.dwell_s)])
        return np.asarray(self.level * np.sin(2 * np.pi * (begun[step] + freq[step] * (t - step * self.dwell_s))))


@dataclass(frozen=True, kw_only=True)
class Hammer(_Banded):
    """Half-sine pulses of slightly varying size and interval [peak level]; the width follows from the band.

    Parameters
    ----------
    interval_s : float
        Mean time between blows.
    """

    interval_s: float = 10.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.interval_s > 3 / self.high_hz:
            raise BadExperiment(
                f"an interval of {self.interval_s} s is too short for blows of {1.5 / self.high_hz:g} s"
            )

    @property
    def period_s(self) -> None:
        """Blows do not repeat exactly."""

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]."""
        t = np.asarray(time, dtype=float)
        rng = np.random.default_rng(self.seed)
        width = 1.5 / self.high_hz  # a half sine of width w has its first spectral zero at 1.5/w
        out = np.zeros_like(t)
        blow = 0.2
        while blow < t.max(initial=0.0) + width:
            inside = (t >= blow) & (t < blow + width)
            out[inside] += self.level * rng.uniform(0.8, 1.2) * np.sin(np.pi * (t[inside] - blow) / width)
            blow += self.interval_s * rng.uniform(0.9, 1.1)
        return out


@dataclass(frozen=True, kw_only=True)
class Release:
    """No signal: the structure is pulled by a static force at the actuator and let go at the start."""

    level: float = 1.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.level):
            raise BadExperiment(f"the static force {self.level} is not finite")

    @property
    def period_s(self) -> None:
        """A release happens once."""

    def sample(self, time: Array) -> Array:
        """Return zeros: the force is gone from the start."""
        return np.zeros_like(np.asarray(time, dtype=float))


EXCITATIONS: Mapping[str, Callable[..., Any]] = {
    "multisine": Multisine,
    "pseudo-random": PseudoRandom,
    "sweep": Sweep,
    "stepped-sine": SteppedSine,
    "hammer": Hammer,
    "release": Release,
}
"""The excitations by name."""


def build_excitation(name: str, **settings: Any) -> Any:
    """Build an excitation by name; settings it does not have are refused unless they are None.

    Raises
    ------
    UnknownName
        No excitation of that name.
    BadExperiment
        A setting that this excitation does not have, or a value it refuses.
    """
    if name not in EXCITATIONS:
        raise unknown_name("excitation", name, EXCITATIONS)
    kind: Any = EXCITATIONS[name]
    accepted = [f.name for f in fields(kind) if f.init]
    given = {key: value for key, value in settings.items() if value is not None}
    for key in given:
        if key not in accepted:
            raise BadExperiment(f"the excitation {name!r} has no setting {key!r} (accepted: {', '.join(accepted)})")
    return kind(**given)
