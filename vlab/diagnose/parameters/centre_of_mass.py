"""Uncertain centres of mass of an MJCF model's bodies."""

import copy
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np

from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.signals import Array

CENTRE_OF_MASS = "centre-of-mass"
"""Kind of a shift of a body's centre of mass over its radius of gyration."""


def centres_of_mass(model: Any, bodies: Mapping[str, int], given: Mapping[str, float]) -> list[Uncertain]:
    """Return the stated uncertain shifts of the centres of mass.

    Where density varies linearly over a body, its centre of mass moves by the relative error times the radius of gyration.

    Parameters
    ----------
    model : Any
        Compiled model.
    bodies : mapping of str to int
        Numbers of the bodies with mass, by name.
    given : mapping
        ``[model.uncertain]``, with standard deviations over the radius of gyration.

    Returns
    -------
    list of Uncertain
        Shifts along the axes of every body that change the dynamics.
    """
    stated = {name: given.get(f"{name}:{CENTRE_OF_MASS}", given.get(CENTRE_OF_MASS)) for name in bodies}
    return [shift for name, sd in stated.items() if sd for shift in _shifts(model, bodies[name], name, sd)]


def _shifts(model: Any, body: int, name: str, sd: float) -> list[Uncertain]:
    """Return the shifts of a body's centre of mass along its axes.

    The square of a radius is the second moment of mass along the axis over the mass.
    """
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    principal = np.maximum(0.5 * model.body_inertia[body].sum() - model.body_inertia[body], 0.0)
    moments = np.square(turn.reshape(3, 3)) @ principal / model.body_mass[body]
    out = []
    for k, (axis, moment) in enumerate(zip("xyz", moments, strict=True)):
        shift = Uncertain(
            name=f"{name}:{CENTRE_OF_MASS}:{axis}",
            kind=CENTRE_OF_MASS,
            sd=sd,
            shifted=((("body_ipos", (body, k)), float(np.sqrt(moment))),),
        )
        if _changes_dynamics(model, shift):
            out.append(shift)
    return out


def _changes_dynamics(model: Any, parameter: Uncertain) -> bool:
    """Return whether a parameter changes the inverse dynamics of a random motion.

    Inverse dynamics are analytic in the motion, so a change that vanishes at a random motion vanishes everywhere.
    """
    changed = copy.copy(model)
    parameter.apply(changed, 1.0)
    q, moves = model.qpos0.copy(), np.random.default_rng(0).standard_normal((3, model.nv))
    mujoco.mj_integratePos(model, q, moves[0], 1.0)
    before, after = (_inverse(m, q, moves[1], moves[2]) for m in (model, changed))
    return not np.allclose(before, after, rtol=0.0, atol=1e-9 * float(np.abs(before).max()))


def _inverse(model: Any, q: Array, v: Array, a: Array) -> Array:
    """Return the generalised forces (nv,) of a motion, without constraints."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    out = np.zeros(model.nv)
    data.qacc[:] = a
    mujoco.mj_rne(model, data, 1, out)
    return out
