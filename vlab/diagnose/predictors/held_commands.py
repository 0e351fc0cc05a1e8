"""Commands that change within the sample intervals of a motion.

Held commands are stairs. A delayed or limited stair changes within an interval. The mean force over an interval gives the
change of momentum, but not the motion of a servo that settles within some intervals. The m equal parts of an interval
therefore have a force each. The deviations f_j from the mean move the state at the end of the interval by

    sum_j A^(m - 1 - j) G f_j,

with the state and input matrices A and G of a part.
"""

from collections.abc import Callable, Sequence

import numpy as np

from vlab.diagnose.predictors.step_jacobian import Stepper
from vlab.diagnose.predictors.trajectory import SystemBatch
from vlab.diagnose.predictors.trajectory_data import TrajectoryData
from vlab.diagnose.settings import TRAJECTORY
from vlab.physics.effect import ActuatorEffect
from vlab.signals import Array


def parts_of_interval(
    trajectories: Sequence[TrajectoryData], stepper: Stepper, actuator: int, effect: ActuatorEffect
) -> int:
    """Return the number of parts of an interval for an actuator's commands.

    Parameters
    ----------
    trajectories : sequence of TrajectoryData
        Runs.
    stepper : Stepper
        Stepped plant.
    actuator : int
        Index of the actuator.
    effect : ActuatorEffect
        Effect on its commands.

    Returns
    -------
    int
        `TRAJECTORY.fine`; 1 for commands that are no stairs, actuators with dynamics, and effects without memory or on the clock
        of the samples.
    """
    is_stepped = all(trajectory.is_stepped for trajectory in trajectories)
    changes_within = effect.has_memory and not effect.is_clocked
    return TRAJECTORY.fine if is_stepped and actuator not in stepper.lags and changes_within else 1


def changed_in_parts(follow: Callable[[Array], Array], command: Array, parts: int) -> Array:
    """Return the change of a command in the parts of every interval.

    Parameters
    ----------
    follow : callable
        Returns changed commands (n parts, ...) for commands (n parts, ...) of the parts.
    command : (n, ...) array
        Commands of the intervals.
    parts : int
        Parts of an interval.

    Returns
    -------
    (parts, n, ...) array
        Changes.
    """
    stairs = np.repeat(command, parts, axis=0)
    change = follow(stairs)
    return np.moveaxis(change.reshape(len(command), parts, *change.shape[1:]), 1, 0)


def over_intervals(stack: SystemBatch, unit: Array, forces: Sequence[Array]) -> tuple[Array, Array | None]:
    """Return the mean force of parts, and the motion by their deviations.

    Parameters
    ----------
    stack : SystemBatch
        Linear time-varying system.
    unit : (n, n_runs, nv) array
        Generalised force of a unit force.
    forces : sequence of (n, n_runs, k) array
        Forces of every part.

    Returns
    -------
    mean : (n, n_runs, nv, k) array
        Means of the generalised forces over the intervals.
    moved : (n, n_runs, 2 nv, k) array or None
        Changes of the state at the end of every interval; None for one part.
    """
    mean = np.asarray(sum(forces) / len(forces))
    whole = unit[..., None] * mean[..., None, :]
    if len(forces) == 1:
        return whole, None
    response = np.einsum("krab,krb->kra", stack.fine_G, unit)
    moved = np.zeros((*response.shape, mean.shape[-1]))
    for force in reversed(forces):
        moved += response[..., None] * (force - mean)[..., None, :]
        response = np.einsum("krab,krb->kra", stack.fine_A, response)
    return whole, moved
