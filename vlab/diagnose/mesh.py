"""The mesh of a structure's physical plant, made as good as the FE model where recordings are, before anything is sought."""

from dataclasses import replace

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.wired import wired_runs
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.plants.build import build_plant
from vlab.structure.model import Tuning

PHYSICAL = "composite"
"""The plant whose mesh is coarse."""
WIDER = 2.0
"""Modes up to this multiple of the highest frequency recorded are those of the FE model: pulses and edges go beyond the others."""


def with_modes_of_fe(case: Case) -> Case:
    """Return a case whose physical plant has the FE model's modes in and above the band that was recorded; others as they are.

    Two links a bar of the grid turn modes that lie close together into each other, which leaves a tenth of the recordings
    whatever is refitted, and steps raise frequencies by as much as resonances are wide; that is no physics that the model lacks,
    and the FE model knows better.
    """
    structure, table = case.structure, case.table.model
    if structure is None or table.plant != PHYSICAL or not case.recordings(("fit",)):
        return case
    if structure.tuning is not None and structure.tuning.of_fe:
        return case
    fe = build_fe_model(replace(structure, tuning=None), table.variant)
    freq = fe.linear.freq[driven_modes(fe.coils.T @ fe.linear.eigen[1])]
    wired = wired_runs(case, ("fit",))
    count = int(np.sum(freq <= WIDER * wired.highest_hz))
    if count == 0:
        return case
    of_fe = replace(structure.tuning or Tuning(), of_fe=count, at_step=wired.step(case.plant))
    tuned = replace(structure, tuning=of_fe)
    plant = build_plant(tuned, table.plant, table.variant)
    return replace(case, structure=tuned, plant=plant.with_physics_of(case.plant))
