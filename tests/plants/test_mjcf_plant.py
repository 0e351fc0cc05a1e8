"""Any user's MJCF as a plant: guarded loading, taps, ports, equilibrium."""

import mujoco
import numpy as np
import pytest

from vlab.errors import BadStructure
from vlab.plants.mjcf import build_mjcf

RIG = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <site name="wall" pos="0 1 0"/>
    <body name="arm">
      <joint name="swing" type="hinge" axis="0 1 0" stiffness="30" damping="0.1"/>
      <geom name="rod" type="capsule" fromto="0 0 0 1 0 0" size="0.02"/>
      <site name="end" pos="1 0 0"/>
      <body name="slider" pos="1 0 0">
        <joint name="push" type="slide" axis="1 0 0" stiffness="500"/>
        <geom size="0.03" mass="0.2"/>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="sum"><joint joint="swing" coef="2"/></fixed>
    <fixed name="mixed"><joint joint="swing" coef="1"/><joint joint="push" coef="3"/></fixed>
    <spatial name="rope"><site site="end"/><site site="wall"/></spatial>
  </tendon>
  <actuator>
    <motor name="torque" joint="swing"/>
    <motor name="thrust" joint="push"/>
    <motor name="pull" tendon="rope"/>
    <motor name="geared" joint="swing" gear="35"/>
    <position name="servo" joint="push" kp="0"/>
    <general name="lagged" joint="push" dyntype="filterexact" dynprm="0.01"/>
    <motor name="jet" site="end" refsite="wall" gear="0 1 0 0 0 0"/>
    <motor name="any" tendon="mixed"/>
  </actuator>
  <sensor>
    <jointpos name="enc" joint="swing"/><jointpos name="ruler" joint="push"/>
    <jointvel name="tacho" joint="swing"/><jointvel name="speed" joint="push"/>
    <tendonpos name="sum" tendon="sum"/><tendonvel name="rope" tendon="rope"/><tendonpos name="mixed" tendon="mixed"/>
    <framepos name="end" objtype="site" objname="end"/><framelinvel name="endv" objtype="site" objname="end"/>
    <accelerometer name="acc" site="end"/><gyro name="gyro" site="end"/><velocimeter name="velo" site="end"/>
    <force name="cell" site="end"/><torque name="torquecell" site="end"/>
    <actuatorfrc name="drive" actuator="torque"/><actuatorfrc name="thrustcell" actuator="thrust"/>
    <framequat name="attitude" objtype="site" objname="end"/>
  </sensor>
</mujoco>
"""

SPRING = """
<mujoco><option timestep="0.001" gravity="0 0 -9.81"/><worldbody><body name="mass">
  <joint name="z" type="slide" axis="0 0 1" stiffness="80" damping="0.01"/><geom size="0.05" mass="2"/>
</body></worldbody></mujoco>
"""

PENDULUM = """
<mujoco><option timestep="0.001" gravity="0 0 -9.81"/><worldbody><body name="rod">
  <joint name="hinge" axis="0 1 0" damping="0.01"/>
  <inertial mass="1.5" pos="0.4 0 0" diaginertia="1e-3 0.08 0.08"/>
