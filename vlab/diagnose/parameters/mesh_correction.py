"""Correction of a composite plant by the FE model."""

from dataclasses import replace

import numpy as np

from vlab.cases.case import Case
from vlab.diagnose.parameters.recorded_runs import read_runs
from vlab.diagnose.settings import MESH_CORRECTION
from vlab.fe import build_fe_model
from vlab.plants.build import build_plant
from vlab.structure.discretisation import Tuning
from vlab.structure.model import Structure

PHYSICAL = "composite"
"""Name of the plant with the coarse mesh."""


def with_modes_of_fe(case: Case, structure: Structure) -> Case:
    """Tune a composite plant to the FE model's frequencies.

    Modes in and above the recorded band are tuned; other cases are unchanged. Two links per bar rotate close modes into
    each other, which leaves a tenth of the recordings after any refit. Time steps shift frequencies by the width of a
    resonance. Both are numerical errors and no missing physics.

    Parameters
    ----------
    case : Case
        Case.
    structure : Structure
        Structure of the case.

    Returns
    -------
    Case
        Case with a tuned plant.
    """
    table = case.table.model
    if table.plant != PHYSICAL or not case.recordings(("fit",)):
        return case
    if structure.has_modes_of_fe:
        return case
    fe = build_fe_model(replace(structure, tuning=None), table.variant)
    freq = fe.linear.freq[fe.measured]
    recorded = read_runs(case, ("fit",))
    count = int(np.sum(freq <= MESH_CORRECTION.wider * recorded.highest_hz))
    if count == 0:
        return case
    of_fe = replace(structure.tuning or Tuning(), of_fe=count, at_step=recorded.step(case.plant))
    return _rebuilt(case, replace(structure, tuning=of_fe))


def with_soft_cables(case: Case, structure: Structure) -> Case | None:
    """Return a case without stretch stiffening of the cables.

    A cable that holds a swinging bar stretches with the square of the swing, and the tension rises. The modes depend on
    the static tension alone, so an axially soft cable of equal tension keeps the modes.

    Parameters
    ----------
    case : Case
        Case.
    structure : Structure
        Structure of the case.

    Returns
    -------
    Case or None
        Case with soft cables; None without cables or with another plant.
    """
    if case.table.model.plant != PHYSICAL or not structure.cable:
        return None
    soft = tuple(
        replace(cable, youngs_modulus=MESH_CORRECTION.soft * cable.youngs_modulus) for cable in structure.cable
    )
    return _rebuilt(case, replace(structure, cable=soft))


def _rebuilt(case: Case, structure: Structure) -> Case:
    model = case.table.model
    plant = build_plant(structure, model.plant, model.variant)
    return replace(case, structure=structure, plant=plant.with_physics_of(case.plant))
