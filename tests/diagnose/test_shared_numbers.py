"""Effects hold the whole change of the gains that they multiply, and the model stays the same."""

from dataclasses import replace

import numpy as np
import pytest
from servo_rigs import servo_case
from test_honest_gap import fit_of

from vlab.cases import load_case
from vlab.diagnose.parameters.locations import at_place
from vlab.diagnose.parameters.shared_numbers import with_whole_gains
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.validation.simulation import check, extended
from vlab.physics.catalogue import EFFECTS


@pytest.fixture(scope="module")
def problem(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lever")
    servo_case(folder, "lever")
    return prepare_trajectory(load_case(folder / "case.toml"))[0]


def term(problem, effect: str, gain: float) -> Term:
    place = next(p for p in problem.places if p.name.startswith("actuator:"))
    return Term(effect=at_place(EFFECTS[effect], place), place=place, values={"gain": gain})


@pytest.mark.parametrize(
    ("effect", "kind"), [("servo-position-gain", "gain"), ("servo-velocity-gain", "velocity-gain")]
)
def test_the_model_stays_the_same(problem, effect, kind):
    theta = np.array([0.05 if p.kind == kind else 0.02 for p in problem.parameters])
    fit = replace(fit_of(term(problem, effect, -0.3)), theta=theta, offsets=np.zeros(len(problem.names)))
    whole = with_whole_gains(fit, problem.parameters, problem.plant)
    assert whole.terms[0].values["gain"] == pytest.approx(0.7 * np.exp(0.05) - 1.0)
    assert [p.kind for p, v in zip(problem.parameters, whole.theta, strict=True) if v == 0.0] == [kind]
    apart, together = (check(problem.runs, extended(problem, f), None)[0] for f in (fit, whole))
    np.testing.assert_allclose(apart.simulated[1].data, together.simulated[1].data, atol=1e-9)


def test_other_effects_leave_calibrated_gains_alone(problem):
    theta = np.full(len(problem.parameters), 0.05)
    fit = replace(
        fit_of(term(problem, "servo-torque-constant", -0.3)), theta=theta, offsets=np.zeros(len(problem.names))
    )
    assert np.array_equal(with_whole_gains(fit, problem.parameters, problem.plant).theta, theta)
