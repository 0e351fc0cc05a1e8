"""Fits far from rest in their parts: the lacking force, the last fit in MuJoCo, the search along the motion."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import rig_swinging
from rig_swinging import PIVOT, swinging_pendulum
from scipy.integrate import solve_ivp
from test_trajectory_diagnosis import shorter

from vlab.cases import load_case
from vlab.diagnose.inference.model_choice import is_prior_driven
from vlab.diagnose.inference.ridge_regression import ridge_inverse
from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.search import trajectory_selection as searching
from vlab.diagnose.search.deadline import NO_DEADLINE
from vlab.diagnose.search.restoring_force import estimate_restoring_force
from vlab.diagnose.search.trajectory_selection import search_moving
from vlab.diagnose.settings import PROBLEM
from vlab.physics.catalogue import EFFECTS

SAMPLES = 220
EFFECT = "viscous-damping"
SIZE = rig_swinging.PENDULUM_CASES[EFFECT].values["damping"]


@pytest.fixture(scope="module")
def screen(tmp_path_factory):
    """Return the screening of a pendulum that a damper brakes more than its model says, all else right."""
    folder = tmp_path_factory.mktemp("pendulum")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_swinging, "BENIGN", 0.0)
        swinging_pendulum(folder, EFFECT, noise=0.001)
    problem, moving = prepare_trajectory(shorter(load_case(folder), SAMPLES))
    return TrajectoryScoreTest(problem, moving)


@pytest.fixture(scope="module")
def place(screen):
    return next(p for p in screen.problem.places if p.name == PIVOT)


def fit_of(screen, *terms):
    """Return a fit that has these terms as they are, and nothing refitted."""
    whole = TrajectoryLeastSquares(screen, whole=True)
    plain = whole.fit((), iterations=0)
    return replace(plain, theta=np.zeros(len(screen.problem.parameters)), terms=terms)


# ---- the force that is lacking --------------------------------------------------------------------------------------


def inner(series):
    """Return a series without the ends of its runs, where the smoothed motion is known worst, in one row."""
    return series[15:-15].ravel()


@pytest.mark.slow
def test_the_force_that_a_motion_asks_for_is_the_one_that_is_hidden(screen, place):
    """A straight line through the speed, whose slope is the damper's constant."""
    term = Term(effect=EFFECTS[EFFECT], place=place, values={"damping": SIZE})
    asked, _, v, _, _ = estimate_restoring_force(screen, fit_of(screen), term)
    force, speed = inner(asked), inner(v)
    slope = -float(force @ speed) / float(speed @ speed)
    assert slope == pytest.approx(SIZE, rel=0.15)
    assert np.corrcoef(force, speed)[0, 1] < -0.5


def test_the_motion_beside_it_is_one_motion(screen, place):
    """The speed is the rate of the displacement, and the acceleration that of the speed."""
    term = Term(effect=EFFECTS[EFFECT], place=place, values={"damping": SIZE})
    _, z, v, a, command = estimate_restoring_force(screen, fit_of(screen), term)
    h = 1.0 / rig_swinging.RATE
    for series, rate, share in ((z, v, 1e-3), (v, a, 5e-2)):
        found = (series[2:] - series[:-2]) / (2 * h)
        assert np.abs(found - rate[1:-1])[15:-15].max() < share * np.abs(rate).max()
    assert command == 0.0
    assert np.abs(z).max() > 1.5  # from rest, which hangs down


@pytest.mark.parametrize("name", ["viscous-damping", "quadratic-drag"])
def test_what_other_effects_do_is_taken_off(screen, place, name):
    """A known effect leaves as much less of the force as its own law gives along the motion."""
    parameter = EFFECTS[name].parameters[0].name
    known = Term(effect=EFFECTS[name], place=place, values={parameter: SIZE})
    sought = Term(effect=EFFECTS["stiffness-to-ground"], place=place, values={"stiffness": 1.0})
    bare = estimate_restoring_force(screen, fit_of(screen), sought)
    less = estimate_restoring_force(screen, fit_of(screen, known, sought), sought)
    v = bare[2]
    law = -SIZE * v if name == "viscous-damping" else -SIZE * np.abs(v) * v
    np.testing.assert_allclose(inner(less[0]), inner(bare[0] - law), atol=1e-6 * np.abs(law).max())
    own = estimate_restoring_force(screen, fit_of(screen, known), known)
    np.testing.assert_allclose(inner(own[0]), inner(bare[0]))  # not what is sought itself


