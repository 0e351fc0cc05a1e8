"""Play and elasticity between a servo's motor and its joint are found, with an integration that knows nothing of the law."""

from pathlib import Path

import numpy as np
import pytest
from servo_rigs import ARMS, LEVER, Train, commands_of, servo_case

from vlab.cases import load_case
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.locations import admissible, at_place
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.physics.catalogue import EFFECTS

HANDED = Path(__file__).parents[3] / "shared" / "cases_from_field" / "backlash_crash" / "case.toml"
WORN = Train(gap=0.02, stiffness=300.0, damper=0.25, share=0.5)
ELASTIC = Train(gap=0.0, stiffness=40.0, damper=0.1, share=0.7)


def values_of(train):
    ratio = train.damper / (2 * np.sqrt(train.stiffness * LEVER.links[0].armature))
    out = {"stiffness": train.stiffness, "damping_ratio": ratio, "motor_share": train.share}
    return out | ({"gap": train.gap} if train.gap else {})


@pytest.fixture(scope="module")
def worn(tmp_path_factory):
    """The lever with play, screened along its motion."""
    folder = tmp_path_factory.mktemp("worn")
    servo_case(folder, "lever", train=WORN)
    return TrajectoryScoreTest(*prepare_trajectory(load_case(folder / "case.toml")))


def term_of(screen, name, values):
    (place,) = (p for p in screen.problem.places if p.name == "actuator:shaft_servo")
    assert admissible(EFFECTS[name], place)
    return Term(effect=at_place(EFFECTS[name], place), place=place, values=values)


def left(refiner, terms, theta):
    """Return the rms error of the angle in every run."""
    y = refiner.move_starts(terms, theta, [dict(t.values) for t in terms], np.zeros(1))
    return [float(np.sqrt(np.mean((y[: len(run), w] - run.y) ** 2))) for w, run in enumerate(refiner.runs)]


def test_the_search_simulates_two_inertias(worn):
    refiner, none = TrajectoryLeastSquares(worn, whole=True), np.zeros(len(worn.problem.parameters))
    before, after = left(refiner, [], none), left(refiner, [term_of(worn, "servo-backlash", values_of(WORN))], none)
    assert max(after) < 0.05 * min(before)
    wider = left(refiner, [term_of(worn, "servo-backlash", values_of(WORN) | {"gap": 1.2 * WORN.gap})], none)
    assert min(wider) > 2 * max(after)


def test_windows_remember_the_motion_before_them(worn, monkeypatch):
    none, term = np.zeros(len(worn.problem.parameters)), term_of(worn, "servo-backlash", values_of(WORN))
    remembered = left(TrajectoryLeastSquares(worn), [term], none)
    monkeypatch.setattr(TrajectoryLeastSquares, "_remembered", lambda self, term, own: term.effect.memory((1, 1)))
    forgotten = left(TrajectoryLeastSquares(worn), [term], none)
    assert np.median(remembered) < 0.5 * np.median(forgotten)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gain:shaft_servo", "velocity-gain:shaft_servo", "armature", "damping"])
def test_a_train_takes_part_in_the_calibration_of_its_servo(worn, name):
    # the same plant, once as a change of the nominal model and once linearised anew
    theta = 0.1 * np.array([p.name == name for p in worn.problem.parameters], dtype=float)
    term = term_of(worn, "servo-backlash", values_of(WORN))
    values = [{k: np.array([v]) for k, v in term.values.items()}]

    def channels(screen, at):
        refiner = TrajectoryLeastSquares(screen, whole=True)
        starts = np.array([run.start for run in TrajectoryLeastSquares(worn, whole=True).runs])[None]
        return refiner.simulate(refiner.runs, [term], at[None], values, starts)

    nominal, changed, anew = channels(worn, 0 * theta), channels(worn, theta), channels(worn.at(theta), theta)
    assert np.std(changed - nominal) > 3e-4
    assert np.std(changed - anew) < 0.05 * np.std(changed - nominal)


def test_a_screening_puts_the_play_first(worn):
    names = [c.effect.name for c in worn.candidates([e for n, e in EFFECTS.items() if n.startswith("servo-")])]
    assert names[0] == "servo-backlash"


@pytest.mark.parametrize("train", [WORN, ELASTIC], ids=["worn", "elastic"])
def test_the_rig_of_a_stiff_train_is_the_lever(train):
    stiff = Train(gap=0.0, stiffness=2e4, damper=5.0, share=train.share)
    commands = commands_of(LEVER, np.random.default_rng(4))[:200]
    rigid = ARMS["lever"].motion(commands, LEVER.drives)[0]
    assert np.abs(stiff.angles(LEVER, commands) - rigid).max() < 0.01 * np.abs(rigid).max()


def diagnosed(folder, **case):
    servo_case(folder, "lever", **case)
    return diagnose(load_case(folder / "case.toml")).diagnosis


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_play_is_named_with_its_size(tmp_path, seed):
    diagnosis = diagnosed(tmp_path, train=WORN, seed=seed)
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place) == ("servo-backlash", "actuator:shaft_servo")
    assert finding.parameters["gap"]["value"] == pytest.approx(WORN.gap, rel=0.1)
    assert diagnosis.heldout["gap_closed"] > 0.9


@pytest.mark.slow
def test_an_elastic_train_is_named_with_its_stiffness(tmp_path):
    diagnosis = diagnosed(tmp_path, train=ELASTIC)
    (finding,) = diagnosis.findings
    assert (finding.effect, finding.place) == ("servo-compliance", "actuator:shaft_servo")
    assert finding.parameters["stiffness"]["value"] == pytest.approx(ELASTIC.stiffness, rel=0.1)
    assert diagnosis.heldout["gap_closed"] > 0.9


@pytest.mark.slow
@pytest.mark.skipif(not HANDED.exists(), reason="the handed case is not here")
def test_the_handed_case():
    diagnosis = diagnose(load_case(HANDED)).diagnosis
    assert [(f.effect, f.place) for f in diagnosis.findings] == [("servo-backlash", "actuator:servo")]
    assert diagnosis.findings[0].parameters["gap"]["value"] == pytest.approx(0.03, rel=0.2)
