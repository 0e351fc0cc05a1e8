"""Starts of laws that remember the motion before the first compared sample.

A compared part may begin in motion, as the held-out rest of one recording. The readings there give positions and velocities, but
not the memory of a law: an attached oscillator, a hysteresis, commands on their way. A run from the start of the file drives that
memory. The two starts are rivals: the one that follows the first samples better counts, on the samples that any start is estimated
from.
"""

from dataclasses import replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.physics.attached import AtActuator
from vlab.physics.running import AtPort
from vlab.plants.base import Plant
from vlab.signals import Recording, strung_together


def remembers(plant: Plant) -> bool:
    """Return whether a law of the plant remembers earlier motion or commands.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.

    Returns
    -------
    bool
        True for a port law with states, and for an actuator's law with memory. Laws of sensors settle by themselves.
    """
    return any(
        part.effect.has_state if isinstance(part, AtPort) else isinstance(part, AtActuator) and part.effect.has_memory
        for part in plant.physics
    )


def from_file_start(run: Run) -> Run | None:
    """Return a run with the samples before it.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.

    Returns
    -------
    Run or None
        Run from the first sample of the file; None if nothing stands before the run, or its start is stated.
    """
    if run.before is None or run.start is not None or run.law is not None:
        return None
    whole = strung_together([run.before, run.measured])
    return replace(run, measured=whole, before=None, valid=None)


def early_error(run: Run, simulated: Recording, window_s: float) -> float:
    """Return the mean-square error of the first samples over the variance.

    Parameters
    ----------
    run : Run
        Recording with mapped channels.
    simulated : Recording
        Simulation of the run.
    window_s : float
        Time from the first sample [s].

    Returns
    -------
    float
        Error [1].
    """
    early = run.measured.time - run.measured.time[0] <= window_s
    error = 0.0
    for c in run.compared:
        counts = early & run.measured.is_read(c.channel)
        spread = float(np.var(run.measured[c.channel]))
        if spread > 0.0 and np.any(counts):
            error += float(np.mean((simulated[c.channel] - run.measured[c.channel])[counts] ** 2)) / spread
    return error
