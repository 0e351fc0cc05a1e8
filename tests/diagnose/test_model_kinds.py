"""Kinds of nominal models: chosen once, and asked for reasons everywhere else."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import vlab.diagnose
from vlab.cases.description import ModelTable
from vlab.diagnose.model_kinds.meshed_structure import STRUCTURE, MeshedStructure
from vlab.diagnose.model_kinds.mjcf_model import MjcfModel
from vlab.diagnose.model_kinds.model_kind import CalibratedModel, ModelKind
from vlab.diagnose.parameters.structure import structure_parameters
from vlab.diagnose.settings import MESHED_STRUCTURE, PROBLEM, VERDICT
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS
from vlab.plants import build_plant
from vlab.structure import load_structure

ROOM = Path(vlab.diagnose.__file__).parent
BEAM = MeshedStructure(structure=load_structure("beam"), variant="published")


def test_the_kind_of_model_is_chosen_once():
    """A branch on the structure of a case elsewhere would hide its reason."""
    branch = re.compile(r"case\.structure\b|\bis_structure\b|isinstance\([^)]*(MeshedStructure|MjcfModel)")
    found = {p.relative_to(ROOM).as_posix() for p in ROOM.rglob("*.py") if branch.search(p.read_text("utf-8"))}
    assert found == {"problem.py"}


@pytest.mark.parametrize("kind", [MjcfModel(), BEAM])
def test_a_kind_states_every_reason(kind):
    assert all(isinstance(getattr(kind, name), bool) for name in ModelKind.__annotations__)


def test_a_mesh_allows_a_larger_residual():
    assert MjcfModel().own_error < BEAM.own_error
    assert MjcfModel().holdout_error < BEAM.holdout_error
    assert MjcfModel().correlated_error == 0.0 < BEAM.correlated_error


def test_only_the_modes_of_a_mesh_need_recordings_that_excite_them():
    assert MjcfModel().predicted_band(20.0) == np.inf
    assert BEAM.predicted_band(20.0) == 20.0 * MESHED_STRUCTURE.band > 20.0


@pytest.mark.parametrize(("kind", "least"), [(MjcfModel(), VERDICT.least_misfit), (BEAM, PROBLEM.mesh_own_error)])
def test_a_mismatch_exceeds_noise_and_model_error(kind, least):
    assert not kind.is_mismatch(0.99 * least, 0.0)
    assert kind.is_mismatch(1.01 * least, 0.0)
    assert not kind.is_mismatch(1.01 * least, least)
    assert not kind.is_mismatch(VERDICT.above_noise, 1.0)


def test_effects_of_a_structure_stay_beside_its_file(tmp_path):
    plant, case = (
        build_plant(BEAM.structure),
        SimpleNamespace(table=SimpleNamespace(model=ModelTable(structure="beam"))),
    )
    effects = (Attached(effect=EFFECTS["added-mass"], place="20in", values={"mass": 0.1}),)
    parameters = tuple(structure_parameters(BEAM.structure, {}, (), ()))
    model = CalibratedModel(case=case, plant=plant, parameters=parameters, theta=np.zeros(len(parameters)))
    written = BEAM.write(model, effects, tmp_path)
    assert written.beside == effects
    assert written.entries == {"structure": STRUCTURE}
    assert load_structure(tmp_path / STRUCTURE) == BEAM.structure


@pytest.mark.parametrize(
    ("effect", "place"), [("added-mass", "20in"), ("sensor-gain", "sensor:20in"), ("actuator-delay", "chain")]
)
def test_every_stated_effect_of_a_structure_runs_beside_its_model(effect, place):
    """Such an effect is written to the case again, since no element of the file holds it."""
    values = {p.name: 0.001 for p in EFFECTS[effect].parameters}
    plant = attach(build_plant(BEAM.structure), [Attached(effect=EFFECTS[effect], place=place, values=values)])
    assert plant.physics
    assert all((one.effect.name, dict(one.values)) == (effect, values) for one in plant.physics)