</body></worldbody></mujoco>
"""


@pytest.fixture(scope="module")
def rig():
    return build_mjcf(RIG)


def test_actuators_have_the_unit_of_what_they_push_or_else_take_a_command(rig):
    units = {tap.name: (tap.kind, tap.unit) for tap in rig.actuators}
    assert units == {
        "torque": ("moment", "N m"),
        "thrust": ("force", "N"),
        "pull": ("force", "N"),
        "geared": ("command", "command"),
        "servo": ("command", "command"),
        "lagged": ("command", "command"),
        "jet": ("force", "N"),
        "any": ("command", "command"),
    }


@pytest.mark.parametrize(
    ("name", "kind", "unit"),
    [
        ("enc", "angle", "rad"),
        ("ruler", "displacement", "m"),
        ("tacho", "angular-velocity", "rad/s"),
        ("speed", "velocity", "m/s"),
        ("sum", "angle", "rad"),
        ("rope", "velocity", "m/s"),
        ("mixed", "other", ""),
        ("end.z", "displacement", "m"),
        ("endv.x", "velocity", "m/s"),
        ("acc.y", "acceleration", "m/s^2"),
        ("gyro.y", "angular-velocity", "rad/s"),
        ("velo.x", "velocity", "m/s"),
        ("cell.z", "force", "N"),
        ("torquecell.y", "moment", "N m"),
        ("drive", "moment", "N m"),
        ("thrustcell", "force", "N"),
    ],
)
def test_sensors_have_kind_and_unit_of_their_type(rig, name, kind, unit):
    tap = rig.sensors[rig.sensor_index(name)]
    assert (tap.kind, tap.unit) == (kind, unit)


def test_a_vector_sensor_is_three_taps_in_order_and_other_sizes_are_named_as_left_out(rig):
    data = rig.new_data()
    values = rig.read(data)
    site = data.site("end").xpos
    np.testing.assert_array_equal([values[rig.sensor_index(f"end.{axis}")] for axis in "xyz"], site)
    assert any("'attitude' has 4 values" in note for note in rig.notes)


def test_port_rows_are_the_slopes_of_their_positions(rig):
    step = 1e-6
    data = rig.new_data()
    for name, port in rig.ports.items():
        for dof in range(rig.model.nv):
            sides = []
            for sign in (step, -step):
                data.qpos[:] = rig.rest
                data.qpos[dof] += sign
                mujoco.mj_forward(rig.model, data)
                sides.append(port.position(data))
            data.qpos[:] = rig.rest
            mujoco.mj_forward(rig.model, data)
            # central differences: step^2/6 of truncation and 1e-16/step = 1e-10 of rounding
            assert port.row(data)[dof] == pytest.approx((sides[0] - sides[1]) / (2 * step), abs=1e-8), name
    assert {"joint:swing", "joint:push", "tendon:rope", "site:end.x", "site:end.z"} <= set(rig.ports)


def test_a_hanging_mass_settles_where_its_spring_carries_the_weight():
    plant = build_mjcf(SPRING)
    # The residual is driven below 1e-9 of the weight (Newton's method on a linear spring is exact).
    assert plant.rest[0] == pytest.approx(-2 * 9.81 / 80, rel=1e-8)
    assert "settled" in plant.notes[0]
    assert plant.linearise().freq[0] == pytest.approx(np.sqrt(80 / 2) / (2 * np.pi), rel=1e-8)


def test_a_rod_held_sideways_settles_hanging_and_swings_as_a_physical_pendulum():
    plant = build_mjcf(PENDULUM)
    assert plant.rest[0] == pytest.approx(np.pi / 2, abs=1e-7)
    omega = np.sqrt(1.5 * 9.81 * 0.4 / (0.08 + 1.5 * 0.4**2))
    # Stiffness by central differences of step 1e-5: truncation (1e-5)^2/6, rounding 1e-11.
    assert plant.linearise().freq[0] == pytest.approx(omega / (2 * np.pi), rel=1e-8)
    np.testing.assert_array_equal(plant.new_data().qpos, plant.rest)


def test_the_keyframe_rest_is_the_rest_configuration():
    key = '<keyframe><key name="other" qpos="1"/><key name="rest" qpos="1.5707963267948966"/></keyframe></mujoco>'
    plant = build_mjcf(PENDULUM.replace("</mujoco>", key))
    assert plant.rest[0] == pytest.approx(np.pi / 2, abs=1e-15)
    assert plant.notes == ()


def test_free_motion_is_allowed_and_said():
    cart = build_mjcf(SPRING.replace('stiffness="80"', "").replace("-9.81", "0"))
    assert "free to move" in cart.notes[0]
    falling = build_mjcf(SPRING.replace('stiffness="80"', ""))
    assert "no equilibrium" in falling.notes[0]
    with pytest.raises(BadStructure, match="no equilibrium"):
        falling.linearise()


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('timestep="0.001"', 'timestep="nan"', "finite"),
        ('timestep="0.001"', 'timestep="0"', "timestep is 0"),
        ('timestep="0.001"', 'timestep="-1"', "timestep is -1"),
        ('mass="2"', 'mass="NaN"', "finite"),
        ('mass="2"', 'mass="-2"', "MuJoCo refuses.*negative"),
        ('stiffness="80"', 'stiffness="inf"', "finite"),
        ('stiffness="80"', 'stiffness="1e999"', "refuses|finite"),
        ('stiffness="80"', 'stiffness="1e200"', "at most 1e\\+77 can be computed with"),
        ('mass="2"', 'mass="1e308"', "body_inertia of the compiled model is inf; it must be finite"),
        ('mass="2"', 'mass="1e100"', "at most 1e\\+77 can be computed with"),
        ('gravity="0 0 -9.81"', 'gravity="0 0 1e100"', "at most 1e\\+77 can be computed with"),
        ("<geom", "<gem", "MuJoCo refuses"),
        ("</body>", "", "malformed XML"),
        ("<mujoco>", '<!DOCTYPE a [<!ENTITY b "c">]><mujoco>', "document type"),
        ("<worldbody>", '<asset><mesh file="a.stl"/></asset><worldbody>', "text cannot refer to files"),
        ("<worldbody>", '<worldbody><replicate count="100000000"><site/></replicate>', "copies"),
        (
            '<joint name="z" type="slide" axis="0 0 1" stiffness="80" damping="0.01"/>',
            "",
            "nothing in the model can move",
        ),
    ],
)
def test_bad_models_are_refused_in_one_line(old, new, match):
    assert old in SPRING
    with pytest.raises(BadStructure, match=match) as caught:
        build_mjcf(SPRING.replace(old, new))
    assert "\n" not in str(caught.value)


def test_a_model_whose_contacts_take_more_memory_than_it_has_is_refused_in_one_line():
    touching = '<size memory="200K"/><worldbody><replicate count="200"><geom size="0.1"/></replicate>'
    with pytest.raises(BadStructure, match="MuJoCo cannot compute it.*memory") as caught:
        build_mjcf(SPRING.replace("<worldbody>", touching))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("mass", ["1e-12", "1e12", "1e30", "1e70"])
def test_a_model_out_of_all_proportion_has_its_rest_or_says_that_it_has_none(mass):
    plant = build_mjcf(SPRING.replace('mass="2"', f'mass="{mass}"'))
    assert np.all(np.isfinite(plant.rest))
    if any("no equilibrium" in note for note in plant.notes):
        assert plant.rest[0] == 0.0  # where MuJoCo began anew it has settled nothing
    else:
        assert plant.rest[0] == pytest.approx(
            -float(mass) * 9.81 / 80, rel=1e-6, abs=1e-9 / 80
        )  # a force of 1e-9 N is left


@pytest.mark.parametrize(
    ("element", "match"),
    [
        ('<asset><mesh name="m" file="/etc/hostname"/></asset>', "absolute or leaves"),
        ('<asset><mesh name="m" file="C:\\\\mesh.stl"/></asset>', "absolute or leaves"),
        ('<asset><mesh name="m" file="../mesh.stl"/></asset>', "absolute or leaves"),
        ('<compiler meshdir="../.."/><asset><mesh name="m" file="mesh.stl"/></asset>', "absolute or leaves"),
        ('<asset><texture name="t" type="skybox" fileup="/etc/hostname"/></asset>', "absolute or leaves"),
        ('<include file="/etc/hostname"/>', "absolute or leaves"),
        ('<include file="part.xml"/>', "absolute or leaves"),
        ('<asset><mesh name="m" file="link.stl"/></asset>', "link that leaves"),
    ],
)
def test_files_outside_the_folder_are_refused(tmp_path, element, match):
    folder = tmp_path / "rig"
    folder.mkdir()
    (tmp_path / "mesh.stl").write_bytes(b"solid")
    (folder / "link.stl").symlink_to(tmp_path / "mesh.stl")
    (folder / "part.xml").write_text(
        '<mujocoinclude><asset><mesh name="m" file="/etc/hostname"/></asset></mujocoinclude>'
    )
    (folder / "rig.xml").write_text(SPRING.replace("<worldbody>", element + "<worldbody>"))
    with pytest.raises(BadStructure, match=match):
        build_mjcf(folder / "rig.xml")


def test_included_files_in_the_folder_are_accepted(tmp_path):
    (tmp_path / "part.xml").write_text('<mujocoinclude><site name="extra"/></mujocoinclude>')
    (tmp_path / "rig.xml").write_text(SPRING.replace("<geom", '<include file="part.xml"/><geom'))
    assert "site:extra.x" in build_mjcf("rig.xml", folder=tmp_path).ports


def test_a_missing_or_outside_model_file_is_refused(tmp_path):
    with pytest.raises(BadStructure, match="no such model file"):
        build_mjcf("rig.xml", folder=tmp_path)
    with pytest.raises(BadStructure, match="lies outside"):
        build_mjcf("../rig.xml", folder=tmp_path)
    with pytest.raises(BadStructure, match="root element is <robot>"):
        build_mjcf("<robot/>")
