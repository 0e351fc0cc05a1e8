"""Uncertain parameters of an MJCF model, as log factors."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from scipy import linalg

from vlab.diagnose.parameters.reduced_model import Change
from vlab.diagnose.settings import MJCF_PRIORS, REDUCED_MODEL
from vlab.plants.base import Plant
from vlab.plants.equilibrium import settle
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array

ELEMENTS = ("stiffness", "damping", "friction", "mass", "armature")
"""Kinds of parameters that elements of a model have."""
VELOCITY_GAIN = "velocity-gain"
"""Kind of the velocity feedback of servos, whose `gain` is that of the position error."""
IMPEDANCE = (*ELEMENTS, "inertia")
"""Kinds of parameters that resist motion."""


Number = tuple[str, int | tuple[int, int]]
"""Value of a model: name of its array, and index in the array."""


VANISHING = frozenset({"damping", "friction"})
"""Kinds of uncertain parameters that may be zero."""


def prior_deviations(theta: Array, may_vanish: Array | bool) -> Array:
    """Return log factors as deviations with a normal prior.

    The deviation is the log factor. Below one, that of a value that may vanish is its relative change: damping known to
    50 % may as well be absent, which is no multiple.

    Parameters
    ----------
    theta : (..., n_parameters) array
        Log factors.
    may_vanish : (n_parameters,) array of bool
        Whether a value may be zero.

    Returns
    -------
    (..., n_parameters) array
        Deviations.
    """
    return np.asarray(np.where(np.logical_and(may_vanish, theta < 0.0), np.expm1(np.minimum(theta, 0.0)), theta))


def log_factors(deviations: Array, may_vanish: Array | bool) -> Array:
    """Return the log factors of deviations; the inverse of `prior_deviations`."""
    vanishing = np.log(np.maximum(1.0 + np.minimum(deviations, 0.0), MJCF_PRIORS.least_factor))
    return np.asarray(np.where(np.logical_and(may_vanish, deviations < 0.0), vanishing, deviations))


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """Uncertain parameter: a log factor on values of the model.

    Parameters
    ----------
    name : str
        ``"stiffness"`` for a kind, ``"joint:hinge:stiffness"`` for an element, ``"gain:motor"``, ``"sensor:enc"``.
    kind : str
        Kind of the parameter.
    sd : float
        Prior standard deviation of the log factor, or of the relative decrease of a value that may vanish.
    fields : tuple
        Multiplied values of the model.
    shifted : tuple of (Number, float)
        Values of the model that are moved instead, and by how much per unit of the parameter.
    stretched : tuple of (Number, float)
        Values of the model whose distance from a fixed value is multiplied, such as a position from an axis.
    actuator, sensor : int or None
        Actuator or channel whose gain is multiplied.
    start : float
        Log factor at which the search begins.
    """

    name: str
    kind: str
    sd: float
    fields: tuple[Number, ...] = ()
    stretched: tuple[tuple[Number, float], ...] = ()
    shifted: tuple[tuple[Number, float], ...] = ()
    actuator: int | None = None
    sensor: int | None = None
    start: float = 0.0

    @property
    def may_vanish(self) -> bool:
        """Whether the value may be zero, with a normal prior."""
        return self.kind in VANISHING

    @property
    def is_of_actuator(self) -> bool:
        """Whether the parameter changes the force of an actuator alone."""
        fields = [name for name, _ in self.fields]
        return self.actuator is not None or (bool(fields) and all(name.startswith("actuator_") for name in fields))

    @property
    def multiplied(self) -> tuple[Number, ...]:
        """Values of the model that the factor multiplies, wholly or in part."""
        return (*self.fields, *(number for number, _ in self.stretched))

    def apply(self, model: Any, value: float) -> None:
        """Change the model's values in place.

        Parameters
        ----------
        model : Any
            Compiled model.
        value : float
            Log factor, or shift of a parameter that moves values.
        """
        for name, index in self.fields:
            getattr(model, name)[index] *= float(np.exp(value))
        for (name, index), size in self.shifted:
            getattr(model, name)[index] += size * value
        for (name, index), fixed in self.stretched:
            values = getattr(model, name)
            values[index] = fixed + (values[index] - fixed) * float(np.exp(value))

    def change(self, difference: Array) -> Array:
        """Return the values' relative change, or shift, for parameter differences."""
        return difference if self.shifted else np.expm1(np.clip(difference, -REDUCED_MODEL.most, REDUCED_MODEL.most))


