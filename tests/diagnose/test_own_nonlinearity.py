"""A model's own nonlinearity along the recorded motion: closed forms, and MuJoCo's beam driven loudly."""

import numpy as np
import pytest
from rigs import PENDULUM

from vlab.cases import load_case
from vlab.cli import main
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.mesh_correction import with_modes_of_fe, with_soft_cables
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.predictors.own_nonlinearity import Inverse, ModalMotion, with_own_nonlinearity
from vlab.diagnose.predictors.scope import linear_problem
from vlab.diagnose.search.model_class import UNSTRETCHED, choose_model_class
from vlab.diagnose.settings import MESH_CORRECTION
from vlab.plants.mjcf import build_mjcf

PLAN = """
title = "Beam driven loudly"
concealed = false
[settings]
structure = "beam"
variant = "physical"
level = 0.2
seconds = 6.0
period_s = 6.0
high_hz = 30.0
noise = 1e-5
[model]
uncertain = { stiffness = 0.02, damping = 0.3 }
[[record]]
name = "loud"
role = "fit"
seed = 2
[[record]]
name = "other"
role = "holdout"
seed = 3
"""


def test_a_pendulum_has_what_the_sine_lacks_of_the_angle():
    plant = build_mjcf(PENDULUM)
    linear = plant.linearise()
    shapes = linear.eigen[1]
    angle = np.linspace(-0.4, 0.4, 9)[:, None]
    rates = np.random.default_rng(0).normal(
        size=(2, 9, 1)
    )  # inertia and viscous damping are linear: they leave nothing
    own = Inverse(plant, shapes)
    extra = own.extra(ModalMotion(angle / shapes[0, 0], *rates), np.zeros((9, 0)), 0.01)
    expected = shapes[0, 0] * linear.K[0, 0] * (np.sin(angle) - angle)
    # slopes are taken over 1e-5 rad: their own error is (1e-5)^2/6 of them
    np.testing.assert_allclose(extra, expected, atol=1e-6 * np.abs(expected).max())


def test_slaves_settle_where_their_stiffness_holds_the_force():
    own = Inverse.__new__(Inverse)
    own.omega, own.damping = np.array([40.0, 90.0]), np.array([30.0, 60.0])
    moved = own.followed(np.tile([2.0, -3.0], (2000, 1)), 1e-3)
    np.testing.assert_allclose(moved[-1], [-2.0 / 40.0**2, 3.0 / 90.0**2], rtol=1e-6)


@pytest.mark.slow
def test_the_twin_of_a_loud_beam_follows_mujoco(tmp_path):
    case = run_of(PLAN, tmp_path)
    plain, own = prepare(case), linear_problem(case)
    missed = [_missed(problem) for problem in (plain, own)]
    assert own.reduced_model.loads.shape[1] == own.reduced_model.m
    assert missed[0] > 0.1  # the tension that the deflection adds: .2 % of a frequency, tens of cycles
    assert missed[1] < 0.03  # the smoothed states, samples of 1.5 ms, and the twin's own .7 % of velocities


@pytest.mark.slow
@pytest.mark.parametrize("plant", ["composite", "modal"])
def test_cables_stretch_where_recordings_show_it(tmp_path, plant):
    """The links swing between cables that tighten, modes are coordinates of small motion."""
    plan = PLAN.replace("[settings]", f'[settings]\nplant = "{plant}"').replace(
        "[model]", '[model]\nplant = "composite"'
    )
    given = run_of(plan, tmp_path)
    given = with_modes_of_fe(given, given.structure)
    model_class = choose_model_class(given)
    case = model_class.problem.case
    assert model_class.notes == ((UNSTRETCHED,) if plant == "modal" else ())
    share = case.structure.cable[0].youngs_modulus / given.structure.cable[0].youngs_modulus
    assert share == (MESH_CORRECTION.soft if plant == "modal" else 1.0)


def test_soft_cables_leave_the_modes_and_take_the_stretching(tmp_path):
    given = run_of(PLAN.replace("seconds = 6.0\nperiod_s = 6.0", "seconds = 0.5\nperiod_s = 0.5"), tmp_path)
    soft = with_soft_cables(given, given.structure)
    omega, tightened = [], []
    for case in (given, soft):
        linear, row = case.plant.linearise(), case.plant.port_rows(["base"])[0]
        w, shapes = linear.eigen
        across = np.abs(row @ shapes) > 1e-6 * np.abs(row @ shapes).max()
        omega.append(w[across])
        first = (
            shapes[:, across][:, :1] * 1e-3 / np.abs(row @ shapes[:, across][:, 0])
        )  # a millimetre of the first mode
        own = Inverse(case.plant, first)
        motion = ModalMotion(np.ones((2, 1)), np.zeros((2, 1)), np.zeros((2, 1)))
        tightened.append(own.extra(motion, np.zeros((2, own.slaves.shape[1])), 0.01)[0, 0])
    assert omega[1][:10] == pytest.approx(omega[0][:10], rel=1e-6)
    assert 0 < tightened[1] < 2 * MESH_CORRECTION.soft * tightened[0]  # what is left is the weight that a swing lifts


@pytest.mark.slow
def test_quiet_motion_gets_no_loads_worth_naming(tmp_path):
    plan = PLAN.replace("level = 0.2", "level = 0.002").replace("noise = 1e-5", "noise = 1e-7")
    problem = prepare(run_of(plan, tmp_path))
    (run,) = with_own_nonlinearity(problem).signals
    driven = run.u @ problem.reduced_model.forces.T
    assert np.sqrt(np.mean(run.load**2)) < 1e-3 * np.sqrt(np.mean(driven**2))


def run_of(plan, folder):
    """Return the case of a plan's recordings."""
    (folder / "plan.toml").write_text(plan)
    assert main(["experiment", "--plan", str(folder / "plan.toml"), "--out", str(folder / "run")]) == 0
    return load_case(folder / "run" / "case.toml")


def _missed(problem):
    """Return by which share of its rms the twin with nominal parameters misses the worst channel."""
    refiner = LeastSquares(ScoreTest(problem), problem.in_role("fit"))
    (run,) = refiner.runs
    starts = np.zeros((1, 1, 2 * problem.reduced_model.m))
    y = refiner.simulate([run], (), np.zeros((1, len(problem.reduced_model.changes))), (), starts)[:, 0, 0]
    return float(np.max(np.std(y - run.y, axis=0) / run.scale))
