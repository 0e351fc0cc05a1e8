"""Places of columns that a draft finds by the names of sites, and by units beside doubtful words."""

import mujoco
import numpy as np
import pytest

from vlab.cases.draft.draft import draft_case
from vlab.cases.places import Suggestion, suggest
from vlab.errors import BadCase
from vlab.plants.mjcf import build_mjcf
from vlab.recordings.overview import kind_of

BLADE = """<mujoco model="blade"><option timestep="0.001" gravity="0 0 0"/><worldbody><body name="root">
<joint name="bend1" axis="0 0 1" stiffness="5" damping="0.01"/><geom type="box" size="0.05 0.01 0.001" pos="0.05 0 0" mass="0.1"/>
<body name="outer" pos="0.1 0 0"><joint name="bend2" axis="0 0 1" stiffness="5" damping="0.01"/>
<geom type="box" size="0.05 0.01 0.001" pos="0.05 0 0" mass="0.1"/><site name="tip" pos="0.1 0 0"/><site name="corner" pos="0.1 0.05 0"/>
</body></body></worldbody><actuator><motor name="shaker" joint="bend1"/></actuator>{}</mujoco>"""
DRIVE = """<mujoco model="drive"><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="motor" axis="0 0 1" damping="0.1"/><geom size="0.05" mass="1"/></body>
<body pos="0.5 0 0"><joint name="load" axis="0 0 1" damping="0.1"/><geom size="0.05" mass="1"/></body></worldbody>
<actuator><motor name="torque" joint="motor"/></actuator></mujoco>"""


def plant_of(tmp_path, text):
    (tmp_path / "model.xml").write_text(text)
    return build_mjcf(tmp_path / "model.xml")


@pytest.mark.parametrize(
    ("column", "at", "kind"),
    [
        ("Tip displacement [mm]", "site:tip.y", "displacement"),  # to first order the tip moves along y alone
        ("tip_velocity [m/s]", "site:tip.y", "velocity"),
        ("corner x [mm]", "site:corner.x", "displacement"),
    ],
)
def test_a_column_named_after_a_site_shows_its_motion(tmp_path, column, at, kind):
    found = suggest(column, plant_of(tmp_path, BLADE.format("")))
    assert found == Suggestion(at=at, kind=kind, is_input=False)


def test_a_site_with_two_directions_or_a_sensor_is_not_guessed(tmp_path):
    assert suggest("corner position", plant_of(tmp_path, BLADE.format(""))) is None
    sensed = plant_of(tmp_path, BLADE.format('<sensor><accelerometer name="tip" site="tip"/></sensor>'))
    assert suggest("tip acceleration", sensed) is None  # the three values of the sensor come first
    assert suggest("tip position", sensed) == Suggestion(at="site:tip.y", kind="displacement", is_input=False)


def write_log(path, names):
    model = mujoco.MjModel.from_xml_string(DRIVE)
    data, rows = mujoco.MjData(model), []
    for k in range(600):
        data.ctrl[:] = 0.3 * np.sin(0.05 * k)
        rows.append((data.time, data.ctrl[0], *data.qpos))
        for _ in range(5):
            mujoco.mj_step(model, data)
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="")


def test_the_message_without_any_place_lists_the_sites(tmp_path):
    (tmp_path / "blade.xml").write_text(BLADE.format(""))
    write_log(tmp_path / "log.csv", ["t", "u", "pressure", "humidity"])
    with pytest.raises(BadCase, match="site:tip.y"):
        draft_case(str(tmp_path / "blade.xml"), [tmp_path / "log.csv"], tmp_path)


def test_a_joint_with_the_name_of_a_quantity_is_found(tmp_path):
    (tmp_path / "drive.xml").write_text(DRIVE)
    write_log(tmp_path / "log.csv", ["t", "motor_torque_Nm", "motor_pos_rad", "load_pos_rad"])
    draft = draft_case(str(tmp_path / "drive.xml"), [tmp_path / "log.csv"], tmp_path)
    assert {m.column: m.at for m in draft.channels}["motor_pos_rad"] == "joint:motor"
    assert {part.label: part.why for part in draft.left_out}["load_pos_rad"] == "it is 0 throughout"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("load_pos_rad", "position"),
        ("load_vel", "velocity"),
        ("load", "force"),
        ("x [N]", "force"),
        ("motor torque [mA]", "current"),
        ("pos_A", "position"),
        ("elbow_cmd [deg]", "command"),
        ("force_h", "force"),
        ("Temps (s)", "time"),
        ("temp [degC]", "temperature"),
    ],
)
def test_a_unit_decides_on_a_doubtful_word(name, kind):
    assert kind_of(name) == kind


CART = """<mujoco model="cart"><option timestep="0.001"/><worldbody><body><joint name="rail" type="slide" axis="1 0 0" damping="5"/>
<geom type="box" size="0.1 0.05 0.05" mass="2"/></body></worldbody>
<actuator><position name="drive" joint="rail" kp="800" kv="60"/></actuator></mujoco>"""


@pytest.mark.parametrize(("factor", "unit"), [(1e3, "mm"), (1.0, "m")])
def test_size_decides_where_the_model_follows_its_command_in_any_unit(tmp_path, factor, unit):
    (tmp_path / "cart.xml").write_text(CART)
    model = mujoco.MjModel.from_xml_string(CART)
    data, rows = mujoco.MjData(model), []
    for k in range(1000):
        data.ctrl[:] = 0.3 * np.sin(0.02 * k)
        rows.append((0.005 * k, factor * data.ctrl[0], factor * data.qpos[0]))
        for _ in range(5):
            mujoco.mj_step(model, data)
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,command,position", comments="")
    draft = draft_case(str(tmp_path / "cart.xml"), [tmp_path / "log.csv"], tmp_path)
    assert [match.unit for match in draft.channels] == [unit, unit]


