"""Where recordings begin: joints that servos hold and no sensor looks at."""

import mujoco
import numpy as np
import pytest

from vlab.cases import load_case
from vlab.cases.initial_state import find_initial_state
from vlab.diagnose.parameters.recorded_runs import read_runs

HELD = 4


def arm():
    """Return the MJCF of a shoulder with an encoder and joints beyond it that servos move."""
    link = '<geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/>'
    beyond = ""
    for i in reversed(range(HELD)):
        axis = "0 1 0" if i % 2 else "0 0 1"
        beyond = f'<body name="link{i}" pos=".2 0 0"><joint name="held{i}" axis="{axis}"/>{link}{beyond}</body>'
    servos = "".join(f'<position name="servo{i}" joint="held{i}" kp="900" kv="12"/>' for i in range(HELD))
    return f"""<mujoco model="arm">
      <option timestep="0.001" integrator="implicitfast"/>
      <worldbody><body name="upper"><joint name="shoulder" axis="0 1 0" damping="2"/>{link}{beyond}</body></worldbody>
      <actuator><motor name="motor" joint="shoulder"/>{servos}</actuator>
      <sensor><jointpos name="encoder" joint="shoulder"/></sensor>
    </mujoco>"""


def channel(column, at, kind, unit, *, is_input=True):
    driven = "input = true\n" if is_input else ""
    hold = 'hold = "linear"\n' if kind == "command" else ""
    return f'[[recording.channel]]\ncolumn = "{column}"\nat = "{at}"\nkind = "{kind}"\nunit = "{unit}"\n{driven}{hold}'


def recorded(folder, start, told):
    """Write the case of an arm that MuJoCo moved from a state, its joints following what they were told; return it, loaded."""
    model = mujoco.MjModel.from_xml_string(arm())
    data, rows = mujoco.MjData(model), []
    data.qpos[:], data.qvel[:] = start
    for k in range(300):
        rows.append([0.4 * np.sin(0.05 * k), *told(0.01 * k), data.qpos[0]])
        for j in range(10):
            data.ctrl[0], data.ctrl[1:] = rows[-1][0], told(0.01 * k + 0.001 * j)
            mujoco.mj_step(model, data)
    (folder / "arm.xml").write_text(arm())
    names = [f"told{i}" for i in range(HELD)]
    np.savetxt(folder / "run.csv", rows, delimiter=",", header=",".join(["u", *names, "angle"]), comments="")
    text = 'title = "Arm"\n[model]\nmjcf = "arm.xml"\n[[recording]]\nfile = "run.csv"\nrole = "fit"\n'
    text += 'rate_hz = 100.0\ninitial = "estimated"\n' + channel("u", "motor", "moment", "N m")
    text += "".join(channel(name, f"servo{i}", "command", "rad") for i, name in enumerate(names))
    (folder / "case.toml").write_text(text + channel("angle", "encoder", "angle", "rad", is_input=False))
    return load_case(folder)


def test_joints_on_servos_start_where_they_are_told_to_be(tmp_path):
    centre, swing = np.array([1.1, -0.8, 0.7, -0.9]), np.array([0.3, 0.2, -0.2, 0.1])

    def told(t):
        return centre + swing * np.sin(2.0 * t)

    case = recorded(tmp_path, (np.append(0.9, told(0.0)), np.append(0.2, 2.0 * swing)), told)
    (run,) = read_runs(case, ("fit",)).runs
    found = find_initial_state(case.plant, run)
    # servos sag by the moment of gravity over their stiffness, 3 N m / 900, and their joints start at speed as told
    np.testing.assert_allclose(found.qpos, np.append(0.9, centre), atol=0.01)
    np.testing.assert_allclose(found.qvel, np.append(0.2, 2.0 * swing), atol=0.1)
    assert found.nrmse < 0.02


