"""Rest of joints that dry friction holds.

Dry friction holds a joint anywhere within a band about its equilibrium, so the readings tell where the joint rests. A start at the
equilibrium would be wrong by up to the friction over the stiffness.
"""

from collections.abc import Mapping

import numpy as np

from vlab.cases.channel_map import Run
from vlab.cases.replay_bench import State
from vlab.physics.running import AtPort
from vlab.plants.base import Plant
from vlab.signals import Array


def joints_held(plant: Plant) -> set[int]:
    """Return the degrees of freedom on which dry friction or micro-slip acts.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.

    Returns
    -------
    set of int
        Degrees of freedom, of MuJoCo's friction losses and of attached laws.
    """
    held = set(np.flatnonzero(plant.model.dof_frictionloss > 0).tolist())
    slips = [a for a in plant.physics if isinstance(a, AtPort) and a.effect.traits.is_slip]
    if slips:
        data = plant.new_data()
        for slip in slips:
            held |= set(np.flatnonzero(slip.port.row(data)).tolist())
    return held


def held_rest(plant: Plant, run: Run, rest: State, deviations: Mapping[int, Array]) -> State:
    """Return the state at rest, with the readings of joints that friction holds.

    Parameters
    ----------
    plant : Plant
        Plant with its effects.
    run : Run
        Recording that begins at rest.
    rest : State
        Equilibrium of the plant.
    deviations : mapping of int to (n,) array
        Readings from the equilibrium of the measured joints, by degree of freedom.

    Returns
    -------
    State
        State. A reading is the mean over the samples before a command changes.
    """
    held = joints_held(plant) & set(deviations)
    if not held:
        return rest
    still = _still_samples(run)
    qpos, model = rest.qpos.copy(), plant.model
    for dof in held:
        qpos[model.jnt_qposadr[model.dof_jntid[dof]]] += float(np.mean(deviations[dof][:still]))
    return State(qpos, rest.qvel)


def _still_samples(run: Run) -> int:
    """Return the number of samples before a command or force changes."""
    inputs = np.column_stack([run.measured[drive.channel] for drive in run.drives])
    changes = np.flatnonzero(np.any(inputs != inputs[0], axis=1))
    return int(changes[0]) if changes.size else len(inputs)
