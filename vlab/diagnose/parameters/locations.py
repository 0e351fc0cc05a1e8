"""Locations of possible missing physics, in modal coordinates."""

import copy
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.settings import LOCATIONS
from vlab.errors import BadCase
from vlab.physics.attach import port_at
from vlab.physics.effect import Effect
from vlab.physics.running import tap_index
from vlab.physics.servo import Servo, ServoEffect, at_servo, servo_of, servo_port
from vlab.plants.base import Plant
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """Location of an effect.

    Parameters
    ----------
    name : str
        Name in the report.
    kind : str
        ``"port"``, ``"body"``, ``"actuator"``, ``"sensor"``, or ``"pick-up"``: a sensor and a second signal.
    rows : (k, m) array
        Port displacement per modal coordinate; of a body or site the three rows of its centre.
    truncated : (k, t) array
        Port displacement per coordinate of the truncated modes; no columns where their flexibility is neglected.
    angular : bool
        Whether the port is a rotation.
    stiffness : float
        Stiffness of the elastic element at the port [N/m or N m/rad]; 0 without one.
    stiffened_by : tuple of int
        Uncertain parameters that multiply the stiffness.
    index : int
        Index of the actuator or channel.
    also : tuple of int
        Further actuators of a location that several share.
    other : int
        Actuator or channel whose signal a pick-up receives, according to `tag`.
    coil : int or None
        Actuator that acts along the port.
    aliases : tuple of str
        Other names of the port.
    tag : str
        Tag of `vlab.plants.base.Port`; of a pick-up ``"command"`` or ``"sensor"``.
    is_held : bool
        Whether the model restores the port; a free port has no rest position.
    servo : Servo or None
        Position servo of an actuator, whose rows are then those of its transmission.
    efforts : (n_channels, n_indices) array
        Readings of force sensors per unit command of every actuator of the location; empty for none.
    seen : float
        Share of the command of a sample's own interval in these readings, see `EffortChannels`.
    per_command : float
        Force of the location's drive along its first row per unit command; 0 without a drive.
    """

    name: str
    kind: str
    rows: Array = field(default_factory=lambda: np.zeros((0, 0)))
    truncated: Array = field(default_factory=lambda: np.zeros((0, 0)))
    angular: bool = False
    stiffness: float = 0.0
    stiffened_by: tuple[int, ...] = ()
    index: int = -1
    also: tuple[int, ...] = ()
    other: int = -1
    coil: int | None = None
    aliases: tuple[str, ...] = ()
    tag: str = ""
    is_held: bool = True
    servo: Servo | None = None
    efforts: Array = field(default_factory=lambda: np.zeros((0, 0)))
    seen: float = 0.0
    per_command: float = 0.0

    @property
    def effort_in_drive(self) -> Array | None:
        """Readings (n_channels,) of force sensors per unit force of the drive."""
        if not np.any(self.efforts) or self.per_command == 0.0:
            return None
        return np.asarray(self.efforts[:, 0] / self.per_command)

    def stiffness_at(self, theta: Array) -> Array:
        """Return the element's stiffness (n_sets,) at log factors (n_sets, n_changes)."""
        return np.asarray(self.stiffness * np.exp(theta[:, list(self.stiffened_by)].sum(axis=1)))

    @property
    def indices(self) -> tuple[int, ...]:
        """All actuators or channels of the location."""
        return (self.index, *self.also)


def limited(effect: Effect, at: Collection[str]) -> Effect:
    """Return a copy of an effect for some locations only.

    Parameters
    ----------
    effect : Effect
        Effect.
    at : collection of str
        Names of locations, with or without their kind, as in ``joint:elbow`` or ``elbow``.

    Returns
    -------
    Effect
        Copy of the effect.
    """
    out = copy.copy(effect)
    out.sought_at = frozenset(at)
    return out


def is_named(place: str, at: Collection[str]) -> bool:
    """Return whether a name of a location is among given names.

    Parameters
    ----------
    place : str
        Name of a location, such as ``joint:elbow``; of a pick-up ``sensor:a/b``.
    at : collection of str
        Given names, with or without their kind.

    Returns
    -------
    bool
        Whether the location is given.
    """
    whole = place.partition("/")[0]
    return not {place, whole, whole.rpartition(":")[2]}.isdisjoint(at)


def check_candidates(effects: Sequence[Effect], places: Sequence[Place]) -> None:
    """Refuse effects of which none can act at any place.

    Parameters
    ----------
    effects : sequence of Effect
        Candidate effects.
    places : sequence of Place
        Locations.

    Raises
    ------
    BadCase
        Nothing would be searched.
    """
    if any(admissible(effect, place) for effect in effects for place in places):
        return
    names = ", ".join(effect.name for effect in effects)
    at = sorted({name for effect in effects for name in effect.sought_at or ()})
    raise BadCase(
        f"{names} cannot act at {', '.join(at) or 'any place that the recordings show'}, so nothing would be searched; "
        "vlab effects NAME says where an effect acts"
    )


