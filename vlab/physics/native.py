"""Effects as MuJoCo elements: numbers of joints, tendons and bodies.

A polynomial spring or damper, armature and dry friction are numbers of the compiled model. A slider, a gap or a stop
needs an element of its own: a fixed tendon parallel to the joint. Only a newly compiled model can hold a new tendon, so
such effects go into the exported model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vlab.physics.effect import Effect, LinearPortEffect, Values
from vlab.physics.port_memory import IwanSlip
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array

Numbers = tuple[tuple[str, int, float], ...]
"""Additions to a model: quantity, power of displacement or velocity beyond the first, and amount."""

POLYNOMIALS: dict[str, Callable[[Values], Numbers]] = {
    "quadratic-drag": lambda p: (("damping", 1, p["coefficient"]),),
    "cubic-stiffness": lambda p: (("stiffness", 2, p["k3"]),),
    "quadratic-stiffness": lambda p: (("stiffness", 1, p["k2"]),),
    "quadratic-cubic-stiffness": lambda p: (("stiffness", 1, p["k2"]), ("stiffness", 2, p["k3"])),
    "coulomb-friction": lambda p: (("frictionloss", 0, p["force"]),),
}
"""Laws expressed by numbers of a joint or tendon, besides mass, damping and stiffness."""


@dataclass(frozen=True)
class Spring:
    """A spring parallel to a joint.

    Attributes: stiffness, slack band and yield deflection.
    """

    stiffness: float
    low: float = 0.0
    high: float = 0.0
    springyield: float = 0.0


FAR = 1e9
"""FAR [m]: bound of a side on which a spring is always slack."""


def _one_sided(p: Values) -> tuple[Spring, ...]:
    gap = abs(p["gap"])
    return (Spring(p["stiffness"], -FAR, gap) if p["gap"] >= 0 else Spring(p["stiffness"], -gap, FAR),)


SPRINGS: dict[str, Callable[[Values], tuple[Spring, ...]]] = {
    "jenkins-slip": lambda p: (Spring(p["force"] / p["slip"], springyield=p["slip"]),),
    "iwan-slip": lambda p: tuple(Spring(k, springyield=x) for k, x in IwanSlip.sliders(p)),
    "stop": lambda p: (Spring(p["stiffness"], -p["gap"], p["gap"]),),
    "one-sided-stiffness": _one_sided,
    "dead-band": lambda p: (Spring(-p["stiffness"]), Spring(p["stiffness"], -p["gap"], p["gap"])),
    "plastic-set": lambda p: (Spring(-p["stiffness"]), Spring(p["stiffness"], springyield=p["yield"])),
}
"""Laws expressed by springs beside a joint."""

_JOINT = {
    "stiffness": ("jnt_stiffness", "jnt_stiffnesspoly"),
    "damping": ("dof_damping", "dof_dampingpoly"),
    "armature": ("dof_armature", ""),
    "frictionloss": ("dof_frictionloss", ""),
}
_TENDON = {
    "stiffness": ("tendon_stiffness", "tendon_stiffnesspoly"),
    "damping": ("tendon_damping", "tendon_dampingpoly"),
    "armature": ("tendon_armature", ""),
    "frictionloss": ("tendon_frictionloss", ""),
}


def numbers(plant: MjcfPlant, effect: Effect, place: str, values: Values) -> Numbers | None:
    """Return an effect's additions to a joint, tendon or body.

    Parameters
    ----------
    plant : MjcfPlant
        Plant with a compiled model.
    effect : Effect
        Effect of the catalogue.
    place : str
        Place of the effect.
    values : Values
        Parameter values in SI.

    Returns
    -------
    Numbers or None
        Additions; None if the effect has no such form at the place.
    """
    kind, _, name = place.partition(":")
    if kind in ("body", "site") and place not in plant.ports:  # a point is a place here, one of its coordinates is not
        return (("mass", 0, values["mass"]),) if effect.name == "added-mass" else None
    if kind not in ("joint", "tendon") or place not in plant.ports:
        return None
    if isinstance(effect, LinearPortEffect):
        mass, damping, stiffness = effect.impedance(values, plant.own_stiffness(place))
        out: Numbers = (("armature", 0, mass), ("damping", 0, damping), ("stiffness", 0, stiffness))
    elif effect.name in POLYNOMIALS:
        out = POLYNOMIALS[effect.name](values)
    else:
        return None
    out = tuple((what, power, float(value)) for what, power, value in out if value != 0.0)
    return out if out and all(_fits(plant, kind, name, what) for what, _, _ in out) else None


HARD = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Solver parameters (impedance) of dry friction. MuJoCo's default is soft and lets a stuck joint creep. The time
constant of two steps makes friction stop a joint within one step."""


