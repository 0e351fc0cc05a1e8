"""Kinds of nominal models: chosen once, and asked for reasons everywhere else."""

import pytest

from vlab.diagnose.model_kinds.meshed_structure import MeshedStructure
from vlab.diagnose.model_kinds.mjcf_model import MjcfModel
from vlab.diagnose.model_kinds.model_kind import ModelKind
from vlab.diagnose.settings import PROBLEM, VERDICT
from vlab.structure import load_structure

BEAM = MeshedStructure(structure=load_structure("beam"), variant="published")


@pytest.mark.parametrize("kind", [MjcfModel(), BEAM])
def test_a_kind_states_every_reason(kind):
    assert all(isinstance(getattr(kind, name), bool) for name in ModelKind.__annotations__)


def test_a_mesh_allows_a_larger_residual():
    assert MjcfModel().own_error < BEAM.own_error
    assert MjcfModel().holdout_error < BEAM.holdout_error
    assert MjcfModel().correlated_error == 0.0 < BEAM.correlated_error


@pytest.mark.parametrize(("kind", "least"), [(MjcfModel(), VERDICT.least_misfit), (BEAM, PROBLEM.mesh_own_error)])
def test_a_mismatch_exceeds_noise_and_model_error(kind, least):
    assert not kind.is_mismatch(0.99 * least, 0.0)
    assert kind.is_mismatch(1.01 * least, 0.0)
    assert not kind.is_mismatch(1.01 * least, least)
    assert not kind.is_mismatch(VERDICT.above_noise, 1.0)
