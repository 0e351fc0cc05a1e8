"""Whitened nuisance columns of the score test: parameters and sensor offsets."""

from collections.abc import Callable, Sequence

import numpy as np

from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.predictors.innovations import Group
from vlab.signals import Array

Through = Callable[[Group, Array | None, Array | None], Array]
"""Function of filtered runs, forces and channel additions that returns the innovations' response."""


def columns_of_changes(
    reduced_model: ReducedModel,
    groups: Sequence[Group],
    forces: Callable[[Group], Array],
    readings: Callable[[Group], Array],
    through: Through,
) -> Array:
    """Return the columns of the uncertain parameters.

    Parameters
    ----------
    reduced_model : ReducedModel
        Reduced model with its changes.
    groups : sequence of Group
        Filtered runs.
    forces : callable
        Forces (n, n_runs, m, n_changes) of a batch per unit parameter.
    readings : callable
        Direct readings (n, n_runs, p, n_changes) of a batch per unit parameter.
    through : callable
        Innovations' response to forces and channel additions.

    Returns
    -------
    (rows, n_changes) array
        Columns.
    """
    blocks, changes = [], reduced_model.changes
    sensors = [(i, change.sensor) for i, change in enumerate(changes) if change.sensor is not None]
    for group in groups:
        reading = readings(group)
        for i, sensor in sensors:
            reading[..., sensor, i] = group.y[..., sensor]
        for shift in reduced_model.shifts:
            p, v = np.split(group.smoothed.x, 2, axis=-1)
            reading[..., shift.sensor, shift.by] = p @ shift.at_q + v @ shift.at_v
        left = through(group, forces(group), reading)
        for i, sensor in sensors:  # of its own sample only the prediction counts, not the innovation
            left[..., sensor, i] -= group.e[..., sensor]
        blocks.append(group.rows(left))
    return np.concatenate(blocks)


def modal_forces_of_changes(group: Group, reduced_model: ReducedModel, forces: Array, theta: Array) -> Array:
    """Return modal forces per unit uncertain parameter.

    Parameters
    ----------
    group : Group
        Filtered runs.
    reduced_model : ReducedModel
        Reduced model with its changes.
    forces : (m, n_actuators) array
        Modal forces per unit command.
    theta : (n_changes,) array
        Log factors.

    Returns
    -------
    (n, n_runs, m, n_changes) array
        Forces along the filtered motion.
    """
    p, v, a = group.motion
    modal = np.zeros((*p.shape, len(reduced_model.changes)))
    slopes = reduced_model.slopes(theta)
    for i, change in enumerate(reduced_model.changes):
        for matrix, motion in zip(slopes[i], (a, v, p), strict=True):
            if matrix is not None:
                modal[..., i] -= motion @ matrix.T
        if change.actuator is not None:
            modal[..., i] += group.u[..., change.actuator, None] * forces[:, change.actuator]
    actuators = reduced_model.gains(theta[None])[0][0]
    for shift in reduced_model.coil_shifts:
        modal[..., shift.by] += actuators[shift.actuator] * group.u[..., shift.actuator, None] * shift.force
    return modal


def columns_of_offsets(groups: Sequence[Group], through: Through) -> Array:
    """Return the columns of the sensor offsets.

    Parameters
    ----------
    groups : sequence of Group
        Filtered runs.
    through : callable
        Innovations' response to forces and channel additions.

    Returns
    -------
    (rows, n_channels) array
        Columns.
    """
    blocks = []
    for group in groups:
        reading = np.zeros((*group.y.shape, group.y.shape[2]))
        for i in range(group.y.shape[2]):
            reading[..., i, i] = 1.0
        blocks.append(group.rows(through(group, None, reading)))
    return np.concatenate(blocks)
