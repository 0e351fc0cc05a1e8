"""Gains of commands behind the force limit of a servo."""

from dataclasses import replace

import numpy as np
import pytest
import servo_rigs
from servo_rigs import LEVER, servo_case

from vlab.cases import load_case
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.physics.catalogue import EFFECTS

GAIN = -0.15
"""Relative error of the command's gain."""
LIMIT = 1.2
"""Force limit [N m]; a unit change of the gain asks for five times as much."""


@pytest.fixture(scope="module")
def screen(tmp_path_factory):
    """The lever on a weak servo whose command has another gain, screened along its motion."""
    folder = tmp_path_factory.mktemp("weak")
    drive = replace(LEVER.drives[0], limit=LIMIT)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(servo_rigs.ARMS, "weak lever", replace(LEVER, drives=(drive,)))
        servo_case(folder, "weak lever", hidden=(replace(drive, scale=1.0 + GAIN),))
    return TrajectoryScoreTest(*prepare_trajectory(load_case(folder / "case.toml")))


def test_the_gain_of_a_limited_servo_is_found_at_its_own_size(screen):
    effect = EFFECTS["actuator-gain"]
    (place,) = [p for p in screen.problem.places if p.name == "actuator:shaft_servo"]
    (found,) = screen._at(place, [effect])
    (of_unit,) = ScoreTest._at(screen, place, [effect])
    assert found.values["gain"] == pytest.approx(GAIN, rel=0.05)
    assert of_unit.values["gain"] != pytest.approx(GAIN, rel=0.15)  # a unit change stands at the limit
    assert found.log_likelihood_gain > of_unit.log_likelihood_gain
    secant, unit = screen.columns_of(found), screen.columns_of(replace(found, values={"gain": 1.0}))
    assert np.linalg.norm(secant) > 1.5 * np.linalg.norm(unit)  # the limit cuts the change of a unit gain
