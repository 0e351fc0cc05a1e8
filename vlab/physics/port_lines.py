"""Port forces of a plant: lines, and constants of a run."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vlab.physics.attached import AtPort
from vlab.physics.effect import LinearPortEffect
from vlab.plants.base import Plant, Port
from vlab.plants.effort_sensors import effort_rows
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array

STAGGERED = (
    mujoco.mjtIntegrator.mjINT_EULER,
    mujoco.mjtIntegrator.mjINT_IMPLICIT,
    mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
)
"""Integrators with the position half a step ahead of the velocity. The position then belongs to the middle of the
beginning step."""
DAMPED = {mujoco.mjtIntegrator.mjINT_EULER: 0.0, mujoco.mjtIntegrator.mjINT_RK4: 0.5}
"""DAMPED [1]: share of a step's change of velocity on which the damping of actuators acts, by integrator; 1 for implicit
integrators."""


def command_of(plant: Plant, a: AtPort) -> tuple[int, int]:
    """Return what a law sees as its command.

    Parameters
    ----------
    plant : Plant
        Plant of the run.
    a : AtPort
        Effect at a port.

    Returns
    -------
    coil, state : int
        Index of the actuator, and address of the filter's state where a servo has one; -1 for none.
    """
    if a.coil is None:
        return -1, -1
    state = int(plant.model.actuator_actadr[plant.actuators[a.coil].controls[0]])
    return a.coil, state if a.effect.is_in_servo else -1


@dataclass(frozen=True, kw_only=True, eq=False)
class PortLines:
    """Lines along which effects act, in order of evaluation.

    Dry friction comes last, because sticking balances all remaining forces.

    Parameters
    ----------
    ports : sequence of Port
        Port of every line.
    rows : (n, nv) array
        Jacobian rows at rest.
    rest : (n,) array
        Positions at rest [m or rad].
    added, viscous, spring : (n,) array
        Mass with half a step of damping, damping and stiffness of the linear effects [SI].
    laws : sequence of (int, AtPort)
        Line and effect of every law that is not linear.
    in_drive : (n,) array of bool
        Whether a sensor of the actuator's force reads the line.
    damping : (nv,) array or None
        Implicit joint damping over a step [SI]; None where the integrator has none.
    is_fixed : bool
        Whether the inertia stays that of rest.
    is_staggered : bool
        Whether positions are half a step ahead of velocities.
    damped : float
        See `DAMPED`.
    efforts : (nsensordata, nv) array
        See `vlab.plants.effort_sensors.effort_rows`.
    """

    ports: tuple[Port, ...]
    rows: Array
    rest: Array
    added: Array
    viscous: Array
    spring: Array
    laws: tuple[tuple[int, AtPort], ...]
    in_drive: Array
    damping: Array | None
    is_fixed: bool
    is_staggered: bool
    damped: float
    efforts: Array

    @classmethod
    def of(cls, plant: Plant, attached: Sequence[AtPort], data: Any) -> "PortLines":
        """Return the lines of effects.

        Parameters
        ----------
        plant : Plant
            Plant of the run.
        attached : sequence of AtPort
            Effects in any order.
        data : MjData
            State at rest.

        Returns
        -------
        PortLines
            Lines.
        """
        model, h = plant.model, plant.timestep
        lines = [(a, port) for a in attached for port in (a.port, *a.port.more)]
        lines.sort(key=lambda line: (line[0].effect.is_force, line[0].effect.traits.is_dry_friction))
        n = len(lines)
        linear, laws = np.zeros((3, n)), []
        for i, (a, _) in enumerate(lines):
            if isinstance(a.effect, LinearPortEffect):
                mass, damping, stiffness = a.effect.impedance(a.values, a.stiffness)
                linear[:, i] = mass + damping * h / 2, damping, stiffness
            else:
                laws.append((i, a))
        is_explicit = model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER and (
            model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        )
        is_implicit = model.opt.integrator in STAGGERED and not is_explicit
        return cls(
            ports=tuple(port for _, port in lines),
            rows=np.array([port.row(data) for _, port in lines]).reshape(n, model.nv),
            rest=np.array([port.position(data) for _, port in lines]),
            added=linear[0],
            viscous=linear[1],
            spring=linear[2],
            laws=tuple(laws),
            in_drive=np.array([a.effect.acts_in_drive for a, _ in lines], dtype=bool),
            damping=h * model.dof_damping if is_implicit and np.any(model.dof_damping) else None,
            is_fixed=not isinstance(
                plant, MjcfPlant
            ),  # a structure's inertia varies only with the square of its rotations
            is_staggered=model.opt.integrator in STAGGERED,
            damped=DAMPED.get(model.opt.integrator, 1.0),
            efforts=effort_rows(model),
        )
