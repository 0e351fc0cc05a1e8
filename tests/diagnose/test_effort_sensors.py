"""Logged torques of servos: read as MuJoCo reads them, and understood along a motion."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from servo_rigs import TWO_LINKS, commands_of, servo_case

from vlab.cases import load_case
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.plants.effort_sensors import effort_rows

GEARED = """<mujoco><worldbody>
  <body><joint name="a" axis="0 1 0"/><geom size="0.1"/>
    <body pos="0 0 0.3"><joint name="b" axis="0 1 0"/><geom size="0.1"/>
      <body pos="0 0 0.3"><joint name="c" axis="1 0 0"/><geom size="0.1"/></body></body></body></worldbody>
  <tendon><fixed name="pull"><joint joint="b" coef="0.4"/><joint joint="c" coef="-0.7"/></fixed></tendon>
  <actuator><position name="one" joint="a" kp="20" kv="1" gear="3"/><motor name="two" tendon="pull" gear="2"/></actuator>
  <sensor><jointpos joint="a"/><actuatorfrc name="e1" actuator="one"/><actuatorfrc name="e2" actuator="two"/>
    <jointactuatorfrc name="e3" joint="b"/></sensor></mujoco>"""


def test_efforts_follow_from_generalised_forces():
    """Readings are the rows times MuJoCo's own generalised forces of the actuators."""
    model = mujoco.MjModel.from_xml_string(GEARED)
    data, rng, rows = mujoco.MjData(model), np.random.default_rng(3), effort_rows(model)
    assert not np.any(rows[0])
    for _ in range(5):
        data.qpos[:], data.qvel[:], data.ctrl[:] = rng.normal(size=3), rng.normal(size=3), rng.normal(size=2)
        mujoco.mj_forward(model, data)
        assert rows[1:] @ data.qfrc_actuator == pytest.approx(data.sensordata[1:], rel=1e-9, abs=1e-9)


def test_the_rig_logs_what_mujoco_reads():
    """An effort before the command of its row is sent, beside MuJoCo's reading with the command before."""
    commands = commands_of(TWO_LINKS, np.random.default_rng(1))[:200]
    angles, efforts = TWO_LINKS.motion(commands, TWO_LINKS.drives)
    model = mujoco.MjModel.from_xml_string(TWO_LINKS.mjcf)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data, last, steps = mujoco.MjData(model), np.zeros(2), round(0.01 / model.opt.timestep)
    read = np.zeros_like(efforts)
    for k, command in enumerate(commands):
        data.ctrl[:] = last
        mujoco.mj_forward(model, data)
        read[k], data.ctrl[:], last = data.sensordata, command, command
        mujoco.mj_step(model, data, steps)
    assert read == pytest.approx(efforts, abs=2e-3 * np.abs(efforts).max())
    assert np.abs(angles).max() > 0.2


def test_the_linear_system_follows_efforts_of_changed_gains(tmp_path):
    """A model with other gains reaches the noise of logged torques once it is linearised about the fitted gains."""
    drives = tuple(replace(d, gain=1.1 * d.gain, damping=0.9 * d.damping) for d in TWO_LINKS.drives)
    servo_case(
        tmp_path, "two links", hidden=drives, uncertain={"gain": 0.2, "velocity-gain": 0.2}, effort_noise=0.01, seed=4
    )
    problem, moving = prepare_trajectory(load_case(tmp_path / "case.toml"))
    screen = TrajectoryScoreTest(problem, moving)
    fit = TrajectoryLeastSquares(screen.at(TrajectoryLeastSquares(screen).fit().theta)).fit()
    efforts = [i for i, name in enumerate(problem.names) if name.endswith("_effort")]
    assert len(efforts) == 2
    assert np.median(fit.error[:, efforts]) == pytest.approx(0.01, rel=0.2)  # of the window's rms, as the noise


HIDDEN = {
    "nothing": ({}, None, None),
    "torque constant": ({"gain": 0.8, "damping": 0.8}, "servo-torque-constant", "actuator:elbow_servo"),
    "force limit": ({"limit": 0.09}, "servo-force-limit", "actuator:elbow_servo"),
}
"""Changed numbers of the elbow's servo as factors, the effect and its place."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", HIDDEN)
def test_servos_with_logged_torques_are_diagnosed(tmp_path, kind):
    factors, effect, place = HIDDEN[kind]
    shoulder, elbow = TWO_LINKS.drives
    elbow = replace(elbow, **{name: factor * getattr(elbow, name) for name, factor in factors.items()})
    stated = {"gain": 0.02, "velocity-gain": 0.02, "sensor": 0.001}
    servo_case(tmp_path, "two links", hidden=(shoulder, elbow), uncertain=stated, effort_noise=0.02, seed=2)
    diagnosis = diagnose(load_case(tmp_path / "case.toml")).diagnosis
    if effect is None:
        assert diagnosis.verdict == "nothing-missing"
        return
    assert diagnosis.verdict == "missing-physics"
    assert [(f.effect, f.place) for f in diagnosis.findings] == [(effect, place)]
