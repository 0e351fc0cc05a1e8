"""Actuators with a state of their own: what reaches their gain is not the command but what it has done to the state."""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True)
class Lag:
    """The state of an actuator: a low-pass of first order, or an integral, of its command.

    Parameters
    ----------
    address : int
        Of the state in ``data.act``.
    control : int
        Of the command in ``data.ctrl``.
    time_constant : float
        [s]; infinite for an integral.
    """

    address: int
    control: int
    time_constant: float

    def of_change(self, change: Array, h: Array) -> Array:
        """Return by how much the state differs at samples where its commands differ by `change` (n, ...), held for h (n, ...)."""
        out = np.zeros_like(change)
        is_integral = np.isinf(self.time_constant)
        for k in range(len(change) - 1):
            step = h[k] if is_integral else -np.expm1(-h[k] / self.time_constant)
            out[k + 1] = out[k] + step * (change[k] - (0.0 if is_integral else out[k]))
        return out


def lags_of(plant: Plant) -> dict[int, Lag]:
    """Return the actuators of a plant that have a state, by their index."""
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
    """Return the states of actuators along commands u (n, n_actuators) that are held for h (n,); (n, na).

    Those of first order are exact: a step of Runge and Kutta's method would leave a filter late by half of it.
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
    """Return the same by MuJoCo's own steps, the plant held at rest: for dynamics of other kinds."""
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
