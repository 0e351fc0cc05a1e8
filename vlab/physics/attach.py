"""Attachment of physical effects to a plant.

An effect becomes numbers of the compiled MuJoCo model where MuJoCo has such numbers. Every other effect runs as forces
and signal changes beside the plant.

A place has the name that the cases and `vlab.diagnose` use: a port of the plant (``20in``, ``joint:hinge``),
``body:arm``, ``actuator:motor`` or ``coil:base``, or ``sensor:enc``. The place ``chain`` means all actuators alike. A
sensor that picks up a second signal names the source after a slash: ``sensor:20in/coil:base``. The default source is
the actuator or sensor at the same place.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from vlab.errors import BadExperiment, unknown_name
from vlab.physics.attached import AtActuator, AtPort, AtSensor
from vlab.physics.effect import ActuatorEffect, Effect, LinearPortEffect, PortEffect, SensorEffect
from vlab.physics.native import add_numbers, add_springs, numbers, springs
from vlab.physics.running import small_motion, tap_index
from vlab.physics.servo import ServoEffect, at_servo, has_motor, put_into, servo_of, servo_port
from vlab.plants.base import Plant, Port
from vlab.plants.element_ports import constant_port
from vlab.plants.equilibrium import settle
from vlab.plants.mjcf import AXES, MjcfPlant
from vlab.plants.numbers import numbers_into_spec
from vlab.signals import Array

CHAIN = "chain"
"""Place that means all actuators alike."""
ALIGNED = 0.9999
"""ALIGNED [1]: smallest cosine at which an actuator's force counts as acting along a port."""


@dataclass(frozen=True)
class Attached:
    """One effect at one place.

    Parameters
    ----------
    values : mapping of str to float
        Every parameter of the effect, in SI.

    Raises
    ------
    BadExperiment, UnknownName
        A parameter is missing, unknown or no finite number.
    """

    effect: Effect
    place: str
    values: Mapping[str, float]

    def __post_init__(self) -> None:
        names = [p.name for p in self.effect.parameters]
        for name, value in self.values.items():
            if name not in names:
                raise unknown_name("parameter", name, names, where=f"effect {self.effect.name!r}")
            if not np.isfinite(value):
                raise BadExperiment(f"effect {self.effect.name!r}: {name} = {value} is no finite number")
        missing = [p for p in self.effect.parameters if p.name not in self.values]
        if missing:
            raise BadExperiment(
                f"effect {self.effect.name!r} at {self.place!r} lacks {', '.join(f'{p.name} [{p.unit}]' for p in missing)}"
            )
        for p in self.effect.parameters:
            value = self.values[p.name]
            if not p.signed and not (value > 0 if p.role == "shape" else value >= 0):
                raise BadExperiment(f"effect {self.effect.name!r}: {p.name} = {value:g}; it must be positive")

    @property
    def label(self) -> str:
        """Effect and place as ``EFFECT@PLACE``."""
        return f"{self.effect.name}@{self.place}"


def attach(plant: Plant, effects: Sequence[Attached], *, channels: Sequence[str] = ()) -> Plant:
    """Return a plant with effects, for open and closed loop.

    Parameters
    ----------
    plant : Plant
        Plant without the effects; it stays unchanged.
    effects : sequence of Attached
        Effects with their places and values.
    channels : sequence of str
        Channel names of a case; sensor effects may use a channel name as place.

    Returns
    -------
    Plant
        Plant with the same interface.

    Raises
    ------
    UnknownName
        No such place.
    BadExperiment
        An effect that cannot act at its place.
    """
    if not effects:
        return plant
    running: list[AtPort | AtActuator | AtSensor] = []
    model: Any = None
    for one in effects:
        if isinstance(one.effect, ActuatorEffect):
            running += [
                AtActuator(effect=one.effect, index=i, values=one.values) for i in actuators_at(plant, one.place)
            ]
        elif isinstance(one.effect, SensorEffect):
            running.append(_at_sensor(plant, one, one.effect, channels))
        else:
            port = _port(plant, one)
            own = numbers(plant, one.effect, one.place, one.values) if isinstance(plant, MjcfPlant) else None
            is_native = own is not None or one.effect.is_in_servo
            changed = copy.copy(plant.model) if is_native and model is None else model
            if own is not None:
                add_numbers(changed, one.place, own)
            elif not _in_actuator(changed, plant, one):
                running.append(_at_port(plant, one, port))
                continue
            model = changed
    if model is not None:
        assert isinstance(plant, MjcfPlant)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        rest, notes = settle(model)
        plant = replace(plant, model=model, rest=rest, notes=tuple(notes))
    added = small_motion(plant, [a for a in running if isinstance(a, AtPort)])
    if plant.impedance is not None and added is not None:
        added = (plant.impedance[0] + added[0], plant.impedance[1] + added[1], plant.impedance[2] + added[2])
    return replace(plant, physics=(*plant.physics, *running), impedance=plant.impedance if added is None else added)


