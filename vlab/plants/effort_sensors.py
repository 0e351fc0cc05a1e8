"""Effort sensors: readings of the forces of actuators."""

from typing import Any

import mujoco
import numpy as np

from vlab.signals import Array


def effort_rows(model: Any) -> Array:
    """Return the sensor values per generalised force of the actuators.

    An ``actuatorfrc`` sensor reads the scalar force of one actuator, a ``jointactuatorfrc`` sensor the generalised force of
    all actuators on a joint. A drive in parallel with another is read by the minimum-norm share of the generalised force.
    Transmissions are taken at the reference configuration; those of joints and fixed tendons are constant.

    Parameters
    ----------
    model : MjModel
        Compiled model.

    Returns
    -------
    (nsensordata, nv) array
        Reading of every sensor value [1 or 1/m]. Zero for sensors of other kinds.
    """
    out = np.zeros((int(model.nsensordata), int(model.nv)))
    of_actuator = np.flatnonzero(model.sensor_type == int(mujoco.mjtSensor.mjSENS_ACTUATORFRC))
    of_joint = np.flatnonzero(model.sensor_type == int(mujoco.mjtSensor.mjSENS_JOINTACTFRC))
    if of_actuator.size:
        share = np.linalg.pinv(_moments(model).T)  # actuator forces per generalised force
        out[model.sensor_adr[of_actuator]] = share[model.sensor_objid[of_actuator]]
    for sensor in of_joint:
        out[model.sensor_adr[sensor], model.jnt_dofadr[model.sensor_objid[sensor]]] = 1.0
    return out


def _moments(model: Any) -> Array:
    """Return moment arms (nu, nv) of the actuators at the reference configuration."""
    data, out = mujoco.MjData(model), np.zeros((int(model.nu), int(model.nv)))
    mujoco.mj_fwdPosition(model, data)
    mujoco.mju_sparse2dense(out, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
    return out