def admissible(effect: Effect, place: Place) -> bool:
    """Return whether an effect can act at a location.

    Parameters
    ----------
    effect : Effect
        Effect.
    place : Place
        Location.

    Returns
    -------
    bool
        Whether kind, family and needs of the effect match the location.
    """
    at = effect.sought_at
    if at is not None and not any(is_named(name, at) for name in (place.name, *place.aliases)):
        return False
    if effect.picks_up:
        return place.kind == "pick-up" and place.tag in effect.needs
    if effect.is_in_servo:
        return place.servo is not None and ("armature" not in effect.needs or place.servo.inertia > 0)
    if effect.kind in ("actuator", "sensor"):
        return place.kind == effect.kind and (not place.also or effect.traits.is_shared)
    if place.kind == "body":
        return effect.name == "added-mass"
    if place.kind != "port":
        return False
    if ("tension" in effect.needs) != (place.tag == "tension") or (len(place.rows) > 1 and not effect.needs):
        return False
    has = {
        "translation": not place.angular and len(place.rows) == 1,
        "rotation": place.angular,
        "stiffness": place.stiffness > 0,
        "coil": place.coil is not None,
        "magnet": place.coil is not None or not place.stiffness > 0,  # elsewhere a magnet is a softer element
    }
    return all(has.get(need, True) for need in effect.needs)


def at_place(effect: Effect, place: Place) -> Effect:
    """Return an effect with the numbers of its location.

    Parameters
    ----------
    effect : Effect
        Effect.
    place : Place
        Location at which the effect is admissible.

    Returns
    -------
    Effect
        The effect itself, or that of a servo at the location.
    """
    return at_servo(effect, place.servo) if isinstance(effect, ServoEffect) and place.servo is not None else effect


def reported_name(name: str, effect: Effect, driven: int) -> str:
    """Return the reported name of a structure's hardware.

    Parameters
    ----------
    name : str
        Name of the location.
    effect : Effect
        Effect, whose family selects the coil, the amplifier or the chain.
    driven : int
        Number of driven actuators. With a single coil, delay, filter and converters belong to the chain.

    Returns
    -------
    str
        Name in the report.
    """
    if not name.startswith("actuator:"):
        return name
    bare = name.removeprefix("actuator:")
    part = effect.traits.hardware
    if part == "chain":
        return "chain" if driven == 1 else f"coil:{bare}"
    return f"{part}:{bare}"


def places_of(
    plant: Plant,
    reduced_model: ReducedModel,
    channels: Sequence[str],
    driven: Sequence[int],
    free: Array | None = None,
    *,
    is_near_rest: bool = True,
) -> list[Place]:
    """Return the locations of a plant.

    Parameters
    ----------
    plant : Plant
        Plant.
    reduced_model : ReducedModel
        Modes of the plant.
    channels : sequence of str
        Names of the compared channels.
    driven : sequence of int
        Actuators driven by recordings or laws.
    free : (m, k) array or None
        Directions without restoring force; the rigid-body modes by default.
    is_near_rest : bool
        Whether the plant stays near rest, where a point that moves along one port is no further location.

    Returns
    -------
    list of Place
        Ports, bodies and sites, actuators, sensors and pick-ups.
    """
    ports: list[Place] = []
    names, data = list(plant.ports), plant.new_data()
    rows, outside = plant.port_rows(names) @ reduced_model.shapes, reduced_model.truncated.shapes
    scale = np.abs(rows).max(initial=0.0)
    free = np.eye(len(reduced_model.omega))[:, np.abs(reduced_model.omega) < LOCATIONS.free] if free is None else free
    for name, row in zip(names, rows, strict=True):
        if np.abs(row).max(initial=0.0) <= 1e-6 * scale:
            continue
        reduced_model_port = next(
            (i for i, p in enumerate(ports) if np.abs(p.rows[0] - row).max() <= LOCATIONS.same * np.abs(row).max()),
            None,
        )
        if reduced_model_port is not None and not plant.ports[name].tag:
            known = ports[reduced_model_port]
            stiffness = max(known.stiffness, plant.own_stiffness(name))
            ports[reduced_model_port] = replace(known, aliases=(*known.aliases, name), stiffness=stiffness)
            continue
        ports.append(
            Place(
                name=name,
                kind="port",
                rows=np.vstack([row, *(more.row(data) @ reduced_model.shapes for more in plant.ports[name].more)]),
                truncated=np.vstack([port.row(data) for port in (plant.ports[name], *plant.ports[name].more)])
                @ outside,
                angular=plant.ports[name].unit == "rad",
                stiffness=plant.own_stiffness(name),
                coil=_coil(reduced_model, row, driven),
                tag=plant.ports[name].tag,
                is_held=bool(np.abs(row @ free).max(initial=0.0) <= 1e-3 * np.abs(row).max()),
            )
        )
    ports = [_with_drive(reduced_model, port) for port in ports[: LOCATIONS.most_ports]]
    straight = [p for p in ports if is_near_rest or plant.ports[p.name].is_constant]
    out = [*ports, *_points(plant, reduced_model, straight)]
    out += [_actuator(plant, reduced_model, i) for i in driven]
    if len(driven) > 1:
        efforts, seen = _efforts(reduced_model, driven), out[-1].seen
        also = tuple(driven[1:])
        out.append(Place(name="chain", kind="actuator", index=driven[0], also=also, efforts=efforts, seen=seen))
    sensors = [f"sensor:{name.removeprefix('sensor:')}" for name in channels]
    out += [Place(name=name, kind="sensor", index=i) for i, name in enumerate(sensors)]
    return out + _pick_ups(plant, channels, sensors, driven)


