"""Actuators without a column: the simulation commands them zero."""

from collections.abc import Sequence
from typing import Any

import mujoco

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.files.text import one_line


def undriven(case: Case, runs: Sequence[Run]) -> tuple[str, ...]:
    """Return the actuators of a model that no recording drives.

    A coil of a structure may be without power, and a motor at a joint whose force is recorded does nothing at zero
    command. Neither counts.

    Parameters
    ----------
    case : Case
        Case with its model.
    runs : sequence of Run
        Recordings of the case.

    Returns
    -------
    tuple of str
        Names of the actuators; empty without recordings in time.
    """
    if case.structure is not None or not runs:
        return ()
    plant = case.plant
    driven = {drive.actuator for run in runs for drive in run.drives}
    driven |= {i for run in runs if run.law is not None for i in run.law.actuators}
    ports = {drive.port for run in runs for drive in run.drives}
    return tuple(
        tap.name
        for i, tap in enumerate(plant.actuators)
        if tap.name and i not in driven and not _is_idle(plant.model, tap.controls, ports)
    )


def words_on(names: Sequence[str]) -> str:
    """Return one line on actuators without a column.

    Parameters
    ----------
    names : sequence of str
        Names of the actuators, at least one.

    Returns
    -------
    str
        Observation.
    """
    listed = ", ".join(repr(one_line(name)) for name in names)
    if len(names) == 1:
        return (
            f"actuator {listed} has no column: its command is zero in the simulation, as if it held still or were off"
        )
    return f"actuators {listed} have no column: their commands are zero in the simulation, as if they held still or were off"


def _is_idle(model: Any, controls: Sequence[int], ports: set[str]) -> bool:
    """Return whether an actuator is idle beside a recorded force."""
    for i in controls:
        kinds = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
        if int(model.actuator_trntype[i]) not in kinds or model.actuator_biasprm[i].any():
            return False
        if f"joint:{model.joint(int(model.actuator_trnid[i, 0])).name}" not in ports:
            return False
    return True
