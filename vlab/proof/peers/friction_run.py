"""Free runs of an arm on servos with load-dependent friction."""

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.clock import plan_clock
from vlab.cases.initial_state import InitialState, joint_of
from vlab.cases.replay_bench import at_timestep
from vlab.cases.replay_inputs import drives_of
from vlab.compilation import compiled
from vlab.physics.port_lines import STAGGERED
from vlab.plants.compiled_steps import IS_AVAILABLE, first_half, second_half
from vlab.plants.mjcf import MjcfPlant
from vlab.proof.peers.result import NotUsable, compared_names
from vlab.signals import Array

FRICTION = ("base", "load-motor", "load-outer", "stribeck", "stribeck-motor", "stribeck-outer", "square-motor",
            "square-outer", "speed", "power")  # fmt: skip
"""FRICTION: parameters of a joint's friction in the order of the columns of `run_with_friction`."""
NO_FRICTION = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 1.35)
"""NO_FRICTION: values without friction; speed [rad/s] and power [-] are the starts of the published models."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmRun:
    """Recording prepared for free runs.

    Parameters
    ----------
    run : Run
        Recording.
    plant : MjcfPlant
        Plant with the step of the recording.
    start : InitialState
        Initial state.
    controls : (n_steps, nu) array
        Commands of every step.
    steps : int
        Steps between two readings.
    readings : int
        Readings of the recording.
    channels : tuple of (int, int)
        Index and kind of every compared channel: degree of freedom with order 0 or 1, actuator with 2.
    """

    run: Run
    plant: MjcfPlant
    start: InitialState
    controls: Array
    steps: int
    readings: int
    channels: tuple[tuple[int, int], ...]


def prepared(plant: MjcfPlant, run: Run, start: InitialState) -> ArmRun:
    """Return a recording prepared for free runs.

    Parameters
    ----------
    plant : MjcfPlant
        Arm on position servos.
    run : Run
        Recording.
    start : InitialState
        Initial state.

    Returns
    -------
    ArmRun
        Prepared recording.

    Raises
    ------
    NotUsable
        The actuators are no position servos of single joints, or a channel is neither motion of a joint nor effort.
    """
    model = plant.model
    servos = [int(model.actuator_trntype[i]) == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_biasprm[i, 1] < 0
              for i in range(model.nu)]  # fmt: skip
    is_arm = model.nu == model.nv == model.njnt and all(servos)
    if not is_arm or not IS_AVAILABLE or model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4:
        raise NotUsable("for arms with a position servo in every joint")
    clock = plan_clock(plant.timestep, run)
    if not clock.on_time:
        raise NotUsable("for evenly sampled recordings")
    own = at_timestep(plant, clock.timestep)
    assert isinstance(own, MjcfPlant)
    compared = {c.channel: c for c in run.compared}
    return ArmRun(
        run=run,
        plant=own,
        start=start,
        controls=np.ascontiguousarray(drives_of(run, clock, own, stood=start.how != "rest")[0] @ own.control_matrix.T),
        steps=clock.steps,
        readings=clock.readings,
        channels=tuple(_channel(own, compared[name]) for name in compared_names(run)),
    )


def _channel(plant: MjcfPlant, compared: Any) -> tuple[int, int]:
    joint = joint_of(plant, compared)
    if joint is not None:
        return joint
    if compared.sensor is not None:
        model, addresses = plant.model, plant.sensors[compared.sensor].addresses
        found = np.flatnonzero(model.sensor_adr == addresses[0])
        if len(addresses) == 1 and model.sensor_type[found[0]] == mujoco.mjtSensor.mjSENS_ACTUATORFRC:
            return int(model.sensor_objid[found[0]]), 2
    raise NotUsable("for channels of joints and efforts of servos")


def run_with_friction(own: ArmRun, model: Any, friction: Array, delay_s: float = 0.0) -> Array:
    """Return the channels of a free run with friction everywhere.

    The friction limit of a joint follows from motor moment, outer moment and speed before each step [1]_. MuJoCo's own
    dry friction then holds or brakes the joint up to the limit.

    Parameters
    ----------
    own : ArmRun
        Prepared recording.
    model : object
        Compiled model with the step of the recording; its dry friction is overwritten.
    friction : (nv, 10) array
        Parameters of `FRICTION` [SI].
    delay_s : float
        Delay of all commands [s].

    Returns
    -------
    (n_readings, n_channels) array
        Channels.

    References
    ----------
    .. [1] M. Duclusaud, G. Passault, V. Padois, O. Ly, "Extended friction models for the physics simulation of servo
       actuators", arXiv:2410.08650, 2024.
    """
    data = mujoco.MjData(model)
    ahead = model.opt.timestep / 2 if model.opt.integrator in STAGGERED else 0.0
    data.qpos[:] = own.start.qpos if own.start.how != "rest" else own.plant.rest
    data.qvel[:] = own.start.qvel
    data.qpos[:] += ahead * data.qvel
    mujoco.mj_forward(model, data)
    controls = own.controls
    if delay_s > 0.0:
        time = np.arange(len(controls)) * model.opt.timestep
        controls = np.column_stack([np.interp(time - delay_s, time, column) for column in controls.T])
    q, v = np.zeros((own.readings, model.nv)), np.zeros((own.readings, model.nv))
    views = (data.qpos, data.qvel, data.ctrl, data.qfrc_actuator, data.qfrc_bias, model.dof_frictionloss)
    _march(model._address, data._address, views, np.ascontiguousarray(controls), friction, own.steps, q, v)
    q -= ahead * v
    present = np.concatenate([controls[:1], controls[own.steps - 1 :: own.steps]])
    efforts = np.clip(
        model.actuator_gainprm[:, 0] * present + model.actuator_biasprm[:, 1] * q + model.actuator_biasprm[:, 2] * v,
        *np.where(model.actuator_forcelimited[:, None], model.actuator_forcerange, [-np.inf, np.inf]).T,
    )
    return np.column_stack([(q, v, efforts)[kind][:, index] for index, kind in own.channels])


@compiled(error_model="numpy")
def _march(
    model: int,
    data: int,
    views: tuple[Array, Array, Array, Array, Array, Array],
    controls: Array,
    friction: Array,
    steps: int,
    q: Array,
    v: Array,
) -> None:  # pragma: no cover - compiled
    qpos, qvel, ctrl, motor, outer, limit = views
    q[0], v[0] = qpos, qvel
    for k in range(len(controls)):
        for j in range(len(limit)):
            f = friction[j]
            pushed, held = motor[j], outer[j]
            size = f[0] + abs(held * f[2] - pushed * f[1])
            if f[3] + f[4] + f[5] + f[6] + f[7] > 0.0:
                slow = np.exp(-((abs(qvel[j]) / f[8]) ** f[9]))
                more = f[3] + abs(held * f[5] - pushed * f[4])
                if held * pushed < 0.0:  # the gear is driven by the stronger side
                    more += f[7] * held**2 if abs(held) < abs(pushed) else f[6] * pushed**2
                size += slow * more
            limit[j] = size
        ctrl[:] = controls[k]
        first_half(model, data)
        second_half(model, data)
        if (k + 1) % steps == 0:
            q[(k + 1) // steps], v[(k + 1) // steps] = qpos, qvel
