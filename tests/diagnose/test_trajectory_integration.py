"""The compiled march along a motion against the laws as they are written."""

import copy

import numpy as np
import pytest
from rig_swinging import driven_arm

from vlab.cases import load_case
from vlab.diagnose.inference import trajectory_least_squares as refine
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.locations import admissible
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.trajectory_integration import trace_laws
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import LinearPortEffect

LAWS = {
    "coulomb-friction": {"force": 0.1},
    "stribeck-friction": {"force": 0.05, "excess": 0.05, "speed": 0.3},
    "lugre-friction": {"force": 0.05, "excess": 0.05, "speed": 0.3, "bristle": 0.02},
    "jenkins-slip": {"force": 0.2, "slip": 0.05},
    "bouc-wen": {"force": 0.2, "yield": 0.05},
    "cubic-stiffness": {"k3": 0.5},
    "stop": {"stiffness": 8.0, "gap": 0.2},
    "quadratic-drag": {"coefficient": 0.2},
    "sinusoidal-force": {"sine": 0.1, "cosine": -0.2, "frequency": 1.3},
    "viscous-damping": {"damping": 0.1},
    "added-mass": {"mass": 0.1},
}


@pytest.fixture(scope="module")
def refiner(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm")
    driven_arm(folder)
    problem, moving = prepare_trajectory(load_case(folder))
    return TrajectoryLeastSquares(TrajectoryScoreTest(problem, moving))


@pytest.fixture(scope="module")
def uneven(refiner):
    """The same windows with steps of random length, as from time stamps of a log."""
    other = copy.copy(refiner)
    other.h = refiner.h * np.random.default_rng(2).uniform(0.6, 1.4, refiner.h.shape)
    other.even, other._paths = None, {}
    return other


@pytest.mark.parametrize("steps", ["refiner", "uneven"])
@pytest.mark.parametrize(
    "names", [*((name,) for name in LAWS), ("coulomb-friction", "stop"), ("bouc-wen", "added-mass")]
)
def test_compiled_laws_move_a_model_as_they_do_as_written(request, steps, names, monkeypatch):
    refiner = request.getfixturevalue(steps)
    terms = []
    for name in names:
        effect, places = EFFECTS[name], refiner.problem.places
        several = isinstance(effect, LinearPortEffect)
        place = max((p for p in places if admissible(effect, p)), key=lambda p: len(p.rows) if several else 0)
        terms.append(Term(effect=effect, place=place, values=LAWS[name]))
    values = [{k: v * np.array([1.0, 0.5]) for k, v in t.values.items()} for t in terms]
    theta = np.repeat(refiner.moving.theta[None], 2, axis=0)
    starts = np.repeat(np.array([run.start for run in refiner.runs])[None], 2, axis=0)
    found = []
    monkeypatch.setattr(refine, "trace_laws", lambda laws: found.append(trace_laws(laws)) or found[-1])
    fast = refiner.simulate(refiner.runs, terms, theta, values, starts)
    assert found[0] is not None
    monkeypatch.setattr(refine, "trace_laws", lambda laws: None)
    slow = refiner.simulate(refiner.runs, terms, theta, values, starts)
    bare = refiner.simulate(refiner.runs, (), theta, [], starts)
    size = np.abs(slow).max()
    assert np.abs(slow - bare).max() > 1e-4 * size  # the laws act
    np.testing.assert_allclose(fast, slow, rtol=0, atol=1e-9 * size)
