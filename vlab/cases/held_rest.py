"""Rest of joints that dry friction holds.

Dry friction holds a joint anywhere within a band about its equilibrium, so the readings tell where the joint rests. The band
reaches as far as the friction over the stiffness. A joint without stiffness rests anywhere under every model, and starts alike.
"""

from collections.abc import Mapping

import mujoco
import numpy as np

from vlab.cases.replay_bench import State
from vlab.physics.running import AtPort
from vlab.plants.base import Plant
from vlab.signals import Array

PROBE = 1e-4
"""PROBE [rad or m]: displacement for the stiffness of a joint. Raising it averages over nonlinear springs."""


def friction_of_joints(plant: Plant) -> dict[int, float]:
    """Return the dry friction on every joint that friction holds.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.

    Returns
    -------
    dict of int to float
        Largest force [N or N m] by degree of freedom: MuJoCo's friction losses and attached laws of friction and micro-slip.
    """
    held = {int(dof): float(plant.model.dof_frictionloss[dof]) for dof in np.flatnonzero(plant.model.dof_frictionloss)}
    slips = [a for a in plant.physics if isinstance(a, AtPort) and a.effect.traits.is_slip]
    if slips:
        data = plant.new_data()
        for slip in slips:
            force = sum(float(slip.values[p.name]) for p in slip.effect.parameters if p.unit == "N")
            row = slip.port.row(data)
            for dof in np.flatnonzero(row):
                held[int(dof)] = held.get(int(dof), 0.0) + abs(float(row[dof])) * force
    return held


def held_rest(plant: Plant, rest: State, deviations: Mapping[int, float]) -> State:
    """Return the rest, with the first readings of held joints.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    rest : State
        Equilibrium of the plant.
    deviations : mapping of int to float
        First readings from the equilibrium of the measured joints, by degree of freedom.

    Returns
    -------
    State
        State; every joint stands at most at the end of its band.
    """
    friction = {dof: force for dof, force in friction_of_joints(plant).items() if dof in deviations}
    if not friction:
        return rest
    qpos, model = rest.qpos.copy(), plant.model
    for dof, force in friction.items():
        k = _stiffness(plant, rest, dof)
        if k > 0.0:
            qpos[model.jnt_qposadr[model.dof_jntid[dof]]] += float(np.clip(deviations[dof], -force / k, force / k))
    return State(qpos, rest.qvel)


def _stiffness(plant: Plant, rest: State, dof: int) -> float:
    """Return a joint's stiffness, its servo included [N/m or N m/rad]."""
    model, data = plant.model, plant.new_data()
    forces: list[Array] = []
    for side in (-1.0, 1.0):
        data.qpos[:], data.qvel[:] = rest.qpos, 0.0
        data.qpos[model.jnt_qposadr[model.dof_jntid[dof]]] += side * PROBE
        mujoco.mj_forward(model, data)
        forces.append((data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias).copy())
    return float(forces[0][dof] - forces[1][dof]) / (2.0 * PROBE)
