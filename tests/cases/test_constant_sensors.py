"""Readings without kinematics beside those of MuJoCo."""

import mujoco
import numpy as np
import pytest

from vlab.cases.constant_sensors import ConstantSensors

CHAIN = """<mujoco><worldbody>
<body><joint name="a" type="slide" axis="1 0 0"/><geom size=".1" contype="0" conaffinity="0"/><site name="s"/>
<body pos="0 0 .3"><joint name="b" axis="0 1 0"/><geom size=".1" contype="0" conaffinity="0"/><site name="t"/></body></body>
</worldbody>
<tendon><fixed name="sum"><joint joint="a" coef="2"/><joint joint="b" coef="-.5"/></fixed>
<spatial name="rope"><site site="s"/><site site="t"/></spatial></tendon>
<sensor>{}</sensor></mujoco>"""
CONSTANT = '<jointvel joint="b"/><tendonpos tendon="sum"/><jointpos joint="a"/><tendonvel tendon="sum"/>'
OTHERS = (
    '<framepos objtype="site" objname="t"/>',
    '<tendonpos tendon="rope"/>',
    '<jointpos joint="a" cutoff=".1"/>',
    '<jointactuatorfrc joint="a"/>',
)


def read(model, qpos, qvel, addresses):
    sums = ConstantSensors.of(model, addresses)
    motion = np.array([qpos, qvel])
    out = np.zeros(model.nsensordata)
    np.add.at(out, sums.address, sums.share * motion[sums.order, sums.joint])
    return out


def test_the_sums_are_the_readings_of_mujoco():
    model = mujoco.MjModel.from_xml_string(CHAIN.format(CONSTANT))
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.3, -0.7), (1.1, 0.4)
    mujoco.mj_forward(model, data)
    assert read(model, data.qpos, data.qvel, {0, 1, 2, 3}) == pytest.approx(data.sensordata, rel=1e-15)


@pytest.mark.parametrize("other", OTHERS)
def test_another_sensor_in_use_needs_the_kinematics(other):
    model = mujoco.MjModel.from_xml_string(CHAIN.format(CONSTANT + other))
    assert not ConstantSensors.of(model, {0, 4}).address.size
    assert set(ConstantSensors.of(model, {0, 3}).address) == {0, 3}  # the other is not in use


def test_disabled_sensors_read_nothing():
    disabled = CHAIN.replace("<mujoco>", '<mujoco><option><flag sensor="disable"/></option>')
    assert not ConstantSensors.of(mujoco.MjModel.from_xml_string(disabled.format(CONSTANT)), {0}).address.size


def test_a_free_joint_needs_the_kinematics():
    free = '<mujoco><worldbody><body><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    assert not ConstantSensors.of(mujoco.MjModel.from_xml_string(free), {0}).address.size
