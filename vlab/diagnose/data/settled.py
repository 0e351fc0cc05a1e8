"""Periods whose responses differ by motion instead of noise.

The difference of two periods is noise only if the motion has settled. A lightly damped or free mode that a release or the
begin of the excitation moves does not settle within a short recording.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.simulate import simulate
from vlab.diagnose.data.repeats import repeat_noise
from vlab.errors import VlabError
from vlab.plants.base import Plant
from vlab.signals import Recording


def with_unsettled(runs: Sequence[Run], plant: Plant) -> tuple[Run, ...]:
    """Return runs that know their channels with unsettled periods.

    The simulated response of the nominal model has no noise, so the noise between its periods is motion. A channel is unsettled
    if this motion has more than half of the recorded power in any run. All runs have the same modes, and the nominal model
    predicts the motion of each only roughly.

    Parameters
    ----------
    runs : sequence of Run
        Runs that know their repeats.
    plant : Plant
        Plant of the nominal model.

    Returns
    -------
    tuple of Run
        Runs with `Run.unsettled`. A run that stays as it is keeps its known noise.
    """
    found = tuple(dict.fromkeys(name for run in runs for name in _unsettled(run, plant)))
    return tuple(run if run.unsettled == found else replace(run, unsettled=found) for run in runs)


def _unsettled(run: Run, plant: Plant) -> tuple[str, ...]:
    """Return the channels whose periods differ by motion."""
    found = {c.channel: repeat_noise(run, c.channel) for c in run.compared if c.actuator is None}
    recorded = {name: noise.rms() for name, noise in found.items() if noise is not None and noise.of == "periods"}
    if not recorded:
        return ()
    try:
        simulated = simulate(plant, run).recording
    except VlabError:  # without a response the recorded periods stand
        return ()
    if len(simulated) != len(run.measured):
        return ()
    clean = replace(run, measured=_with(run.measured, simulated), before=None)
    moved = {name: repeat_noise(clean, name) for name in recorded}
    return tuple(
        name for name, noise in moved.items() if noise is not None and 2.0 * noise.rms() ** 2 > recorded[name] ** 2
    )


def _with(measured: Recording, simulated: Recording) -> Recording:
    """Return a recording with the simulated channels."""
    columns = [simulated[name] if name in simulated.names else measured[name] for name in measured.names]
    return replace(measured, data=np.column_stack(columns))
