"""Actuator states along given commands."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True)
class Lag:
    """Low-pass or integral state of an actuator.

    Parameters
    ----------
    address : int
        Index of the state in ``data.act``.
    control : int
        Index of the command in ``data.ctrl``.
    time_constant : float
        Time constant [s]; infinite for an integral.
    """

    address: int
    control: int
    time_constant: float

    def of_change(self, change: Array, h: Array) -> Array:
        """Return the state's change from a command change.

        Parameters
        ----------
        change : (n, ...) array
            Change of the commands.
        h : (n, ...) array
            Sample intervals [s].

        Returns
        -------
        (n, ...) array
            Change of the state.
        """
        out = np.zeros_like(change)
        is_integral = np.isinf(self.time_constant)
        for k in range(len(change) - 1):
            step = h[k] if is_integral else -np.expm1(-h[k] / self.time_constant)
            out[k + 1] = out[k] + step * (change[k] - (0.0 if is_integral else out[k]))
        return out


def lags_of(plant: Plant) -> dict[int, Lag]:
    """Return the low-pass and integral actuator states.

    Parameters
    ----------
    plant : Plant
        Plant.

    Returns
    -------
    dict of int to Lag
        Dynamics by actuator.
    """
    model, out = plant.model, {}
    filters = (int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT))
    for i, actuator in enumerate(plant.actuators):
        for control in actuator.controls[:1]:
            kind, address = int(model.actuator_dyntype[control]), int(model.actuator_actadr[control])
            if address >= 0 and kind in (*filters, int(mujoco.mjtDyn.mjDYN_INTEGRATOR)):
                constant = float(model.actuator_dynprm[control, 0]) if kind in filters else np.inf
                out[i] = Lag(address=address, control=control, time_constant=max(constant, 1e-12))
    return out


def actuator_states(plant: Plant, u: Array, h: Array) -> Array:
    """Return the actuator states along held commands.

    First-order states are exact: a Runge-Kutta step would delay the state by half a step.

    Parameters
    ----------
    plant : Plant
        Plant.
    u : (n, n_actuators) array
        Commands.
    h : (n,) array
        Sample intervals [s].

    Returns
    -------
    (n, na) array
        States.
    """
    lags, model, start = lags_of(plant), plant.model, plant.new_data()
    out = np.zeros((len(u), int(model.na))) + start.act
    for i, lag in lags.items():
        control = plant.control_matrix[lag.control, i] * u[:, i]
        rest = 0.0 if np.isinf(lag.time_constant) else start.act[lag.address]
        out[:, lag.address] += lag.of_change(control - rest, h)
    if len(lags) == model.na:
        return out
    known = [lag.address for lag in lags.values()]
    integrated = _integrated(plant, u, h)
    integrated[:, known] = out[:, known]
    return integrated


def _integrated(plant: Plant, u: Array, h: Array) -> Array:
    """Return actuator states of any dynamics, by MuJoCo."""
    model, start = copy.copy(plant.model), plant.new_data()
    data = mujoco.MjData(model)
    out = np.zeros((len(u), int(model.na)))
    data.act[:] = start.act
    for k in range(len(u)):
        out[k] = data.act
        count = max(1, int(np.ceil(h[k] / plant.timestep - 1e-9)))
        model.opt.timestep = h[k] / count
        for _ in range(count):
            data.qpos[:], data.qvel[:] = start.qpos, 0.0
            data.ctrl[:] = plant.control_matrix @ u[k]
            mujoco.mj_step(model, data)
    return out
