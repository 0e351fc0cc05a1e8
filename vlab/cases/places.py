"""Places of a model that the name of a column suggests.

Robot logs name joints in many ways: ``shoulder_pan.pos``, ``qpos_0``, ``/joint_states/position[2]``,
``observation.state[1]``. A suggestion stands in messages and overviews; nothing is taken from a suggestion silently.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from vlab.plants.base import ONE_WAY, Plant
from vlab.recordings.overview import kind_of

_INPUTS = ("command", "moment", "force", "voltage", "current")
"""Kinds of a column that more often drive than show a model."""
_GENERIC = {"joint", "jnt", "hinge", "slide", "servo", "motor", "actuator", "act", "sensor", "encoder", "enc"}
"""Words of an element's name that say what the element is; a log often leaves such words out."""
_MOTIONS = {"position": "displacement", "velocity": "velocity", "acceleration": "acceleration", "": "displacement"}
"""Kinds of motion of a site, by the quantity that a name suggests."""
_OUTER = re.compile(r".*[./]")
_NUMBER = re.compile(r"(?:\[(\d+)\]|[_/.]?(\d+))\s*(?:[._/]\w+)?\s*$")


@dataclass(frozen=True, kw_only=True)
class Suggestion:
    """Place of a column, with its kind.

    Parameters
    ----------
    at : str
        Actuator, sensor, joint or site of the model.
    kind : str
        Kind of channel.
    is_input : bool
        Whether the column drives the model.
    """

    at: str
    kind: str
    is_input: bool


def suggest(
    column: str, plant: Plant, *, is_input: bool | None = None, first: int = 0, kind: str = ""
) -> Suggestion | None:
    """Return the place that the name of a column suggests.

    Parameters
    ----------
    column : str
        Name of the column.
    plant : Plant
        Model.
    is_input : bool, optional
        Whether the column drives the model; from its name by default.
    first : int
        Number of the first joint or actuator in the names of columns.
    kind : str
        Quantity of the column, where the name tells none.

    Returns
    -------
    Suggestion or None
        None if the name fits no single place. Names count first, then numbers in the order of the model.
    """
    kind = kind_of(column) or kind
    drives = kind in _INPUTS if is_input is None else is_input
    joints = joints_of(plant)
    sensor = next((tap for tap in plant.sensors if tap.name == column), None)
    if sensor is not None and is_input is None and all(tap.name != column for tap in plant.actuators):
        return Suggestion(at=sensor.name, kind=sensor.kind, is_input=False)
    if drives:
        actuators = [tap.name for tap in plant.actuators if tap.name]
        joint = _named(column, joints)
        of_joint = actuators_of(plant, joint) if joint else []
        at = (
            of_joint[0]
            if len(of_joint) == 1
            else _named(column, actuators) or _numbered(column, actuators, kind, first)
        )
        kind = "command" if kind in ("", "position") else kind
        return None if at is None else Suggestion(at=at, kind=kind, is_input=True)
    sensors = [tap.name for tap in plant.sensors]
    if sensor is not None:
        return Suggestion(at=sensor.name, kind=sensor.kind, is_input=False)
    joint = _named(column, joints) or _numbered(column, joints, kind, first)
    if joint is not None and kind in ("position", "velocity", "acceleration", ""):
        return Suggestion(at=f"joint:{joint}", kind=_kind(plant, joint, kind), is_input=False)
    named = _named(column, sensors)
    tap = next((tap for tap in plant.sensors if tap.name == named), None)
    if tap is not None:
        return Suggestion(at=tap.name, kind=tap.kind, is_input=False)
    site = _at_site(column, plant, kind)
    if site is not None:
        return site
    own = _OUTER.sub("", column)  # an entry of a nested log
    is_actuator = is_input is None and own in [tap.name for tap in plant.actuators]
    return Suggestion(at=own, kind="command", is_input=True) if is_actuator and kind in ("", "position") else None


