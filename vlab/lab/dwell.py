"""Sines one frequency at a time: incremental sweeps with zoom, and multi-point dwells (force appropriation)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vlab.errors import BadExperiment
from vlab.lab.broadband import Banded
from vlab.signals import Array

MAX_STEPS = 100_000
"""Frequencies of one sweep; more are a slip of the keyboard."""


@dataclass(frozen=True, kw_only=True)
class SteppedSine(Banded):
    """A sine that dwells at one frequency after another, phase-continuous [peak level]: an incremental sine sweep.

    Parameters
    ----------
    steps : int
        Number of frequencies, evenly spaced over the band.
    dwell_s : float
        Time at each. What is left of the transient at a resonance after half of it is exp(-pi zeta f dwell_s).
    least_cycles : float
        A step lasts at least so many cycles, whatever `dwell_s` says.
    zoom_hz : tuple of float
        Modes around which finer steps lie; the steps of the band within a zoom give way to them.
    zoom_width : float
        Half the width of a zoom relative to its frequency.
    zoom_steps : int
        Number of frequencies in each zoom.
    zoom_dwell_s : float
        Time at each of those; 0 for `dwell_s`.
    """

    steps: int = 20
    dwell_s: float = 3.0
    least_cycles: float = 10.0
    zoom_hz: tuple[float, ...] = ()
    zoom_width: float = 0.03
    zoom_steps: int = 11
    zoom_dwell_s: float = 0.0
    freq: Array = field(init=False, repr=False, compare=False)
    duration: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps < 1 or not self.dwell_s > 0 or min(self.zoom_dwell_s, self.least_cycles) < 0:
            raise BadExperiment(f"{self.steps} steps of {self.dwell_s} s make no stepped sine")
        outside = [f for f in self.zoom_hz if not self.low_hz <= f <= self.high_hz]
        if outside or not 0 < self.zoom_width < 0.5 or self.zoom_steps < 2:
            what = f"{outside[0]:g} Hz" if outside else f"{self.zoom_steps} steps of +-{self.zoom_width:g}"
            raise BadExperiment(
                f"a zoom of {what} cannot be made; accepted: frequencies from {self.low_hz:g} to {self.high_hz:g} Hz, at "
                "least 2 steps, a relative half width between 0 and 0.5"
            )
        if self.steps + self.zoom_steps * len(self.zoom_hz) > MAX_STEPS:
            raise BadExperiment(f"more than {MAX_STEPS} frequencies; accepted: fewer steps")
        freq, is_fine = self._schedule()
        object.__setattr__(self, "freq", freq)
        asked = np.where(is_fine, self.zoom_dwell_s or self.dwell_s, self.dwell_s)
        object.__setattr__(self, "duration", np.maximum(asked, self.least_cycles / freq))

    def _schedule(self) -> tuple[Array, Array]:
        """Return the frequencies in rising order and which of them belong to a zoom."""
        coarse = np.linspace(self.low_hz, self.high_hz, self.steps)
        fine = [np.linspace(f - self.zoom_width * f, f + self.zoom_width * f, self.zoom_steps) for f in self.zoom_hz]
        inside = [np.abs(coarse - f) <= self.zoom_width * f for f in self.zoom_hz]
        coarse = coarse[~np.any(inside, axis=0)] if inside else coarse
        zoomed = np.concatenate(fine) if fine else np.zeros(0)
        freq = np.concatenate([coarse, zoomed])
        is_fine = np.arange(freq.size) >= coarse.size
        freq, first = np.unique(freq, return_index=True)
        return freq, is_fine[first]

    @property
    def seconds(self) -> float:
        """Time that the whole sweep takes."""
        return float(self.duration.sum())

    @property
    def period_s(self) -> None:
        """A stepped sine runs once."""

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "stepped", "step_hz": self.freq.tolist(), "step_s": self.duration.tolist()}

    def sample(self, time: Array) -> Array:
        """Return the signal at times [s]; after the last step it stays there."""
        t = np.asarray(time, dtype=float)
        begin = np.concatenate([[0.0], np.cumsum(self.duration)[:-1]])
        step = np.clip(np.searchsorted(begin, t, side="right") - 1, 0, self.freq.size - 1)
        begun = np.concatenate([[0.0], np.cumsum(self.freq[:-1] * self.duration[:-1])])
        return np.asarray(self.level * np.sin(2 * np.pi * (begun[step] + self.freq[step] * (t - begin[step]))))


@dataclass(frozen=True, kw_only=True)
class Dwell:
    """One sine at several actuators at once, in phase or in opposition [peak level]: force appropriation.

    The forces hold one mode in its natural motion at its natural frequency, where all displacements are in quadrature
    with the forces; `vlab.modal.appropriation` finds frequency and forces from frequency responses. When the forces stop
    the mode decays alone, and its damping can be read from the decay.

    Parameters
    ----------
    level : float
        Peak of the largest of the forces.
    hz : float
        Frequency [Hz].
    forces : tuple of float
        One number for each actuator, in their order; only their ratios count, negative for opposition.
    drive_s : float
        When the forces stop, at the next end of a cycle [s]; 0: they do not.
    """

    level: float = 0.1
    hz: float = 1.0
    forces: tuple[float, ...] = (1.0,)
    drive_s: float = 0.0

    def __post_init__(self) -> None:
        values = [self.level, self.hz, self.drive_s, *self.forces]
        if not np.isfinite(values).all() or self.level < 0 or self.hz <= 0 or self.drive_s < 0:
            raise BadExperiment(
                f"a dwell of level {self.level}, {self.hz} Hz, {self.drive_s} s cannot be driven; accepted: level and time "
                "from 0, a frequency above 0"
            )
        if not self.forces or not np.any(self.forces):
            raise BadExperiment("a dwell without any force excites nothing; give one number for each actuator")

    @property
    def period_s(self) -> None:
        """A dwell is looked at from when it is steady; see `vlab.modal.dwell`."""

    @property
    def stop_s(self) -> float:
        """When the forces stop [s]; infinity if they do not."""
        return float(np.ceil(self.drive_s * self.hz - 1e-9) / self.hz) if self.drive_s else np.inf

    @property
    def facts(self) -> dict[str, Any]:
        """What a recording notes of the signal."""
        return {"signal": "dwell", "dwell_hz": self.hz} | ({"drive_s": self.stop_s} if self.drive_s else {})

    def sample(self, time: Array) -> Array:
        """Return the forces at times [s], (n_times, n_actuators)."""
        t = np.asarray(time, dtype=float)
        pattern = np.array(self.forces) / np.abs(self.forces).max()
        sine = np.where(t < self.stop_s, np.sin(2 * np.pi * self.hz * t), 0.0)
        return np.asarray(self.level * sine[:, None] * pattern)
