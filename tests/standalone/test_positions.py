"""Calibrated lengths, masses and gains of an arm reach the user's text, or the law module where the text cannot hold them."""

import json
from argparse import Namespace
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from vlab.cli.diagnose import _written
from vlab.diagnose.export import ExtendedModelFiles
from vlab.diagnose.parameters.geometry import geometry_parameters
from vlab.diagnose.parameters.mjcf import adjusted, uncertain_parameters
from vlab.errors import BadStructure
from vlab.physics.attach import Attached, written
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf
from vlab.standalone import answer as answer_module
from vlab.standalone.answer import write_answer
from vlab.standalone.model_patch import differing
from vlab.views.reports.diagnosis import _without_vlab

ARM = """<mujoco model="arm">
  <!-- measured with a ruler -->
  <option timestep="0.001" integrator="implicitfast"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <default class="link"><joint damping="0.05" armature="0.001" axis="0 1 0"/><position kp="8" kv="0.3"/></default>
  </default>
  <worldbody>
    <body name="upper" childclass="link" euler="0 20 0">
      <joint name="shoulder"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.5"/>
      <body name="fore" pos="0 0 -0.3">  <!-- the elbow -->
        <joint name="elbow"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.3"/>
        <site name="tip" pos="0 0 -0.25"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="m1" class="link" joint="shoulder"/>
    <motor name="m2" joint="elbow"/>
  </actuator>
  <sensor><framepos name="tip" objtype="site" objname="tip"/></sensor>
</mujoco>
"""
FRAMES = """<mujoco>
  <compiler angle="degree"{compiler}/>
  <default><geom contype="0" conaffinity="0"/><default class="c"><site pos="0 0 .02"/></default></default>
  <worldbody>
    <body name="a" childclass="c" euler="0 30 0"><joint name="j1" axis="0 1 0" damping=".2"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
      <site name="s1" pos=".1 0 .02"/><site name="by_default"/>
      <frame pos=".3 0 0">
        <body name="b" pos=".01 0 0" quat=".9 .1 0 0"><joint name="j2" axis="0 1 0"/>
          <inertial pos=".1 .01 0" mass=".4" fullinertia="1e-3 2e-3 2.5e-3 1e-4 0 0"/>
          <geom size=".05"/>
          <site name="s2" pos=".1 0 0"/>
          <site class="main" type="capsule" fromto="0 0 0 .1 0 .1" size=".01"/>
          <frame euler="0 0 90">
            <body pos=".2 0 0"><joint name="j3" axis="0 1 0"/><geom type="box" size=".1 .02 .02" pos=".1 0 0"/></body>
          </frame>
        </body>
      </frame>
    </body>
  </worldbody>
  <tendon><spatial name="t" stiffness="5"><site site="s1"/><site site="s2"/></spatial></tendon>
  <actuator>
    <position name="p" joint="j2" kp="5" dampratio="1"/>
    <muscle name="m" tendon="t" lengthrange=".05 .5"/>
  </actuator>
</mujoco>
"""
ROW = """<mujoco><worldbody><replicate count="2" offset="0 1 0"><body name="a"><joint name="j" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/><body name="b" pos=".3 0 0"><joint name="k" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></body></replicate></worldbody></mujoco>"""
LOOP = """<mujoco><worldbody><body name="a"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
<body name="b" pos=".3 0 0"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 .2" size=".02"/></body></body>
<body name="w" pos=".5 0 .2"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></worldbody>
<equality><connect body1="b" body2="w" anchor=".2 0 .2"/></equality></mujoco>"""
WELDED = """<mujoco><compiler fusestatic="true"/><worldbody><body pos="0 0 .2" euler="0 0 40"><geom size=".1"/>
<body name="a" pos=".1 0 0"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
<body pos=".3 0 0" euler="0 0 20"><geom size=".03"/><body name="b" pos=".05 0 0"><joint axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></body></body></body></worldbody></mujoco>"""
MODELS = {
    "arm": ARM,
    "frames": FRAMES.format(compiler=""),
    "inertia from geoms": FRAMES.format(compiler=' inertiafromgeom="true"'),
    "replicated": ROW,
    "closed loop": LOOP,
    "fused": WELDED,
}


def calibrated(path):
    """Return the plant of a file with all its uncertain numbers changed, as by a calibration of large motion."""
    plant = build_mjcf(path)
    parameters = uncertain_parameters(plant, {}, [], range(len(plant.actuators))) + geometry_parameters(plant, {})
    assert any(p.kind == "length" for p in parameters)
    return adjusted(plant, parameters, 0.05 * np.random.default_rng(0).standard_normal(len(parameters)))


def loaded(folder, made):
    """Return the written model as MuJoCo alone has it."""
    model = mujoco.MjModel.from_xml_path(str(folder / made.files[0]))
    if made.uses:
        law = {}
        exec(compile((folder / "law.py").read_text(), "law.py", "exec"), law)
        law["install"](model)
        law["uninstall"]()
    return model


