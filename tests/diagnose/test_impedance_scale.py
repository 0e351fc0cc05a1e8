"""Motions on another scale: readings stay where actuators push more, sensors show less, and every law grows as its unit says."""

import numpy as np
import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.inference.impedance_scale import exponent, motion_scale
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.physics.catalogue import EFFECTS

LAWS = {
    "coulomb-friction": {"force": 0.2},
    "viscous-damping": {"damping": 0.5},
    "quadratic-drag": {"coefficient": 6.0},
    "cubic-stiffness": {"k3": 1e5},
    "added-mass": {"mass": 0.1},
    "one-sided-stiffness": {"stiffness": 800.0, "gap": 1e-3},
}


@pytest.fixture(scope="module")
def refiner(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_oscillator, "SECONDS", 2.0)
        folder = tmp_path_factory.mktemp("scales")
        oscillator_case(folder, effect="none")
        return LeastSquares(ScoreTest(prepare(load_case(folder))))


@pytest.mark.parametrize("law", LAWS)
def test_readings_stay_where_motions_are_larger_and_sensors_show_less(refiner, law):
    effect = EFFECTS[law]
    place = next(p for p in refiner.problem.places if p.name == "joint:mass2")
    grown = 0.1
    theta = np.outer([0.0, 1.0], grown * motion_scale(refiner.problem))
    values = {
        p.name: LAWS[law][p.name] * np.exp(np.array([0.0, 1.0]) * grown * exponent(effect, p))
        for p in effect.parameters
    }
    run = max(refiner.runs, key=lambda run: np.ptp(run.u))
    starts = np.zeros((2, 1, 2 * refiner.reduced_model.m))
    term = Term(effect=effect, place=place, values=LAWS[law])
    alone = refiner.simulate([run], [], theta[:1], [], starts[:1])
    usual, same = np.moveaxis(refiner.simulate([run], [term], theta, [values], starts), 1, 0)
    assert np.abs(usual - alone[:, 0]).max() > 1e-3 * np.abs(usual).max()  # the law acts
    np.testing.assert_allclose(same, usual, rtol=0, atol=1e-9 * np.abs(usual).max())