def _actuator(plant: Plant, reduced_model: ReducedModel, index: int) -> Place:
    """Return an actuator; a position servo has its transmission's rows."""
    name, efforts = plant.actuators[index].name.removeprefix("coil:"), _efforts(reduced_model, [index])
    seen = 0.0 if reduced_model.efforts is None else float(reduced_model.efforts.seen[index])
    out = Place(name=f"actuator:{name}", kind="actuator", index=index, efforts=efforts, seen=seen)
    port, servo = servo_port(plant, index), servo_of(plant, index)
    if port is None or servo is None:
        return out
    row = port.row(plant.new_data())[None]
    rows, truncated = row @ reduced_model.shapes, row @ reduced_model.truncated.shapes
    return replace(
        out,
        rows=rows,
        truncated=truncated,
        angular=port.unit == "rad",
        coil=index,
        servo=servo,
        per_command=servo.gain,
    )


def _with_drive(reduced_model: ReducedModel, port: Place) -> Place:
    """Return a port with the force of the actuator along it, which force sensors read."""
    if port.coil is None or reduced_model.efforts is None:
        return port
    force, row = reduced_model.forces[:, port.coil], port.rows[0]
    return replace(
        port,
        efforts=_efforts(reduced_model, [port.coil]),
        seen=float(reduced_model.efforts.seen[port.coil]),
        per_command=float(force @ row / (row @ row)),
    )


def _efforts(reduced_model: ReducedModel, actuators: Sequence[int]) -> Array:
    """Return the readings of force sensors per unit command of some actuators."""
    efforts = reduced_model.efforts
    return np.zeros((0, 0)) if efforts is None else efforts.per_command[:, list(actuators)]


def _pick_ups(plant: Plant, channels: Sequence[str], sensors: Sequence[str], driven: Sequence[int]) -> list[Place]:
    """Return sensors paired with possible crosstalk signals."""
    own = [i for i, name in enumerate(channels) if tap_index(plant.sensors, name) is not None]
    out = [
        Place(name=f"{sensors[i]}/{plant.actuators[k].name}", kind="pick-up", index=i, other=k, tag="command")
        for i in own
        for k in driven
    ]
    if len(channels) > LOCATIONS.most_picked_up:
        return out
    return out + [
        Place(name=f"{sensors[i]}/{sensors[k].partition(':')[2]}", kind="pick-up", index=i, other=k, tag="sensor")
        for i in own
        for k in own
        if i != k
    ]


def _coil(reduced_model: ReducedModel, row: Array, driven: Sequence[int]) -> int | None:
    """Return the actuator along a port's row, or None."""
    for i in driven:
        force = reduced_model.forces[:, i]
        size = np.linalg.norm(force) * np.linalg.norm(row)
        if size > 0 and abs(force @ row) > 0.9999 * size:
            return i
    return None


def _points(plant: Plant, reduced_model: ReducedModel, ports: list[Place]) -> list[Place]:
    """Return bodies and sites without a port of the same motion.

    Added mass there needs three rows.
    """
    if not isinstance(plant, MjcfPlant):
        return []
    model, data = plant.model, plant.new_data()
    bodies = [("body", model.body(i).name) for i in range(1, model.nbody) if model.body_mass[i] > 0]
    sites = [("site", model.site(i).name) for i in range(model.nsite)]
    out: list[Place] = []
    for name in (f"{kind}:{own}" for kind, own in (*bodies, *sites) if own):
        port = port_at(plant, name)
        whole = np.array([one.row(data) for one in (port, *port.more)])
        rows = whole @ reduced_model.shapes
        if np.abs(rows).max(initial=0.0) == 0.0:
            continue
        moves = np.abs(rows).max(axis=1) > 1e-6 * np.abs(rows).max()
        moving = rows[moves]
        if len(moving) == 1 and any(_is_parallel(p.rows[0], moving[0]) for p in ports if not p.angular):
            continue
        if any(p.rows.shape == moving.shape and _is_parallel(p.rows, moving) for p in out):
            continue  # a site at a body's centre is no second location
        out.append(Place(name=name, kind="body", rows=moving, truncated=whole[moves] @ reduced_model.truncated.shapes))
    return out[: LOCATIONS.most_ports]


def _is_parallel(a: Array, b: Array) -> bool:
    """Return whether rows are equal up to sign."""
    return bool(np.abs(np.abs(a) - np.abs(b)).max() <= LOCATIONS.same * np.abs(b).max())
