"""The runs of a case beside what its model makes of their inputs, by channel and by bands of frequency."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.checks.bands import Bands, bands
from vlab.cases.replay import plan_clock
from vlab.cases.simulate import simulate
from vlab.errors import BadCase, Diverged
from vlab.plants.base import Plant
from vlab.signals import Recording

FEWEST = 3
"""Bands below which a recording says nothing of a channel: at one resonance any phase and size may be the model's own error."""
UNEXPLAINED, EXPLAINED = 0.5, 0.3
"""Recordings are read otherwise where the model leaves the first share of a channel in most bands of some recording, and leaves no more than
the second of it then."""
MOST_STEPS = 40_000
"""Integration steps of a run that are simulated for the checks: the first seconds of it, or all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Beside:
    """Runs with what a model does.

    Parameters
    ----------
    runs : tuple of Run
    simulated : tuple of Recording or None
        None where the model cannot follow.
    channels : mapping of str to list of Bands
        Of every compared channel, commands aside: the runs of which at least `FEWEST` bands say something of it.
    """

    runs: tuple[Run, ...]
    simulated: tuple[Recording | None, ...]
    channels: Mapping[str, Sequence[Bands]]

    def left(self, channel: str) -> float:
        """Return what a simulated channel leaves in the run of which it leaves most, see `Bands.left`; all where the model cannot follow a
        run, nothing where no run says anything of the channel."""
        if any(own is None for own in self.simulated):
            return 1.0
        return max((b.left() for b in self.channels[channel]), default=0.0)


def beside(plant: Plant, runs: Sequence[Run], simulated: Sequence[Recording | None] | None = None) -> Beside:
    """Put runs beside what a plant does under their inputs.

    Parameters
    ----------
    simulated : sequence of Recording or None, optional
        Where that is known already.
    """
    known = (
        [_simulated(plant, run) for run in runs]
        if simulated is None
        else [_as_far(*pair) for pair in zip(simulated, runs, strict=True)]
    )
    channels: dict[str, list[Bands]] = {}
    for run, own in zip(runs, known, strict=True):
        for name in (c.channel for c in run.compared if c.actuator is None):
            of_channel = channels.setdefault(name, [])
            if own is None:
                continue
            found = bands(run.measured.time, run.measured[name], own[name])
            if len(found) >= FEWEST:
                of_channel.append(found)
    return Beside(runs=tuple(runs), simulated=tuple(known), channels=channels)


def first_seconds(plant: Plant, run: Run, most_steps: int = MOST_STEPS) -> Run:
    """Return the first part of a run that takes at most so many steps of its plant."""
    step, time = plan_clock(plant.timestep, run).timestep, run.measured.time
    if time[-1] - time[0] <= most_steps * step:
        return run
    part = run.measured.between(time[0], time[0] + most_steps * step)
    valid = None if run.valid is None else run.valid[: len(part)]
    return replace(run, measured=part, valid=valid) if len(part) >= 2 else run


def _as_far(simulated: Recording | None, run: Run) -> Recording | None:
    """Return a simulation of a longer run as far as a run goes."""
    n = len(run.measured)
    return None if simulated is None else replace(simulated, time=simulated.time[:n], data=simulated.data[:n])


def _simulated(plant: Plant, run: Run) -> Recording | None:
    try:
        with np.errstate(all="ignore"):
            return simulate(plant, run).recording
    except (Diverged, BadCase):
        return None
