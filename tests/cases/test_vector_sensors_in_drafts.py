"""Columns of a vector sensor without an axis in a draft."""

import numpy as np
import pytest

from vlab.cases.draft import draft_case
from vlab.errors import BadCase

TOWER = """<mujoco model="tower"><option timestep="0.001"/><worldbody><body><joint name="sway" type="{}" axis="{}"
stiffness="300" damping="0.7"/><geom type="box" size="0.1 0.1 0.02" mass="1" pos="0 0 0.5"/><site name="imu" pos="0 0 0.6"/></body>
</worldbody><sensor><accelerometer name="acceleration" site="imu"/></sensor></mujoco>"""


def drafted(folder, kind, axis, name="Acceleration"):
    (folder / "tower.xml").write_text(TOWER.format(kind, axis))
    time = 0.01 * np.arange(300)
    table = np.column_stack([time, np.exp(-0.3 * time) * np.sin(17.3 * time)])
    np.savetxt(folder / "log.csv", table, delimiter=",", header=f"Time,{name}", comments="")
    return draft_case(str(folder / "tower.xml"), [folder / "log.csv"], folder)


@pytest.mark.parametrize(("axis", "end"), [("1 0 0", "x"), ("0 1 0", "y"), ("0 0 1", "z")])
def test_the_only_axis_of_motion_is_taken(tmp_path, axis, end):
    (match,) = drafted(tmp_path, "slide", axis).channels
    assert (match.at, match.kind, match.is_place_sure) == (f"acceleration.{end}", "acceleration", True)
    assert "the only axis" in match.why


@pytest.mark.parametrize(("kind", "axis"), [("slide", "1 1 0"), ("hinge", "0 1 0")])
def test_of_several_axes_the_names_are_said(tmp_path, kind, axis):
    with pytest.raises(BadCase, match=r"one of acceleration\.x, acceleration\.y, acceleration\.z: name it so"):
        drafted(tmp_path, kind, axis)