def uncertain_parameters(
    plant: Plant, given: Mapping[str, float], channels: Sequence[str], actuators: Sequence[int]
) -> list[Uncertain]:
    """Return the uncertain parameters of an MJCF plant.

    Parameters
    ----------
    plant : Plant
        Plant.
    given : mapping
        ``[model.uncertain]`` of the case.
    channels : sequence of str
        Names of the compared channels.
    actuators : sequence of int
        Driven actuators.

    Returns
    -------
    list of Uncertain
        Parameters of elements, actuator gains and sensor gains.
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
        braked = _braked(plant, i)
        if braked:
            usual = given.get(VELOCITY_GAIN, MJCF_PRIORS.default_sd[VELOCITY_GAIN])
            sd = given.get(f"actuator:{name}:{VELOCITY_GAIN}", usual)
            out.append(Uncertain(name=f"{VELOCITY_GAIN}:{name}", kind=VELOCITY_GAIN, sd=sd, fields=braked))
    for i, name in enumerate(channels):
        sd = given.get(
            f"sensor:{name.removeprefix('sensor:')}:gain", given.get("sensor", MJCF_PRIORS.default_sd["sensor"])
        )
        out.append(Uncertain(name=f"sensor:{name}", kind="sensor", sd=sd, sensor=i))
    return out


def gain_sd(given: Mapping[str, float], actuator: str) -> float:
    """Return the prior standard deviation of an actuator's gain."""
    return given.get(f"actuator:{actuator}:gain", given.get("gain", MJCF_PRIORS.default_sd["gain"]))


def _returned(plant: Plant, actuator: int) -> tuple[Number, ...]:
    """Return the feedback values that a servo's gain multiplies."""
    model, out = plant.model, []
    for control in plant.actuators[actuator].controls:
        if model.actuator_biastype[control] == mujoco.mjtBias.mjBIAS_AFFINE:
            gain, bias = float(model.actuator_gainprm[control, 0]), model.actuator_biasprm[control]
            out += [("actuator_biasprm", (int(control), k)) for k in (1, 2) if gain != 0.0 and bias[k] == -gain]
    return tuple(out)


def _braked(plant: Plant, actuator: int) -> tuple[Number, ...]:
    """Return the velocity feedback that is no part of a servo's gain."""
    model, own = plant.model, _returned(plant, actuator)
    numbers = [("actuator_biasprm", (int(control), 2)) for control in plant.actuators[actuator].controls]
    return tuple(
        (name, index)
        for name, index in numbers
        if model.actuator_biastype[index[0]] == mujoco.mjtBias.mjBIAS_AFFINE
        and model.actuator_biasprm[index] != 0.0
        and (name, index) not in own
    )


