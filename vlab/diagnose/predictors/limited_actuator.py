"""Forces of limited actuators along a motion.

A servo at its force limit does not respond to small changes of its command, so the derivative by the command vanishes
there. A command that comes later or slower may leave the limit. The force at both commands is known in closed form,
because MuJoCo's affine actuators are linear in command, length and rate between their limits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from vlab.plants.base import Plant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitedActuator:
    """Affine actuator with limits along one motion.

    Parameters
    ----------
    gain, bias : (n,) array
        Force is gain times control plus bias, between the limits.
    moment : (n, nv) array
        Generalised force per unit force.
    unit : float
        Control per unit command.
    control : (low, high)
        Limits of the control.
    force : (low, high)
        Limits of the force.
    """

    gain: Array
    bias: Array
    moment: Array
    unit: float
    control: tuple[float, float]
    force: tuple[float, float]

    def change(self, u: Array, change: Array) -> Array:
        """Return the force's change under a changed command.

        Parameters
        ----------
        u : (n,) array
            Commands.
        change : (n, k) array
            Changes of the commands.

        Returns
        -------
        (n, k) array
            Changes of the force.
        """
        return self._force(u[:, None] + change) - self._force(u[:, None])

    def _force(self, u: Array) -> Array:
        control = np.clip(self.unit * u, *self.control)
        return np.clip(self.gain[:, None] * control + self.bias[:, None], *self.force)


def limited_actuator(plant: Plant, actuator: int, q: Array, v: Array) -> LimitedActuator | None:
    """Return an affine actuator with limits along a motion.

    Parameters
    ----------
    plant : Plant
        Plant.
    actuator : int
        Index of the actuator.
    q, v : (n, nq), (n, nv) array
        Configurations and velocities.

    Returns
    -------
    LimitedActuator or None
        None without limits, with dynamics, or with another law than MuJoCo's affine one.
    """
    model, controls = plant.model, plant.actuators[actuator].controls
    if len(controls) != 1:
        return None
    c = controls[0]
    limits = _limits(model, c)
    is_affine = (
        int(model.actuator_dyntype[c]) == int(mujoco.mjtDyn.mjDYN_NONE)
        and int(model.actuator_gaintype[c]) in (int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtGain.mjGAIN_AFFINE))
        and int(model.actuator_biastype[c]) in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE))
    )
    if not is_affine or not np.any(np.isfinite(limits)):
        return None
    length, rate, moment = _transmission(model, c, q, v)
    gain, bias = model.actuator_gainprm[c], model.actuator_biasprm[c]
    gain_varies = int(model.actuator_gaintype[c]) == int(mujoco.mjtGain.mjGAIN_AFFINE)
    has_bias = int(model.actuator_biastype[c]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    of_gain = gain[:3] * np.array([True, gain_varies, gain_varies])
    of_bias = bias[:3] * has_bias
    state = np.stack([np.ones(len(q)), length, rate])
    return LimitedActuator(
        gain=of_gain @ state,
        bias=of_bias @ state,
        moment=moment,
        unit=float(plant.control_matrix[c, actuator]),
        control=limits[0],
        force=limits[1],
    )


def _limits(model: object, c: int) -> Sequence[tuple[float, float]]:
    """Return the limits of control and force; infinite without one."""
    out = []
    for is_limited, span in (
        (model.actuator_ctrllimited[c], model.actuator_ctrlrange[c]),  # type: ignore[attr-defined]
        (model.actuator_forcelimited[c], model.actuator_forcerange[c]),  # type: ignore[attr-defined]
    ):
        out.append((float(span[0]), float(span[1])) if is_limited else (-np.inf, np.inf))
    return out


def _transmission(model: object, c: int, q: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return an actuator's length (n,), rate (n,) and moment (n, nv)."""
    data = mujoco.MjData(model)
    length, rate = np.zeros(len(q)), np.zeros(len(q))
    nu, nv = model.nu, model.nv  # type: ignore[attr-defined]
    moments, moment = np.zeros((nu, nv)), np.zeros((len(q), nv))
    for k in range(len(q)):
        data.qpos[:], data.qvel[:] = q[k], v[k]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mju_sparse2dense(
            moments, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind
        )
        moment[k], length[k] = moments[c], data.actuator_length[c]
        rate[k] = moments[c] @ v[k]
    return length, rate, moment
