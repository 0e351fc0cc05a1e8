"""What is wrong within a position servo is found, and nothing is found in servos that are as modelled."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from servo_rigs import ARMS, LEVER, RATE, TWO_LINKS, commands_of, servo_case

from vlab.cases import load_case
from vlab.diagnose.pipeline import diagnose


def hide(arm, joint, **changed):
    """Return an arm's drives with one of them changed."""
    return tuple(replace(d, **changed) if i == joint else d for i, d in enumerate(arm.drives))


HIDDEN = {
    # effect: arm, drives, place, parameter, true value, tolerance
    "position gain, soft": ("lever", hide(LEVER, 0, gain=0.78 * 12.0), "servo-position-gain", "shaft", {"gain": -0.22}),
    "position gain, stiff": (
        "two links",
        hide(TWO_LINKS, 0, gain=1.45 * 40.0),
        "servo-position-gain",
        "shoulder",
        {"gain": 0.45},
    ),
    "dead zone": ("lever", hide(LEVER, 0, dead=0.018), "servo-error-dead-zone", "shaft", {"threshold": 0.018}),
    "velocity gain": (
        "two links",
        hide(TWO_LINKS, 1, damping=0.5 * 0.8),
        "servo-velocity-gain",
        "elbow",
        {"gain": -0.5},
    ),
    "force limit": ("two links", hide(TWO_LINKS, 0, limit=6.0), "servo-force-limit", "shoulder", {"limit": 6.0}),
}
QUICK = "position gain, soft"


def found(folder, kind):
    arm, drives, effect, joint, parameters = HIDDEN[kind]
    servo_case(folder, arm, hidden=drives, effect=effect, place=f"actuator:{joint}_servo", parameters=parameters)
    return diagnose(load_case(folder / "case.toml")).diagnosis


def check(diagnosis, kind):
    _, _, effect, joint, parameters = HIDDEN[kind]
    assert diagnosis.verdict == "missing-physics"
    assert [f.effect for f in diagnosis.findings] == [effect]
    (finding,) = diagnosis.findings
    assert finding.place == f"actuator:{joint}_servo"
    for name, value in parameters.items():
        assert finding.parameters[name].value == pytest.approx(value, rel=0.1)
    assert diagnosis.heldout.gap_closed > 0.9


def test_a_soft_servo_is_not_an_inertia(tmp_path):
    check(found(tmp_path, QUICK), QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in HIDDEN if kind != QUICK])
def test_an_error_within_a_servo_is_found(tmp_path, kind):
    check(found(tmp_path, kind), kind)


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("seed", [1, 2])
def test_servos_as_modelled_lack_nothing(tmp_path, arm, seed):
    servo_case(tmp_path, arm, seed=seed)
    diagnosis = diagnose(load_case(tmp_path / "case.toml")).diagnosis
    assert diagnosis.verdict == "nothing-missing"
    assert not diagnosis.findings


@pytest.mark.parametrize("name", ARMS)
def test_the_arms_are_those_of_mujoco(name):
    # the rig's closed form against MuJoCo's recursive dynamics, to the error of its steps of 1 ms
    arm = ARMS[name]
    commands = commands_of(arm, np.random.default_rng(3))[:200]
    here, model = arm.angles(commands, arm.drives), mujoco.MjModel.from_xml_string(arm.mjcf)
    data, there = mujoco.MjData(model), np.zeros(here.shape)
    for k, command in enumerate(commands):
        there[k], data.ctrl[:] = data.qpos, command
        for _ in range(round(1.0 / RATE / model.opt.timestep)):
            mujoco.mj_step(model, data)
    assert np.abs(here - there).max() < 0.01 * np.abs(here).max()