def test_counts_of_an_encoder_are_no_degrees(tmp_path):
    hinge = CART.replace('type="slide" axis="1 0 0"', 'type="hinge" axis="0 0 1"')
    (tmp_path / "arm.xml").write_text(hinge)
    model = mujoco.MjModel.from_xml_string(hinge)
    data, rows = mujoco.MjData(model), []
    for k in range(1000):
        data.ctrl[:] = 0.3 * np.sin(0.02 * k)
        rows.append((0.005 * k, *(np.rint(2048 + 4096 / (2 * np.pi) * x[0]) for x in (data.ctrl, data.qpos))))
        for _ in range(5):
            mujoco.mj_step(model, data)
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,goal_position,present_position", comments="")
    draft = draft_case(str(tmp_path / "arm.xml"), [tmp_path / "log.csv"], tmp_path)
    assert not any(match.is_unit_sure for match in draft.channels)
    assert any("counts of an encoder: state scale" in line for line in draft.unsure)


SERVO = """<mujoco model="servo"><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="shaft" axis="0 0 1" damping="0.1"/><geom size="0.05" mass="1"/></body></worldbody>
<actuator><position name="drive" joint="shaft" kp="20" kv="1"/></actuator>
<sensor><jointpos name="angle" joint="shaft"/><actuatorfrc name="torque" actuator="drive"/></sensor></mujoco>"""


RULER = """<mujoco model="ruler"><option timestep="0.001" gravity="0 0 0"/><worldbody>
<body><joint name="bend" type="slide" axis="0 0 1" stiffness="50" damping="0.1"/><geom size="0.05" mass="0.1"/>
<site name="imu"/></body></worldbody><sensor><accelerometer name="adxl" site="imu"/></sensor></mujoco>"""


@pytest.mark.parametrize("command", ["control", "demand_rad"])
def test_the_only_command_drives_the_only_servo_and_a_sensor_takes_the_effort(tmp_path, command):
    """A column with the exact name of a sensor shows this sensor, whatever quantity the name suggests."""
    (tmp_path / "servo.xml").write_text(SERVO)
    t = np.arange(600) / 100.0
    columns = [t, 0.3 * np.sin(t), 0.3 * np.sin(t - 0.1), 0.5 * np.cos(t)]
    header = ",".join(["t", command, "angle", "torque"])
    np.savetxt(tmp_path / "log.csv", np.column_stack(columns), delimiter=",", header=header, comments="")
    draft = draft_case(str(tmp_path / "servo.xml"), [tmp_path / "log.csv"], tmp_path)
    found = {match.column: (match.at, match.is_input) for match in draft.channels}
    assert found == {command: ("drive", True), "angle": ("angle", False), "torque": ("torque", False)}


def test_the_only_vector_sensor_takes_a_column_along_its_moving_axis(tmp_path):
    (tmp_path / "ruler.xml").write_text(RULER)
    t = np.arange(600) / 100.0
    values = np.column_stack([t, np.sin(7.0 * t) * np.exp(-t)])
    np.savetxt(tmp_path / "log.csv", values, delimiter=",", header="t,Acceleration", comments="")
    draft = draft_case(str(tmp_path / "ruler.xml"), [tmp_path / "log.csv"], tmp_path)
    assert [(match.column, match.at) for match in draft.channels] == [("Acceleration", "adxl.z")]


PENDULUM = """<mujoco model="cart"><option timestep="0.002"/><worldbody><body><joint name="slider" type="slide" axis="1 0 0"/>
<geom size="0.05" mass="1"/><body><joint name="hinge" axis="0 1 0"/><geom size="0.02" pos="0 0 -0.4" mass="0.2"/>
<site name="imu" pos="0 0 -0.3"/></body></body></worldbody><actuator><motor name="motor" joint="slider"/></actuator>
<sensor><jointpos name="encoder" joint="hinge"/><gyro name="gyro" site="imu"/><accelerometer name="acc" site="imu"/></sensor>
</mujoco>"""


@pytest.mark.parametrize("unit", ["g", "m/s^2"])
def test_units_and_gravity_place_columns_without_a_known_name(tmp_path, unit):
    plant = plant_of(tmp_path, PENDULUM)
    model = plant.model
    data, rows = mujoco.MjData(model), []
    for k in range(2000):
        data.ctrl[0] = 2.0 * np.sin(0.01 * k)
        mujoco.mj_step(model, data)
        mujoco.mj_forward(model, data)
        rows.append(
            [data.time, data.ctrl[0], data.qpos[0] * 1e3, *np.degrees(data.sensordata[:4]), *data.sensordata[4:]]
        )
    table = np.array(rows)
    table[:, -6:] += 1e-3 * np.random.default_rng(0).standard_normal(table[:, -6:].shape)
    table[:, -3:] /= 9.80665 if unit == "g" else 1.0
    names = ["time", "current_A", "stage_mm", "pole_deg", *(f"{s}{a}" for s in ("gyro_", "acc_") for a in "xyz")]
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=",".join(names), comments="")
    draft = draft_case(str(tmp_path / "model.xml"), [tmp_path / "log.csv"], tmp_path)
    found = {m.label: (m.at, m.unit) for m in draft.channels}
    assert found["stage_mm"] == ("joint:slider", "mm")  # the only slide
    assert found["pole_deg"] == ("encoder", "deg")  # the only hinge
    assert found["gyro_y"] == ("gyro.y", "deg/s")  # beside an angle in degrees
    assert {found[f"acc_{axis}"] for axis in "xyz"} == {(f"acc.{axis}", unit) for axis in "xyz"}
