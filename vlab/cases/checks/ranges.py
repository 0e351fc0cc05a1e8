"""Angles beyond the ranges of the model, such as degrees for radians.

A joint cannot leave its range by far, and a command lies within the range of its actuator. A position servo without a
range has that of its joint. Numbers that leave the range
in the stated unit and stay inside in the other unit of angle are in that other unit. The check needs no simulation.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.correction import Column, Correction, Found, Taken, columns_of, mend_in
from vlab.plants.base import Plant
from vlab.signals import KIND_UNITS, Array

MARGIN = 0.1
"""MARGIN [1]: distance beyond a range, as a share of its span, that play and calibration explain."""
FAR = 1.0
"""FAR [1]: distance of a servo's command beyond the range of its joint, as a share of the span, that is reported in any
unit; raising it lets commands into a stop pass. A command somewhat beyond presses the joint against its stop."""
_UNITS = {int(mujoco.mjtJoint.mjJNT_HINGE): "rad", int(mujoco.mjtJoint.mjJNT_SLIDE): "m"}
OTHER = {"rad": "deg", "deg": "rad"}
"""OTHER: unit that an angle may be mistaken for."""


def check_ranges(case: Case, runs: Sequence[Run]) -> list[Found]:
    """Return angles and commands in another unit than stated.

    Parameters
    ----------
    case : Case
        Case with its model.
    runs : sequence of Run
        Recordings of the case.

    Returns
    -------
    list of Found
        Warnings with the edit of the case.
    """
    out = []
    for name, column in columns_of(case).items():
        with_channel = [run.measured[name] for run in runs if name in run.measured.names]
        if with_channel:
            values = np.concatenate(with_channel)
            found = _in_other_unit(case, name, column, values) or _far_outside(case, name, column, values)
            out += [found] if found is not None else []
    return out


def _in_other_unit(case: Case, name: str, column: Column, values: Array) -> Found | None:
    """Return a channel within its range in the other unit."""
    table = column.table
    is_bare = table.input and table.scale == 1.0  # the numbers are the command, and a servo of a hinge takes radians
    unit = "rad" if is_bare else table.unit
    other = OTHER.get(unit)
    limits = limits_of(case.plant, table.at, table.kind, is_input=table.input)
    if other is None or limits is None or (table.scale is not None and not is_bare):
        return None
    is_turning = _unit_of(case.plant, table.at) == "rad"
    if is_bare and not (is_turning and _is_servo(case.plant.model, _actuator(case.plant.model, table.at))):
        return None
    # the channel of a free kind keeps the stated unit; the model's own is the radian
    values = values * (units.factor(unit, "rad") / column.factor)
    ratio = units.factor(other, "rad") / units.factor(unit, "rad")
    reach = (_servo_range(case.plant, table.at) if table.input else None) or limits
    if is_inside(values, limits) or not is_inside(values * ratio, reach):
        return None
    edit = Correction(taken=(Taken(channel=name, source=name, factor=1.0 / ratio, unit=other),)).edits(case)
    low, high = (f"{limit / units.factor(unit, 'rad'):.4g}" for limit in reach)
    worst = values[np.argmax(np.abs(values))] / units.factor(unit, "rad")
    text = (
        f"{name} reaches {worst:.4g} {unit}, and the model's range is {low} to {high} {unit}; "
        f"in {other} the numbers stay inside{mend_in(case)}{edit}"
    )
    return Found(severity="warning", text=text, channels=(name,), mend=edit)


def _far_outside(case: Case, name: str, column: Column, values: Array) -> Found | None:
    """Return a servo's command far outside the range of its joint."""
    table = column.table
    limits = _servo_range(case.plant, table.at) if table.input else None
    if limits is None or KIND_UNITS[table.kind] not in (None, "rad", "m"):
        return None
    if table.scale is None:  # as above, a channel of a free kind keeps the stated unit
        si = next((own for own in ("rad", "m") if units.same_dimension(table.unit, own)), None)
        if si is None:
            return None
        values = values * (units.factor(table.unit, si) / column.factor)
    if is_inside(values, limits, margin=FAR):
        return None
    worst, unit = values[np.argmax(np.abs(values - np.mean(limits)))], _unit_of(case.plant, table.at)
    text = (
        f"{name} reaches {worst:.4g} {unit}, and the joint of this position servo moves from {limits[0]:.4g} to "
        f"{limits[1]:.4g} {unit}; check the unit of the column and the range of the joint"
    )
    return Found(severity="warning", text=text, channels=(name,))


