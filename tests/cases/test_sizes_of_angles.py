"""Radians and degrees of hinges without limits: the size beside the model decides, or the user."""

import numpy as np
import pytest

from vlab.cases.case import load_case
from vlab.cases.checks import check_recordings
from vlab.cases.draft import draft_case

WHEEL = """<mujoco model="wheel"><option timestep="0.001" gravity="0 0 0"/><worldbody><body>
<joint name="axle" axis="0 0 1" damping="0.1"/><inertial pos="0 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>
{}</mujoco>"""
MOTOR = '<actuator><motor name="motor" joint="axle"/></actuator>'
TIME = 0.01 * np.arange(400)
TORQUE = np.sin(2 * np.pi * 0.25 * TIME)
SIZE = float(np.std(10.0 * 2 / np.pi * (1 - np.cos(2 * np.pi * 0.25 * TIME))))  # of the wheel, nearly all damping


def write_log(folder, motor="", **columns):
    (folder / "wheel.xml").write_text(WHEEL.format(motor))
    table = np.column_stack([TIME, *columns.values()])
    np.savetxt(folder / "log.csv", table, delimiter=",", header=",".join(["time", *columns]), comments="")
    return folder


def drafted(folder):
    draft = draft_case(str(folder / "wheel.xml"), [folder / "log.csv"], folder)
    (match,) = (m for m in draft.channels if not m.is_input)
    return match, draft


@pytest.mark.parametrize(("per_rad", "unit"), [(1.0, "rad"), (180 / np.pi, "deg")])
def test_a_driven_wheel_of_other_physics_has_the_unit_of_its_size(tmp_path, per_rad, unit):
    angle = per_rad * 2.0 * SIZE * np.sin(2 * np.pi * 1.1 * TIME)
    match, _ = drafted(write_log(tmp_path, MOTOR, motor_torque=TORQUE, axle=angle))
    assert (match.unit, match.is_unit_sure) == (unit, False)
    assert "times that of the model" in match.why_unit


def test_a_free_wheel_leaves_the_unit_open(tmp_path):
    write_log(tmp_path, axle=30.0 * (1 - np.exp(-0.5 * TIME)))
    (tmp_path / "wheel.xml").write_text(WHEEL.format("").replace('damping="0.1"', 'damping="0.004"'))
    match, draft = drafted(tmp_path)
    assert (match.unit, match.is_unit_sure) == ("rad", False)
    assert "rad and deg both fit" in match.why_unit
    assert 'unit = "rad"  # CHECK:' in draft.text


@pytest.mark.parametrize(("stated", "true"), [("deg", "rad"), ("rad", "deg")])
def test_a_check_names_the_unit_that_the_size_has(tmp_path, stated, true):
    per_rad = 180 / np.pi if true == "deg" else 1.0
    write_log(tmp_path, MOTOR, motor_torque=TORQUE, axle=per_rad * SIZE * np.sqrt(2) * np.cos(2 * np.pi * 1.1 * TIME))
    text = (
        '[model]\nmjcf = "wheel.xml"\n[[recording]]\nfile = "log.csv"\nrole = "fit"\ntime = "time"\ninitial = "rest"\n'
        '[[recording.channel]]\ncolumn = "motor_torque"\nat = "motor"\nkind = "moment"\nunit = "N m"\ninput = true\n'
        '[[recording.channel]]\ncolumn = "axle"\nat = "joint:axle"\nkind = "angle"\nunit = "{}"\n'
    )
    (tmp_path / "case.toml").write_text(text.format(true))
    assert not [f for f in check_recordings(load_case(tmp_path)).found if "unit =" in f.text]
    (tmp_path / "case.toml").write_text(text.format(stated))
    (found,) = (f for f in check_recordings(load_case(tmp_path)).found if "unit =" in f.text)
    assert found.severity == "note"
    assert found.mend == f'unit = "{true}" in every [[recording.channel]] with column = "axle"'