def _fits(plant: MjcfPlant, kind: str, name: str, what: str) -> bool:
    model = plant.model
    if what == "frictionloss":
        off = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS
        return not model.opt.disableflags & off
    i = getattr(model, kind)(name).id
    if what == "armature" and kind == "tendon":  # a tendon across trees would lose its off-diagonal terms
        return int(model.tendon_treenum[i]) <= 1
    if what == "stiffness":  # the law's zero is rest, MuJoCo's is the slack length
        if kind == "joint":
            slack = [model.qpos_spring[model.jnt_qposadr[i]]]
            rest = plant.rest[model.jnt_qposadr[i]]
        else:
            slack, rest = list(model.tendon_lengthspring[i]), plant.port(f"tendon:{name}").position(plant.new_data())
        return bool(np.all(np.abs(np.array(slack) - rest) <= 1e-9 * max(abs(rest), 1.0)))
    return True


def add_numbers(model: Any, place: str, what: Numbers) -> None:
    """Add numbers to a compiled model in place."""
    kind, _, name = place.partition(":")
    i = getattr(model, kind)(name).id
    if kind in ("body", "site"):
        mass = sum(value for _, _, value in what)
        if kind == "body":
            model.body_mass[i] += mass
        else:
            _add_point_mass(model, int(model.site_bodyid[i]), model.site_pos[i], mass)
        return
    fields = _JOINT if kind == "joint" else _TENDON
    for quantity, power, value in what:
        first, higher = fields[quantity]
        row = int(model.jnt_dofadr[i]) if first.startswith("dof_") else i
        if power == 0:
            getattr(model, first)[row] += value
        else:
            getattr(model, higher)[row, power - 1] += value
        if quantity == "frictionloss":
            solref, solimp = (
                ("dof_solref", "dof_solimp") if kind == "joint" else ("tendon_solref_fri", "tendon_solimp_fri")
            )
            getattr(model, solref)[row] = 2 * model.opt.timestep, 1.0
            getattr(model, solimp)[row] = HARD


def _add_point_mass(model: Any, body: int, at: Array, mass: float) -> None:
    """Add a point mass to a body at a place.

    The body's centre and moments of inertia change by the parallel-axis theorem. `at` is in the body's frame.
    """
    own, centre, axes = float(model.body_mass[body]), model.body_ipos[body].copy(), np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    turned = axes.reshape(3, 3)
    inertia = turned @ np.diag(model.body_inertia[body]) @ turned.T
    together = (own * centre + mass * at) / (own + mass)
    for m, arm in ((own, centre - together), (mass, at - together)):
        inertia += m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    moments, vectors = np.linalg.eigh(inertia)
    vectors[:, 2] = np.cross(vectors[:, 0], vectors[:, 1])  # principal axes must be right-handed
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, vectors.ravel())
    model.body_mass[body], model.body_ipos[body] = own + mass, together
    model.body_inertia[body], model.body_iquat[body] = moments, quaternion


def springs(plant: MjcfPlant, effect: Effect, place: str, values: Values) -> tuple[Spring, ...] | None:
    """Return the parallel springs that represent an effect.

    Parameters
    ----------
    plant : MjcfPlant
        Plant of an MJCF model.
    effect : Effect
        Effect of the catalogue.
    place : str
        Name of the place.
    values : Values
        Parameter values.

    Returns
    -------
    tuple of Spring or None
        Springs; None if the effect has no such form at the place.
    """
    kind, _, name = place.partition(":")
    if effect.name not in SPRINGS or kind not in ("joint", "tendon") or place not in plant.ports:
        return None
    if kind == "tendon" and _joints(plant.model, name) is None:
        return None
    return SPRINGS[effect.name]({k: float(v) for k, v in values.items()})


def add_springs(spec: Any, plant: MjcfPlant, place: str, label: str, what: tuple[Spring, ...]) -> None:
    """Add springs to a spec as fixed tendons.

    The tendons run parallel to a joint or a fixed tendon; displacements count from rest.
    """
    kind, _, name = place.partition(":")
    joints = [(name, 1.0)] if kind == "joint" else _joints(plant.model, name)
    rest = plant.port(place).position(plant.new_data())
    for k, spring in enumerate(what):
        tendon = spec.add_tendon(name=f"{label}:{k + 1}")
        tendon.damping[:], tendon.stiffness[:] = 0.0, 0.0  # overrides the model's defaults for tendons
        tendon.frictionloss = tendon.armature = 0.0
        tendon.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        tendon.stiffness[0] = spring.stiffness
        tendon.springlength = [rest + spring.low, rest + spring.high]
        tendon.springyield = spring.springyield
        for joint, coefficient in joints or ():
            tendon.wrap_joint(joint, coefficient)


def _joints(model: Any, tendon: str) -> list[tuple[str, float]] | None:
    """Return the joints and coefficients of a fixed tendon.

    Returns
    -------
    list of tuple of (str, float) or None
        None for a spatial tendon.
    """
    i = model.tendon(tendon).id
    first = int(model.tendon_adr[i])
    wraps = range(first, first + int(model.tendon_num[i]))
    if any(model.wrap_type[w] != mujoco.mjtWrap.mjWRAP_JOINT for w in wraps):
        return None
    return [(model.joint(int(model.wrap_objid[w])).name, float(model.wrap_prm[w])) for w in wraps]
