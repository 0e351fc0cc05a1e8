"""Runs of a case beside their simulation, by channel and band."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.checks.bands import Bands, bands
from vlab.cases.clock import plan_clock
from vlab.cases.simulate import simulate
from vlab.errors import BadCase, Diverged
from vlab.parallel import side_by_side
from vlab.plants.base import Plant
from vlab.signals import Array, Recording

FEWEST = 3
"""FEWEST [1]: fewest bands from which a channel is assessed. At a single resonance any phase and size may be the
model's own error."""
UNEXPLAINED, EXPLAINED = 0.5, 0.3
"""UNEXPLAINED [1]: residual share of a channel, in most bands of a recording, from which corrections are tried.
EXPLAINED [1]: largest residual share of an accepted correction."""
MOST_STEPS = 40_000
"""MOST_STEPS [1]: integration steps of a run that the checks simulate at most."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Beside:
    """Runs with their simulation.

    Parameters
    ----------
    runs : tuple of Run
        Runs of the case.
    simulated : tuple of Recording or None
        Simulation of each run; None if the model diverges.
    channels : mapping of str to list of Bands
        Bands of every compared channel except commands, from the runs with at least `FEWEST` bands.
    """

    runs: tuple[Run, ...]
    simulated: tuple[Recording | None, ...]
    channels: Mapping[str, Sequence[Bands]]

    def left(self, channel: str) -> float:
        """Return the largest residual share of a channel.

        The maximum is over runs, see `Bands.left`. The result is 1 if the model diverges in a run, and 0 without bands.
        """
        if any(own is None for own in self.simulated):
            return 1.0
        return max((b.left() for b in self.channels[channel]), default=0.0)


def beside(plant: Plant, runs: Sequence[Run], simulated: Sequence[Recording | None] | None = None) -> Beside:
    """Simulate runs and collect their bands.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    runs : sequence of Run
        Recordings with mapped channels.
    simulated : sequence of Recording or None, optional
        Known simulations.

    Returns
    -------
    Beside
        Runs, simulations and bands.
    """
    if simulated is None:
        data = side_by_side(lambda run: _simulated(plant, run), runs)
        known = [None if own is None else replace(run.measured, data=own) for own, run in zip(data, runs, strict=True)]
    else:
        known = [_as_far(*pair) for pair in zip(simulated, runs, strict=True)]
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
    """Return the first part of a run.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    run : Run
        Recording with mapped channels.
    most_steps : int
        Largest number of integration steps of the part.

    Returns
    -------
    Run
        The whole run if short enough.
    """
    step, time = plan_clock(plant.timestep, run).timestep, run.measured.time
    if time[-1] - time[0] <= most_steps * step:
        return run
    part = run.measured.between(time[0], time[0] + most_steps * step)
    valid = None if run.valid is None else run.valid[: len(part)]
    return replace(run, measured=part, valid=valid) if len(part) >= 2 else run


def _as_far(simulated: Recording | None, run: Run) -> Recording | None:
    """Return a simulation cut to a run's length."""
    n = len(run.measured)
    return None if simulated is None else simulated.rows(slice(n))


def _simulated(plant: Plant, run: Run) -> Array | None:
    """Return the simulated channels, or None after a failure."""
    try:
        with np.errstate(all="ignore"):
            return simulate(plant, run).recording.data
    except (Diverged, BadCase):
        return None