def test_what_uncertain_parameters_do_is_taken_off(screen, place):
    """A pivot's own damper that is larger by a factor brakes by so much more."""
    term = Term(effect=EFFECTS[EFFECT], place=place, values={"damping": SIZE})
    plain = fit_of(screen)
    which = next(i for i, p in enumerate(screen.problem.parameters) if any(n == "dof_damping" for n, _ in p.fields))
    theta = np.zeros(len(plain.theta))
    theta[which] = np.log(3.0)
    bare = estimate_restoring_force(screen, plain, term)
    more = estimate_restoring_force(screen, replace(plain, theta=theta), term)
    taken, own = inner(bare[0] - more[0]), -0.001 * 2.0 * inner(bare[2])
    np.testing.assert_allclose(taken, own, atol=0.05 * np.abs(own).max())


# ---- the last fit in MuJoCo -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def polished(screen, place):
    """Return a refiner, its last fit of the hidden law from half its size, and the fit without MuJoCo."""
    term = Term(effect=EFFECTS[EFFECT], place=place, values={"damping": 0.5 * SIZE})
    refiner = SimulatorLeastSquares(screen)
    start = replace(refiner.fit((), iterations=0), terms=(term,))
    return (
        refiner,
        refiner.fit((term,), start),
        TrajectoryLeastSquares.fit(SimulatorLeastSquares(screen), (term,), start),
    )


def test_the_last_fit_misses_the_recordings_in_mujoco_no_more_than_the_first(polished):
    refiner, fit, first = polished
    missed, bias = refiner._missed(fit)
    assert bias is not None
    assert missed <= refiner._missed(first)[0] * (1 + 1e-9)
    assert missed < 1.3 * sum(run.y.size for run in refiner.runs)  # nothing but the noise


def test_the_last_fit_finds_the_hidden_size(polished):
    """Its own damper, 30 % uncertain and a sixth of it, is the same to these recordings."""
    _, fit, _ = polished
    assert fit.terms[0].values["damping"] == pytest.approx(SIZE, rel=0.1)


def test_the_last_fit_is_that_of_mujocos_run_whatever_the_system_along_the_motion_does(screen, place):
    """MuJoCo's plant brakes by half the hidden damper already: the other half is all that is left to find."""
    refiner = SimulatorLeastSquares(screen)
    plant = screen.problem.plant
    model = copy.copy(plant.model)
    model.dof_damping[0] += 0.5 * SIZE
    refiner.problem = replace(screen.problem, plant=replace(plant, model=model))
    term = Term(effect=EFFECTS[EFFECT], place=place, values={"damping": SIZE})
    fit = refiner.fit((term,), replace(refiner.fit((), iterations=0), terms=(term,)))
    whole = model.dof_damping[0] * np.exp(_log_factor(refiner, fit, "dof_damping")) + fit.terms[0].values["damping"]
    assert whole == pytest.approx(0.001 + SIZE, rel=0.1)
    assert fit.terms[0].values["damping"] < 0.75 * SIZE


def test_the_recordings_are_the_same_after_a_fit(polished):
    refiner, _, _ = polished
    for run, y in zip(refiner.runs, refiner.recorded, strict=True):
        np.testing.assert_array_equal(run.y, y)


def test_the_difference_that_is_taken_off_is_that_of_mujoco_and_the_system_along_the_motion(polished):
    """MuJoCo's run is integrated by scipy here, from the start that the fit has."""
    refiner, fit, _ = polished
    _, bias = refiner._missed(fit)
    along, states = refiner._along(fit)
    damping = 0.001 * np.exp(_log_factor(refiner, fit, "dof_damping")) + fit.terms[0].values["damping"]
    longest = int(np.argmax([len(y) for y in along]))
    trajectory = refiner.moving.moving.trajectories[longest]
    plant = refiner.problem.adjusted(fit.theta)
    mass, (aside, _, below) = float(plant.model.body_mass[1]), plant.model.body_ipos[1]
    inertia = float(plant.model.body_inertia[1, 1]) + mass * (aside**2 + below**2)
    gain = np.exp(
        sum(v for change, v in zip(refiner.reduced_model.changes, fit.theta, strict=True) if change.sensor is not None)
    )  # of the only sensor

    def rate(_, x):
        lever = aside * np.cos(x[0]) + below * np.sin(x[0])
        return [x[1], (mass * 9.80665 * lever - damping * x[1]) / inertia]

    state, time = states[longest], trajectory.time - trajectory.time[0]
    angle = solve_ivp(
        rate, (0, time[-1]), [float(state.qpos[0]), float(state.qvel[0])], "DOP853", time, rtol=1e-10, atol=1e-11
    ).y[0]
    np.testing.assert_allclose(along[longest][:, 0] + bias[longest][:, 0], gain * angle + fit.offsets[0], atol=2e-6)