def written(plant: Plant, effects: Sequence[Attached]) -> tuple[Any, list[Attached]]:
    """Return a spec with native effects, and the remaining effects.

    The remaining effects go into ``[[model.effect]]`` tables of a case, see `effect_tables`. Numbers of the compiled
    model that differ from the plant's file (calibrated parameters) enter the spec.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    effects : sequence of Attached
        Effects with places and values.

    Returns
    -------
    tuple of (object, list of Attached)
        The MuJoCo spec, and the effects without MuJoCo elements.
    """
    if not isinstance(plant, MjcfPlant):
        return plant.spec, list(effects)
    spec, model, left = plant.spec.copy(), copy.copy(plant.model), []
    extra = []
    for one in effects:
        own = None if one.effect.kind != "port" else numbers(
            plant, one.effect, one.place, one.values
        )  # fmt: skip
        beside = springs(plant, one.effect, one.place, one.values)
        if own is not None:
            add_numbers(model, one.place, own)
        elif beside is not None:
            extra.append((one, beside))
        elif not _in_actuator(model, plant, one):
            left.append(one)
    numbers_into_spec(spec, model)
    for one, beside in extra:
        add_springs(spec, plant, one.place, one.label, beside)
    return spec, left


def effect_tables(effects: Sequence[Attached]) -> str:
    """Return effects as ``[[model.effect]]`` tables of a ``case.toml``.

    Parameters
    ----------
    effects : sequence of Attached
        Effects with places and values.

    Returns
    -------
    str
        TOML text.
    """
    out = []
    for one in effects:
        out += [
            "[[model.effect]]",
            f'name = "{one.effect.name}"',
            f'place = "{one.place}"',
            "[model.effect.parameters]",
        ]
        out += [f"{name} = {float(value)!r}" for name, value in one.values.items()] + [""]
    return "\n".join(out)


# ---- places ---------------------------------------------------------------------------------------------------------


def actuators_at(plant: Plant, place: str) -> list[int]:
    """Return the actuators at a place.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    place : str
        Name of one actuator, or ``chain`` for all.

    Returns
    -------
    list of int
        Indices into ``plant.actuators``.

    Raises
    ------
    UnknownName
        No such actuator.
    """
    if place == CHAIN:
        return list(range(len(plant.actuators)))
    index = tap_index(plant.actuators, place)
    if index is None:
        raise unknown_name("actuator", place, [*(f"actuator:{tap.name}" for tap in plant.actuators if tap.name), CHAIN])
    return [index]


def port_at(plant: Plant, place: str) -> Port:
    """Return the port at a place.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    place : str
        Port name, ``actuator:NAME`` (a position servo), ``coil:NAME`` (the coil's position), ``body:NAME``, ``site:NAME`` or ``floor``.

    Returns
    -------
    Port
        The port; a body or a site has three coordinates.

    Raises
    ------
    UnknownName
        No such place.
    """
    if place in plant.ports:
        return plant.ports[place]
    kind, _, name = place.partition(":")
    index = tap_index(plant.actuators, place) if kind == "actuator" else None
    if index is not None and (servo := servo_port(plant, index)) is not None:
        return servo
    if kind in ("coil", "sensor", "amplifier") and name:
        every: tuple[Any, ...] = (*plant.actuators, *plant.sensors)
        taps = [tap for tap in every if name in (tap.at, tap.name)]
        if taps and taps[0].at in plant.ports:
            return plant.ports[taps[0].at]
    if kind in ("body", "site") and isinstance(plant, MjcfPlant):
        return _point_port(plant, kind, name)
    if kind.split(".")[0] == "floor":
        return _floor_port(plant, kind.partition(".")[2])
    bodies = (
        [f"body:{plant.model.body(i).name}" for i in range(1, plant.model.nbody)]
        if isinstance(plant, MjcfPlant)
        else []
    )
    raise unknown_name("place", place, [*plant.ports, *bodies, "floor"])


