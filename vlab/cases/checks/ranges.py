"""Angles that contradict the ranges of the model, as degrees read as radians do.

A joint cannot leave its range by far, and a command lies within the range of its actuator. Numbers that leave the range
in the stated unit and stay inside in the other unit of angle are in that other unit. The check needs no simulation.
"""

from collections.abc import Sequence

import mujoco
import numpy as np

from vlab import units
from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks.correction import Column, Correction, Found, Taken, columns_of
from vlab.signals import KIND_UNITS

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
        limits = _limits(case, column)
        if other is None or limits is None or column.table.scale is not None:
            continue
        with_channel = [run for run in runs if name in run.measured.names]
        if not with_channel:
            continue
        values = np.concatenate([run.measured[name] for run in with_channel])
        # the channel of a free kind keeps the stated unit; the model's own is the radian
        values = values * (units.factor(column.table.unit, "rad") / column.factor)
        ratio = units.factor(other, "rad") / units.factor(column.table.unit, "rad")
        if _is_inside(values, limits) or not _is_inside(values * ratio, limits):
            continue
        edit = Correction(taken=(Taken(channel=name, source=name, factor=1.0 / ratio, unit=other),)).edits(case)
        low, high = (f"{limit / units.factor(column.table.unit, 'rad'):.4g}" for limit in limits)
        worst = values[np.argmax(np.abs(values))] / units.factor(column.table.unit, "rad")
        text = (
            f"{name} reaches {worst:.4g} {column.table.unit}, and the model's range is {low} to {high} {column.table.unit}; "
            f"in {other} the numbers stay inside; to mend it, say in {case.path.name}: {edit}"
        )
        out.append(Found(severity="warning", text=text, channels=(name,)))
    return out


def _is_inside(values: np.ndarray, limits: tuple[float, float]) -> bool:
    slack = MARGIN * (limits[1] - limits[0])
    return bool(values.min() >= limits[0] - slack and values.max() <= limits[1] + slack)


def _limits(case: Case, column: Column) -> tuple[float, float] | None:
    """Return the range of a joint or of a position servo [rad]."""
    model, at = case.plant.model, column.table.at
    hinge = int(mujoco.mjtJoint.mjJNT_HINGE)
    if column.table.input:
        names = [model.actuator(i).name for i in range(model.nu)]
        i = next((k for k, name in enumerate(names) if name and at in (name, f"actuator:{name}")), None)
        if i is None or not model.actuator_ctrllimited[i] or KIND_UNITS[column.table.kind] not in (None, "rad"):
            return None
        joint = int(model.actuator_trnid[i, 0])
        is_joint = int(model.actuator_trntype[i]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        if not is_joint or int(model.jnt_type[joint]) != hinge:
            return None
        return float(model.actuator_ctrlrange[i, 0]), float(model.actuator_ctrlrange[i, 1])
    for i in range(model.njnt):
        if at == f"joint:{model.joint(i).name}" and column.table.kind == "angle" and int(model.jnt_type[i]) == hinge:
            return (float(model.jnt_range[i, 0]), float(model.jnt_range[i, 1])) if model.jnt_limited[i] else None
    return None