def _log_factor(refiner, fit, field):
    return sum(
        v for p, v in zip(refiner.problem.parameters, fit.theta, strict=True) if any(n == field for n, _ in p.fields)
    )


def test_a_fit_that_mujoco_cannot_follow_is_no_better_than_any(polished):
    """A spring that pushes away by a thousand times the weight: nothing is corrected then."""
    refiner, fit, _ = polished
    wild = replace(fit.terms[0], effect=EFFECTS["cubic-stiffness"], values={"k3": -1e9})
    missed, bias = refiner._missed(replace(fit, terms=(wild,)))
    assert bias is None
    assert missed > 1e3 * refiner._missed(fit)[0]


# ---- the search -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def found(screen):
    """Return what a search of three effects finds, and what it said on the way."""
    said = []
    effects = [EFFECTS[n] for n in (EFFECT, "stiffness-to-ground", "sensor-gain")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(searching, "SECOND_EFFECT", replace(searching.SECOND_EFFECT, seeds=1))
        return search_moving(screen, effects, lambda share, what: said.append(share)), said


def test_the_search_along_a_motion_finds_what_is_hidden(found):
    out, said = found
    best = out.hypotheses[0]
    assert best.label == f"{EFFECT}@{PIVOT}"
    assert best.score > out.before.score
    assert is_prior_driven(
        best, out.before
    )  # a refitted damper does as well, with a factor of six that nobody believes
    assert said == sorted(said)


def test_last_fits_allow_no_more_model_error_than_is_left(found, screen):
    """Noise of 0.1 % is all that is left, so the bound of 0.2 % is not used up."""
    out, _ = found
    assert PROBLEM.integration_error <= out.whole.model_error < PROBLEM.model_error
    bound = SimulatorLeastSquares(out.whole.moving, model_error=PROBLEM.model_error)
    terms, fit = out.hypotheses[0].terms, out.hypotheses[0].long_fit
    name = f"{terms[0].label}:damping"
    assert out.whole.fit(terms, fit).sd[name] < bound.fit(terms, fit).sd[name]
    for left in (1.01, out.hypotheses[0].normalised_residual):
        best = replace(out.hypotheses[0], normalised_residual=left)
        error = searching._estimated_error(bound, best, NO_DEADLINE)
        assert error == (PROBLEM.model_error if left > 1.0 else out.whole.model_error)


def test_the_search_leaves_out_what_leaves_no_trace(found):
    """The gain of a single sensor is one with the start of a swing that nothing drives."""
    out, _ = found
    assert {h.terms[0].effect.name for h in out.hypotheses} <= {EFFECT, "stiffness-to-ground"}
    assert {c.effect.name for c in out.candidates} == {EFFECT, "stiffness-to-ground"}


def test_hypotheses_come_by_score_and_the_best_has_its_place(found):
    out, _ = found
    scores = [h.score for h in out.hypotheses]
    assert scores == sorted(scores, reverse=True)
    assert PIVOT in out.places
    assert isinstance(out.whole, SimulatorLeastSquares)
    assert out.screen is not None
    assert out.screen.theta.shape == out.hypotheses[0].fit.theta.shape


def test_a_second_effect_stands_beside_another_one(screen, place):
    """Pairs are of two effects, whose first one is the seed."""
    narrow = TrajectoryLeastSquares(screen)
    effects = [EFFECTS[n] for n in (EFFECT, "stiffness-to-ground", "quadratic-drag")]
    candidates = screen.candidates(effects)
    start = narrow.fit()
    weak = [c for c in candidates if c.effect.name == "stiffness-to-ground"][:1]
    singles = searching.finished(narrow, searching.each_fitted(narrow, weak, start))
    pairs = searching._pairs(screen, narrow, weak, candidates, singles, effects, start)
    assert pairs
    for pair in pairs:
        assert pair.terms[0].label == weak[0].label
        assert len({t.effect.name for t in pair.terms}) == 2
    best = max(pairs, key=lambda h: h.score)
    assert best.terms[1].effect.name in (EFFECT, "quadratic-drag")
    assert best.normalised_residual < singles[0].normalised_residual


def test_free_responses_of_unstable_motion_keep_their_priors():
    rng = np.random.default_rng(3)
    plain = rng.standard_normal((40, 4))
    np.testing.assert_allclose(ridge_inverse(plain), np.linalg.solve(plain.T @ plain + np.eye(4), plain.T), atol=1e-13)
    clipped = np.full((40, 4), 1e9)  # all columns alike: the normal matrix is singular to rounding
    moved = ridge_inverse(clipped) @ np.full(40, 1e9)
    np.testing.assert_allclose(moved, 0.25, rtol=1e-6)  # the least norm of the four starts
