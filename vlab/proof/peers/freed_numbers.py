"""Numbers of a model and its measurement chain that mujoco.sysid frees."""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vlab.cases.channel_map import Run
from vlab.diagnose.settings import MJCF_PRIORS
from vlab.plants.mjcf import MjcfPlant
from vlab.proof.peers.result import compared_names
from vlab.signals import Array

FACTOR = 1.6
"""FACTOR [-]: limit of the logarithm of a multiplied number, a factor of five."""
SHARE = 0.01
"""SHARE [-]: unit of an added number, over the largest force, inertia, stiffness or deflection there."""
MOST = 50.0
"""MOST [-]: limit of an added number in its unit, half of that largest value."""
START = 0.1
"""START [-]: start of an added number that cannot be negative, in its unit; at a bound the optimiser may stall."""
LATE = 0.05
"""LATE [s]: largest delay."""
SLOW = 0.001
"""SLOW [s]: unit of a delay."""
OF_INERTIA = 0.1
"""OF_INERTIA [-]: standard deviation of a moment of inertia where a case states none."""
POSE = 0.3
"""POSE [rad or m]: displacement of every joint at which inertia and weight are compared."""
NEAREST_LIMIT, FURTHEST_LIMIT = -3.0, 0.7
"""NEAREST_LIMIT, FURTHEST_LIMIT [-]: bounds of the logarithm of a force limit."""
Change = Callable[[Any, float], None]
"""Change of a compiled model by a value of the number."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Freed:
    """Freed number.

    Parameters
    ----------
    label : str
        Unique name.
    raised, lowered : str
        Effects that a larger and a smaller number stand for; "" for none.
    place : str
        Place of the effect.
    sd : float
        Stated standard deviation, in the unit of the number; infinite where the model has nothing.
    low, high, start : float
        Bounds and start.
    change : callable or None
        Change of the model; None for a number of the measurement chain.
    channel : str
        Channel of a number of the measurement chain.
    """

    label: str
    raised: str
    lowered: str
    place: str
    sd: float = np.inf
    low: float = -FACTOR
    high: float = FACTOR
    start: float = 0.0
    change: Change | None = None
    channel: str = ""

    @property
    def kind(self) -> str:
        """First part of the label."""
        return self.label.partition(":")[0]


def freed_numbers(plant: MjcfPlant, given: Mapping[str, float], runs: Sequence[Run]) -> list[Freed]:
    """Return all numbers that are freed.

    Multiplied numbers are logarithms of factors: masses, moments of inertia, armatures, springs, dampers, gears, position
    and velocity gains, force limits, gains of sensors. Added numbers start from nothing: dry friction, springs and
    dampers where the model has none, offsets of commands and sensors, delays of commands and sensors.

    Parameters
    ----------
    plant : MjcfPlant
        Nominal plant.
    given : mapping
        ``[model.uncertain]`` of the case.
    runs : sequence of Run
        Recordings to fit.

    Returns
    -------
    list of Freed
        Numbers.
    """
    model = plant.model
    force = _largest_forces(plant, runs)
    bodies = [number for number in _bodies(model, given) if _acts(model, number)]
    joints, tendons = _joints(model, given, force), _tendons(model, given, force)
    return [*bodies, *joints, *tendons, *_actuators(plant, given, runs), *_sensors(given, runs)]


def with_numbers(model: Any, freed: Sequence[Freed], values: Array) -> Any:
    """Return a copy of a model with changed numbers.

    Parameters
    ----------
    model : object
        Compiled model.
    freed : sequence of Freed
        Numbers.
    values : (n,) array
        Values.

    Returns
    -------
    object
        Compiled model.
    """
    out = copy.copy(model)
    for number, value in zip(freed, values, strict=True):
        if number.change is not None:
            number.change(out, float(value))
    mujoco.mj_setConst(out, mujoco.MjData(out))
    return out


def _acts(model: Any, number: Freed) -> bool:
    """Return whether a number changes a model's inertia or weight.

    A mass that only turns about its centre does not, nor a moment of inertia that only slides.
    """
    found = []
    for value in (0.0, 0.1):
        changed = with_numbers(model, [number], np.array([value]))
        data, full = mujoco.MjData(changed), np.zeros((model.nv, model.nv))
        data.qpos[:] += POSE
        mujoco.mj_forward(changed, data)
        mujoco.mj_fullM(changed, data, full)
        found.append(np.append(full.ravel(), data.qfrc_bias))
    return not np.allclose(found[0], found[1], rtol=1e-9, atol=1e-12)


def stated_deviation(given: Mapping[str, float], kind: str, *elements: str) -> float:
    """Return the stated or usual deviation of a kind of number."""
    own = next((given[f"{e}:{kind}"] for e in elements if f"{e}:{kind}" in given), None)
    usual = MJCF_PRIORS.default_sd.get(kind, OF_INERTIA)
    return float(given.get(kind, usual) if own is None else own)


def _times(array: str, *indices: Any) -> Change:
    """Return a change that multiplies entries of an array of the model."""

    def change(model: Any, value: float) -> None:
        for index in indices:
            getattr(model, array)[index] *= np.exp(value)

    return change


def _plus(array: str, index: Any, unit: float) -> Change:
    """Return a change that adds to an entry of an array."""

    def change(model: Any, value: float) -> None:
        getattr(model, array)[index] += value * unit

    return change


def _added(label: str, effect: str, place: str, change: Change) -> Freed:
    return Freed(label=label, raised=effect, lowered="", place=place, low=0.0, high=MOST, start=START, change=change)


def _largest_forces(plant: MjcfPlant, runs: Sequence[Run]) -> float:
    """Return the actuators' largest recorded force [N or N m]."""
    model, most = plant.model, 0.0
    for run in runs:
        for drive in run.drives:
            if drive.actuator is None:
                most = max(most, float(np.abs(run.measured[drive.channel]).max()))
                continue
            for control in plant.actuators[drive.actuator].controls:
                gain = abs(float(model.actuator_gainprm[control, 0] * model.actuator_gear[control, 0]))
                own = gain * float(np.ptp(run.measured[drive.channel])) / 2
                limit = float(model.actuator_forcerange[control, 1])
                most = max(most, min(own, limit) if model.actuator_forcelimited[control] else own)
    return most


