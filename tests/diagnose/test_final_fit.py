"""The last fit: left alone where MuJoCo agrees, and brought back by MuJoCo's own simulation where it does not."""

from dataclasses import replace

import numpy as np
import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.final_fit import final_fit
from vlab.physics.catalogue import EFFECTS


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """Return a problem with cubic stiffness hidden in it, its refiner and the fit of that law."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_oscillator, "SECONDS", 2.0)
        rig = oscillator_case(tmp_path_factory.mktemp("rig"), effect="cubic-stiffness")
        problem = prepare(load_case(rig.folder))
    refiner = LeastSquares(ScoreTest(problem))
    place = next(p for p in problem.places if p.name == rig.place)
    term = Term(effect=EFFECTS["cubic-stiffness"], place=place, values={"k3": rig.parameters["k3"]})
    return problem, refiner, refiner.fit([term]), rig.parameters["k3"]


def test_a_fit_that_mujoco_confirms_is_left_as_it_is(fitted):
    problem, refiner, fit, _ = fitted
    assert final_fit(problem, refiner, fit) is fit


@pytest.mark.slow
def test_a_law_that_mujoco_does_not_confirm_is_fitted_there(fitted):
    problem, refiner, fit, truth = fitted
    (term,) = fit.terms
    wrong = replace(fit, terms=(replace(term, values={"k3": 0.5 * term.values["k3"]}),))
    found = final_fit(problem, refiner, wrong)
    assert found.terms[0].values["k3"] == pytest.approx(fit.terms[0].values["k3"], rel=0.1)
    # 2 s hold six cycles of the lowest mode: the stiffnesses, 2 % uncertain, share what the law leaves
    assert found.terms[0].values["k3"] == pytest.approx(truth, rel=0.15)
    assert np.all(np.abs(found.theta) < 3 * problem.reduced_model.prior)
