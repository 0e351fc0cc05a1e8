"""States of a rig from its recordings, for regression on measured motion."""

from dataclasses import dataclass

import mujoco
import numpy as np
from scipy import signal

from vlab.cases.channel_map import Run
from vlab.cases.initial_state import joint_of
from vlab.plants.base import Plant
from vlab.proof.peers.result import NotUsable
from vlab.signals import Array

ORDER = 3
"""ORDER [-]: degree of the local polynomials whose derivatives are those of the states (Savitzky and Golay 1964)."""
LEAST_WINDOW = 5
"""LEAST_WINDOW [samples]: shortest window of a local polynomial."""
TURN, EQUAL = 0.3, 1e-9
"""TURN [rad or m]: displacement of every joint at which the mass matrix is compared with that at rest.
EQUAL [-]: largest relative change of a constant mass matrix."""


@dataclass(frozen=True, kw_only=True, eq=False)
class States:
    """Smoothed states of one recording.

    Parameters
    ----------
    q, v, a : (n, nv) array
        Positions, velocities, accelerations of the joints [SI].
    u : (n, n_inputs) array
        Recorded inputs.
    step_s : float
        Sample period [s].
    """

    q: Array
    v: Array
    a: Array
    u: Array
    step_s: float


def joint_channels(plant: Plant, run: Run) -> dict[int, tuple[str, int]]:
    """Return channel and order of every measured joint.

    Parameters
    ----------
    plant : Plant
        Plant.
    run : Run
        Recording.

    Returns
    -------
    dict
        Name of the channel and order of the derivative, by degree of freedom; a position before a velocity.

    Raises
    ------
    NotUsable
        A joint has neither a measured angle nor a measured velocity, or the inertia depends on the pose.
    """
    found: dict[int, tuple[str, int]] = {}
    for c in run.compared:
        joint = None if c.actuator is not None else joint_of(plant, c)
        if joint is not None and joint[1] < found.get(joint[0], ("", 2))[1]:
            found[joint[0]] = (c.channel, joint[1])
    if len(found) < plant.model.nv:
        raise NotUsable("not every state is measured")
    if not _has_constant_inertia(plant):
        raise NotUsable("the inertia of the model depends on its pose, which no term of the library has")
    return found


def _has_constant_inertia(plant: Plant) -> bool:
    """Return whether mass matrix and bias forces ignore the pose."""
    model, data, matrices, forces = plant.model, plant.new_data(), [], []
    for turn in (0.0, TURN):
        data.qpos[:] += turn
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        matrices.append(full)
        forces.append(data.qfrc_bias.copy())
    size = float(np.abs(matrices[0]).max())
    return bool(np.abs(matrices[1] - matrices[0]).max() <= EQUAL * size and np.ptp(forces, axis=0).max() <= EQUAL)


def states_of(run: Run, channels: dict[int, tuple[str, int]], window_s: float) -> States:
    """Return the smoothed states of a recording.

    A measured velocity is integrated from the start.

    Parameters
    ----------
    run : Run
        Recording.
    channels : dict
        Channels of `joint_channels`.
    window_s : float
        Window of the local polynomials [s].

    Returns
    -------
    States
        States.
    """
    rate = run.measured.rate
    window = max(LEAST_WINDOW, round(window_s * rate) | 1)

    def smooth(name: str, derivative: int) -> Array:
        return np.asarray(
            signal.savgol_filter(run.measured[name], window, ORDER, deriv=derivative, delta=1.0 / rate, mode="interp")
        )

    rows = []
    for dof in sorted(channels):
        name, order = channels[dof]
        own = [smooth(name, d) for d in range(3 - order)]
        rows.append([np.cumsum(own[0]) / rate, *own] if order else own)
    q, v, a = (np.array(series).T for series in zip(*rows, strict=True))
    u = np.column_stack([run.measured[d.channel] for d in run.drives])
    return States(q=q, v=v, a=a, u=u, step_s=1.0 / rate)
