"""A structure's physical plant made as good as the FE model where recordings are, and as linear as they are, before anything is
sought."""

from dataclasses import replace

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.parameters.recorded_runs import read_runs
from vlab.diagnose.settings import MESH_CORRECTION
from vlab.fe import build_fe_model
from vlab.fe.damping import driven_modes
from vlab.plants.build import build_plant
from vlab.structure.model import Structure, Tuning

PHYSICAL = "composite"
"""The plant whose mesh is coarse."""


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
    recorded = read_runs(case, ("fit",))
    count = int(np.sum(freq <= MESH_CORRECTION.wider * recorded.highest_hz))
    if count == 0:
        return case
    of_fe = replace(structure.tuning or Tuning(), of_fe=count, at_step=recorded.step(case.plant))
    return _rebuilt(case, replace(structure, tuning=of_fe))


def with_soft_cables(case: Case) -> Case | None:
    """Return a case whose cables do not stiffen its structure as it swings; None where it has none, or another plant.

    A cable that holds a swinging bar is stretched by the square of the swing, which tightens it. The modes know the tension at
    rest only, so a cable that is soft along its length and pulls as much has the same ones.
    """
    structure = case.structure
    if structure is None or case.table.model.plant != PHYSICAL or not structure.cable:
        return None
    soft = tuple(
        replace(cable, youngs_modulus=MESH_CORRECTION.soft * cable.youngs_modulus) for cable in structure.cable
    )
    return _rebuilt(case, replace(structure, cable=soft))


def _rebuilt(case: Case, structure: Structure) -> Case:
    model = case.table.model
    plant = build_plant(structure, model.plant, model.variant)
    return replace(case, structure=structure, plant=plant.with_physics_of(case.plant))
