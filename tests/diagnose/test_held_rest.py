"""Starts of joints that dry friction holds away from the equilibrium."""

from dataclasses import replace

import numpy as np
import pytest
from rig_folder import Channel, Record, write_case

from vlab.cases import load_case
from vlab.cases.initial_state import find_initial_state
from vlab.cases.simulate import simulate
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS

KP, FRICTION = 20.0, 0.4
"""Gain [N m/rad], friction [N m]."""
MODEL = f"""<mujoco><option timestep="0.001" integrator="implicitfast"/><worldbody><body>
  <inertial pos="0 0 0" mass="1" diaginertia="0.05 0.05 0.05"/>
  <joint name="hinge" axis="0 0 1" damping="0.3"/>
  <geom size="0.01" contype="0" conaffinity="0"/></body></worldbody>
  <actuator><position name="servo" joint="hinge" kp="{KP}"/></actuator></mujoco>"""


def angles(command, friction, start):
    """Angles at 100 Hz under a held command, from rest; friction sticks exactly."""
    out, q, v, h = [], start, 0.0, 1e-4
    for u in command:
        out.append(q)
        for _ in range(100):
            free = v + h * (KP * (u - q) - 0.3 * v) / 0.05
            v = free - np.clip(free, -h * friction / 0.05, h * friction / 0.05)
            q += h * v
    return np.array(out)


def run_of(folder, friction, posture, start, wait):
    """A joint whose command stands for a while, then sways."""
    time = np.arange(300) / 100.0
    command = posture + 0.5 * np.sin(4.0 * np.maximum(time - wait, 0.0))
    angle = angles(command, friction, start)
    write_case(
        folder,
        title="hinge",
        mjcf=MODEL,
        uncertain={},
        channels=[
            Channel(column="u", at="servo", kind="command", unit="rad", is_input=True, hold="zero"),
            Channel(column="q", at="joint:hinge", kind="angle", unit="rad"),
        ],
        records=[Record(name="one", role="fit", columns={"u": command, "q": angle}, rate_hz=100.0, initial="auto")],
    )
    case = load_case(folder / "case.toml")
    (run,) = case.runs()
    law = Attached(
        effect=EFFECTS["stribeck-friction"],
        place="joint:hinge",
        values={"force": friction, "excess": 1e-6, "speed": 0.1},
    )  # sticks exactly, as friction of MuJoCo does not
    return (attach(case.plant, [law]) if friction else case.plant), run


@pytest.mark.parametrize(("posture", "stuck", "wait"), [(0.0, 0.008, 1.0), (4.0, 0.006, 0.0)])
def test_friction_holds_a_joint_where_the_readings_say(tmp_path, posture, stuck, wait):
    """At rest and at a posture: the linear estimate would release the joint to its equilibrium."""
    plant, run = run_of(tmp_path, FRICTION, posture, posture + stuck, wait)
    assert find_initial_state(plant, run).qpos[0] == pytest.approx(posture + stuck, abs=1e-3)
    assert simulate(plant, run).recording["joint:hinge"] == pytest.approx(run.measured["joint:hinge"], abs=4e-3)


def test_without_friction_a_joint_begins_at_its_equilibrium(tmp_path):
    plant, run = run_of(tmp_path, 0.0, 0.0, 0.0, 1.0)
    state = find_initial_state(plant, run)
    assert (state.how, state.qpos[0]) == ("rest", 0.0)


def test_a_start_stays_within_the_band_of_the_friction(tmp_path):
    """Friction too weak to hold the joint explains no offset of its readings."""
    plant, run = run_of(tmp_path, 0.01, 0.0, 0.0, 1.0)
    data = run.measured.data.copy()
    data[:, run.measured.index("joint:hinge")] += 0.008  # a sensor's zero
    off = replace(run, measured=replace(run.measured, data=data))
    assert find_initial_state(plant, off).qpos[0] == pytest.approx(0.01 / KP, rel=1e-3)


def test_a_step_from_the_first_sample_starts_at_the_first_reading(tmp_path):
    plant, run = run_of(tmp_path, FRICTION, 0.0, 0.0, 0.0)
    assert find_initial_state(plant, run).qpos[0] == 0.0
