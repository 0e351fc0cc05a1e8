"""Coupled joints: the tendon that stands for a joint equality, beside MuJoCo's own constraint."""

import mujoco
import numpy as np
import pytest

from vlab.diagnose.parameters.mjcf import uncertain_parameters
from vlab.errors import BadStructure
from vlab.plants.linearise import linearise
from vlab.plants.mjcf import build_mjcf

HAND = """<mujoco><option timestep="0.0005" integrator="{integrator}"/>
  <worldbody>
    <body><joint name="one" type="slide" axis="0 0 1" damping="0.5"/><geom size="0.02" mass="{one}"/></body>
    <body pos="0 1 0"><joint name="two" type="slide" axis="0 0 -1" damping="0.5"/><geom size="0.02" mass="{two}"/></body>
  </worldbody>
  <equality><joint name="gear" joint1="one" {other} polycoef="{poly}" {more}/></equality>
  <actuator><position name="grip" joint="one" kp="40" kv="2"/></actuator>
</mujoco>"""
ONE, TWO, RATIO = 0.1, 0.15, 1.2


def hand(*, poly=f"0.002 {RATIO} 0 0 0", integrator="implicitfast", other='joint2="two"', more=""):
    return HAND.format(one=ONE, two=TWO, poly=poly, integrator=integrator, other=other, more=more)


def simulated(model, seconds=3.0):
    data, out = mujoco.MjData(model), []
    for k in range(round(seconds / model.opt.timestep)):
        t = k * model.opt.timestep
        data.ctrl[:] = 0.02 * np.sin(2 * np.pi * 1.5 * t) + 0.01 * (t > 1)
        mujoco.mj_step(model, data)
        out.append(data.qpos.copy())
    return np.array(out)


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler", "RK4"])
def test_a_coupled_hand_moves_as_with_the_constraint_of_mujoco(integrator):
    text = hand(integrator=integrator)
    plant = build_mjcf(text)
    assert plant.model.neq == 0
    assert "gear" in plant.notes[0]
    own, constrained = simulated(plant.model), simulated(mujoco.MjModel.from_xml_string(text))
    apart = np.std(own - constrained, axis=0) / np.std(constrained, axis=0)
    assert apart.max() < 0.02  # the constraint's own softness moves the fingers by more than one percent


def test_the_coupling_has_the_static_stiffness_of_the_constraint():
    text = hand(poly=f"0 {RATIO} 0 0 0", more='solimp="0.9 0.9 0.001"')  # the same impedance at every residual
    deflections = []
    for model in (build_mjcf(text).model, mujoco.MjModel.from_xml_string(text)):
        data = mujoco.MjData(model)
        for _ in range(20000):
            data.qfrc_applied[:] = 0.3, 0.1
            mujoco.mj_step(model, data)
        deflections.append(data.qpos[0] - RATIO * data.qpos[1])
    assert abs(deflections[1]) > 1e-4
    assert deflections[0] == pytest.approx(deflections[1], rel=1e-6)


def test_the_linear_model_has_the_mode_of_the_coupled_mass():
    linear = linearise((plant := build_mjcf(hand())).model, plant.rest)
    # moving both fingers by (RATIO, 1): mass, and the stiffness of the servo on the first one
    expected = np.sqrt(40 * RATIO**2 / (ONE * RATIO**2 + TWO)) / (2 * np.pi)
    assert linear.freq[0] == pytest.approx(expected, rel=0.01)
    assert linear.freq[1] > 10 * linear.freq[0]


def test_a_joint_may_be_locked_by_the_constraint():
    held = hand(poly="0.003 0 0 0 0", other="").replace('name="two"', 'name="two" stiffness="500"')
    plant = build_mjcf(held)
    assert plant.rest[0] == pytest.approx(0.003, abs=5e-4)


@pytest.mark.parametrize("offset", [-1.0, -0.9, 0.5])
def test_the_coupling_keeps_its_offset(offset):
    """A rest length of minus one is MuJoCo's default, which stands for the length in the reference configuration."""
    plant = build_mjcf(hand(poly=f"{offset} {RATIO} 0 0 0"))
    assert plant.rest[0] - RATIO * plant.rest[1] == pytest.approx(offset, abs=0.01)


def test_the_coupling_is_no_place_and_no_uncertain_stiffness():
    plant = build_mjcf(hand())
    assert not any(name.startswith("tendon:") for name in plant.ports)
    parameters = uncertain_parameters(plant, {"stiffness": 0.1, "damping": 0.1}, (), ())
    stated = {p.name for p in parameters if "stiffness" in p.name or "damping" in p.name}
    assert stated == {"damping", "joint:one:damping", "joint:two:damping"}


def test_a_curved_coupling_is_refused_in_one_line():
    plant = build_mjcf(hand(poly="0 1 0.3 0 0"))
    assert plant.model.neq == 1
    with pytest.raises(BadStructure, match="'gear' ties coordinates together"):
        linearise(plant.model, plant.rest)
