"""Motion that a case records joint by joint, and its contacts.

The recorded positions show contacts before any linearisation along the motion.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from vlab.cases.case import Case
from vlab.cases.channel_map import Run
from vlab.cases.initial_state import joint_of
from vlab.diagnose.predictors.scope import check_contacts, is_linear
from vlab.diagnose.predictors.trajectory_data import Motion
from vlab.diagnose.problem import model_kind_of
from vlab.plants.base import ONE_WAY, Plant


def refuse_recorded_contacts(case: Case) -> None:
    """Refuse a case whose recorded joint positions close contacts.

    A linearisation about touching bodies is singular, so the test comes before the search.

    Parameters
    ----------
    case : Case
        Case.

    Raises
    ------
    BadCase
        Contacts are closed along the recorded motion.
    """
    if moves_far(case):
        fitted = [run for run in case.runs() if run.role == "fit"]
        check_contacts(case, recorded_motions(case.plant, fitted))


def moves_far(case: Case) -> bool:
    """Return whether the search may follow the motion of the model.

    Parameters
    ----------
    case : Case
        Case.

    Returns
    -------
    bool
        Whether neither the kind of model nor the model itself stays linear.
    """
    return not model_kind_of(case).stays_linear and not is_linear(case.plant)


def recorded_motions(plant: Plant, runs: Sequence[Run]) -> list[Motion]:
    """Return the motions of runs that record the position of every joint.

    Parameters
    ----------
    plant : Plant
        Model.
    runs : sequence of Run
        Recordings.

    Returns
    -------
    list of Motion
        Configurations (n, nq) and velocities (n, nv), zero here.
    """
    model: Any = plant.model
    if any(int(kind) not in ONE_WAY for kind in model.jnt_type):
        return []
    out = []
    for run in runs:
        shown = {at[0]: c.channel for c in run.compared if (at := joint_of(plant, c)) is not None and at[1] == 0}
        if len(shown) < model.nv:
            continue
        q = np.column_stack([run.measured[shown[dof]] for dof in range(model.nv)])
        q = q[np.isfinite(q).all(axis=1)]
        out.append(Motion(q=q, v=np.zeros_like(q)))
    return out