LIMP = """<mujoco model="limp"><option timestep="0.001" integrator="RK4"/><worldbody>
  <body name="upper" pos="0 0 1"><joint name="a" axis="0 1 0" damping="4" armature="0.2"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" contype="0" conaffinity="0"/>
    <body name="lower" pos=".3 0 0"><joint name="b" axis="0 1 0" damping="3" armature="0.15"/>
      <geom type="capsule" fromto="0 0 0 .3 0 0" size=".03" contype="0" conaffinity="0"/></body></body></worldbody>
  <actuator><position name="sa" joint="a" kp="300" kv="30"/><position name="sb" joint="b" kp="200" kv="20"/></actuator>
</mujoco>"""


def test_measured_joints_start_where_they_were_measured(tmp_path):
    """Joints that stand under a command away from rest, and then make large steps; the model is exact."""
    model = mujoco.MjModel.from_xml_string(LIMP)
    data, told = mujoco.MjData(model), np.array([[0.5, -0.4], [-0.9, 0.8], [0.7, -1.2]])
    data.ctrl[:] = told[0]
    mujoco.mj_step(model, data, 20_000)  # at rest under the first command
    begun, rows = data.qpos.copy(), []
    for k in range(300):
        data.ctrl[:] = told[min(k // 20, 2)]
        rows.append([*data.ctrl, *data.qpos])
        mujoco.mj_step(model, data, 10)
    (tmp_path / "arm.xml").write_text(LIMP)
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header="ca,cb,a,b", comments="")
    text = 'title = "Limp"\n[model]\nmjcf = "arm.xml"\n[[recording]]\nfile = "run.csv"\nrole = "fit"\nrate_hz = 100.0\n'
    for name in ("a", "b"):
        text += f'[[recording.channel]]\ncolumn = "c{name}"\nat = "s{name}"\nkind = "command"\nunit = "rad"\n'
        text += 'input = true\nhold = "zero"\n'
        text += f'[[recording.channel]]\ncolumn = "{name}"\nat = "joint:{name}"\nkind = "angle"\nunit = "rad"\n'
    (tmp_path / "case.toml").write_text(text)
    case = load_case(tmp_path)
    (run,) = read_runs(case, ("fit",)).runs
    found = find_initial_state(case.plant, run)
    np.testing.assert_allclose(found.qpos, begun, atol=2e-3)
    assert found.nrmse < 2e-3


def test_a_decay_with_uneven_stamps_starts_where_it_does(tmp_path):
    """Accelerations of an oscillator in closed form, without noise; the stamps scatter by 15 ms about 20 Hz."""
    stiffness, damping, start, rate = 361.0, 0.7, 0.002, 0.03
    omega = np.sqrt(stiffness - damping**2 / 4)
    time = np.round(np.arange(66) * 0.05 + np.random.default_rng(0).uniform(-0.015, 0.015, 66), 3)
    time -= time[0]
    sine = (rate + 0.5 * damping * start) / omega
    decay = np.exp((-0.5 * damping + 1j * omega) * time) * (start - 1j * sine)
    velocity = ((-0.5 * damping + 1j * omega) * decay).real
    acceleration = -stiffness * decay.real - damping * velocity
    (tmp_path / "tower.xml").write_text(
        '<mujoco><option timestep="0.0005" gravity="0 0 0" integrator="RK4"/><worldbody><body>'
        f'<joint name="sway" type="slide" axis="1 0 0" stiffness="{stiffness}" damping="{damping}"/>'
        '<geom size="0.05" mass="1"/><site name="imu"/></body></worldbody>'
        '<sensor><accelerometer name="acc" site="imu"/></sensor></mujoco>'
    )
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, acceleration]), delimiter=",", header="t,a", comments="")
    text = 'title = "Tower"\n[model]\nmjcf = "tower.xml"\n[[recording]]\nfile = "run.csv"\nrole = "fit"\ntime = "t"\n'
    (tmp_path / "case.toml").write_text(text + channel("a", "acc.x", "acceleration", "m/s^2", is_input=False))
    case = load_case(tmp_path)
    (run,) = read_runs(case, ("fit",)).runs
    found = find_initial_state(case.plant, run)
    assert found.qpos[0] == pytest.approx(start, rel=1e-3)
    assert found.qvel[0] == pytest.approx(rate, rel=1e-3)