def _port(plant: Plant, one: Attached) -> Port:
    """Return the port of a port effect.

    Raises
    ------
    BadExperiment
        The effect cannot act at the place.
    """
    port, needs = port_at(plant, one.place), one.effect.needs
    wrong = ""
    if "translation" in needs and port.unit == "rad":
        wrong = "it acts on displacements, this is a rotation"
    elif "rotation" in needs and port.unit != "rad":
        wrong = "it acts on rotations, this is a displacement"
    elif "stiffness" in needs and own_stiffness(plant, one.place) <= 0:
        wrong = "no elastic element with a stiffness of its own is there"
    elif ("tension" in needs) != (port.tag == "tension"):
        wrong = "tension-error goes with the place of a stretched bar's tension, and nothing else does"
    elif port.tag == "body" and one.effect.name != "added-mass":
        wrong = "a body or a site takes added-mass only; a site along one axis, such as site:tip.x, takes forces"
    elif port.tag == "floor" and one.effect.name not in ("sinusoidal-force", "force-offset"):
        wrong = "the floor takes sinusoidal-force and force-offset only"
    elif ("servo" in needs) != one.place.startswith("actuator:"):
        wrong = "effects of a servo go with a position servo, as in actuator:NAME, and nothing else does"
    elif "armature" in needs and not has_motor(plant, actuators_at(plant, one.place)[0]):
        wrong = "the inertia of the servo's motor is unknown; give its joint or tendon an armature above 0"
    elif "coil" in needs and coil_at(plant, port) is None:
        wrong = "no actuator acts along it"
    if wrong:
        raise BadExperiment(f"effect {one.effect.name!r} cannot act at {one.place!r}: {wrong}")
    return port


def _at_port(plant: Plant, one: Attached, port: Port) -> AtPort:
    assert isinstance(one.effect, (PortEffect, LinearPortEffect))
    if isinstance(one.effect, ServoEffect):
        (i,) = actuators_at(plant, one.place)
        servo = servo_of(plant, i)
        assert servo is not None
        return AtPort(effect=at_servo(one.effect, servo), port=port, values=one.values, coil=i)
    return AtPort(
        effect=one.effect,
        port=port,
        values=one.values,
        stiffness=own_stiffness(plant, one.place),
        coil=coil_at(plant, port) if "coil" in one.effect.needs else None,
    )


def own_stiffness(plant: Plant, place: str) -> float:
    """Return the stiffness of the elastic element at a place.

    A port without an element of its own takes the stiffness of another port with the same motion.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    place : str
        Name of the place.

    Returns
    -------
    float
        Stiffness [N/m or N m/rad], 0 without an element.
    """
    if place not in plant.ports:
        return 0.0
    own = plant.own_stiffness(place)
    if own > 0:
        return own
    data = plant.new_data()
    row = plant.port(place).row(data)
    for name, port in plant.ports.items():
        stiffness = plant.own_stiffness(name)
        if stiffness > 0 and np.abs(port.row(data) - row).max() <= 1e-6 * np.abs(row).max():
            return stiffness
    return 0.0


def coil_at(plant: Plant, port: Port) -> int | None:
    """Return the actuator that acts along a port.

    Parameters
    ----------
    plant : Plant
        Plant with its ports and transducers.
    port : Port
        Port of the plant.

    Returns
    -------
    int or None
        Index of the actuator; None without one.
    """
    data = plant.new_data()
    base, row = data.qfrc_actuator.copy(), port.row(data)
    for i in range(len(plant.actuators)):
        data.ctrl[:] = plant.control_matrix[:, i]
        mujoco.mj_forward(plant.model, data)
        force = data.qfrc_actuator - base
        size = np.linalg.norm(force) * np.linalg.norm(row)
        if size > 0 and abs(force @ row) > ALIGNED * size:
            return i
    return None


def _point_port(plant: MjcfPlant, kind: str, name: str) -> Port:
    """Return a body's centre or a site as one place.

    The place has three coordinates.
    """
    model = plant.model
    count = {"body": model.nbody, "site": model.nsite}[kind]
    known = [n for n in (getattr(model, kind)(i).name for i in range(1 if kind == "body" else 0, count)) if n]
    if name not in known:
        raise unknown_name(kind, name, known)
    i = getattr(model, kind)(name).id
    find = {"body": mujoco.mj_jacBodyCom, "site": mujoco.mj_jacSite}[kind]

    def part(axis: int) -> Port:
        def row(data: Any) -> Array:
            jacobian = np.zeros((3, model.nv))
            find(model, data, jacobian, None, i)
            return jacobian[axis]

        def position(data: Any) -> float:
            return float((data.xipos if kind == "body" else data.site_xpos)[i, axis])

        return Port(name=f"{kind}:{name}.{AXES[axis]}", unit="m", row=row, position=position, tag="body")

    first, *others = (part(axis) for axis in range(3))
    return replace(first, name=f"{kind}:{name}", more=tuple(others))


