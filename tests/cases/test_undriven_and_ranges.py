"""Actuators without a column, and commands of servos beyond the range of their joint."""

import mujoco
import numpy as np
import pytest
from command import run

import vlab
from vlab.cases.checks import check_recordings
from vlab.cases.checks.undriven import undriven

ARM = """<mujoco><compiler angle="radian"/><option timestep="0.002" gravity="0 0 0"/><worldbody>
<body name="upper"><joint name="elbow" type="hinge" axis="0 0 1" range="-1.5 1.5" limited="true" damping="1" armature="0.01"/>
<geom size="0.05" mass="0.2" pos=".2 0 0"/>
<body name="lower" pos=".4 0 0"><joint name="wrist" type="hinge" axis="0 0 1" range="-1.5 1.5" limited="true" damping=".3" armature="0.01"/>
<geom size="0.03" mass="0.1" pos=".1 0 0"/></body></body></worldbody>
<actuator><position name="elbow" joint="elbow" kp="30"{0}/><position name="wrist" joint="wrist" kp="20"/></actuator>
<sensor><jointpos name="qe" joint="elbow"/><jointpos name="qw" joint="wrist"/></sensor></mujoco>"""
CHANNEL = '[[recording.channel]]\ncolumn = "{}"\nat = "{}"\nkind = "{}"\n{}\n'
T = 0.01 * np.arange(600)
COMMAND = 0.8 * np.sin(np.pi * T) + 0.3 * np.sin(7.0 * T)


@pytest.fixture(scope="module")
def angles():
    model = mujoco.MjModel.from_xml_string(ARM.replace("{0}", ""))
    data, out = mujoco.MjData(model), []
    for u in COMMAND:
        out.append(data.qpos.copy())
        data.ctrl[:] = u, 0.0
        mujoco.mj_step(model, data, 5)
    return np.array(out) + np.random.default_rng(0).normal(0.0, 1e-5, (T.size, 2))


def case_file(folder, angles, *, command=COMMAND, kind="angle", unit='unit = "rad"', ctrlrange=""):
    (folder / "arm.xml").write_text(ARM.replace("{0}", ctrlrange))
    rows = np.column_stack([T, command, angles])
    np.savetxt(folder / "run.csv", rows, "%.9g", ",", header="t,u,qe,qw", comments="")
    (folder / "case.toml").write_text(
        '[model]\nmjcf = "arm.xml"\n[[recording]]\nfile = "run.csv"\ntime = "t"\nrole = "fit"\n'
        + CHANNEL.format("u", "elbow", kind, f"{unit}\ninput = true")
        + CHANNEL.format("qe", "qe", "angle", 'unit = "rad"')
        + CHANNEL.format("qw", "qw", "angle", 'unit = "rad"')
    )
    return folder


def test_check_warns_of_actuators_without_a_column(capsys, tmp_path, angles):
    status, text, err = run(capsys, "check", str(case_file(tmp_path, angles)))
    assert (status, err) == (0, "")
    assert "WARNING: actuator 'wrist' has no column: its command is zero in the simulation" in text
    assert "reaches" not in text


def test_driven_actuators_powerless_coils_and_idle_motors_are_not_named(angles):
    both = {"elbow": COMMAND, "wrist": 0 * T}
    arm = ARM.replace("{0}", "")
    driven = vlab.Case.from_arrays(arm, T, both, {"qe": angles[:, 0]})
    assert undriven(driven, driven.runs()) == ()
    motor = arm.replace('<position name="wrist" joint="wrist" kp="20"/>', '<motor name="wrist" joint="wrist"/>')
    torque = vlab.Case.from_arrays(motor, T, {"elbow": COMMAND, "joint:wrist": 0 * T}, {"qe": angles[:, 0]})
    assert undriven(torque, torque.runs()) == ()
    beam = vlab.Case.from_arrays("beam", 5e-4 * np.arange(200), {"base": np.zeros(200)}, {"20in": np.zeros(200)})
    assert undriven(beam, beam.runs()) == ()


@pytest.mark.parametrize(
    ("stated", "mend"),
    [
        ({}, 'unit = "deg" in every'),
        ({"kind": "command"}, 'unit = "deg" in every'),
        ({"kind": "command", "unit": "scale = 1.0"}, "scale = 0.0174532925199 in every"),
        ({"kind": "command", "unit": "scale = 1.0", "ctrlrange": ' ctrlrange="-1.5 1.5"'}, "scale = 0.0174532925199"),
    ],
)
def test_degrees_left_as_radians_are_seen_from_the_range_of_the_joint(tmp_path, angles, stated, mend):
    folder = case_file(tmp_path, angles, command=np.rad2deg(COMMAND), **stated)
    (line,) = [text for text in check_recordings(vlab.Case.load(folder)).of("warning") if "reaches" in text]
    assert (
        "the model's range is -1.5 to 1.5 rad; in deg the numbers stay inside; to mend it, say in case.toml: " in line
    )
    assert mend in line


def test_a_command_far_outside_in_any_unit_is_a_warning_and_one_into_a_stop_is_not(tmp_path, angles):
    far = case_file(tmp_path, angles, command=200.0 * COMMAND)
    (line,) = [text for text in check_recordings(vlab.Case.load(far)).of("warning") if "reaches" in text]
    assert "the joint of this position servo moves from -1.5 to 1.5 rad; check the unit of the column" in line
    pressed = case_file(tmp_path, angles, command=2.0 * COMMAND)
    assert not [text for text in check_recordings(vlab.Case.load(pressed)).lines if "reaches" in text]


def test_a_case_in_memory_names_the_argument_that_mends_it(angles):
    case = vlab.Case.from_arrays(
        ARM.replace("{0}", ""), T, {"elbow": np.rad2deg(COMMAND)}, {"qe": angles[:, 0], "qw": angles[:, 1]}
    )
    (line,) = [text for text in check_recordings(case).lines if "reaches" in text]
    assert line.endswith('; to mend it, say in vlab.Case.from_arrays: channels={"elbow": {"scale": 0.0174532925199}}')


def test_compare_names_the_folder_that_it_writes(capsys, tmp_path, angles):
    status, text, err = run(capsys, "compare", str(case_file(tmp_path, angles)), "--out", str(tmp_path / "out"))
    assert (status, err) == (0, "")
    assert text.rstrip().endswith(f"written to {tmp_path / 'out'}: report.html, run.rrd")
    assert (tmp_path / "out" / "run.rrd").is_file()