@pytest.fixture
def source(tmp_path, request):
    path = tmp_path / "model" / "rig.xml"
    path.parent.mkdir()
    path.write_text(MODELS[getattr(request, "param", "arm")])
    return path


@pytest.mark.parametrize("source", MODELS, indirect=True)
def test_every_field_of_the_written_model_is_that_of_the_calibrated_plant(source, tmp_path):
    plant = calibrated(source)
    assert differing(plant.model, build_mjcf(source).model)
    made = write_answer(source, plant, [], tmp_path / "out")
    assert not differing(plant.model, loaded(tmp_path / "out", made))


@pytest.mark.parametrize("source", MODELS, indirect=True)
def test_the_extended_model_has_the_numbers_of_the_calibrated_plant(source):
    plant = calibrated(source)
    spec, _ = written(plant, [])
    assert not differing(plant.model, spec.compile())


def test_lengths_of_an_arm_are_attributes_of_its_text(source, tmp_path):
    plant = calibrated(source)
    made = write_answer(source, plant, [], tmp_path / "out")
    text = (tmp_path / "out" / "model.xml").read_text()
    assert not made.uses
    for comment in ("<!-- measured with a ruler -->", "<!-- the elbow -->"):
        assert comment in text
    moved = {c.element: c.after for c in made.changes if c.attribute == "pos"}
    assert set(moved) == {"body:fore", "site:tip"}
    assert f'<body name="fore" pos="{moved["body:fore"]}">' in text
    assert float(moved["body:fore"].split()[2]) == pytest.approx(plant.model.body_pos[2, 2], rel=1e-9)
    assert 'fromto="0 0 0 0 0 -0.3"' in text  # the geoms stay
    assert "-0 " not in made.patch.replace("--- a", "")


def test_the_written_arm_moves_as_the_calibrated_plant(source, tmp_path):
    plant = calibrated(source)
    effects = [Attached(EFFECTS["coulomb-friction"], "joint:elbow", {"force": 0.02})]
    made = write_answer(source, plant, effects, tmp_path / "out")
    model = loaded(tmp_path / "out", made)
    expected = plant.model
    expected.dof_frictionloss[1] = model.dof_frictionloss[1]
    expected.dof_solref[1], expected.dof_solimp[1] = model.dof_solref[1], model.dof_solimp[1]
    assert model.dof_frictionloss[1] == pytest.approx(0.02)
    tips = []
    for one in (expected, model):
        data = mujoco.MjData(one)
        rows = []
        for k in range(1000):
            data.ctrl[:] = 0.8 * np.sin(0.006 * k), 0.2 * np.cos(0.01 * k)
            mujoco.mj_step(one, data)
            rows.append(data.sensordata.copy())
        tips.append(np.array(rows))
    assert np.ptp(tips[0], axis=0).max() > 0.1  # the arm moves far
    # ten written digits, magnified by the motion of 1 s
    assert np.abs(tips[1] - tips[0]).max() < 1e-7


@pytest.mark.parametrize("source", ["replicated"], indirect=True)
def test_a_failure_leaves_no_folder_and_says_its_reason(source, tmp_path, monkeypatch):
    monkeypatch.setattr(answer_module, "NUMBERS", ())
    out = tmp_path / "out" / "mujoco"
    with pytest.raises(BadStructure, match=r"rig\.xml: the changed text differs from the computed model in .*body_pos"):
        write_answer(source, calibrated(source), [], out)
    assert not list(out.parent.iterdir())


def test_a_failure_leaves_a_present_folder_as_it_is(source, tmp_path, monkeypatch):
    monkeypatch.setattr(answer_module, "differing", lambda *_: {"nq": np.array(True)})
    (tmp_path / "model.xml").write_text("mine")
    with pytest.raises(BadStructure, match="nq"):
        write_answer(source, calibrated(source), [], tmp_path)
    assert (tmp_path / "model.xml").read_text() == "mine"
    assert {p.name for p in tmp_path.iterdir()} == {"model", "model.xml"}


def test_terminal_report_and_json_say_why_there_is_no_answer(tmp_path):
    files = ExtendedModelFiles(files=(), tables=(), nrmse=None, reported=0.0, mujoco_note="rig.xml: it differs in nq")
    line = "The answer for MuJoCo alone is not written: rig.xml: it differs in nq"
    assert files.notes == (line,)
    (section,) = _without_vlab(files)
    assert section.text == (f"{line}.",)

    def write_into(folder: Path) -> None:
        document = {"notes": ["first", *files.notes], "mujoco": None}
        (folder / "diagnosis.json").write_text(json.dumps(document))

    diagnosis = SimpleNamespace(notes=("first",), findings=(), is_naming=False, to_json=lambda: {"notes": ["first"]})
    result = SimpleNamespace(done=SimpleNamespace(diagnosis=diagnosis), write_into=write_into)
    document, lines = _written(Namespace(overwrite=False, patch=False, jobs=None), result, tmp_path / "out")
    assert document["notes"] == ["first", line]
    assert lines[-1] == line