def common_scale(plant: Plant, parameters: Sequence[Uncertain], *, loaded: bool) -> Array | None:
    """Return log factors that scale all impedances and gains.

    Recorded motions cannot identify that common factor; only the priors do.

    Parameters
    ----------
    plant : Plant
        Plant.
    parameters : sequence of Uncertain
        Uncertain parameters.
    loaded : bool
        Whether measured forces act, beside commanded ones.

    Returns
    -------
    (n_parameters,) array or None
        Log factors; None where a part of the model has no uncertain factor.
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
    """Return parameter directions without effect on the model.

    A common factor compensates the elements' own factors. Only the priors identify the position along these directions.

    Parameters
    ----------
    parameters : sequence of Uncertain
        Uncertain parameters.

    Returns
    -------
    (k, n_parameters) array
        Directions in standard deviations.
    """
    if any(p.actuator is None and p.sensor is None and not (p.multiplied or p.shifted) for p in parameters):
        return np.zeros((0, len(parameters)))  # parameters of a structure multiply disjoint values
    numbers = sorted({number for p in parameters for number in p.multiplied}, key=str)
    actuators = sorted({p.actuator for p in parameters if p.actuator is not None})
    spread = _spread(parameters, numbers, actuators)
    sensors = [[float(p.sensor == i) for p in parameters] for i in {p.sensor for p in parameters} - {None}]
    moved = [row for row, p in zip(np.eye(len(parameters)), parameters, strict=True) if p.shifted]
    return np.asarray(linalg.null_space(np.vstack([spread, *sensors, *moved])).T)


def _spread(parameters: Sequence[Uncertain], numbers: Sequence[Number], actuators: Sequence[int]) -> Array:
    """Return the changes of log values and log gains per standard deviation.

    The shape is (n_numbers + n_actuators, n_parameters).
    """
    fields = [set(p.multiplied) for p in parameters]
    rows = [[float(number in own) for own in fields] for number in numbers]
    rows += [[float(p.actuator == i) for p in parameters] for i in actuators]
    return np.reshape(rows, (len(rows), len(parameters))) * [p.sd for p in parameters]


def _all_known(
    plant: Plant, numbers: Sequence[Number], actuators: Sequence[int], parameters: Sequence[Uncertain]
) -> bool:
    """Return whether every element and servo has an uncertain factor."""
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
    """Return the common and individual parameters of one kind.

    Parameters
    ----------
    kind : str
        Kind.
    elements : mapping
        Multiplied values of the model by element.
    sd : float
        Prior standard deviation of the kind.
    given : mapping
        ``[model.uncertain]``, which may name elements.
    also : str
        Alternative name of the kind after an element's name.

    Returns
    -------
    list of Uncertain
        Parameters.
    """
    every = tuple(field for fields in elements.values() for field in fields)
    if not every:
        return []
    is_split = 1 < len(elements) <= MJCF_PRIORS.most_elements
    is_named = any(f"{name}:{kind}" in given for name in elements)  # then the kind's factor is the common one
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


def _of_bodies(model: Any, given: Mapping[str, float]) -> dict[str, float]:
    """Return stated uncertainties with geom masses assigned to their bodies.

    Of several geoms of a body the largest value holds.
    """
    out = dict(given)
    for name, sd in given.items():
        kind, _, rest = name.partition(":")
        if kind == "geom":
            body = model.body(int(model.geom(rest.rpartition(":")[0]).bodyid[0]))
            of_body = f"body:{body.name or f'body{body.id}'}:mass"
            out[of_body] = max(sd, out.get(of_body, 0.0))
    return out


def _elements(model: Any, kind: str) -> dict[str, tuple[Number, ...]]:
    """Return the elements and values of one kind of parameter."""
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
        if not model.tendon(i).name:  # such as a coupling of joints, see `vlab.plants.joint_coupling`
            continue
        name = f"tendon:{model.tendon(i).name}"
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
    """Return the stiffness values of the first elastic element."""
    elements = _elements(model, "stiffness")
    return next((list(elements[name]) for name in names if name in elements), [])


def adjusted(plant: Plant, parameters: Sequence[Uncertain], theta: Array) -> Plant:
    """Return a plant at given log factors, in equilibrium.

    A servo's gain multiplies its feedback and its command. Channel gains are no part of the plant.

    Parameters
    ----------
    plant : Plant
        Nominal plant.
    parameters : sequence of Uncertain
        Uncertain parameters.
    theta : (n_parameters,) array
        Log factors.

    Returns
    -------
    Plant
        Adjusted plant.
    """
    model = copy.copy(plant.model)
    for parameter, value in zip(parameters, theta, strict=True):
        parameter.apply(model, float(value))
        if parameter.actuator is not None:
            for control in plant.actuators[parameter.actuator].controls:
                model.actuator_gainprm[control] *= float(np.exp(value))
    return with_model(plant, model)


def with_model(plant: Plant, model: Any) -> Plant:
    """Return a plant with another compiled model, in equilibrium.

    Parameters
    ----------
    plant : Plant
        Plant.
    model : Any
        Compiled model, overwritten in its derived constants.

    Returns
    -------
    Plant
        Plant at the equilibrium of the model.
    """
    mujoco.mj_setConst(model, mujoco.MjData(model))
    if isinstance(plant, MjcfPlant):
        rest, notes = settle(model, near=plant.rest)
        return replace(plant, model=model, rest=rest, notes=tuple(notes))
    return replace(plant, model=model)


def relative_changes(parameters: Sequence[Uncertain], differences: Array) -> Array:
    """Return the relative changes of the plant's values, for its linearisation.

    Parameters
    ----------
    parameters : sequence of Uncertain
        Uncertain parameters.
    differences : (..., n_parameters) array
        Differences to the parameters of the linearisation.

    Returns
    -------
    (..., n_parameters) array
        Relative changes, or shifts; zero for the gains of channels, which are no part of the plant.
    """
    out = np.zeros_like(differences)
    for i, parameter in enumerate(parameters):
        if parameter.sensor is None:
            out[..., i] = parameter.change(differences[..., i])
    return out


def changes_of(parameters: Sequence[Uncertain]) -> tuple[Change, ...]:
    """Return uncertain parameters as the reduced model's changes."""
    return tuple(Change(name=p.name, sd=p.sd, actuator=p.actuator, sensor=p.sensor, start=p.start) for p in parameters)
