"""Offsets of readings that a force or a servo explains as well are not said to be the sensor's alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlab.cases import load_case
from vlab.diagnose.data_findings import alike_offsets, finding_of_offset
from vlab.diagnose.inference.sensor_offset import SensorOffset
from vlab.diagnose.parameters.recorded_runs import read_runs

SERVO = '<position name="drive" joint="first" kp="50" kv="2"/>'
MOTOR = '<motor name="drive" joint="first"/>'


def problem(folder, actuator, stiffness, *, joints=1):
    """Return runs and plant of a chain whose first joint is driven."""
    inner = '<body pos="0.2 0 0"><joint name="second" axis="0 1 0"/><geom size="0.03" mass="0.2"/></body>' * (
        joints - 1
    )
    (folder / "arm.xml").write_text(
        f'<mujoco><worldbody><body><joint name="first" axis="0 1 0" stiffness="{stiffness}" damping="0.1"/>'
        f'<geom size="0.05" mass="1"/>{inner}</body></worldbody><actuator>{actuator}</actuator>'
        '<sensor><jointpos name="angle" joint="first"/><jointvel name="rate" joint="first"/></sensor></mujoco>'
    )
    wave = np.sin(0.1 * np.arange(200))
    np.savetxt(folder / "run.csv", np.column_stack([wave] * 3), delimiter=",", header="u,angle,rate", comments="")
    text = 'title = "Arm"\n[model]\nmjcf = "arm.xml"\n[[recording]]\nfile = "run.csv"\nrole = "fit"\nrate_hz = 100.0\n'
    for column, at, kind, unit in (
        ("u", "drive", *(("command", "rad") if "kp" in actuator else ("moment", "N m"))),
        ("angle", "angle", "angle", "rad"),
    ):
        text += f'[[recording.channel]]\ncolumn = "{column}"\nat = "{at}"\nkind = "{kind}"\nunit = "{unit}"\n'
        text += 'input = true\nhold = "zero"\n' if column == "u" else ""
    text += '[[recording.channel]]\ncolumn = "rate"\nat = "rate"\nkind = "angular-velocity"\nunit = "rad/s"\n'
    (folder / "case.toml").write_text(text)
    case = load_case(folder)
    return SimpleNamespace(plant=case.plant, runs=read_runs(case, ("fit",)).runs)


@pytest.mark.parametrize(
    ("actuator", "stiffness", "joints", "alike"),
    [
        (SERVO, 0, 2, ("sensor-offset", "actuator-offset", "force-offset")),
        (MOTOR, 5, 1, ("sensor-offset", "force-offset")),
        (MOTOR, 5, 2, ("sensor-offset",)),  # the second joint shows a force at the first
        (MOTOR, 0, 1, ("sensor-offset",)),  # a force accelerates what nothing holds
    ],
)
def test_an_offset_has_the_class_of_what_shifts_the_reading_alike(tmp_path, actuator, stiffness, joints, alike):
    given = problem(tmp_path, actuator, stiffness, joints=joints)
    assert alike_offsets("angle", given) == alike
    assert alike_offsets("rate", given) == ("sensor-offset",)
    sure = finding_of_offset(SensorOffset(channel="angle", offset=0.1, sd=0.001), "rad")
    found = finding_of_offset(SensorOffset(channel="angle", offset=0.1, sd=0.001), "rad", alike)
    assert found.alike == alike
    assert found.probability == pytest.approx(sure.probability / len(alike))
    assert all(name in found.words for name in alike[1:])
