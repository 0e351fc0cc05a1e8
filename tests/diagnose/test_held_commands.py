"""Held commands that act late within the sample intervals, beside the closed form of a servo."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from vlab.cases.case import load_case
from vlab.diagnose.inference.simulator_least_squares import SimulatorLeastSquares
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.held_commands import changed_in_parts
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.settings import TRAJECTORY
from vlab.physics.catalogue import EFFECTS

RATE, DELAY = 50.0, 0.0032
INERTIA, GAIN, BRAKE = 0.02, 20.0, 0.8  # natural frequency 5 Hz, sampled ten times a period
MODEL = f"""<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 0"/><worldbody>
<body><joint name="joint" type="hinge" axis="0 0 1" damping="0.01"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 {INERTIA}"/></body></worldbody>
<actuator><position name="servo" joint="joint" kp="{GAIN}" kv="{BRAKE}"/></actuator>
<sensor><jointpos name="angle" joint="joint"/><jointvel name="rate" joint="joint"/></sensor></mujoco>"""


def stairs(commands: np.ndarray, delay: float) -> np.ndarray:
    """Return angle and velocity (n, 2) of the servo at the samples, under stairs that come late, by matrix exponentials."""
    free = np.array([[0.0, 1.0], [-GAIN / INERTIA, -(BRAKE + 0.01) / INERTIA]])
    early, late = expm(free * delay), expm(free * (1.0 / RATE - delay))
    x, before, out = np.zeros(2), 0.0, []
    for now in commands:
        out.append(x)
        x = np.array([before, 0.0]) + early @ (x - [before, 0.0])  # rest at the command is the equilibrium
        x = np.array([now, 0.0]) + late @ (x - [now, 0.0])
        before = now
    return np.array(out)


@pytest.fixture
def screen(tmp_path: Path) -> TrajectoryScoreTest:
    """Screening of a recording of the late servo, from stairs of random height."""
    rng = np.random.default_rng(5)
    commands = np.repeat(rng.uniform(-0.8, 0.8, 50), 4)
    read = stairs(commands, DELAY) + rng.standard_normal((200, 2)) * [1e-4, 2e-3]
    (tmp_path / "rig.xml").write_text(MODEL)
    table = np.column_stack([np.arange(200) / RATE, commands, read])
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header="t,u,angle,rate", comments="", fmt="%.9g")
    lines = ['title = "servo"', "[model]", 'mjcf = "rig.xml"', "[[recording]]", 'file = "log.csv"', 'role = "fit"']
    lines += ['time = "t"', 'initial = "rest"']
    for column, at, kind, unit in (("u", "servo", "command", "rad"), ("angle", "angle", "angle", "rad")):
        lines += ["[[recording.channel]]", f'column = "{column}"', f'at = "{at}"', f'kind = "{kind}"']
        lines += [f'unit = "{unit}"', *(["input = true", 'hold = "zero"'] if column == "u" else [])]
    lines += ["[[recording.channel]]", 'column = "rate"', 'at = "rate"', 'kind = "angular-velocity"', 'unit = "rad/s"']
    (tmp_path / "case.toml").write_text("\n".join(lines))
    return TrajectoryScoreTest(*prepare_trajectory(load_case(tmp_path)))


def test_a_delay_within_an_interval_is_told_from_a_wrong_gain(screen):
    place = next(p for p in screen.problem.places if p.kind == "actuator")
    fits = TrajectoryLeastSquares(screen, whole=True)
    fit = fits.fit((Term(effect=EFFECTS["actuator-delay"], place=place, values={"delay": 0.002}),))
    # a part of 5 ms has one force, the mean before and after the change: a bias of some hundredths
    assert fit.terms[0].values["delay"] == pytest.approx(DELAY, rel=0.05)
    assert fit.cost < 1.3 * sum(run.y.size for run in fits.runs)  # noise and the allowed model error
    exact = SimulatorLeastSquares(screen).fit(fit.terms, fit)
    assert exact.terms[0].values["delay"] == pytest.approx(DELAY, rel=0.02)
    assert np.all(np.abs(exact.theta) < [p.sd for p in screen.problem.parameters])


def test_the_screening_prefers_the_delay_to_a_gain(screen):
    names = ("actuator-delay", "sensor-gain", "actuator-gain")
    best = screen.candidates([EFFECTS[name] for name in names])[0]
    assert best.effect.name == "actuator-delay"


def test_the_parts_of_a_late_stair_are_before_and_after_the_change():
    late = changed_in_parts(lambda u: np.concatenate([[0.0], u[:-1]]) - u, np.array([0.0, 1.0, 3.0]), 4)
    assert np.array_equal(late[:, 1], [-1.0, 0.0, 0.0, 0.0])  # one part late
    assert np.array_equal(late[:, 2], [-2.0, 0.0, 0.0, 0.0])


def test_a_law_beside_a_delay_keeps_the_changes_within_the_intervals(screen):
    actuator = next(p for p in screen.problem.places if p.kind == "actuator")
    joint = next(p for p in screen.problem.places if p.name == "joint:joint")
    delay = Term(effect=EFFECTS["actuator-delay"], place=actuator, values={"delay": 0.0032})
    friction = Term(effect=EFFECTS["coulomb-friction"], place=joint, values={"force": 1e-7})  # in fine steps
    fits = TrajectoryLeastSquares(screen, whole=True)
    alone, both = fits.fit((delay,)), fits.fit((delay, friction))
    assert both.cost < 1.1 * alone.cost
    assert both.terms[0].values["delay"] == pytest.approx(DELAY, rel=0.05)


def test_effects_on_the_clock_of_the_samples_have_undivided_intervals(screen):
    assert screen.parts_of(0, EFFECTS["actuator-delay"]) == TRAJECTORY.fine
    assert screen.parts_of(0, EFFECTS["rate-limit"]) == screen.parts_of(0, EFFECTS["actuator-jitter"]) == 1
