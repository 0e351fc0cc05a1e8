"""Play and elasticity between a servo's motor and its joint: two inertias, closed forms and an independent integration."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vlab.errors import VlabError
from vlab.physics.attach import Attached, attach
from vlab.physics.attached import AtPort
from vlab.physics.catalogue import EFFECTS
from vlab.physics.running import PortForces
from vlab.physics.servo import servo_of
from vlab.plants.mjcf import build_mjcf

KP, KV, MOTOR, JOINT, DAMPING = 12.0, 0.35, 0.006, 0.0063, 0.12
"""KP [N m/rad], KV [N m s/rad], MOTOR and JOINT [kg m2]: servo and inertias of the bench; DAMPING [N m s/rad] of the
joint."""
STIFFNESS, RATIO, GAP, SHARE = 140.0, 0.065, 0.03, 0.4
DAMPER = 2 * RATIO * np.sqrt(STIFFNESS * MOTOR)
WIDE = 1e3
"""WIDE [N m]: force limit that no run reaches."""


def bench(
    *, step=2.5e-4, integrator="implicitfast", limit=WIDE, kp=KP, kv=KV, damping=DAMPING, gear=1.0, spans="joint"
):
    """Return the lever on a servo; the length of the transmission is gear times angle."""
    return build_mjcf(f"""
    <mujoco>
      <compiler angle="radian" autolimits="true"/>
      <option timestep="{step}" gravity="0 0 0" integrator="{integrator}"/>
      <worldbody>
        <body name="lever">
          <inertial pos="0 0 0" mass="1" diaginertia="{JOINT} {JOINT} {JOINT}"/>
          <joint name="shaft" axis="0 1 0" damping="{damping}" armature="{0.0 if spans == "tendon" else MOTOR}"/>
          <geom size="0.01" contype="0" conaffinity="0"/>
        </body>
      </worldbody>
      <tendon>
        <fixed name="line" armature="{MOTOR if spans == "tendon" else 0.0}"><joint joint="shaft" coef="1"/></fixed>
      </tendon>
      <actuator>
        <position name="servo" {spans}="{"line" if spans == "tendon" else "shaft"}" gear="{gear}" kp="{kp / gear**2}" kv="{kv / gear**2}" forcerange="-{limit} {limit}"/>
      </actuator>
    </mujoco>""")


def with_train(plant, *, gap=0.0, stiffness=STIFFNESS, ratio=RATIO, share=SHARE):
    values = {"stiffness": stiffness, "damping_ratio": ratio, "motor_share": share} | ({"gap": gap} if gap else {})
    effect = EFFECTS["servo-backlash" if gap else "servo-compliance"]
    return attach(plant, [Attached(effect=effect, place="actuator:servo", values=values)])


class Bench:
    """A run of the bench, with angles and energies."""

    def __init__(self, plant, *, command=lambda t: 0.0, load=0.0, rate=0.0, seconds=1.0):
        data, h = plant.new_data(), plant.model.opt.timestep
        (train,) = (a for a in plant.physics if isinstance(a, AtPort))
        laws, n = PortForces(plant, [train]), round(seconds / h)
        data.qvel[0] = rate
        self.t = np.arange(n) * h
        self.q, self.v, self.apart, self.relative = np.zeros((4, n))
        self.motor_inertia = train.effect.servo.inertia
        is_staged = plant.model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        for k in range(n):
            self.q[k], self.v[k] = data.qpos[0], data.qvel[0]
            self.apart[k], self.relative[k] = laws._memory[0]
            data.ctrl[0], data.qfrc_applied[:] = command(self.t[k] + (0.5 * h if is_staged else 0.0)), load
            if is_staged:
                mujoco.mj_forward(plant.model, data)
                laws.push(data, data.ctrl)
                mujoco.mj_step(plant.model, data)
            else:
                mujoco.mj_step1(plant.model, data)
                laws.push(data, data.ctrl)
                mujoco.mj_step2(plant.model, data)


def commands(t):
    return 0.5 * np.sin(2 * np.pi * 1.3 * t) + 0.2 * np.sin(2 * np.pi * 3.1 * t + 0.3)


def independent(t, *, gap, limit):
    """Return the joint's angle from two inertias, a spring and a damper, integrated by Runge-Kutta with error control."""

    def rate(now, x):
        m, q, r, w = x
        s = m - q
        beyond = s - np.clip(s, -gap, gap)
        train = STIFFNESS * beyond + DAMPER * (r - w) * (abs(s) > gap or gap == 0.0)
        tau = np.clip(KP * (commands(now) - m) - KV * r, -limit, limit)
        motor, joint = SHARE * DAMPING * r, (1 - SHARE) * DAMPING * w
        return [r, w, (tau - train - motor) / MOTOR, (train - joint) / JOINT]

    return solve_ivp(rate, (0.0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-8, atol=1e-10, max_step=4e-3).y[1]


@pytest.mark.slow
@pytest.mark.parametrize("gap", [0.0, GAP])
@pytest.mark.parametrize("limit", [WIDE, 1.5])
def test_a_run_is_that_of_two_inertias(gap, limit):
    # the error falls with the step, as that of MuJoCo's integrators does
    run = Bench(with_train(bench(limit=limit), gap=gap), command=commands)
    exact = independent(run.t, gap=gap, limit=limit)
    fine = np.sqrt(np.mean((run.q - exact) ** 2))
    assert fine < 5e-4 * np.std(exact)
    if gap:
        assert np.ptp(run.apart) > 2 * gap  # the run crosses the play
    for integrator in ("Euler", "RK4", "implicitfast"):
        coarse = Bench(with_train(bench(step=1e-3, limit=limit, integrator=integrator), gap=gap), command=commands)
        assert np.sqrt(np.mean((coarse.q - exact[::4]) ** 2)) < 4e-3 * np.std(exact), integrator


@pytest.mark.parametrize(("gear", "spans"), [(3.0, "joint"), (1.0, "tendon"), (0.5, "tendon")])
def test_gear_and_tendon_carry_the_train(gear, spans):
    plant = bench(gear=gear, spans=spans, step=1e-3, damping=0.0)
    assert servo_of(plant, 0).inertia == pytest.approx(MOTOR / gear**2)
    # the same train in units of the transmission's length
    run = Bench(with_train(plant, gap=GAP * gear, stiffness=STIFFNESS / gear**2), command=lambda t: gear * commands(t))
    same = Bench(with_train(bench(step=1e-3, damping=0.0), gap=GAP), command=commands)
    assert np.abs(run.q - same.q).max() < 1e-9


def test_a_load_droops_by_both_stiffnesses():
    load, stiffness = 0.5, 40.0
    run = Bench(with_train(bench(step=1e-3), stiffness=stiffness), load=load, seconds=2.0)
    assert run.q[-1] == pytest.approx(load * (1 / KP + 1 / stiffness), rel=1e-4)
    run = Bench(with_train(bench(step=1e-3), gap=GAP, stiffness=stiffness), load=load, seconds=2.0)
    assert run.q[-1] == pytest.approx(load * (1 / KP + 1 / stiffness) + GAP, rel=1e-4)


def test_motor_and_joint_swing_at_the_frequencies_of_a_two_mass_system():
    # no damping: the frequencies are those of M x'' + K x = 0
    plant = with_train(bench(kv=0.0, damping=0.0, step=1e-4), ratio=1e-12)
    run = Bench(plant, rate=1.0)
    K, M = np.array([[KP + STIFFNESS, -STIFFNESS], [-STIFFNESS, STIFFNESS]]), np.diag([MOTOR, JOINT])
    squared, shapes = np.linalg.eig(np.linalg.solve(M, K))
    share = shapes[1] * np.linalg.solve(shapes, [1.0, 1.0])  # motor and joint start together
    exact = sum(a * np.sin(w * run.t) / w for a, w in zip(share, np.sqrt(squared), strict=True))
    # half a step of the staggered integrator, at the joint's largest velocity of about 1 rad/s
    assert np.abs(run.q - exact).max() < 1e-4


@pytest.mark.slow
def test_no_energy_arises_in_the_play():
    plant = with_train(bench(kv=0.0, damping=0.0, step=1e-4), gap=GAP, ratio=1e-12)
    run = Bench(plant, rate=3.0)
    q = run.q - 0.5e-4 * run.v  # MuJoCo's positions are half a step ahead
    m, r = q + run.apart, run.v + run.relative
    beyond = run.apart - np.clip(run.apart, -GAP, GAP)
    energy = 0.5 * (JOINT * run.v**2 + MOTOR * r**2 + KP * m**2 + STIFFNESS * beyond**2)
    hits = np.count_nonzero(np.diff((beyond != 0).astype(int)) == 1)
    assert hits > 10
    assert energy == pytest.approx(energy[0], rel=0.02)
    free = beyond == 0
    inside = free[1:] & free[:-1]  # between the stops the joint keeps its velocity
    assert np.abs(np.diff(run.v)[inside]).max() < 1e-6 * 3.0
    damped = Bench(with_train(bench(kv=0.0, damping=0.0, step=1e-4), gap=GAP), rate=3.0)
    m, r = damped.q - 0.5e-4 * damped.v + damped.apart, damped.v + damped.relative
    beyond = damped.apart - np.clip(damped.apart, -GAP, GAP)
    left = 0.5 * (JOINT * damped.v**2 + MOTOR * r**2 + KP * m**2 + STIFFNESS * beyond**2)
    assert left[-1] < 0.7 * left[0]


def test_a_stiff_train_without_play_is_rigid():
    plant = bench()
    run = Bench(with_train(plant, stiffness=1e5, ratio=1.0), command=commands)
    data, rigid = plant.new_data(), np.zeros(len(run.t))
    for k, t in enumerate(run.t):
        rigid[k], data.ctrl[0] = data.qpos[0], commands(t)
        mujoco.mj_step(plant.model, data)
    assert np.abs(run.q - rigid).max() < 1e-3 * np.abs(rigid).max()


def test_a_light_joint_and_a_strong_loop_stay_stable():
    # the joint has a thousandth of the motor's inertia, and the loop's damping stops the motor within a step
    text = bench(step=2e-3, kv=20.0, kp=400.0).spec.to_xml().replace(f"{JOINT} {JOINT} {JOINT}", "6e-6 6e-6 6e-6")
    run = Bench(with_train(build_mjcf(text), gap=GAP, stiffness=4e3, ratio=0.3), command=commands)
    assert np.abs(run.q).max() < 1.0


def test_a_train_needs_the_motors_inertia():
    plant = build_mjcf(bench().spec.to_xml().replace(f'armature="{MOTOR}"', ""))
    with pytest.raises(VlabError, match="armature"):
        with_train(plant)
