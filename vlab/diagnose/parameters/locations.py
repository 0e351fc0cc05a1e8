"""Where physics can be missing: the places of a plant, in the twin's modal coordinates."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vlab.diagnose.parameters.reduced_model import ReducedModel
from vlab.diagnose.settings import LOCATIONS
from vlab.physics.attach import port_at
from vlab.physics.effect import Effect, PickUp
from vlab.physics.running import tap_index
from vlab.plants.base import Plant
from vlab.plants.mjcf import MjcfPlant
from vlab.signals import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Place:
    """One place.

    Parameters
    ----------
    name : str
        As a diagnosis reports it.
    kind : str
        ``"port"``, ``"body"``, ``"actuator"``, ``"sensor"``, or ``"pick-up"``: a sensor and a second signal.
    rows : (k, m) array
        Of a port its row per modal coordinate; of a body the three rows of its centre, or of a site.
    angular : bool
        The port is a rotation.
    stiffness : float
        Of the elastic element at the port; 0 without one.
    stiffened_by : tuple of int
        Uncertain parameters that multiply it.
    index : int
        Of an actuator or a channel.
    also : tuple of int
        More actuators, where the place is the chain that all share.
    other : int
        Of a pick-up the actuator or channel whose signal is picked up; `tag` is ``"command"`` or ``"sensor"``.
    coil : int or None
        The actuator that acts along the port.
    aliases : tuple of str
        Other names of the same port.
    tag : str
        As `vlab.plants.base.Port` has it.
    is_held : bool
        Something in the model brings the port back; a port that is free to move has no rest position.
    """

    name: str
    kind: str
    rows: Array = field(default_factory=lambda: np.zeros((0, 0)))
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

    def stiffness_at(self, theta: Array) -> Array:
        """Return the element's stiffness at log-factors of what is uncertain (n_sets, n_changes), (n_sets,)."""
        return np.asarray(self.stiffness * np.exp(theta[:, list(self.stiffened_by)].sum(axis=1)))

    @property
    def indices(self) -> tuple[int, ...]:
        """All actuators or channels of the place."""
        return (self.index, *self.also)


def admissible(effect: Effect, place: Place) -> bool:
    """Say whether an effect can act at a place."""
    if isinstance(effect, PickUp):
        return place.kind == "pick-up" and place.tag in effect.needs
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
        "magnet": place.coil is not None or not place.stiffness > 0,  # elsewhere an element is softer
    }
    return all(has.get(need, True) for need in effect.needs)


def reported_name(name: str, effect: Effect, driven: int) -> str:
    """Return what a place of a structure's hardware is called in a diagnosis: coil, amplifier or the chain of all channels.

    Parameters
    ----------
    name : str
        As `Place` has it.
    driven : int
        How many actuators are driven: what one coil alone shows of delay, filter and converters is the chain's.
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
    """Return the places of a plant.

    Parameters
    ----------
    channels : list of str
        Names of the compared channels.
    driven : list of int
        The actuators that recordings or laws drive.
    free : (m, k) array or None
        Directions in which nothing brings the plant back to rest; the twin's modes without a frequency by default.
    is_near_rest : bool
        The plant stays where a point that moves along one port at rest is no place of its own.
    """
    ports: list[Place] = []
    names, data = list(plant.ports), plant.new_data()
    rows = plant.port_rows(names) @ reduced_model.shapes
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
                angular=plant.ports[name].unit == "rad",
                stiffness=plant.own_stiffness(name),
                coil=_coil(reduced_model, row, driven),
                tag=plant.ports[name].tag,
                is_held=bool(np.abs(row @ free).max(initial=0.0) <= 1e-3 * np.abs(row).max()),
            )
        )
    ports = ports[: LOCATIONS.most_ports]
    straight = [p for p in ports if is_near_rest or plant.ports[p.name].is_constant]
    out = [*ports, *_points(plant, reduced_model, straight)]
    out += [
        Place(name=f"actuator:{plant.actuators[i].name.removeprefix('coil:')}", kind="actuator", index=i)
        for i in driven
    ]
    if len(driven) > 1:
        out.append(Place(name="chain", kind="actuator", index=driven[0], also=tuple(driven[1:])))
    sensors = [f"sensor:{name.removeprefix('sensor:')}" for name in channels]
    out += [Place(name=name, kind="sensor", index=i) for i, name in enumerate(sensors)]
    return out + _pick_ups(plant, channels, sensors, driven)


def _pick_ups(plant: Plant, channels: Sequence[str], sensors: Sequence[str], driven: Sequence[int]) -> list[Place]:
    """Return sensors with what they may pick up: the command of a coil, or what another sensor sees."""
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
    """Return the actuator whose force acts along a port's row."""
    for i in driven:
        force = reduced_model.forces[:, i]
        size = np.linalg.norm(force) * np.linalg.norm(row)
        if size > 0 and abs(force @ row) > 0.9999 * size:
            return i
    return None


def _points(plant: Plant, reduced_model: ReducedModel, ports: list[Place]) -> list[Place]:
    """Return the bodies and sites that move with no single port: added mass there has three rows."""
    if not isinstance(plant, MjcfPlant):
        return []
    model, data = plant.model, plant.new_data()
    bodies = [("body", model.body(i).name) for i in range(1, model.nbody) if model.body_mass[i] > 0]
    sites = [("site", model.site(i).name) for i in range(model.nsite)]
    out: list[Place] = []
    for name in (f"{kind}:{own}" for kind, own in (*bodies, *sites) if own):
        port = port_at(plant, name)
        rows = np.array([one.row(data) for one in (port, *port.more)]) @ reduced_model.shapes
        if np.abs(rows).max(initial=0.0) == 0.0:
            continue
        moving = rows[np.abs(rows).max(axis=1) > 1e-6 * np.abs(rows).max()]
        if len(moving) == 1 and any(_is_parallel(p.rows[0], moving[0]) for p in ports if not p.angular):
            continue
        if any(p.rows.shape == moving.shape and _is_parallel(p.rows, moving) for p in out):
            continue  # a site at a body's centre
        out.append(Place(name=name, kind="body", rows=moving))
    return out[: LOCATIONS.most_ports]


def _is_parallel(a: Array, b: Array) -> bool:
    """Return whether rows are the same but for their sense."""
    return bool(np.abs(np.abs(a) - np.abs(b)).max() <= LOCATIONS.same * np.abs(b).max())
