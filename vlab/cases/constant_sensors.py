"""Sensors that read constant sums of the joints' positions or velocities.

Joint sensors and sensors of fixed tendons need no kinematics: on a grillage, kinematics is nine tenths of a reading.
"""

from typing import Any, NamedTuple

import mujoco
import numpy as np

from vlab.signals import Array

JOINT = {int(mujoco.mjtSensor.mjSENS_JOINTPOS): 0, int(mujoco.mjtSensor.mjSENS_JOINTVEL): 1}
TENDON = {int(mujoco.mjtSensor.mjSENS_TENDONPOS): 0, int(mujoco.mjtSensor.mjSENS_TENDONVEL): 1}
PLAIN = (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE))


class ConstantSensors(NamedTuple):
    """Sensor values as sums over joints.

    Parameters
    ----------
    address, joint : (n,) array of int
        Sensor value and degree of freedom of every summand.
    share : (n,) array
        Factor of every summand.
    order : (n,) array of int
        0 for a position, 1 for a velocity.
    """

    address: Array
    joint: Array
    share: Array
    order: Array

    @classmethod
    def of(cls, model: Any, addresses: set[int]) -> "ConstantSensors":
        """Return the sums of some sensor values.

        Parameters
        ----------
        model : MjModel
            Compiled model.
        addresses : set of int
            Sensor values in use.

        Returns
        -------
        ConstantSensors
            Sums; none where a value in use is no such sum.
        """
        rows: list[tuple[int, int, float, int]] = []
        reads = not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_SENSOR)
        if reads and np.isin(model.jnt_type, PLAIN).all():  # a position is then one number per degree of freedom
            rows = [row for sensor in range(model.nsensor) for row in _summands(model, sensor) if row[0] in addresses]
        is_whole = bool(rows) and {row[0] for row in rows} == addresses
        address, joint, share, order = zip(*rows, strict=True) if is_whole else ((), (), (), ())
        return cls(np.array(address, int), np.array(joint, int), np.array(share, float), np.array(order, int))


def _summands(model: Any, sensor: int) -> list[tuple[int, int, float, int]]:
    """Return address, joint, share and order of a sensor's summands."""
    kind, element, address = (int(x[sensor]) for x in (model.sensor_type, model.sensor_objid, model.sensor_adr))
    if model.sensor_cutoff[sensor] != 0.0 or model.sensor_history[sensor].any():
        return []
    if kind in JOINT:
        return [(address, int(model.jnt_dofadr[element]), 1.0, JOINT[kind])]
    if kind not in TENDON:
        return []
    wraps = range(model.tendon_adr[element], model.tendon_adr[element] + model.tendon_num[element])
    if any(model.wrap_type[w] != int(mujoco.mjtWrap.mjWRAP_JOINT) for w in wraps):
        return []
    joints = ((int(model.jnt_dofadr[model.wrap_objid[w]]), float(model.wrap_prm[w])) for w in wraps)
    return [(address, joint, share, TENDON[kind]) for joint, share in joints]
