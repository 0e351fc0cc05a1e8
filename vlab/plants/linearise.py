"""Linearisation of a MuJoCo model about its equilibrium."""

from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadStructure
from vlab.fe.second_order import SecondOrderModel
from vlab.signals import Array

POSITION_STEP = 1e-5
"""POSITION_STEP [m or rad]: step of the central differences. Truncation is 1e-10, rounding 1e-11 of the forces'
scale."""


def linearise(model: Any, qpos: Array | None = None) -> SecondOrderModel:
    """Return M, C and K of a MuJoCo model at rest.

    M is MuJoCo's inertia matrix. K and C are central differences of all smooth forces: gravity, springs, tendons,
    dampers, and servos at zero command. Joints with quaternions are perturbed in their tangent space.

    Parameters
    ----------
    model : object
        Compiled model.
    qpos : (nq,) array or None
        Equilibrium configuration; the model's initial one by default.

    Returns
    -------
    SecondOrderModel
        M, symmetric C and symmetric K, (nv, nv) each.

    Raises
    ------
    BadStructure
        Residual forces act at the configuration, or equality constraints couple coordinates.
    """
    check_free(model)
    data = mujoco.MjData(model)
    rest = model.qpos0.copy() if qpos is None else np.array(qpos, dtype=float)
    data.qpos[:] = rest
    mujoco.mj_forward(model, data)
    left = _force(data)
    scale = np.abs(data.qfrc_bias).max() + np.abs(data.qfrc_passive).max()
    if np.abs(left).max() > 1e-6 * scale + 1e-9:
        worst = int(np.abs(left).argmax())
        raise BadStructure(
            f"the configuration is no equilibrium: {left[worst]:.3g} is left over at degree of freedom {worst} "
            f"({_dof_name(model, worst)}); settle the model first"
        )
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    K, C = np.zeros_like(M), np.zeros_like(M)
    unit = np.zeros(model.nv)
    for i in range(model.nv):
        unit[:] = 0
        unit[i] = 1.0
        forces = []
        for sign in (1.0, -1.0):
            data.qpos[:] = rest
            mujoco.mj_integratePos(model, data.qpos, unit, sign * POSITION_STEP)
            mujoco.mj_forward(model, data)
            forces.append(_force(data))
        K[:, i] = (forces[1] - forces[0]) / (2 * POSITION_STEP)
        data.qpos[:] = rest
        forces = []
        for sign in (1.0, -1.0):
            data.qvel[:] = sign * POSITION_STEP * unit
            mujoco.mj_forward(model, data)
            forces.append(_force(data))
        data.qvel[:] = 0
        C[:, i] = (forces[1] - forces[0]) / (2 * POSITION_STEP)
    names = tuple(_dof_name(model, i) for i in range(model.nv))
    return SecondOrderModel(M=M, C=(C + C.T) / 2, K=(K + K.T) / 2, coordinates=names)


def check_free(model: Any) -> None:
    """Refuse equality constraints.

    Their forces are no function of position and velocity alone.

    Parameters
    ----------
    model : object
        Compiled MuJoCo model.

    Raises
    ------
    BadStructure
        The model has active equality constraints.
    """
    active = np.flatnonzero(model.eq_active0)
    if active.size:
        name = model.equality(int(active[0])).name or f"number {active[0]}"
        raise BadStructure(
            f"the equality constraint {name!r} ties coordinates together, which has no linearisation here; accepted: "
            "joint equalities with a linear polynomial; tie them by one, or by a tendon of high stiffness"
        )


def _force(data: Any) -> Array:
    return np.array(data.qfrc_smooth)  # passive, bias and actuator forces with zero controls


def _dof_name(model: Any, dof: int) -> str:
    joint = model.joint(model.dof_jntid[dof])
    first = int(joint.dofadr[0])
    several = joint.type[0] in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL)
    return f"{joint.name or f'joint{joint.id}'}" + (f":{dof - first}" if several else "")
