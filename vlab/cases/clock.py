"""Integration steps of a replay that meet the recorded time stamps."""

from dataclasses import dataclass

import numpy as np

from vlab.cases.channel_map import Run
from vlab.errors import BadCase
from vlab.signals import Array, sample_period

MAX_STEPS, MAX_EACH = 100_000_000, 10_000
"""MAX_STEPS, MAX_EACH [steps]: longest run, about 8 min at 5 us a step, and mean number per sample."""


@dataclass(frozen=True)
class Clock:
    """Relation of integration steps, samples and steps of the law.

    Parameters
    ----------
    timestep : float
        Integration step [s], at most that of the plant.
    steps : int
        Integration steps between two readings.
    law_every : int
        Readings between two steps of the law.
    readings : int
        Number of readings of the recording.
    on_time : bool
        Whether every sample of the recording is a reading and needs no interpolation.
    """

    timestep: float
    steps: int
    law_every: int
    readings: int
    on_time: bool

    @property
    def times(self) -> Array:
        """Times of the readings from the start [s]."""
        return np.arange(self.readings) * (self.steps * self.timestep)

    @property
    def middles(self) -> Array:
        """Midpoints of the integration steps from the start [s]."""
        return (np.arange((self.readings - 1) * self.steps) + 0.5) * self.timestep


def plan_clock(timestep: float, run: Run) -> Clock:
    """Fit the integration step to samples and law.

    Parameters
    ----------
    timestep : float
        Integration step of the plant [s].
    run : Run
        Recording with its channel map.

    Returns
    -------
    Clock
        Integration step and numbers of steps.

    Raises
    ------
    BadCase
        The run would take more than `MAX_STEPS` steps, or more than `MAX_EACH` per sample.
    """
    time = run.measured.time - run.measured.time[0]
    sample = 1.0 / run.measured.rate if run.measured.is_uniform else None
    if sample is None:
        timestep = min(timestep, sample_period(time))
    law = None if run.law is None else 1.0 / run.law.rate_hz
    period, law_every, dense = sample or law, 1, sample is None
    if sample is not None and law is not None:
        if _is_whole(law / sample):
            law_every = round(law / sample)
        else:
            period, dense = law, not _is_whole(sample / law)
    steps = 1 if period is None else int(np.ceil(period / timestep - 1e-9))
    step = timestep if period is None else period / steps
    if dense:
        law_every, steps = steps, 1
    if time[-1] / step > MAX_STEPS:
        raise BadCase(
            f"{run.name}: {time[-1]:g} s at a step of {step:g} s are {time[-1] / step:.3g} steps; at most {MAX_STEPS} are run: is the "
            "time in seconds?"
        )
    each = time[-1] / step / (time.size - 1)
    if each > MAX_EACH:
        raise BadCase(
            f"{run.name}: samples that are {time[-1] / (time.size - 1):.3g} s apart on average take {each:.3g} steps of {step:g} s each; "
            f"at most {MAX_EACH} are run: is the time in seconds?"
        )
    block = steps * step
    readings = int(np.ceil(time[-1] / block - 1e-6)) + 1
    readings += -(readings - 1) % law_every
    on_time = bool(np.all(np.abs(time - np.rint(time / block) * block) <= 1e-4 * block))
    return Clock(step, steps, law_every, max(readings, 2), on_time)


def _is_whole(ratio: float) -> bool:
    return ratio > 0.5 and abs(ratio - round(ratio)) <= 1e-6 * ratio
