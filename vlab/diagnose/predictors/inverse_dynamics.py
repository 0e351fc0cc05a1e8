"""Generalised forces of uncertain parameters along recorded motion, by inverse dynamics."""

import copy
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from vlab.compilation import compiled
from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.predictors.step_jacobian import Stepper
from vlab.diagnose.predictors.trajectory import TimeVaryingSystem
from vlab.diagnose.settings import TRAJECTORY_SCORE_TEST
from vlab.plants.compiled_steps import IS_AVAILABLE, c_function
from vlab.plants.contacts import contact_count, first_contacts_fit
from vlab.signals import Array

_mj_inverse, _mj_actuation = c_function("mj_inverse"), c_function("mj_fwdActuation")


def changed_models(model: Any, parameter: Uncertain) -> list[Any]:
    """Return models with a parameter increased and decreased.

    Parameters
    ----------
    model : MjModel
        Model.
    parameter : Uncertain
        Uncertain parameter with its fields of the model.

    Returns
    -------
    list of MjModel
        Models at plus and minus a small log factor.
    """
    return [_changed(model, parameter, sign * TRAJECTORY_SCORE_TEST.change) for sign in (1.0, -1.0)]


def _changed(whole: Any, parameter: Uncertain, value: float) -> Any:
    model = copy.copy(whole)
    parameter.apply(model, value)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def middle_of_steps(stepper: Stepper, system: TimeVaryingSystem, h: Array) -> tuple[Array, Array, Array]:
    """Return the motion in the middle of steps.

    Parameters
    ----------
    stepper : Stepper
        Stepper of the plant.
    system : TimeVaryingSystem
        Linear system of a run, with its motion.
    h : (n,) array
        Steps [s].

    Returns
    -------
    q, v, a : array
        Configurations (n, nq), velocities and accelerations (n, nv).
    """
    q, v = system.motion.q, system.motion.v
    later = np.minimum(np.arange(1, len(v) + 1), len(v) - 1)
    if stepper.is_flat:
        middle = 0.5 * (q + q[later])
    else:
        pairs = zip(q, q[later], strict=True)
        middle = np.array([stepper.moved(a, 0.5 * stepper.between(a, b)) for a, b in pairs])
    return middle, 0.5 * (v + v[later]), (v[later] - v) / h[:, None]


def forces_of_change(pair: Sequence[Any], middle: tuple[Array, ...], stride: int) -> Array:
    """Return the generalised forces of a unit uncertain parameter.

    The forces are the decrease of inverse dynamics per log factor.

    Parameters
    ----------
    pair : sequence of MjModel
        Models from `changed_models`.
    middle : tuple of array
        Configurations, velocities, accelerations, controls and actuator states at mid-step.
    stride : int
        Sample stride; a spline interpolates between.

    Returns
    -------
    (n, nv) array
        Forces.
    """
    n = len(middle[0])
    at = np.unique(np.append(np.arange(0, n, stride), n - 1))
    part = [x[at] for x in middle]
    slope = (_inverse(pair[1], *part) - _inverse(pair[0], *part)) / (2 * TRAJECTORY_SCORE_TEST.change)
    return slope if stride == 1 or len(at) < 4 else np.asarray(CubicSpline(at, slope)(np.arange(n)))


def _inverse(model: Any, q: Array, v: Array, a: Array, control: Array, act: Array) -> Array:
    """Return missing generalised forces (n, nv), by inverse dynamics.

    MuJoCo's inverse dynamics leave the actuators out; the feedback of servos belongs to the model.
    """
    data, out = mujoco.MjData(model), np.zeros(a.shape)
    first = 0
    if IS_AVAILABLE and first_contacts_fit(model):
        motion = tuple(np.ascontiguousarray(x) for x in (q, v, a, control, act))
        views = (data.qpos, data.qvel, data.qacc, data.ctrl, data.act, data.qfrc_inverse, data.qfrc_actuator)
        first = _inverse_until_contact((model._address, data._address), motion, views, contact_count(data), out)
    for k in range(first, len(out)):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], v[k], a[k]
        data.ctrl[:], data.act[:] = control[k], act[k]
        mujoco.mj_inverse(model, data)
        mujoco.mj_fwdActuation(model, data)
        out[k] = data.qfrc_inverse - data.qfrc_actuator
    return out


@compiled(error_model="numpy")
def _inverse_until_contact(
    addresses: tuple[int, int],
    motion: tuple[Array, ...],
    views: tuple[Array, ...],
    contacts: Array,
    out: Array,
) -> int:  # pragma: no cover - compiled
    """Write missing forces up to the first contact.

    The sample of the contact is returned, or the number of samples. The memory of many contacts has no bound, and MuJoCo
    ends the process where memory runs out in compiled code.
    """
    model, data = addresses
    for k in range(len(out)):
        for i in range(5):
            for j in range(views[i].size):
                views[i][j] = motion[i][k, j]
        _mj_inverse(model, data)
        if contacts[0] > 0:
            return k
        _mj_actuation(model, data)
        for j in range(out.shape[1]):
            out[k, j] = views[5][j] - views[6][j]
    return len(out)