def is_inside(values: Array, limits: tuple[float, float], *, margin: float = MARGIN) -> bool:
    """Return whether values keep to a range, play and calibration aside.

    Parameters
    ----------
    values : array
        Values in the unit of the range.
    limits : tuple of float
        Range.
    margin : float
        Distance beyond the range that counts as inside, as a share of its span.
    """
    slack = margin * (limits[1] - limits[0])
    return bool(values.min() >= limits[0] - slack and values.max() <= limits[1] + slack)


def limits_of(plant: Plant, at: str, kind: str, *, is_input: bool) -> tuple[float, float] | None:
    """Return the range of a joint or its position servo [rad or m].

    The commands of a position servo without a range reach beyond its joint by `FAR`.

    Parameters
    ----------
    plant : Plant
        Model.
    at : str
        Actuator, joint or joint sensor.
    kind : str
        Kind of channel.
    is_input : bool
        Whether the channel drives the model.

    Returns
    -------
    tuple of float or None
        None for an unlimited or any other place.
    """
    model = plant.model
    if is_input:
        i = _actuator(model, at)
        joint = None if i is None else _joint_of(model, i)
        if i is None or joint is None or KIND_UNITS[kind] not in (None, _UNITS.get(int(model.jnt_type[joint]))):
            return None
        if int(model.jnt_type[joint]) not in _UNITS:
            return None
        if not model.actuator_ctrllimited[i]:
            reach = _servo_range(plant, at)
            room = 0.0 if reach is None else FAR * (reach[1] - reach[0])
            return None if reach is None else (reach[0] - room, reach[1] + room)
        return float(model.actuator_ctrlrange[i, 0]), float(model.actuator_ctrlrange[i, 1])
    number = _joint(model, at) if kind in ("angle", "displacement") else None
    if number is None or _UNITS.get(int(model.jnt_type[number])) != KIND_UNITS[kind] or not model.jnt_limited[number]:
        return None
    return float(model.jnt_range[number, 0]), float(model.jnt_range[number, 1])


def _actuator(model: Any, at: str) -> int | None:
    """Return the actuator of a place."""
    names = [model.actuator(i).name for i in range(model.nu)]
    return next((k for k, name in enumerate(names) if name and at in (name, f"actuator:{name}")), None)


def _joint_of(model: Any, i: int) -> int | None:
    """Return the joint that an actuator drives."""
    kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return int(model.actuator_trnid[i, 0]) if int(model.actuator_trntype[i]) in kinds else None


def _is_servo(model: Any, i: int | None) -> bool:
    """Return whether an actuator is a position servo."""
    if i is None or int(model.actuator_biastype[i]) != int(mujoco.mjtBias.mjBIAS_AFFINE):
        return False
    gain = float(model.actuator_gainprm[i, 0])
    return gain > 0.0 and bool(model.actuator_biasprm[i, 1] == -gain)


def _servo_range(plant: Plant, at: str) -> tuple[float, float] | None:
    """Return the commands of an unlimited position servo inside its joint's range.

    The unit is m or rad.
    """
    model = plant.model
    i = _actuator(model, at)
    joint = None if i is None else _joint_of(model, i)
    if i is None or joint is None or model.actuator_ctrllimited[i] or not model.jnt_limited[joint]:
        return None
    if not _is_servo(model, i):
        return None
    gear = float(model.actuator_gear[i, 0])
    low, high = sorted(gear * float(limit) for limit in model.jnt_range[joint])
    return low, high


def _unit_of(plant: Plant, at: str) -> str:
    """Return the unit of the joint of an actuator."""
    i = _actuator(plant.model, at)
    joint = None if i is None else _joint_of(plant.model, i)
    return "rad" if joint is None else _UNITS.get(int(plant.model.jnt_type[joint]), "rad")


def _joint(model: Any, at: str) -> int | None:
    """Return the joint of a place or of a position sensor."""
    for i in range(model.njnt):
        if model.joint(i).name and at == f"joint:{model.joint(i).name}":
            return i
    for i in range(model.nsensor):
        is_position = int(model.sensor_type[i]) == int(mujoco.mjtSensor.mjSENS_JOINTPOS)
        if is_position and model.sensor(i).name and at in (model.sensor(i).name, f"sensor:{model.sensor(i).name}"):
            return int(model.sensor_objid[i])
    return None
