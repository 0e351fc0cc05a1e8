"""Position servos: effects within the loop against closed forms."""

import mujoco
import numpy as np
import pytest

from vlab.errors import VlabError
from vlab.physics.attach import Attached, attach, written
from vlab.physics.attached import AtPort
from vlab.physics.catalogue import EFFECTS
from vlab.physics.effect import Step
from vlab.physics.expression import trace_expression
from vlab.physics.running import PortForces
from vlab.physics.servo import at_servo, servo_of
from vlab.plants.mjcf import build_mjcf

KP, KV, INERTIA, FORCE = 12.0, 0.35, 0.02, 3.0
LOAD = 0.5
"""LOAD [N m]: constant moment on the shaft."""
BENCH = f"""
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.0002" gravity="0 0 0" integrator="implicitfast"/>
  <worldbody>
    <body name="lever">
      <inertial pos="0 0 0" mass="1" diaginertia="{INERTIA} {INERTIA} {INERTIA}"/>
      <joint name="shaft" axis="0 1 0"/>
      <geom size="0.01" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" joint="shaft" kp="{KP}" kv="{KV}" forcerange="-{FORCE} {FORCE}"/>
    <motor name="motor" joint="shaft"/>
  </actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def plant():
    return build_mjcf(BENCH)


def bench(plant, effects):
    values = [Attached(effect=EFFECTS[name], place="actuator:servo", values=p) for name, p in effects.items()]
    return attach(plant, values)


def angles(plant, *, command=0.0, load=0.0, start=0.0, rate=0.0, seconds=3.0):
    """Return times and angles of a run under a constant command and load."""
    data = plant.new_data()
    data.qpos[0], data.qvel[0] = start, rate
    ports = [a for a in plant.physics if isinstance(a, AtPort)]
    laws = PortForces(plant, ports) if ports else None
    h = plant.model.opt.timestep
    out = np.zeros(round(seconds / h))
    for k in range(len(out)):
        out[k] = data.qpos[0]
        data.ctrl[:], data.qfrc_applied[:] = (command, load), 0.0
        mujoco.mj_step1(plant.model, data)
        if laws is not None:
            laws.push(data, data.ctrl)
        mujoco.mj_step2(plant.model, data)
    return np.arange(len(out)) * h, out


def crossings(t, x):
    """Return the times at which a signal changes its sign, between samples."""
    at = np.flatnonzero(np.signbit(x[1:]) != np.signbit(x[:-1]))
    return t[at] - x[at] * (t[at + 1] - t[at]) / (x[at + 1] - x[at])


@pytest.mark.parametrize("gain", [-0.33, 0.5])
def test_the_droop_under_a_load_is_load_over_gain(plant, gain):
    _, q = angles(bench(plant, {"servo-position-gain": {"gain": gain}}), load=LOAD)
    assert q[-1] == pytest.approx(LOAD / ((1 + gain) * KP), rel=1e-4)
    _, q = angles(bench(plant, {"servo-torque-constant": {"gain": gain}}), load=LOAD)
    assert q[-1] == pytest.approx(LOAD / ((1 + gain) * KP), rel=1e-4)
    _, q = angles(bench(plant, {"servo-velocity-gain": {"gain": gain}}), load=LOAD)
    assert q[-1] == pytest.approx(LOAD / KP, rel=1e-4)


@pytest.mark.parametrize("gain", [-0.33, 0.5])
def test_a_free_swing_has_the_frequency_and_decay_of_the_changed_gains(plant, gain):
    for name, (kp, kv) in {
        "servo-position-gain": (1 + gain, 1.0),
        "servo-velocity-gain": (1.0, 1 + gain),
        "servo-torque-constant": (1 + gain, 1 + gain),
    }.items():
        t, q = angles(bench(plant, {name: {"gain": gain}}), start=0.05, seconds=1.0)
        decay = kv * KV / (2 * INERTIA)
        omega = np.sqrt(kp * KP / INERTIA - decay**2)
        cross = crossings(t, q)
        assert np.pi / np.diff(cross[:3]).mean() == pytest.approx(omega, rel=2e-3), name
        exact = 0.05 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
        assert np.abs(q - exact).max() < 0.005 * 0.05, name  # half a step of the staggered integrator


def test_a_command_is_followed_whatever_the_gain(plant):
    _, q = angles(bench(plant, {"servo-position-gain": {"gain": -0.4}}), command=0.2)
    assert q[-1] == pytest.approx(0.2, rel=1e-6)


def test_a_gain_of_commands_is_another_law(plant):
    amplified = attach(plant, [Attached(effect=EFFECTS["actuator-gain"], place="actuator:servo", values={"gain": 0.5})])
    assert not bench(plant, {"servo-position-gain": {"gain": 0.5}}).physics
    assert amplified.physics  # acts on the command alone: a held angle scales, a droop does not


def test_a_dead_zone_holds_a_load_beside_the_target(plant):
    dead = bench(plant, {"servo-error-dead-zone": {"threshold": 0.03}})
    _, q = angles(dead, load=LOAD)
    assert q[-1] == pytest.approx(LOAD / KP + 0.03, rel=1e-3)
    _, q = angles(dead, start=0.02)
    assert np.all(q == pytest.approx(0.02, abs=1e-12))  # within the threshold nothing moves the joint
    _, free = angles(dead, start=0.0, rate=0.1, seconds=0.2)
    t = np.arange(len(free)) * dead.model.opt.timestep
    own = 0.1 * INERTIA / KV * (1 - np.exp(-KV / INERTIA * t))  # the velocity gain alone brakes
    assert np.abs(free - own).max() < 0.005 * own.max()


def test_a_force_limit_caps_the_acceleration(plant):
    limit = 0.4 * FORCE
    limited = bench(plant, {"servo-force-limit": {"limit": limit}})
    t, q = angles(limited, command=1.0, seconds=0.1)
    assert q == pytest.approx(0.5 * limit / INERTIA * t**2, abs=limit / INERTIA * 0.1 * limited.model.opt.timestep)
    assert abs(limited.model.actuator_forcerange[0]) == pytest.approx([limit, limit])
    _, q = angles(bench(plant, {"servo-torque-constant": {"gain": -0.6}}), command=1.0, seconds=0.1)
    assert q == pytest.approx(0.5 * limit / INERTIA * t**2, abs=limit / INERTIA * 0.1 * limited.model.opt.timestep)


def test_a_soft_limit_droops_more_than_a_spring(plant):
    limit = 0.8
    _, q = angles(bench(plant, {"servo-soft-force-limit": {"limit": limit}}), load=LOAD)
    assert q[-1] == pytest.approx(limit / KP * np.arctanh(LOAD / limit), rel=1e-3)


def test_a_motor_runs_up_to_its_no_load_speed(plant):
    # I dv/dt = L (1 - v/v0), from rest: an exponential with the time constant I v0/L
    limit, speed = 0.4 * FORCE, 5.0
    t, q = angles(
        bench(plant, {"servo-torque-speed-line": {"limit": limit, "speed": speed}}), command=100.0, seconds=0.4
    )
    tau = INERTIA * speed / limit
    assert q == pytest.approx(speed * (t - tau * (1 - np.exp(-t / tau))), abs=2e-3 * q.max())


@pytest.mark.parametrize("command", [100.0, -100.0])
def test_a_gear_takes_its_share_of_the_force(plant, command):
    # the largest force drives throughout, less the share that rubs
    gear = bench(plant, {"servo-load-friction": {"share": 0.3, "rise": 1e-3}})
    t, q = angles(gear, command=command, seconds=0.1)
    assert q == pytest.approx(0.5 * np.sign(command) * 0.7 * FORCE / INERTIA * t**2, abs=2e-3 * np.abs(q).max())


@pytest.mark.parametrize(
    ("name", "values"),
    {
        "servo-position-gain": {"gain": -0.3},
        "servo-velocity-gain": {"gain": 0.7},
        "servo-torque-constant": {"gain": 0.4},
        "servo-force-limit": {"limit": 1.1},
    }.items(),
)
def test_the_law_is_the_difference_of_the_changed_numbers(plant, name, values):
    # MuJoCo's own actuator force with changed numbers, minus that of the model
    changed, servo = bench(plant, {name: values}), servo_of(plant, 0)
    law, rng = at_servo(EFFECTS[name], servo), np.random.default_rng(0)
    for command, q, v in rng.uniform(-0.6, 0.6, (20, 3)) * (1.0, 1.0, 5.0):
        forces = []
        for model in (plant.model, changed.model):
            data = mujoco.MjData(model)
            data.ctrl[0], data.qpos[0], data.qvel[0] = command, q, v
            mujoco.mj_forward(model, data)
            forces.append(data.qfrc_actuator[0])
        assert law.force(q, v, values, Step(h=0.0, command=command), None)[0] == pytest.approx(
            forces[1] - forces[0], abs=1e-12
        )


def test_every_law_runs_in_compiled_loops(plant):
    for name, effect in EFFECTS.items():
        if name.startswith("servo-"):
            assert trace_expression(at_servo(effect, servo_of(plant, 0)), 0.01) is not None, name


def test_an_exported_model_holds_the_changed_numbers(plant):
    effects = [
        Attached(effect=EFFECTS["servo-position-gain"], place="actuator:servo", values={"gain": -0.25}),
        Attached(effect=EFFECTS["servo-velocity-gain"], place="actuator:servo", values={"gain": 0.2}),
        Attached(effect=EFFECTS["servo-force-limit"], place="actuator:servo", values={"limit": 1.0}),
        Attached(effect=EFFECTS["servo-error-dead-zone"], place="actuator:servo", values={"threshold": 0.01}),
    ]
    spec, left = written(plant, effects)
    model = build_mjcf(spec.to_xml()).model
    assert model.actuator_gainprm[0, 0] == pytest.approx(0.75 * KP)
    assert model.actuator_biasprm[0, 1:3] == pytest.approx([-0.75 * KP, -1.2 * KV])
    assert model.actuator_forcerange[0] == pytest.approx([-1.0, 1.0])
    assert [one.effect.name for one in left] == ["servo-error-dead-zone"]


def test_effects_of_a_servo_need_a_servo(plant):
    gain = EFFECTS["servo-position-gain"]
    assert servo_of(plant, 1) is None
    for place in ("actuator:motor", "joint:shaft"):
        with pytest.raises(VlabError, match="position servo|unknown place"):
            attach(plant, [Attached(effect=gain, place=place, values={"gain": 0.1})])
    with pytest.raises(VlabError, match="position servo"):
        attach(plant, [Attached(effect=EFFECTS["coulomb-friction"], place="actuator:servo", values={"force": 0.1})])


def test_a_gear_and_a_tendon_carry_the_law(plant):
    # the length of the transmission is gear times angle, so the joint's stiffness is gear^2 kp
    for old, new in (
        ('name="servo" joint="shaft"', 'name="servo" joint="shaft" gear="2"'),
        ('name="servo" joint="shaft"', 'name="servo" tendon="line" gear="2"'),
    ):
        text = BENCH.replace(old, new).replace(
            "<actuator>", '<tendon><fixed name="line"><joint joint="shaft" coef="1"/></fixed></tendon><actuator>'
        )
        _, q = angles(bench(build_mjcf(text), {"servo-error-dead-zone": {"threshold": 0.03}}), load=LOAD)
        assert q[-1] == pytest.approx((LOAD / 2 / KP + 0.03) / 2, rel=1e-3)


def test_a_servo_with_a_filter_errs_by_the_filtered_command(plant):
    # far below its corner the filter passes the command; the dead zone then holds the joint behind the filtered command
    filtered = build_mjcf(BENCH.replace('kv="0.35"', 'kv="0.35" timeconst="0.05"'))
    t, q = angles(bench(filtered, {"servo-error-dead-zone": {"threshold": 0.03}}), command=0.1, seconds=0.02)
    held = 0.1 * (1 - np.exp(-t / 0.05)) < 0.03
    assert held.sum() > 50
    assert np.abs(q[held]).max() < 1e-12
    assert abs(q[-1]) > 1e-6
