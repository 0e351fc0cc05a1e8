"""Columns of a log matched to actuators, sensors and joints.

Names are compared by `vlab.cases.places`. The type of the actuator and the values decide between several candidates.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco

from vlab import units
from vlab.cases.draft.lead import leads
from vlab.cases.draft.logs import Log
from vlab.cases.draft.model import feedback_of
from vlab.cases.draft.vector_sensors import VectorSensor, only_vector_sensor, vector_sensor
from vlab.cases.places import Suggestion, actuators_of, element_of, is_in_name, joints_of, numbered_from, suggest
from vlab.files.text import in_line
from vlab.plants.base import ActuatorTap, Plant
from vlab.recordings.overview import ColumnOverview, kind_of, kind_of_unit
from vlab.signals import KIND_UNITS

EFFORTS = ("moment", "force", "current", "voltage")
"""EFFORTS: kinds of a column that drive a motor, and show the effort of a servo."""
RATES = ("velocity", "angular-velocity", "acceleration", "angular-acceleration")
"""RATES: kinds of motion that a log mostly derives from positions."""
EXCITATION = "excitation:"
"""EXCITATION: start of the name of a column of `vlab experiment` that is part of another column."""
JOINT_SENSORS = {0: mujoco.mjtSensor.mjSENS_JOINTPOS, 1: mujoco.mjtSensor.mjSENS_JOINTVEL}
"""JOINT_SENSORS: sensor of a joint by order of its time derivative."""


@dataclass(frozen=True, kw_only=True)
class Match:
    """Column with its place in the model.

    Parameters
    ----------
    column : str
        Name in the table.
    label : str
        Name for the case.
    at : str
        Actuator, sensor or joint.
    kind : str
        Kind of channel.
    is_input : bool
        Whether the column drives the model.
    why : str
        Reason of the place.
    stated : str
        Unit stated by file or name; empty if none.
    unit, why_unit : str
        Chosen unit with its reason.
    is_place_sure, is_unit_sure : bool
        Whether names or values leave no doubt about place and role, and about the unit.
    scale : float or None
        Model unit per file unit, where the user must state the value.
    wraps : int
        Number of jumps by a full turn in all logs.
    turn : str
        Unit in which the jumps are a full turn; empty without jumps.
    """

    column: str
    label: str
    at: str
    kind: str
    is_input: bool
    why: str
    stated: str = ""
    unit: str = ""
    why_unit: str = ""
    is_place_sure: bool = True
    is_unit_sure: bool = True
    scale: float | None = None
    wraps: int = 0
    turn: str = ""

    @property
    def is_sure(self) -> bool:
        """Whether the user has nothing to confirm."""
        return self.is_place_sure and self.is_unit_sure


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """Column that the draft does not use.

    Parameters
    ----------
    label : str
        Name for the case.
    why : str
        Reason.
    """

    label: str
    why: str


@dataclass(frozen=True, kw_only=True)
class Matched:
    """Columns of a log, used and left out, with remarks."""

    used: tuple[Match, ...]
    left_out: tuple[LeftOut, ...]
    unread: tuple[str, ...] = ()


def unit_of(plant: Plant, match: Match) -> str:
    """Return the SI unit of a column at its place.

    A servo takes the unit of its joint's motion.

    Parameters
    ----------
    plant : Plant
        Model.
    match : Match
        Column with its place.

    Returns
    -------
    str
        SI unit; empty for a free unit.
    """
    si = KIND_UNITS[match.kind]
    if si is not None or not match.is_input:
        return si or ""
    follows, model = feedback_of(plant, match.at), plant.model
    names = [model.actuator(i).name for i in range(model.nu)]
    if not follows or match.at not in names:
        return ""
    number = names.index(match.at)
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    if int(model.actuator_trntype[number]) not in kinds or model.actuator_gear[number, 0] != 1.0:
        return ""
    joint = int(model.jnt_type[int(model.actuator_trnid[number, 0])])
    unit = {int(mujoco.mjtJoint.mjJNT_HINGE): "rad", int(mujoco.mjtJoint.mjJNT_SLIDE): "m"}.get(joint, "")
    return f"{unit}/s" if unit and follows == "velocity" else unit


def match_columns(log: Log, plant: Plant, clock: str | None) -> Matched:
    """Match the columns of a log to a model.

    Parameters
    ----------
    log : Log
        Log.
    plant : Plant
        Model.
    clock : str or None
        Time column.

    Returns
    -------
    Matched
        At most one column an input and a quantity of a place.
    """
    first = numbered_from([log.label(c.name) for c in log.columns], len(joints_of(plant)))
    matcher = _Matcher(log, plant, first, clock)
    for name, why in log.table.refused.items():
        matcher.add_unread(name, why)
    for column in log.columns:
        if column.name != clock:
            matcher.add(column)
    matcher.tell_commands()
    matcher.take_the_only_ones()
    return Matched(used=matcher.used(), left_out=tuple(matcher.left_out), unread=tuple(matcher.unread))


class _Matcher:
    """Candidates of every place, in the order of the columns."""

    def __init__(self, log: Log, plant: Plant, first: int, clock: str | None) -> None:
        self.log, self.plant, self.first = log, plant, first
        counts = [column.rows for column in log.columns]
        self.rows = len(log.table[clock]) if clock is not None else max(counts, key=counts.count)
        self.taps = {tap.name: tap for tap in plant.actuators if tap.name}
        self.candidates: list[Match] = []
        self.left_out: list[LeftOut] = []
        self.unplaced: list[ColumnOverview] = []
        self.unread: list[str] = []

    # ---- single columns -------------------------------------------------------------------------------------------

    def add(self, column: ColumnOverview) -> None:
        """Find the place of a column, or leave the column out."""
        label = self.log.label(column.name)
        if column.kind.startswith(("time", "frequency", "complex", "temperature", "error", "flag")):
            self._leave(label, f"by its name, its quantity is {column.kind.split(',')[0]}")
            return
        if column.name.startswith(EXCITATION):
            self._leave(label, "the excitation is part of the actuator's command, which has a column of its own")
            return
        if column.rows == column.blank:
            self._leave(label, "it has no values")
            return
        if column.rows != self.rows:
            self._leave(label, f"it has {column.rows} rows, and the clock {self.rows}")
            return
        names = dict.fromkeys((label, column.name))
        given = (suggest(name, self.plant, first=self.first, kind=column.kind) for name in names)
        found = next((place for place in given if place is not None), None)
        vector = vector_sensor(self.plant, list(names), column.kind) if found is None else None
        if vector is not None:
            self._take_axis(column, vector)
        elif found is None:
            self.unplaced.append(column)
        else:
            is_named = any(is_in_name(name, self._element(found)) for name in names)
            self._take(column, found, "its name" if is_named else "its number", is_sure=is_named)

    def add_unread(self, name: str, why: str) -> None:
        """Leave out a column without numbers, perhaps with a remark."""
        label = in_line(self.log.label(name))
        self._leave(label, f"it cannot be read: {in_line(why)}")
        place = suggest(label, self.plant, first=self.first, kind=kind_of(name))
        if place is not None:
            self.unread.append(
                f"column {label!r} belongs to {in_line(place.at)} by its name, and cannot be read: {in_line(why)}"
            )

    def _take(self, column: ColumnOverview, found: Suggestion, why: str, *, is_sure: bool = True) -> None:
        label = self.log.label(column.name)
        match = Match(
            column=column.name,
            label=label,
            at=found.at if found.is_input else self._sensor_of(found),
            kind=found.kind,
            is_input=found.is_input,
            why=why,
            stated=column.unit,
            is_place_sure=is_sure,
        )
        if found.is_input:
            follows = feedback_of(self.plant, found.at)
            if follows and found.kind in EFFORTS:
                self._leave_effort(match, follows)
                return
            by_unit = kind_of_unit(column.unit)
            given = by_unit if by_unit in ("current", "voltage") else found.kind
            match = replace(match, kind=_input_kind(self.taps[found.at], given))
            if match.kind in ("voltage", "current") and self.taps[found.at].unit != "command":
                match = replace(match, scale=1.0, is_unit_sure=False)
        if self._has_other_unit(match):
            return
        if not match.is_input and column.least == column.greatest:
            self._leave(label, f"it is {column.least:g} throughout")
            return
        self.candidates.append(match)

    def _take_axis(self, column: ColumnOverview, vector: VectorSensor) -> None:
        """Take the value of a vector sensor that moves, if it is one."""
        if len(vector.moving) == 1:
            found = Suggestion(at=vector.moving[0], kind=vector.kind, is_input=False)
            self._take(column, found, "its name, and the only axis along which the model moves")
            return
        label = self.log.label(column.name)
        self._leave(label, f"sensor {in_line(vector.name)!r} has several values")
        self.unread.append(f"column {label!r} belongs to one of {', '.join(map(in_line, vector.names))}: name it so")

    def _element(self, found: Suggestion) -> list[str]:
        """Return the names of a place and of its joint."""
        name = element_of(found.at)
        return [name, *(j for j in joints_of(self.plant) if found.is_input and name in actuators_of(self.plant, j))]

    def _has_other_unit(self, match: Match) -> bool:
        """Leave out a column whose stated unit is none of its place."""
        si = unit_of(self.plant, match)
        if not match.stated or not si or units.same_dimension(match.stated, si):
            return False
        self._leave(match.label, f"{in_line(match.at)!r} is in {si}, and the column in {in_line(match.stated)}")
        return True

    def _sensor_of(self, found: Suggestion) -> str:
        """Return the model's sensor of a joint, or else the joint."""
        kind, _, joint = found.at.partition(":")
        order = {"angle": 0, "displacement": 0, "angular-velocity": 1, "velocity": 1}.get(found.kind)
        if kind != "joint" or order is None:
            return found.at
        model: Any = self.plant.model
        number = int(model.joint(joint).id)
        own = [
            model.sensor(i).name
            for i in range(model.nsensor)
            if int(model.sensor_type[i]) == int(JOINT_SENSORS[order]) and int(model.sensor_objid[i]) == number
        ]
        return own[0] if len(own) == 1 and own[0] else found.at

    def _leave_effort(self, match: Match, follows: str) -> None:
        model: Any = self.plant.model
        number = int(model.actuator(match.at).id)
        own = [
            model.sensor(i).name
            for i in range(model.nsensor)
            if int(model.sensor_type[i]) == int(mujoco.mjtSensor.mjSENS_ACTUATORFRC)
            and int(model.sensor_objid[i]) == number
            and model.sensor(i).name
        ]
        taps = {tap.name: tap for tap in self.plant.sensors}
        if own and match.kind in ("moment", "force"):
            kind = taps[own[0]].kind
            self.candidates.append(replace(match, at=own[0], kind=kind, is_input=False))
            return
        name = f"{match.at}_effort"
        why = f"{in_line(match.at)!r} is a {follows} servo, which takes a target and no effort"
        if match.kind in ("moment", "force"):
            why += f'; to compare the effort, add <actuatorfrc name="{name}" actuator="{match.at}"/> to <sensor>'
        self._leave(match.label, why)

    def _leave(self, label: str, why: str) -> None:
        self.left_out.append(LeftOut(label=label, why=why))

    # ---- several columns --------------------------------------------------------------------------------------------

    def tell_commands(self) -> None:
        """Make the earlier of two joint positions the servo's command."""
        driven = {match.at for match in self.candidates if match.is_input}
        for joint in joints_of(self.plant):
            servos = [a for a in actuators_of(self.plant, joint) if feedback_of(self.plant, a) == "position"]
            places = {f"joint:{joint}", self._sensor_of(Suggestion(at=f"joint:{joint}", kind="angle", is_input=False))}
            shown = [m for m in self.candidates if m.at in places and m.kind in ("angle", "displacement")]
            if len(servos) != 1 or servos[0] in driven or len(shown) < 2:
                continue
            one, other = shown[:2]
            is_first = leads(self.log.table.real(one.column), self.log.table.real(other.column))
            command, reading = (one, other) if is_first is not False else (other, one)
            why = "its name, and it is ahead of" if is_first is not None else "its name, and it comes before"
            as_input = replace(
                command,
                at=servos[0],
                kind="command",
                is_input=True,
                why=f"{why} {in_line(reading.label)!r}",
                is_place_sure=False,
            )
            self.candidates[self.candidates.index(command)] = as_input

    def take_the_only_ones(self) -> None:
        """Give the only free place to the only column that fits."""
        used = {match.at for match in self.candidates}
        free = [name for name in self.taps if name not in used]
        inputs = [c for c in self.unplaced if c.kind in ("command", *EFFORTS)]
        inputs = [c for c in inputs if c.kind == "command"] or inputs  # efforts beside commands are readings
        if len(free) == 1 and len(inputs) == 1 and not any(m.is_input for m in self.candidates):
            (column,) = inputs
            self.unplaced.remove(column)
            self._take(
                column, Suggestion(at=free[0], kind=column.kind, is_input=True), "the only actuator", is_sure=False
            )
        self._take_the_only_axis()
        self._take_the_only_joints()
        place = self._only_output()
        if place is not None and all(m.is_input for m in self.candidates):
            for kind in ("position", "velocity", "acceleration"):
                outputs = [c for c in self.unplaced if c.kind == kind and c not in inputs]
                found = self._output(place, kind)
                if len(outputs) == 1 and found is not None:
                    self.unplaced.remove(outputs[0])
                    self._take(outputs[0], found, "the only place", is_sure=False)
                    break
        for column in self.unplaced:
            self._leave(self.log.label(column.name), "no joint, sensor or actuator has its name")

    def _take_the_only_axis(self) -> None:
        """Give the only sensor, of three values, to the only column of its quantity."""
        vector = only_vector_sensor(self.plant)
        if vector is None or len(vector.moving) != 1 or not all(m.is_input for m in self.candidates):
            return
        outputs = [c for c in self.unplaced if c.kind == vector.kind.removeprefix("angular-")]
        if len(outputs) == 1:
            self.unplaced.remove(outputs[0])
            why = f"the only axis of the only sensor {in_line(vector.name)!r} along which the model moves"
            found = Suggestion(at=vector.moving[0], kind=vector.kind, is_input=False)
            self._take(outputs[0], found, why, is_sure=False)

    def _take_the_only_joints(self) -> None:
        """Give the only free hinge, or slide, to the only column in its unit."""
        free = unused_places(self.plant, [m for m in self.candidates if not m.is_input])
        for si, kind, what in (("rad", "angle", "hinge"), ("m", "displacement", "slide")):
            ports = {name: self.plant.ports[f"joint:{name}"] for name in joints_of(self.plant)}
            fitting = [name for name, port in ports.items() if port.unit == si and f"joint {name!r}" in free]
            columns = [c for c in self.unplaced if c.kind in ("position", "") and c.unit in units.WRITTEN[si]]
            if len(fitting) == 1 and len(columns) == 1:
                self.unplaced.remove(columns[0])
                place = Suggestion(at=f"joint:{fitting[0]}", kind=kind, is_input=False)
                self._take(columns[0], place, f"the only {what} without a column", is_sure=False)

    def _only_output(self) -> str | None:
        sensors, joints = [tap.name for tap in self.plant.sensors], joints_of(self.plant)
        if len(sensors) == 1:
            return sensors[0]
        return f"joint:{joints[0]}" if len(joints) == 1 and not sensors else None

    def _output(self, at: str, kind: str) -> Suggestion | None:
        tap = next((tap for tap in self.plant.sensors if tap.name == at), None)
        if tap is not None:
            word = {"displacement": "position", "angle": "position"}.get(tap.kind, tap.kind.removeprefix("angular-"))
            return Suggestion(at=at, kind=tap.kind, is_input=False) if word == kind else None
        if self.plant.ports[at].unit == "rad":
            return Suggestion(at=at, kind={"position": "angle"}.get(kind, f"angular-{kind}"), is_input=False)
        return Suggestion(at=at, kind={"position": "displacement"}.get(kind, kind), is_input=False)

    # ---- the choice -------------------------------------------------------------------------------------------------

    def used(self) -> tuple[Match, ...]:
        """Return one column for each input and each quantity of a place."""
        out: list[Match] = []
        for match in self.candidates:
            same = [m for m in self.candidates if (m.at, m.is_input, m.kind) == (match.at, match.is_input, match.kind)]
            if match.is_input:
                same = [m for m in self.candidates if m.is_input and m.at == match.at]
            best = min(same, key=lambda m: (self._rank(m), len(m.label)))
            if match is not best:
                self._leave(match.label, f"{in_line(best.label)!r} stands for {in_line(best.at)!r}")
            elif not match.is_input and match.kind in RATES and self._is_position_known(match):
                self._leave(
                    match.label, "the position is compared; a log mostly derives such a column from the position"
                )
            else:
                out.append(match)
        return tuple(sorted(out, key=lambda m: not m.is_input))

    def _rank(self, match: Match) -> int:
        """Return 0 for the kind that an actuator takes."""
        if not match.is_input:
            return 0
        wanted = ("command",) if feedback_of(self.plant, match.at) else (self.taps[match.at].kind, *EFFORTS)
        return int(match.kind not in wanted)

    def _is_position_known(self, match: Match) -> bool:
        joint = _joint_at(self.plant, match.at)
        return joint is not None and any(
            m.kind in ("angle", "displacement") and not m.is_input and _joint_at(self.plant, m.at) == joint
            for m in self.candidates
        )


