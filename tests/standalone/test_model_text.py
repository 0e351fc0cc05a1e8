"""The user's model text with a diagnosis' changes: everything else stays as written, and the numbers arrive."""

import difflib

import mujoco
import numpy as np
import pytest

from vlab.physics.attach import Attached
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf
from vlab.standalone.answer import write_answer
from vlab.standalone.mjcf_text import ModelText

ROBOT = """<?xml version="1.0"?>
<!-- my robot: do not touch -->
<mujoco model='robot'>
  <compiler angle="degree"
            meshdir="parts"/>
  <default>
    <joint damping="0.1"/>  <!-- all joints -->
    <default class="stiff"><joint stiffness="3" armature="0.01"/><motor ctrlrange="-9 9"/></default>
  </default>
  <asset><mesh name="block" file="block.obj"/></asset>
  <include file="arms/arm.xml"/>
  <actuator>
    <motor name='drive' joint="elbow" gear="2"/>
    <position name="servo" joint="wrist" kp="20" kv="0.3"/>
    <general name="g" joint="shoulder" gainprm="2"/>
  </actuator>
  <sensor><jointpos name="q" joint="elbow"/></sensor>
</mujoco>
"""
ARM = """<mujocoinclude>
  <worldbody>
    <body name="upper">  <!-- of aluminium -->
      <joint name="shoulder" class="stiff" axis="0 1 0" springref="10"/>
      <geom type="mesh" mesh="block" density="900"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="elbow"
               axis="0 1 0"   range="-90 90"/>
        <inertial pos="0.1 0 0" mass="0.5" fullinertia="1e-3 2e-3 2.5e-3 1e-4 0 0"/>
        <body name="hand" pos="0.2 0 0"><geom size=".05"/>
          <joint name="wrist" axis="0 1 0"/>
          <site name="tip" pos="0.1 0 0"/></body>
      </body>
    </body>
  </worldbody>
</mujocoinclude>
"""
BLOCK = "v 0 0 0\nv .3 0 0\nv 0 .05 0\nv 0 0 .04\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.fixture
def robot(tmp_path):
    home = tmp_path / "robot"
    (home / "arms").mkdir(parents=True)
    (home / "parts").mkdir()
    (home / "robot.xml").write_bytes(ROBOT.replace("\n", "\r\n").encode())
    (home / "arms" / "arm.xml").write_text(ARM)
    (home / "parts" / "block.obj").write_text(BLOCK)
    return home / "robot.xml"


def answer(source, out, *effects, change=lambda model: None):
    plant = build_mjcf(source)
    change(plant.model)
    mujoco.mj_setConst(plant.model, mujoco.MjData(plant.model))
    made = write_answer(source, plant, [Attached(EFFECTS[n], at, values) for n, at, values in effects], out)
    return made, mujoco.MjModel.from_xml_path(str(out / made.files[0]))


def changed_lines(before, after):
    lines = list(difflib.ndiff(before.splitlines(keepends=True), after.splitlines(keepends=True)))
    return [x[2:] for x in lines if x[0] == "-"], [x[2:] for x in lines if x[0] == "+"]


def test_only_the_changed_attributes_change(robot, tmp_path):
    effects = [
        ("viscous-damping", "joint:elbow", {"damping": 0.25}),
        ("lost-stiffness", "joint:shoulder", {"share": 0.2}),
        ("coulomb-friction", "joint:wrist", {"force": 0.02}),
        ("actuator-gain", "actuator:servo", {"gain": 0.5}),
    ]
    made, model = answer(robot, tmp_path / "out", *effects)
    assert (tmp_path / "out" / "model.xml").read_bytes().count(b"\r\n") == ROBOT.count("\n")
    gone, new = changed_lines(ARM, (tmp_path / "out" / "arms" / "arm.xml").read_text())
    assert gone == [
        '               axis="0 1 0"   range="-90 90"/>\n',
        '          <joint name="wrist" axis="0 1 0"/>\n',
    ]
    assert len(new) == 2
    assert list(made.laws) == ["lost-stiffness@joint:shoulder"]  # its spring is slack elsewhere than at rest
    assert '               axis="0 1 0"   range="-90 90" damping="0.35"/>\n' in new
    assert model.dof_damping[model.joint("elbow").dofadr[0]] == pytest.approx(0.35)
    assert model.dof_frictionloss[model.joint("wrist").dofadr[0]] == pytest.approx(0.02)
    i = model.actuator("servo").id
    assert model.actuator_gainprm[i, 0] == pytest.approx(30.0)
    assert model.actuator_biasprm[i, 1] == pytest.approx(-20.0)  # the feedback keeps its gain
    assert made.patch.startswith("--- a/robot.xml\n+++ b/model.xml\n")
    assert "--- a/arms/arm.xml\n+++ b/arms/arm.xml\n" in made.patch
    assert not made.not_written


