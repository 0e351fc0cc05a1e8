"""Sensors of a plant under given controls, in MuJoCo's own loop."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
from mujoco.rollout import Rollout

from vlab.plants.base import ONE_WAY, check_run
from vlab.signals import Array

FULL = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
"""FULL [-]: MuJoCo's state with everything that a step depends on."""
CHECK_EVERY = 500
"""CHECK_EVERY [steps]: integration steps between two checks for divergence, and between two reports of progress."""


def run_open_loop(
    model: Any, data: Any, controls: Array, present: Array, *, ahead: float, progress: Callable[[float], None]
) -> tuple[Array, Array]:
    """Simulate a model and read its sensors.

    Parameters
    ----------
    model : object
        Compiled MuJoCo model.
    data : object
        Initial state after `mj_forward`, overwritten.
    controls : ((n_readings - 1) * steps, nu) array
        Controls of every step.
    present : (n_readings, nu) array
        Controls at the readings.
    ahead : float
        Time by which positions are ahead of velocities in the state [s].
    progress : callable
        Receives the completed share of the run.

    Returns
    -------
    states : (n_readings, n_states) array
        States at the readings, positions moved back by `ahead`.
    sensors : (n_readings, nsensordata) array
        Sensor values there.

    Raises
    ------
    Diverged
        The state left the finite range or MuJoCo reset the run.
    """
    size = mujoco.mj_stateSize(model, FULL)
    count = len(present) - 1
    steps = len(controls) // max(count, 1)
    states = np.empty((count + 1, size))
    mujoco.mj_getState(model, data, states[0], FULL)
    part = max(CHECK_EVERY // max(steps, 1), 1)
    with Rollout(nthread=0) as rollout:
        for first in range(0, count, part):
            last = min(first + part, count)
            found, _ = rollout.rollout(
                model,
                [data],
                states[first],
                controls[first * steps : last * steps],
                initial_warmstart=data.qacc_warmstart.copy(),
            )
            states[first + 1 : last + 1] = found[0, steps - 1 :: steps]
            check_run(model, data, last * steps * model.opt.timestep)
            progress(last / count)
        if ahead:
            _move_back(model, states, ahead)
        _, sensors = rollout.rollout(model, [data], states, present[:, None])
    return states, np.asarray(sensors[:, 0])


def motion_of(model: Any, states: Array) -> tuple[Array, Array]:
    """Return positions (n, nq) and velocities (n, nv) as views of states."""
    return states[:, 1 : 1 + model.nq], states[:, 1 + model.nq : 1 + model.nq + model.nv]


def _move_back(model: Any, states: Array, ahead: float) -> None:
    """Move the positions of states back along their velocities, in place."""
    qpos, qvel = motion_of(model, states)
    if np.all(np.isin(model.jnt_type, ONE_WAY)):
        qpos -= ahead * qvel
        return
    for position, velocity in zip(qpos, qvel, strict=True):
        moved = position.copy()
        mujoco.mj_integratePos(model, moved, velocity.copy(), -ahead)
        position[:] = moved