def _floor_port(plant: Plant, axis: str) -> Port:
    """Return the port of floor motion.

    A unit force at the port is the inertia force of a floor acceleration of 1 m/s^2. A structure's floor moves across
    the drawing; an MJCF model names the axis, as in ``floor.x``.
    """
    axis = axis if isinstance(plant, MjcfPlant) else "y"
    if axis not in AXES:
        raise unknown_name("axis of the floor", axis, [f"floor.{a}" for a in AXES])
    data, row = plant.new_data(), np.zeros(plant.model.nv)
    for i in range(1, plant.model.nbody):
        jacobian = np.zeros((3, plant.model.nv))
        mujoco.mj_jacBodyCom(plant.model, data, jacobian, None, i)
        row -= plant.model.body_mass[i] * jacobian[AXES.index(axis)]
    return constant_port("floor", row, tag="floor")


def _at_sensor(plant: Plant, one: Attached, effect: SensorEffect, channels: Sequence[str]) -> AtSensor:
    place, other = one.place, ""
    index = tap_index(plant.sensors, place)
    if index is None:  # split sensor from pick-up source; names of a model may hold the separator as well
        parts = one.place.split("/")
        heads = ["/".join(parts[:k]) for k in range(len(parts) - 1, 0, -1)]
        place = next((head for head in heads if tap_index(plant.sensors, head) is not None), parts[0])
        index, other = tap_index(plant.sensors, place), one.place[len(place) + 1 :]
    bare = place.removeprefix("sensor:")
    if index is None and bare not in channels and bare not in plant.ports:
        known = [f"sensor:{tap.name.removeprefix('sensor:')}" for tap in plant.sensors]
        raise unknown_name("sensor", place, [*known, *channels])
    name = bare if index is None or bare in channels else plant.sensors[index].name
    if "command" in effect.needs or "sensor" in effect.needs:
        if index is None:
            raise BadExperiment(f"effect {effect.name!r} acts on sensors of the plant; {bare!r} is a channel")
        other = _other(plant, one, index, other)
    elif other:
        raise BadExperiment(f"effect {effect.name!r} picks nothing up; leave out '/{other}' of its place")
    return AtSensor(effect=effect, name=name, values=one.values, other=other)


def _other(plant: Plant, one: Attached, sensor: int, given: str) -> str:
    """Return the name of the picked-up actuator or sensor."""
    is_command = "command" in one.effect.needs
    taps: tuple[Any, ...] = plant.actuators if is_command else plant.sensors
    if given:
        index = tap_index(taps, given)
    elif is_command:
        index = next((i for i, tap in enumerate(taps) if tap.at == plant.sensors[sensor].at), None)
    else:
        index = sensor + 1 if sensor + 1 < len(taps) else sensor - 1
    if index is None or index < 0 or (not is_command and index == sensor):
        what = "the coil whose command" if is_command else "the sensor whose signal"
        raise BadExperiment(
            f"effect {one.effect.name!r} at {one.place!r}: say {what} it picks up, as in {one.place}/NAME"
        )
    return str(taps[index].name)


def _in_actuator(model: Any, plant: Plant, one: Attached) -> bool:
    """Put a gain or a limit into a plain actuator's numbers.

    Returns
    -------
    bool
        Whether the actuator could take the effect.
    """
    if isinstance(one.effect, ServoEffect):
        return put_into(model, plant, actuators_at(plant, one.place)[0], one.effect, one.values)
    if one.effect.kind != "actuator" or one.place == CHAIN:
        return False
    for i in actuators_at(plant, one.place):
        for c in plant.actuators[i].controls:
            is_plain = (
                model.actuator_gaintype[c] == mujoco.mjtGain.mjGAIN_FIXED
                and model.actuator_biastype[c] == mujoco.mjtBias.mjBIAS_NONE
                and model.actuator_dyntype[c] == mujoco.mjtDyn.mjDYN_NONE
                and not model.actuator_ctrllimited[c]
            )
            if not is_plain:
                return False
            if one.effect.name == "actuator-gain":
                model.actuator_gainprm[c, 0] *= 1.0 + one.values["gain"]
            elif one.effect.name == "actuator-clipping":
                model.actuator_ctrllimited[c] = 1
                model.actuator_ctrlrange[c] = -one.values["limit"], one.values["limit"]
            else:
                return False
    return True
