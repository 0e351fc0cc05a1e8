"""What may be off in a model although no physics is missing: stiffness, mass, damping, friction, gains; and models with them changed."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy import linalg

from vlab.diagnose.parameters.reduced_model import Change, Part
from vlab.diagnose.settings import MJCF_PRIORS
from vlab.plants.base import Plant
from vlab.plants.equilibrium import settle
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array

ELEMENTS = ("stiffness", "damping", "friction", "mass", "armature")
"""Kinds that elements of a model have."""
IMPEDANCE = (*ELEMENTS, "inertia")
"""Kinds of what a force is needed for."""


Number = tuple[str, int | tuple[int, int]]
"""A number of a model: the name of its array, and its index there."""


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """One uncertain parameter: a log-factor on some numbers of the model.

    Parameters
    ----------
    name : str
        ``"stiffness"`` for all of a kind, ``"joint:hinge:stiffness"`` for one element, ``"gain:motor"``, ``"sensor:enc"``.
    sd : float
        Prior standard deviation of the log-factor.
    fields : tuple
        (name of the model's array, index) of the numbers that are multiplied.
    actuator, sensor : int or None
        The actuator's or channel's gain that is multiplied, too.
    """

    name: str
    kind: str
    sd: float
    fields: tuple[Number, ...] = ()
    actuator: int | None = None
    sensor: int | None = None


def uncertain_parameters(
    plant: Plant, given: Mapping[str, float], channels: Sequence[str], actuators: Sequence[int]
) -> list[Uncertain]:
    """Return what is uncertain of an MJCF plant.

    Parameters
    ----------
    given : mapping
        ``[model.uncertain]`` of the case.
    channels : sequence of str
        Names of the compared channels.
    actuators : sequence of int
        The actuators that are driven.
    """
    given = _of_bodies(plant.model, given)
    out: list[Uncertain] = []
    for kind in ELEMENTS:
        elements = _elements(plant.model, kind)
        also = "inertia" if kind == "mass" else kind
        out += of_kind(kind, elements, given.get(kind, MJCF_PRIORS.default_sd[kind]), given, also)
    for i in actuators:
        name = plant.actuators[i].name
        sd = gain_sd(given, name)
        out.append(Uncertain(name=f"gain:{name}", kind="gain", sd=sd, fields=_returned(plant, i), actuator=i))
    for i, name in enumerate(channels):
        sd = given.get(
            f"sensor:{name.removeprefix('sensor:')}:gain", given.get("sensor", MJCF_PRIORS.default_sd["sensor"])
        )
        out.append(Uncertain(name=f"sensor:{name}", kind="sensor", sd=sd, sensor=i))
    return out


def gain_sd(given: Mapping[str, float], actuator: str) -> float:
    """Return the relative standard deviation of an actuator's gain, by ``[model.uncertain]`` or the default."""
    return given.get(f"actuator:{actuator}:gain", given.get("gain", MJCF_PRIORS.default_sd["gain"]))


def _returned(plant: Plant, actuator: int) -> tuple[Number, ...]:
    """Return what an actuator's gain multiplies besides its command: a servo's reading of the position or the velocity that it
    holds against the command."""
    model, out = plant.model, []
    for control in plant.actuators[actuator].controls:
        if model.actuator_biastype[control] == mujoco.mjtBias.mjBIAS_AFFINE:
            gain, bias = float(model.actuator_gainprm[control, 0]), model.actuator_biasprm[control]
            out += [("actuator_biasprm", (int(control), k)) for k in (1, 2) if gain != 0.0 and bias[k] == -gain]
    return tuple(out)


def common_scale(plant: Plant, parameters: Sequence[Uncertain], *, loaded: bool) -> Array | None:
    """Return the likeliest log-factors that make all impedances and all gains larger by the same factor, (n_parameters,); None
    where something else in the model stays.

    No recording of motions says anything of that factor: only what is known of the model does.

    Parameters
    ----------
    loaded : bool
        Whether forces act that were measured, and not commanded.
    """
    model = plant.model
    if loaded or model.opt.density or model.opt.viscosity:
        return None
    numbers = sorted({number for p in parameters if p.kind in IMPEDANCE for number in p.fields}, key=str)
    actuators = sorted({p.actuator for p in parameters if p.actuator is not None})
    known = {name for name, _ in numbers}
    if "body_mass" not in known or not _all_known(plant, numbers, actuators, parameters):
        return None
    spread = _spread(parameters, numbers, actuators)
    found = np.linalg.lstsq(spread, np.ones(len(spread)), rcond=1e-9)[0]
    if not np.allclose(spread @ found, 1.0, atol=1e-6):
        return None
    return np.asarray(found * [p.sd for p in parameters])


def redundant(parameters: Sequence[Uncertain]) -> Array:
    """Return the directions of the uncertain parameters, in standard deviations, along which no number of a model changes, (k, n):
    what all elements have in common against what each has of its own. Only the priors say where along them they are."""
    if any(p.actuator is None and p.sensor is None and not p.fields for p in parameters):
        return np.zeros((0, len(parameters)))  # of a structure: what they multiply overlaps nowhere
    numbers = sorted({number for p in parameters for number in p.fields}, key=str)
    actuators = sorted({p.actuator for p in parameters if p.actuator is not None})
    spread = _spread(parameters, numbers, actuators)
    sensors = [[float(p.sensor == i) for p in parameters] for i in {p.sensor for p in parameters} - {None}]
    return np.asarray(linalg.null_space(np.vstack([spread, *sensors])).T)


def _spread(parameters: Sequence[Uncertain], numbers: Sequence[Number], actuators: Sequence[int]) -> Array:
    """Return by how much the logarithms of numbers of a model, and of gains of actuators, change where every parameter changes by its
    standard deviation, (n_numbers + n_actuators, n_parameters)."""
    fields = [set(p.fields) for p in parameters]
    rows = [[float(number in own) for own in fields] for number in numbers]
    rows += [[float(p.actuator == i) for p in parameters] for i in actuators]
    return np.reshape(rows, (len(rows), len(parameters))) * [p.sd for p in parameters]


def _all_known(
    plant: Plant, numbers: Sequence[Number], actuators: Sequence[int], parameters: Sequence[Uncertain]
) -> bool:
    """Return whether every spring, damper, mass and servo of a model has an uncertain factor."""
    model, have = plant.model, set(numbers)
    for kind in ELEMENTS:
        if any(not set(fields) <= have for fields in _elements(model, kind).values()):
            return False
    controls = {int(c) for i in actuators for c in plant.actuators[i].controls}
    servos = {number for p in parameters if p.actuator is not None for number in p.fields}
    biased = {("actuator_biasprm", (int(i), int(k))) for i, k in zip(*np.nonzero(model.actuator_biasprm), strict=True)}
    return biased <= servos and controls >= {index[0] for _, index in biased}


def of_kind(
    kind: str, elements: Mapping[str, tuple[Number, ...]], sd: float, given: Mapping[str, float], also: str
) -> list[Uncertain]:
    """Return what is uncertain of one kind: a factor that all elements have in common, and one of every element's own.

    Parameters
    ----------
    elements : mapping
        Their names to the numbers of the model that are multiplied.
    sd : float
        Of the kind.
    given : mapping
        ``[model.uncertain]``, where elements may be named.
    also : str
        Another word for the kind that elements may be named with.
    """
    every = tuple(field for fields in elements.values() for field in fields)
    if not every:
        return []
    is_split = 1 < len(elements) <= MJCF_PRIORS.most_elements
    is_named = any(f"{name}:{kind}" in given for name in elements)  # then the kind's is what they have in common
    out = [
        Uncertain(name=kind, kind=kind, sd=MJCF_PRIORS.common * sd if is_split and not is_named else sd, fields=every)
    ]
    own = {name: given.get(f"{name}:{kind}") or given.get(f"{name}:{also}") for name in elements}
    if is_split:
        out += [
            Uncertain(name=f"{name}:{kind}", kind=kind, sd=MJCF_PRIORS.own * sd, fields=fields)
            for name, fields in elements.items()
            if not own[name]
        ]
    out += [
        Uncertain(name=f"{name}:{kind}", kind=kind, sd=stated, fields=elements[name])
        for name, stated in own.items()
        if stated
    ]
    return out


def unused(given: Mapping[str, float], parameters: Sequence[Uncertain]) -> list[str]:
    """Return what is stated in ``[model.uncertain]`` and moves nothing, in a sentence."""
    kinds, names = {p.kind for p in parameters}, {p.name for p in parameters}
    stated = [name for name in given if not name.startswith("geom:")]  # the mass of its body
    idle = [name for name in stated if not (_meant(name) & names if ":" in name else name in kinds)]
    if not idle:
        return []
    return [f"[model.uncertain] {', '.join(idle)}: not used, nothing of that kind or name is uncertain in this case"]


def _meant(name: str) -> set[str]:
    """Return the names of parameters that a stated name may set."""
    kind, _, rest = name.partition(":")
    element, _, quantity = rest.rpartition(":")
    return {
        "actuator": {f"gain:{element}"},
        "sensor": {f"sensor:{element}", f"sensor:sensor:{element}"},
        "body": {name, f"body:{element}:mass"} if quantity == "inertia" else {name},
    }.get(kind, {name})


def _of_bodies(model: Any, given: Mapping[str, float]) -> dict[str, float]:
    """Return what is stated with masses of geoms as those of their bodies; of several geoms of a body the largest."""
    out = dict(given)
    for name, sd in given.items():
        kind, _, rest = name.partition(":")
        if kind == "geom":
            body = model.body(int(model.geom(rest.rpartition(":")[0]).bodyid[0]))
            of_body = f"body:{body.name or f'body{body.id}'}:mass"
            out[of_body] = max(sd, out.get(of_body, 0.0))
    return out


def _elements(model: Any, kind: str) -> dict[str, tuple[Number, ...]]:
    """Return the elements of a model that have a stiffness, damping, friction, mass or armature, with their fields."""
    out: dict[str, tuple[Number, ...]] = {}
    if kind == "mass":
        for i in range(1, model.nbody):
            if model.body_mass[i] > 0 and model.body_weldid[i] != 0:
                name = model.body(i).name or f"body{i}"
                out[f"body:{name}"] = (("body_mass", i), ("body_inertia", i))
        return out
    for i in range(model.njnt):
        name = f"joint:{model.joint(i).name or i}"
        dofs = _dofs(model, i)
        if kind == "armature" and any(model.dof_armature[d] for d in dofs):
            out[name] = tuple(("dof_armature", d) for d in dofs)
        if kind == "friction" and any(model.dof_frictionloss[d] for d in dofs):
            out[name] = tuple(("dof_frictionloss", d) for d in dofs)
        if kind == "stiffness" and (model.jnt_stiffness[i] or np.any(model.jnt_stiffnesspoly[i])):
            out[name] = (("jnt_stiffness", i), ("jnt_stiffnesspoly", i))
        if kind == "damping" and any(model.dof_damping[d] or np.any(model.dof_dampingpoly[d]) for d in dofs):
            out[name] = tuple((field, d) for d in dofs for field in ("dof_damping", "dof_dampingpoly"))
    for i in range(model.ntendon):
        name = f"tendon:{model.tendon(i).name or i}"
        array, poly = f"tendon_{kind}", f"tendon_{kind}poly"
        if kind == "armature" and model.tendon_armature[i]:
            out[name] = ((array, i),)
        if kind == "friction" and model.tendon_frictionloss[i]:
            out[name] = (("tendon_frictionloss", i),)
        if kind in ("stiffness", "damping") and (getattr(model, array)[i] or np.any(getattr(model, poly)[i])):
            out[name] = ((array, i), (poly, i))
    return out


def _dofs(model: Any, joint: int) -> range:
    """Return the degrees of freedom of a joint."""
    first = int(model.jnt_dofadr[joint])
    return range(first, first + {0: 6, 1: 3}.get(int(model.jnt_type[joint]), 1))


def stiffness_of(model: Any, names: Sequence[str]) -> list[Number]:
    """Return the numbers of a model that are the stiffness of the first of some joints and tendons that has one."""
    elements = _elements(model, "stiffness")
    return next((list(elements[name]) for name in names if name in elements), [])


def adjusted(plant: Plant, parameters: Sequence[Uncertain], theta: Array) -> Plant:
    """Return the plant with its uncertain parameters at given log-factors; channel gains are not the plant's.

    The equilibrium is found again. The gain of a servo multiplies what it makes of the motion that it holds against its command, too.
    """
    model = copy.copy(plant.model)
    for parameter, value in zip(parameters, theta, strict=True):
        factor = float(np.exp(value))
        for name, index in parameter.fields:
            getattr(model, name)[index] *= factor
        if parameter.actuator is not None:
            for control in plant.actuators[parameter.actuator].controls:
                model.actuator_gainprm[control] *= factor
    return with_model(plant, model)


def with_model(plant: Plant, model: Any) -> Plant:
    """Return the plant with another compiled model of the same layout, at its own equilibrium."""
    mujoco.mj_setConst(model, mujoco.MjData(model))
    if isinstance(plant, MjcfPlant):
        rest, notes = settle(model)
        return replace(plant, model=model, rest=rest, notes=tuple(notes))
    return replace(plant, model=model)


def derivative(make: Callable[[float], tuple[Array, Array, Array]], step: float = 1e-3) -> tuple[Array, Array, Array]:
    """Return the derivatives of M, C and K by a log-factor at zero, by central differences."""
    high, low = make(step), make(-step)
    return tuple((a - b) / (2 * step) for a, b in zip(high, low, strict=True))  # type: ignore[return-value]


def changes_of(parameters: Sequence[Uncertain]) -> tuple[Change, ...]:
    """Return uncertain parameters as the twin has them."""
    return tuple(Change(name=p.name, sd=p.sd, actuator=p.actuator, sensor=p.sensor) for p in parameters)


def parts_of(plant: Plant, parameters: Sequence[Uncertain], basis: Array) -> tuple[Part, ...]:
    """Return what the uncertain parameters of an MJCF plant multiply, in modal coordinates.

    A spring's stiffness is one part, although a factor of its own and one of all springs multiply it: were both derivatives
    simply added, two factors of 7 % would leave the frequency of a light structure off by a tenth of its width.
    """
    by: dict[Number, tuple[int, ...]] = {}
    for i, parameter in enumerate(parameters):
        for number in parameter.fields:
            by[number] = (*by.get(number, ()), i)
    together: dict[tuple[int, ...], list[Number]] = {}
    for number, multiplied in by.items():
        together.setdefault(multiplied, []).append(number)
    return tuple(_part(plant, tuple(fields), multiplied, basis) for multiplied, fields in together.items())


def _part(plant: Plant, fields: tuple[Number, ...], by: tuple[int, ...], basis: Array) -> Part:
    one = Uncertain(name="", kind="", sd=1.0, fields=fields)

    def matrices(theta: float) -> tuple[Array, Array, Array]:
        linear = adjusted(plant, [one], np.array([theta])).linearise()
        return linear.M, linear.C, linear.K

    M, C, K = (basis.T @ part @ basis for part in derivative(matrices))
    return Part(
        by=by,
        M=M if np.abs(M).max() > 1e-9 else None,  # of modes with unit mass
        C=C if np.any(C) else None,
        K=K if np.any(K) else None,
    )