def _bodies(model: Any, given: Mapping[str, float]) -> list[Freed]:
    out = []
    for i in range(1, model.nbody):
        if model.body_mass[i] <= 0 or model.body_weldid[i] == 0:
            continue
        place = f"body:{model.body(i).name or f'body{i}'}"
        mass, inertia = stated_deviation(given, "mass", place), stated_deviation(given, "inertia", place)
        out += [
            Freed(label=f"mass:{i}", raised="added-mass", lowered="added-mass", place=place, sd=mass,
                  change=_times("body_mass", i)),
            Freed(label=f"inertia:{i}", raised="rotary-inertia", lowered="rotary-inertia", place=place, sd=inertia,
                  change=_times("body_inertia", i)),
        ]  # fmt: skip
    return out


def _joints(model: Any, given: Mapping[str, float], force: float) -> list[Freed]:
    out = []
    largest = max(float(model.jnt_stiffness.max(initial=0.0)), float(model.tendon_stiffness.max(initial=0.0)),
                  float(np.abs(model.actuator_biasprm[:, 1]).max(initial=0.0)))  # fmt: skip
    for i in range(model.njnt):
        dof, place = int(model.jnt_dofadr[i]), f"joint:{model.joint(i).name}"
        out += [_added(f"friction:{i}", "coulomb-friction", place, _plus("dof_frictionloss", dof, SHARE * force))]
        if model.dof_damping[dof] > 0:
            out += [Freed(label=f"damping:{i}", raised="viscous-damping", lowered="viscous-damping", place=place,
                          sd=stated_deviation(given, "damping", place), high=2 * FACTOR, change=_times("dof_damping", dof))]  # fmt: skip
        elif model.dof_damping.any():
            unit = SHARE * float(model.dof_damping.max())
            out += [_added(f"damping:{i}", "viscous-damping", place, _plus("dof_damping", dof, unit))]
        if model.dof_armature[dof] > 0:
            out += [Freed(label=f"armature:{i}", raised="rotary-inertia", lowered="rotary-inertia", place=place,
                          sd=stated_deviation(given, "armature", place), change=_times("dof_armature", dof))]  # fmt: skip
        if model.jnt_stiffness[i] > 0:
            out += [Freed(label=f"stiffness:{i}", raised="stiffness-to-ground", lowered="lost-stiffness", place=place,
                          sd=stated_deviation(given, "stiffness", place), change=_times("jnt_stiffness", i))]  # fmt: skip
        elif largest > 0:
            out += [_added(f"stiffness:{i}", "stiffness-to-ground", place, _plus("jnt_stiffness", i, SHARE * largest))]
    return out