def _input_kind(tap: ActuatorTap, kind: str) -> str:
    """Return the kind of an input that an actuator accepts."""
    if tap.unit == "command":
        return kind if kind in ("voltage", "current") else "command"
    return tap.kind if kind not in ("voltage", "current") else kind


def _joint_at(plant: Plant, at: str) -> int | None:
    """Return the joint that a place shows."""
    model: Any = plant.model
    if at.startswith("joint:"):
        return int(model.joint(at.removeprefix("joint:")).id)
    for i in range(model.nsensor):
        if model.sensor(i).name == at and int(model.sensor_type[i]) in map(int, JOINT_SENSORS.values()):
            return int(model.sensor_objid[i])
    return None


def unused_places(plant: Plant, used: Sequence[Match]) -> list[str]:
    """Return actuators and joints of the model without a column.

    Parameters
    ----------
    plant : Plant
        Model.
    used : sequence of Match
        Matched columns.

    Returns
    -------
    list of str
        Names with the type of element, such as ``joint 'elbow'``.
    """
    driven = {match.at for match in used if match.is_input}
    shown = {_joint_at(plant, match.at) for match in used if not match.is_input}
    model: Any = plant.model
    free = [f"actuator {tap.name!r}" for tap in plant.actuators if tap.name and tap.name not in driven]
    return free + [f"joint {name!r}" for name in joints_of(plant) if int(model.joint(name).id) not in shown]