def _at_site(column: str, plant: Plant, kind: str) -> Suggestion | None:
    """Return the motion of a site along one axis.

    The axis stands in the name, or is the only one along which the site moves. A sensor of several values with such a name and quantity comes first.
    """
    sites = list(dict.fromkeys(axis[5:-2] for axis in plant.ports if axis.startswith("site:")))
    site = _named(column, sites)
    if site is None or kind not in _MOTIONS:
        return None
    of_kind = {tap.name.rpartition(".")[0] for tap in plant.sensors if not kind or tap.kind == _MOTIONS[kind]}
    if _named(column, sorted(of_kind - {""})) is not None:
        return None
    axes = [f"site:{site}.{axis}" for axis in "xyz" if f"site:{site}.{axis}" in plant.ports]
    data: Any = mujoco.MjData(plant.model)
    mujoco.mj_forward(plant.model, data)
    sizes = {axis: float(np.abs(plant.ports[axis].row(data)).max(initial=0.0)) for axis in axes}
    still = np.sqrt(np.finfo(float).eps) * max(sizes.values(), default=0.0)
    moving = [axis for axis, size in sizes.items() if size > still]
    named = [axis for axis in axes if axis[-1] in _words(column)]
    chosen = named or moving
    return Suggestion(at=chosen[0], kind=_MOTIONS[kind], is_input=False) if len(chosen) == 1 else None


def element_of(at: str) -> str:
    """Return the name of the element at a place.

    Parameters
    ----------
    at : str
        Place, such as ``joint:elbow`` or ``site:tip.y``.

    Returns
    -------
    str
        Name, such as ``elbow`` or ``tip``.
    """
    kind, _, name = at.rpartition(":")
    return name.rpartition(".")[0] if kind == "site" else name


def joints_of(plant: Plant) -> list[str]:
    """Return the named hinges and slides of a model."""
    model = plant.model
    return [model.joint(i).name for i in range(model.njnt) if int(model.jnt_type[i]) in ONE_WAY and model.joint(i).name]


def _kind(plant: Plant, joint: str, kind: str) -> str:
    is_hinge = int(plant.model.joint(joint).type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE)
    words = {"velocity": "velocity", "acceleration": "acceleration"}
    if kind in words:
        return f"angular-{kind}" if is_hinge else kind
    return "angle" if is_hinge else "displacement"


def actuators_of(plant: Plant, joint: str) -> list[str]:
    """Return the named actuators on a joint.

    Parameters
    ----------
    plant : Plant
        Model.
    joint : str
        Name of the joint.

    Returns
    -------
    list of str
        Names in the order of the model.
    """
    model: Any = plant.model
    number = int(model.joint(joint).id)
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return [
        model.actuator(i).name
        for i in range(model.nu)
        if int(model.actuator_trntype[i]) in kinds
        and int(model.actuator_trnid[i, 0]) == number
        and model.actuator(i).name
    ]


def _words(name: str) -> list[str]:
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    return [part.lower() for part in re.split(r"[^a-zA-Z0-9]+", spaced) if part]


def _named(column: str, names: Sequence[str]) -> str | None:
    """Return the longest name whose words stand in a column's name.

    Where no whole name is found, names count without their generic words.
    """
    words = _words(column)
    for shortened in (False, True):
        found = []
        for name in names:
            own = [w for w in _words(name) if w not in _GENERIC or not shortened]
            if own and any(words[i : i + len(own)] == own for i in range(len(words) - len(own) + 1)):
                found.append((len(own), name))
        longest = max((length for length, _ in found), default=0)
        best = [name for length, name in found if length == longest]
        if best:
            return best[0] if len(best) == 1 else None
    return None


def is_in_name(column: str, names: Sequence[str]) -> bool:
    """Return whether a column's name holds one of some names.

    Parameters
    ----------
    column : str
        Name of the column.
    names : sequence of str
        Names of elements, whose generic words may be missing.
    """
    return any(_named(column, [name]) is not None for name in names)


def numbered_from(columns: Sequence[str], count: int) -> int:
    """Return the number of the first element in numbered columns.

    Parameters
    ----------
    columns : sequence of str
        Names of columns of one file.
    count : int
        Number of joints or actuators.

    Returns
    -------
    int
        1 if some names are alike but for numbers from 1 to `count`, else 0.
    """
    stems: dict[str, set[int]] = {}
    for column in columns:
        match = _NUMBER.search(column)
        if match is not None:
            span = match.span(1) if match[1] else match.span(2)
            stems.setdefault(column[: span[0]] + column[span[1] :], set()).add(int(match[1] or match[2]))
    return int(any(numbers == set(range(1, count + 1)) for numbers in stems.values()))


def _numbered(column: str, names: Sequence[str], kind: str, first: int) -> str | None:
    """Return the name of a numbered column, such as ``qpos_0`` or ``position[2]``."""
    match = _NUMBER.search(column)
    if match is None or not kind:
        return None
    number = int(match[1] or match[2]) - first
    return names[number] if 0 <= number < len(names) else None