def _tendons(model: Any, given: Mapping[str, float], force: float) -> list[Freed]:
    out = []
    for i in range(model.ntendon):
        place = f"tendon:{model.tendon(i).name}"
        out += [
            _added(f"tendon-friction:{i}", "coulomb-friction", place, _plus("tendon_frictionloss", i, SHARE * force))
        ]
        for kind, raised, lowered in (
            ("stiffness", "stiffness-to-ground", "lost-stiffness"),
            ("damping", "viscous-damping", "viscous-damping"),
        ):
            if getattr(model, f"tendon_{kind}")[i] > 0:
                out += [Freed(label=f"tendon-{kind}:{i}", raised=raised, lowered=lowered, place=place,
                              high=2 * FACTOR, sd=stated_deviation(given, kind, place), change=_times(f"tendon_{kind}", i))]  # fmt: skip
    return out


def _actuators(plant: MjcfPlant, given: Mapping[str, float], runs: Sequence[Run]) -> list[Freed]:
    """Return gains, limits, offsets and delays of the driven actuators."""
    model, out = plant.model, []
    for drive in runs[0].drives:
        if drive.actuator is None:
            continue
        tap = plant.actuators[drive.actuator]
        place, (control, *_) = f"actuator:{tap.name}", tap.controls
        gain = stated_deviation(given, "gain", place)
        if model.actuator_biastype[control] == mujoco.mjtBias.mjBIAS_AFFINE:
            out += _servo(model, int(control), place, gain, stated_deviation(given, "velocity-gain", place))
        else:
            change = _times("actuator_gainprm", *((int(c), 0) for c in tap.controls))
            out += [Freed(label=f"gain:{control}", raised="actuator-gain", lowered="actuator-gain", place=place, sd=gain,
                          change=change)]  # fmt: skip
        out += [
            Freed(label=f"command-offset:{drive.channel}", raised="actuator-offset", lowered="actuator-offset",
                  place=place, low=-MOST, high=MOST, channel=drive.channel),
            Freed(label=f"command-delay:{drive.channel}", raised="actuator-delay", lowered="", place=place, low=0.0,
                  high=LATE / SLOW, start=START, channel=drive.channel),
        ]  # fmt: skip
    return out


def _servo(model: Any, control: int, place: str, gain: float, velocity: float) -> list[Freed]:
    """Return position gain, velocity gain and force limit of a position servo."""

    def position(model: Any, value: float) -> None:
        model.actuator_gainprm[control, 0] *= np.exp(value)
        model.actuator_biasprm[control, 1] *= np.exp(value)

    name = "servo-position-gain"
    out = [Freed(label=f"kp:{control}", raised=name, lowered=name, place=place, sd=gain, change=position)]
    if model.actuator_biasprm[control, 2] != 0.0:
        name, change = "servo-velocity-gain", _times("actuator_biasprm", (control, 2))
        out += [Freed(label=f"kv:{control}", raised=name, lowered=name, place=place, sd=velocity, change=change)]
    if model.actuator_forcelimited[control]:
        change = _times("actuator_forcerange", (control, 0), (control, 1))
        out += [Freed(label=f"limit:{control}", raised="", lowered="servo-force-limit", place=place, low=NEAREST_LIMIT,
                      high=FURTHEST_LIMIT, change=change)]  # fmt: skip
    return out


def _sensors(given: Mapping[str, float], runs: Sequence[Run]) -> list[Freed]:
    """Return gains, offsets and delays of the compared channels."""
    out = []
    sd = stated_deviation(given, "sensor")
    for name in compared_names(runs[0]):
        place = name if ":" in name else f"sensor:{name}"
        out += [
            Freed(label=f"sensor-gain:{name}", raised="sensor-gain", lowered="sensor-gain", place=place, sd=sd,
                  channel=name),
            Freed(label=f"sensor-offset:{name}", raised="sensor-offset", lowered="sensor-offset", place=place,
                  low=-MOST, high=MOST, channel=name),
            Freed(label=f"sensor-delay:{name}", raised="sensor-delay", lowered="", place=place, low=0.0,
                  high=LATE / SLOW, start=START, channel=name),
        ]  # fmt: skip
    return out