def test_a_calibrated_servo_keeps_its_own_attribute(robot, tmp_path):
    def stiffer(model):
        i = model.actuator("servo").id
        model.actuator_gainprm[i, 0] *= 1.25
        model.actuator_biasprm[i, 1:3] *= 1.25

    made, model = answer(robot, tmp_path / "out", change=stiffer)
    assert 'kp="25" kv="0.375"/>' in (tmp_path / "out" / "model.xml").read_text()
    assert [(c.element, c.attribute, c.after) for c in made.changes] == [
        ("actuator:servo", "kp", "25"),
        ("actuator:servo", "kv", "0.375"),
    ]
    assert model.actuator_biasprm[1, 2] == pytest.approx(-0.375)


def test_masses_become_inertias_of_bodies(robot, tmp_path):
    def heavier(model):
        for name, factor in (("upper", 1.1), ("lower", 0.9)):
            model.body_mass[model.body(name).id] *= factor
            model.body_inertia[model.body(name).id] *= factor

    effects = [("added-mass", "site:tip", {"mass": 0.05}), ("added-mass", "body:upper", {"mass": 0.2})]
    plain = mujoco.MjModel.from_xml_path(str(robot))
    made, model = answer(robot, tmp_path / "out", *effects, change=heavier)
    assert not made.uses  # all of it is in the text
    own = float(plain.body("upper").mass[0])
    assert float(model.body("upper").mass[0]) == pytest.approx(1.1 * own + 0.2)
    assert np.allclose(model.body("lower").inertia, 0.9 * plain.body("lower").inertia)
    hand, before = model.body("hand"), plain.body("hand")
    assert float(hand.mass[0]) == pytest.approx(float(before.mass[0]) + 0.05)
    # the parallel-axis theorem for a point 0.1 m from a sphere's centre
    together = float(before.mass[0]) * 0.05 / (float(before.mass[0]) + 0.05) * 0.1**2
    assert np.sort(hand.inertia)[1:] == pytest.approx(np.sort(before.inertia)[1:] + together)
    text = (tmp_path / "out" / "arms" / "arm.xml").read_text()
    assert '<body name="upper">  <!-- of aluminium -->' not in text or text.count("<inertial") == 3
    assert "fullinertia" not in text


def test_elements_outside_the_text_are_set_by_the_law_module(tmp_path):
    source = tmp_path / "row.xml"
    source.write_text(
        '<mujoco><option gravity="0 0 0"/><worldbody><replicate count="3" offset="1 0 0"><body name="b">'
        '<joint name="j" type="slide" stiffness="9"/><geom size=".1"/></body></replicate></worldbody></mujoco>'
    )
    made, model = answer(source, tmp_path / "out", ("viscous-damping", "joint:j1", {"damping": 0.7}))
    law = {}
    exec(compile((tmp_path / "out" / "law.py").read_text(), "law.py", "exec"), law)
    assert model.dof_damping[model.joint("j1").dofadr[0]] == 0.0
    law["install"](model)
    law["uninstall"]()
    assert [float(x) for x in model.dof_damping] == pytest.approx([0.0, 0.7, 0.0])
    assert made.uses == ("install",)


def test_unnamed_elements_are_found_by_their_number(tmp_path):
    source = tmp_path / "rig.xml"
    source.write_text(
        "<mujoco><worldbody><body><body><joint type='slide' damping='2'/><geom size='.1'/></body>"
        "<joint type='slide' damping='1'/><geom size='.1'/></body></worldbody></mujoco>"
    )

    def doubled(model):
        model.dof_damping[1] *= 2  # of the inner body

    made, model = answer(source, tmp_path / "out", change=doubled)
    assert list(model.dof_damping) == pytest.approx([1.0, 4.0])
    assert not made.uses
    assert """<joint type='slide' damping="4"/>""" in (tmp_path / "out" / "model.xml").read_text()


def test_a_text_without_edits_is_byte_for_byte_the_same(robot):
    text = ModelText(robot)
    assert all(text.written(path) == path.read_bytes() for path in text.texts)
    assert [e.attributes.get("name") for e in text.root.iterate() if e.tag == "body"] == ["upper", "lower", "hand"]


@pytest.mark.slow
def test_a_byte_order_mark_and_signs_beyond_ascii_stay(tmp_path):
    source = tmp_path / "rig.xml"
    source.write_bytes(
        "\ufeff<mujoco><!-- Prüfstand ä --><worldbody><body name='ä'><joint name='j' type='slide'/><geom size='.1'/></body>"
        "</worldbody></mujoco>".encode()
    )
    _, model = answer(source, tmp_path / "out", ("viscous-damping", "joint:j", {"damping": 0.7}))
    assert model.dof_damping[0] == pytest.approx(0.7)
    assert (tmp_path / "out" / "model.xml").read_bytes().startswith("\ufeff<mujoco><!-- Prüfstand ä -->".encode())
