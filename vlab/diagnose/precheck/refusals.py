"""Reasons for which a diagnosis would refuse a case."""

from collections.abc import Sequence
from typing import Any

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.checks import FileCheck
from vlab.cases.initial_state import joint_of
from vlab.diagnose.data.quality import assess_quality
from vlab.diagnose.parameters.recorded_runs import read_runs
from vlab.diagnose.predictors.recorded_motion import moves_far, recorded_motions
from vlab.diagnose.predictors.scope import check_contacts, check_scope
from vlab.errors import VlabError
from vlab.plants.base import ONE_WAY, Plant


def refusals(case: Case, runs: Sequence[Run], check: FileCheck) -> list[str]:
    """Return the reasons for which a diagnosis would refuse a case.

    Limits of models that move far are tested along the recorded joint positions.

    Parameters
    ----------
    case : Case
        Case.
    runs : sequence of Run
        Recordings of the case.
    check : FileCheck
        Findings on the case description.

    Returns
    -------
    list of str
        Reasons; empty where the tests find none.
    """
    out: list[str] = []
    fitted = [run for run in runs if run.role == "fit"]
    if fitted:
        out += assess_quality(runs, fitted, check).fatal
    try:
        read_runs(case, ("fit",))
        if moves_far(case):
            check_scope(case)
            check_contacts(case, recorded_motions(case.plant, fitted))
    except VlabError as error:
        out.append(str(error))
    return out


def unseen_joints(plant: Plant, runs: Sequence[Run]) -> list[str]:
    """Return remarks on joints without a recorded motion.

    Parameters
    ----------
    plant : Plant
        Model.
    runs : sequence of Run
        Recordings.

    Returns
    -------
    list of str
        One remark a joint; empty where other sensors show the joints together.
    """
    model: Any = plant.model
    compared = [c for run in runs for c in run.compared]
    if any(c.actuator is None and joint_of(plant, c) is None for c in compared):
        return []  # other sensors show the joints together
    shown = {at[0] for c in compared if (at := joint_of(plant, c)) is not None}
    names = [
        model.joint(i).name or f"number {i}"
        for i in range(model.njnt)
        if int(model.jnt_type[i]) in ONE_WAY and int(model.jnt_dofadr[i]) not in shown
    ]
    return [f"no channel shows the joint {name!r}; its motion is that of the model alone" for name in names]
