"""A model's own nonlinearity along the recorded motion: closed forms, and MuJoCo's beam driven loudly."""

import numpy as np
import pytest
from rigs import PENDULUM

from vlab.cases import load_case
from vlab.cli import main
from vlab.diagnose.nonlinear.scope import linear_problem
from vlab.diagnose.own_nonlinearity import Inverse, ModalMotion, with_own_nonlinearity
from vlab.diagnose.prepare import prepare
from vlab.diagnose.refine import Refiner
from vlab.diagnose.screen import Screen
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
    (tmp_path / "plan.toml").write_text(PLAN)
    assert main(["experiment", "--plan", str(tmp_path / "plan.toml"), "--out", str(tmp_path / "run")]) == 0
    case = load_case(tmp_path / "run" / "case.toml")
    plain, own = prepare(case), linear_problem(case)
    missed = [_missed(problem) for problem in (plain, own)]
    assert own.twin.loads.shape[1] == own.twin.m
    assert missed[0] > 0.1  # the tension that the deflection adds: .2 % of a frequency, tens of cycles
    assert missed[1] < 0.03  # the smoothed states, samples of 1.5 ms, and the twin's own .7 % of velocities


@pytest.mark.slow
def test_quiet_motion_gets_no_loads_worth_naming(tmp_path):
    plan = PLAN.replace("level = 0.2", "level = 0.002").replace("noise = 1e-5", "noise = 1e-7")
    (tmp_path / "plan.toml").write_text(plan)
    assert main(["experiment", "--plan", str(tmp_path / "plan.toml"), "--out", str(tmp_path / "run")]) == 0
    problem = prepare(load_case(tmp_path / "run" / "case.toml"))
    (run,) = with_own_nonlinearity(problem).signals
    driven = run.u @ problem.twin.forces.T
    assert np.sqrt(np.mean(run.load**2)) < 1e-3 * np.sqrt(np.mean(driven**2))


def _missed(problem):
    """Return by which share of its rms the twin with nominal parameters misses the worst channel."""
    refiner = Refiner(Screen(problem), problem.in_role("fit"))
    (run,) = refiner.runs
    starts = np.zeros((1, 1, 2 * problem.twin.m))
    y = refiner.simulate([run], (), np.zeros((1, len(problem.twin.changes))), (), starts)[:, 0, 0]
    return float(np.max(np.std(y - run.y, axis=0) / run.scale))
