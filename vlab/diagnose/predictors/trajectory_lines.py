"""Jacobian rows and coordinates of locations along recorded motion."""

from collections.abc import Sequence

import mujoco
import numpy as np

from vlab.diagnose.predictors.trajectory import TimeVaryingSystem, pad_and_stack
from vlab.plants.base import Plant, Port
from vlab.plants.mjcf import AXES
from vlab.signals import Array


class Lines:
    """Jacobian rows of a location along the motions of all runs.

    Parameters
    ----------
    rows : (k, n, n_runs, nv) array
        Rows of the location's coordinates at the samples.
    z : (k, n, n_runs) array
        Coordinates from rest.
    weight : (k,) array
        Gravity along the coordinates [m/s^2], where added mass has weight; otherwise 0.
    """

    def __init__(self, rows: Array, z: Array, weight: Array) -> None:
        self.rows, self.z, self.weight = rows, z, weight


def lines_along(plant: Plant, systems: Sequence[TimeVaryingSystem], port: Port, *, is_body: bool) -> Lines:
    """Return the rows and coordinates of a port along the motions.

    Parameters
    ----------
    plant : Plant
        Plant.
    systems : sequence of TimeVaryingSystem
        Linear systems of the runs, with their motions.
    port : Port
        Port.
    is_body : bool
        Whether the port is a body, whose added mass has weight.

    Returns
    -------
    Lines
        Rows, coordinates from rest and gravity.
    """
    model, ports = plant.model, (port, *port.more)
    at_rest = plant.new_data()
    rest = [p.position(at_rest) for p in ports]
    if all(p.is_constant for p in ports) and port.is_joint:
        address = int(model.jnt_qposadr[model.joint(port.name.partition(":")[2]).id])
        z = pad_and_stack([a.motion.q[:, address] - rest[0] for a in systems])
        return Lines(np.broadcast_to(port.row(at_rest), (1, *z.shape, model.nv)), z[None], np.zeros(1))
    rows, values = [], []
    for system in systems:
        own, z = _rows_and_coordinates(plant, ports, system)
        rows.append(own)
        values.append(z - rest)
    weight = np.array([model.opt.gravity[i] for i in range(len(AXES))]) if is_body else np.zeros(len(ports))
    return Lines(np.moveaxis(pad_and_stack(rows), 2, 0), np.moveaxis(pad_and_stack(values), 2, 0), weight)


def _rows_and_coordinates(plant: Plant, ports: Sequence[Port], system: TimeVaryingSystem) -> tuple[Array, Array]:
    """Return rows (n, k, nv) and coordinates (n, k) of ports."""
    model, data, n = plant.model, mujoco.MjData(plant.model), len(system.M)
    rows, z = np.zeros((n, len(ports), model.nv)), np.zeros((n, len(ports)))
    for k, q in enumerate(system.motion.q):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_tendon(model, data)
        for i, p in enumerate(ports):
            rows[k, i], z[k, i] = p.row(data), p.position(data)
    return rows, z
