"""Nonlinear elements of a MuJoCo model as laws of the catalogue.

A linearisation at rest omits dry friction, polynomial springs and dampers, slack bands, and the yield of springs. For
responses of known level each such element is a law at the port of its joint or tendon.
"""

from collections.abc import Iterator
from typing import NamedTuple

import mujoco
import numpy as np

from vlab.physics.effect import Effect
from vlab.physics.port_memory import PlasticSet
from vlab.physics.port_nonlinear import CoulombFriction, CubicStiffness, QuadraticDrag, QuadraticStiffness, Stop
from vlab.plants.base import Plant
from vlab.plants.mjcf import MjcfPlant

SAME = 1e-6
"""SAME [1]: relative asymmetry up to which a slack band is centred on rest; raising it accepts slanted bands."""


class NativeLaw(NamedTuple):
    """A law that a MuJoCo element stands for."""

    effect: Effect
    place: str
    values: dict[str, float]


def native_laws(plant: Plant) -> list[NativeLaw]:
    """Return the nonlinear elements of a plant's MuJoCo model as laws.

    Parameters
    ----------
    plant : Plant
        Plant; only one of a user's MJCF model has such elements.

    Returns
    -------
    list of NativeLaw
        Laws at ports. A spring that yields appears as the loss of its spring beyond the yield.
    """
    return list(_laws(plant)) if isinstance(plant, MjcfPlant) else []


def _laws(plant: MjcfPlant) -> Iterator[NativeLaw]:
    model = plant.model
    off = model.opt.disableflags & (mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)
    for i in range(model.njnt):
        place = f"joint:{model.joint(i).name}"
        if place not in plant.ports:
            continue
        dof = int(model.jnt_dofadr[i])
        friction = 0.0 if off else float(model.dof_frictionloss[dof])
        yield from _numbers(place, friction, model.jnt_stiffnesspoly[i], model.dof_dampingpoly[dof])
    for i in range(model.ntendon):
        place = f"tendon:{model.tendon(i).name}"
        if place not in plant.ports:
            continue
        friction = 0.0 if off else float(model.tendon_frictionloss[i])
        yield from _numbers(place, friction, model.tendon_stiffnesspoly[i], model.tendon_dampingpoly[i])
        yield from _springs(plant, place, i)


def _numbers(place: str, friction: float, stiffness: np.ndarray, damping: np.ndarray) -> Iterator[NativeLaw]:
    if friction:
        yield NativeLaw(CoulombFriction(), place, {"force": friction})
    if stiffness[0]:
        yield NativeLaw(QuadraticStiffness(), place, {"k2": float(stiffness[0])})
    if stiffness[1]:
        yield NativeLaw(CubicStiffness(), place, {"k3": float(stiffness[1])})
    if damping[0]:
        yield NativeLaw(QuadraticDrag(), place, {"coefficient": float(damping[0])})


def _springs(plant: MjcfPlant, place: str, index: int) -> Iterator[NativeLaw]:
    model, stiffness = plant.model, float(plant.model.tendon_stiffness[index])
    low, high = (float(x) for x in model.tendon_lengthspring[index])
    rest = float(plant.port(place).position(plant.new_data()))
    below, above = rest - low, high - rest
    if stiffness > 0 and below > 0 and abs(above - below) <= SAME * below:
        yield NativeLaw(Stop(), place, {"stiffness": stiffness, "gap": below})
    width = float(np.ravel(model.tendon_springyield[index])[0])
    if stiffness > 0 and width > 0:
        yield NativeLaw(PlasticSet(), place, {"stiffness": stiffness, "yield": width})
