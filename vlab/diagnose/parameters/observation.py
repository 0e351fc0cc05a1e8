"""Linear observation model of the channels near rest.

The channels are y = at_q q + at_v v + at_a a + rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from vlab.cases.channel_map import Compared
from vlab.cases.replay_bench import Bench, State
from vlab.diagnose.settings import OBSERVATION
from vlab.plants.base import Plant, without_limits
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class ChannelRows:
    """Channels per generalised position, velocity and acceleration.

    Parameters
    ----------
    at_q, at_v, at_a : (n_channels, nv) array
        Output rows about rest.
    rest : (n_channels,) array
        Channel values at rest.
    """

    at_q: Array
    at_v: Array
    at_a: Array
    rest: Array

    def onto(self, shapes: Array) -> "ChannelRows":
        """Return the rows per coordinate p with q = shapes p."""
        return ChannelRows(at_q=self.at_q @ shapes, at_v=self.at_v @ shapes, at_a=self.at_a @ shapes, rest=self.rest)


def channel_rows(plant: Plant, compared: Sequence[Compared]) -> ChannelRows:
    """Compute the channels' rows by central differences.

    Acceleration rows come first, from generalised forces at rest. The accelerations' part is subtracted from the
    position and velocity differences, so the maps are independent of stiffness and damping.

    Parameters
    ----------
    plant : Plant
        Plant.
    compared : sequence of Compared
        Channels.

    Returns
    -------
    ChannelRows
        Rows (n_channels, nv).
    """
    bench = Bench(plant)
    model, channels = plant.model, tuple(compared)
    nv = model.nv
    rest, rest_qacc = _evaluate(bench, channels, np.zeros(nv), np.zeros(nv), np.zeros(nv))
    inertia = np.zeros((nv, nv))
    mujoco.mj_fullM(model, bench.data, inertia)
    zero = np.zeros(nv)
    at_a = np.zeros((len(channels), nv))
    for j in range(nv):
        high = _evaluate(bench, channels, zero, zero, inertia[:, j])
        low = _evaluate(bench, channels, zero, zero, -inertia[:, j])
        moved = (high[1] - low[1])[j]
        at_a[:, j] = (high[0] - low[0]) / (moved if moved else 2.0)
    maps = []
    for which in range(2):
        out = np.zeros((len(channels), nv))
        for j in range(nv):
            step = np.zeros(nv)
            step[j] = OBSERVATION.step
            moves = [(sign * step, zero) if which == 0 else (zero, sign * step) for sign in (1.0, -1.0)]
            pair = [_evaluate(bench, channels, move, velocity, zero) for move, velocity in moves]
            change = (pair[0][0] - pair[1][0]) - at_a @ (pair[0][1] - pair[1][1])
            out[:, j] = change / (2 * OBSERVATION.step)
        maps.append(_clean(out))
    return ChannelRows(at_q=maps[0], at_v=maps[1], at_a=_clean(at_a), rest=rest - at_a @ rest_qacc)


def _clean(rows: Array) -> Array:
    """Set values at rounding level to zero, relative to a channel's largest."""
    largest = np.abs(rows).max(axis=1, keepdims=True, initial=0.0)
    return np.where(np.abs(rows) > 1e-9 * np.maximum(largest, 1e-6), rows, 0.0)


def _evaluate(
    bench: Bench,
    compared: tuple[Compared, ...],
    move: Array,
    velocity: Array,
    applied: Array,
    ctrl: Array | None = None,
) -> tuple[Array, Array]:
    qpos = bench.rest.qpos.copy()
    mujoco.mj_integratePos(bench.model, qpos, move, 1.0)
    bench.start(State(qpos, velocity))
    bench.data.qfrc_applied[:] = applied
    bench.look(np.zeros(bench.model.nu) if ctrl is None else ctrl)
    return bench.values(compared, bench.sensors()), bench.acceleration.copy()


def within_limits(plant: Plant, actuator: int, commands: Array) -> Array:
    """Clip commands at the plant's own limits.

    Servo force limits and joint limits depend on the motion: only MuJoCo's simulation includes them.

    Parameters
    ----------
    plant : Plant
        Plant.
    actuator : int
        Index of the actuator.
    commands : (n,) array
        Commands.

    Returns
    -------
    (n,) array
        Clipped commands.
    """
    model, out = plant.model, commands
    for control in plant.actuators[actuator].controls:
        share = plant.control_matrix[control, actuator]
        limits = []
        if model.actuator_ctrllimited[control] and not model.opt.disableflags & int(
            mujoco.mjtDisableBit.mjDSBL_CLAMPCTRL
        ):
            limits.append(model.actuator_ctrlrange[control])
        gain = model.actuator_gainprm[control, 0]
        is_motor = (
            model.actuator_gaintype[control] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[control] == mujoco.mjtBias.mjBIAS_NONE
            and model.actuator_dyntype[control] == mujoco.mjtDyn.mjDYN_NONE
        )
        if model.actuator_forcelimited[control] and is_motor and gain:
            limits.append(np.sort(model.actuator_forcerange[control] / gain))
        for low, high in limits if share else ():
            out = np.clip(out, *np.sort([low / share, high / share]))
    return np.asarray(out)


def command_feedthrough(plant: Plant, compared: Sequence[Compared]) -> Array:
    """Return the channels' response to commands without acceleration.

    Parameters
    ----------
    plant : Plant
        Plant.
    compared : sequence of Compared
        Channels.

    Returns
    -------
    (n_channels, n_actuators) array
        Feedthrough [SI per unit command].
    """
    plant = without_limits(plant)
    bench, channels = Bench(plant), tuple(compared)
    forces, still = plant.actuator_forces(), np.zeros(plant.model.nv)
    out = np.zeros((len(channels), len(plant.actuators)))
    for i in range(len(plant.actuators)):
        column = plant.control_matrix[:, i]
        high, low = (
            _evaluate(bench, channels, still, still, -sign * forces[:, i], sign * column)[0] for sign in (1.0, -1.0)
        )
        out[:, i] = (high - low) / 2
    return _clean(out)
