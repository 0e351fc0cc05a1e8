"""Stepped sines with zoom, and multi-point dwells (force appropriation)."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from vlab.errors import BadExperiment
from vlab.lab.broadband import Banded
from vlab.signals import Array

MAX_STEPS = 100_000
"""MAX_STEPS [1]: largest number of frequencies of a sweep; more indicates a typing error."""


@dataclass(frozen=True, kw_only=True)
class SteppedSine(Banded):
    """Phase-continuous sine with stepped frequency [peak level].

    Parameters
    ----------
    steps : int
        Number of frequencies, evenly spaced over the band.
    dwell_s : float
        Duration of each step [s]. After half of it, the transient at a resonance is exp(-pi zeta f dwell_s).
    least_cycles : float
        Shortest step in cycles, even if `dwell_s` is shorter.
    zoom_hz : tuple of float
        Frequencies of modes with finer steps around; steps of the band inside a zoom are dropped.
    zoom_width : float
        Half width of a zoom relative to its frequency.
    zoom_steps : int
        Number of frequencies in each zoom.
    zoom_dwell_s : float
        Duration of each zoom step [s]; 0 for `dwell_s`.
    zoom_widths, zoom_dwells_s : tuple of float
        Half width and duration of a step of each zoom, in place of the common ones.
    """

    steps: int = 20
    dwell_s: float = 3.0
    least_cycles: float = 10.0
    zoom_hz: tuple[float, ...] = ()
    zoom_width: float = 0.03
    zoom_steps: int = 11
    zoom_dwell_s: float = 0.0
    zoom_widths: tuple[float, ...] = ()
    zoom_dwells_s: tuple[float, ...] = ()
    freq: Array = field(init=False, repr=False, compare=False)
    duration: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps < 1 or not self.dwell_s > 0 or min(self.zoom_dwell_s, self.least_cycles) < 0:
            raise BadExperiment(f"{self.steps} steps of {self.dwell_s} s make no stepped sine")
        for name in ("zoom_widths", "zoom_dwells_s"):
            if getattr(self, name) and len(getattr(self, name)) != len(self.zoom_hz):
                raise BadExperiment(f"{name} has {len(getattr(self, name))} numbers for {len(self.zoom_hz)} zooms")
        if not all(0 < width < 0.5 for width in self.zoom_widths) or not all(s > 0 for s in self.zoom_dwells_s):
            raise BadExperiment("zoom_widths must lie between 0 and 0.5, and zoom_dwells_s above 0")
        outside = [f for f in self.zoom_hz if not self.low_hz <= f <= self.high_hz]
        if outside or not 0 < self.zoom_width < 0.5 or self.zoom_steps < 2:
            what = f"{outside[0]:g} Hz" if outside else f"{self.zoom_steps} steps of +-{self.zoom_width:g}"
            raise BadExperiment(
                f"a zoom of {what} cannot be made; accepted: frequencies from {self.low_hz:g} to {self.high_hz:g} Hz, at "
                "least 2 steps, a relative half width between 0 and 0.5"
            )
        if self.steps + self.zoom_steps * len(self.zoom_hz) > MAX_STEPS:
            raise BadExperiment(f"more than {MAX_STEPS} frequencies; accepted: fewer steps")
        freq, asked = self._schedule()
        object.__setattr__(self, "freq", freq)
        object.__setattr__(self, "duration", np.maximum(asked, self.least_cycles / freq))

    def _schedule(self) -> tuple[Array, Array]:
        """Return ascending frequencies [Hz] and asked durations of their steps [s]."""
        coarse = np.linspace(self.low_hz, self.high_hz, self.steps)
        widths = self.zoom_widths or (self.zoom_width,) * len(self.zoom_hz)
        dwells = self.zoom_dwells_s or (self.zoom_dwell_s or self.dwell_s,) * len(self.zoom_hz)
        zooms = list(zip(self.zoom_hz, widths, dwells, strict=True))
        inside = [np.abs(coarse - f) <= width * f for f, width, _ in zooms]
        coarse = coarse[~np.any(inside, axis=0)] if inside else coarse
        fine = [np.linspace(f - width * f, f + width * f, self.zoom_steps) for f, width, _ in zooms]
        freq = np.concatenate([coarse, *fine])
        asked = np.concatenate(
            [np.full(coarse.size, self.dwell_s), *(np.full(self.zoom_steps, seconds) for _, _, seconds in zooms)]
        )
        freq, first = np.unique(freq, return_index=True)
        return freq, asked[first]

    @property
    def seconds(self) -> float:
        """Duration of the whole sweep [s]."""
        return float(self.duration.sum())

    @property
    def period_s(self) -> None:
        """None: a stepped sine runs once."""

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""
        return {"signal": "stepped", "step_hz": self.freq.tolist(), "step_s": self.duration.tolist()}

    def sample(self, time: Array) -> Array:
        """Return the signal.

        After the last step the signal stays at its frequency.

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
        begin = np.concatenate([[0.0], np.cumsum(self.duration)[:-1]])
        step = np.clip(np.searchsorted(begin, t, side="right") - 1, 0, self.freq.size - 1)
        begun = np.concatenate([[0.0], np.cumsum(self.freq[:-1] * self.duration[:-1])])
        return np.asarray(self.level * np.sin(2 * np.pi * (begun[step] + self.freq[step] * (t - begin[step]))))


@dataclass(frozen=True, kw_only=True)
class Dwell:
    """One sine at several actuators [peak level].

    Force appropriation: in-phase or opposed forces hold one mode at its natural frequency [1]_. All displacements are
    then in quadrature with the forces. `vlab.modal.appropriation` finds frequency and forces from frequency responses.
    After the forces stop, the mode decays alone and the decay gives its damping.

    Parameters
    ----------
    level : float
        Peak of the largest force.
    hz : float
        Frequency [Hz].
    forces : tuple of float
        Force ratios, one an actuator in order; negative for opposition.
    drive_s : float
        Stop time of the forces, rounded up to the end of a cycle [s]; 0 for no stop.

    References
    ----------
    .. [1] D. J. Ewins, Modal Testing: Theory, Practice and Application, 2nd ed., Research Studies Press, 2000.
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
        """None: analysis starts at steady state, see `vlab.modal.dwell`."""

    @property
    def stop_s(self) -> float:
        """Stop time of the forces [s]; infinity without a stop."""
        return float(np.ceil(self.drive_s * self.hz - 1e-9) / self.hz) if self.drive_s else np.inf

    @property
    def facts(self) -> dict[str, Any]:
        """Signal description for the recording."""
        return {"signal": "dwell", "dwell_hz": self.hz} | ({"drive_s": self.stop_s} if self.drive_s else {})

    def sample(self, time: Array) -> Array:
        """Return the forces at times [s], (n_times, n_actuators)."""
        t = np.asarray(time, dtype=float)
        pattern = np.array(self.forces) / np.abs(self.forces).max()
        sine = np.where(t < self.stop_s, np.sin(2 * np.pi * self.hz * t), 0.0)
        return np.asarray(self.level * sine[:, None] * pattern)
