"""Angles beyond the ranges of the model, such as degrees for radians.

A joint cannot leave its range by far, and a command lies within the range of its actuator. Numbers that leave the range
in the stated unit and stay inside in the other unit of angle are in that other unit. The check needs no simulation.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.correction import Correction, Found, Taken, columns_of
from vlab.plants.base import Plant
from vlab.signals import KIND_UNITS, Array

MARGIN = 0.1
"""MARGIN [1]: distance beyond a range, as a share of its span, that play and calibration explain."""
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
        other = OTHER.get(column.table.unit)
        limits = limits_of(case.plant, column.table.at, column.table.kind, is_input=column.table.input)
        if other is None or limits is None or column.table.scale is not None:
            continue
        with_channel = [run for run in runs if name in run.measured.names]
        if not with_channel:
            continue
        values = np.concatenate([run.measured[name] for run in with_channel])
        # the channel of a free kind keeps the stated unit; the model's own is the radian
        values = values * (units.factor(column.table.unit, "rad") / column.factor)
        ratio = units.factor(other, "rad") / units.factor(column.table.unit, "rad")
        if is_inside(values, limits) or not is_inside(values * ratio, limits):
            continue
        edit = Correction(taken=(Taken(channel=name, source=name, factor=1.0 / ratio, unit=other),)).edits(case)
        low, high = (f"{limit / units.factor(column.table.unit, 'rad'):.4g}" for limit in limits)
        worst = values[np.argmax(np.abs(values))] / units.factor(column.table.unit, "rad")
        text = (
            f"{name} reaches {worst:.4g} {column.table.unit}, and the model's range is {low} to {high} {column.table.unit}; "
            f"in {other} the numbers stay inside; to mend it, say in {case.path.name}: {edit}"
        )
        out.append(Found(severity="warning", text=text, channels=(name,), mend=edit))
    return out


def is_inside(values: Array, limits: tuple[float, float]) -> bool:
    """Return whether values keep to a range, play and calibration aside.

    Parameters
    ----------
    values : array
        Values in the unit of the range.
    limits : tuple of float
        Range.
    """
    slack = MARGIN * (limits[1] - limits[0])
    return bool(values.min() >= limits[0] - slack and values.max() <= limits[1] + slack)


def limits_of(plant: Plant, at: str, kind: str, *, is_input: bool) -> tuple[float, float] | None:
    """Return the range of a hinge or its position servo [rad].

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
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    if is_input:
        names = [model.actuator(i).name for i in range(model.nu)]
        i = next((k for k, name in enumerate(names) if name and at in (name, f"actuator:{name}")), None)
        if i is None or not model.actuator_ctrllimited[i] or KIND_UNITS[kind] not in (None, "rad"):
            return None
        joint = int(model.actuator_trnid[i, 0])
        is_joint = int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        if not is_joint or int(model.jnt_type[joint]) != hinge:
            return None
        return float(model.actuator_ctrlrange[i, 0]), float(model.actuator_ctrlrange[i, 1])
    number = _joint(model, at) if kind == "angle" else None
    if number is None or int(model.jnt_type[number]) != hinge or not model.jnt_limited[number]:
        return None
    return float(model.jnt_range[number, 0]), float(model.jnt_range[number, 1])


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
