"""The bench of arms on servos: equations of motion, drives and cases against MuJoCo, closed forms and conservation laws."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from command import run
from scipy.integrate import solve_ivp

from vlab.cases import compare_case
from vlab.physics.servo import servo_of
from vlab.plants.mjcf import build_mjcf
from vlab.proof.case_folder import write_case
from vlab.proof.conceal import conceal_cases
from vlab.proof.equivalence import right_class
from vlab.proof.generator import arm as generator
from vlab.proof.generator.arm import conceal_arm
from vlab.proof.generator.arm_commands import MOTIONS, motion, received
from vlab.proof.generator.arm_effects import ARM_STRANGE
from vlab.proof.generator.arm_models import ARMS, BENCHTOP, DESK, benign_of, built, mjcf_of, with_payload
from vlab.proof.generator.arm_setup import ServoArm, direct, scales_of
from vlab.proof.generator.concealed import Wanted
from vlab.proof.generator.hidden import Hidden
from vlab.proof.generator.motion_sizing import MotionRefit
from vlab.proof.generator.rigid_body import Chain
from vlab.proof.generator.servo_drive import ideal
from vlab.proof.judge import ADDED_SINCE, judge
from vlab.proof.prove import read_commitments
from vlab.proof.servo_scoring import ARM_HZ
from vlab.proof.suites import arm_kinds, drawn_suites, make_case

STATED = {"mass": 0.05, "inertia": 0.1, "damping": 0.3, "gain": 0.05}


def setup_of(arm, rate_hz=100.0, substeps=40, logged=("angle", "rate", "effort")) -> ServoArm:
    n = len(arm.links)
    machine = built(arm, {})
    return ServoArm(arm=arm, machine=machine, ways=direct(n), rate_hz=rate_hz, substeps=substeps, logged=logged)


def model_of(arm, timestep=1e-5, **changes) -> mujoco.MjModel:
    given = {"integrator": "implicitfast", "is_general": False, "has_effort": True, **changes}
    return mujoco.MjModel.from_xml_string(mjcf_of(arm, timestep=timestep, **given))


# ---- rigid bodies ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_mass_matrix_and_bias_are_those_of_mujoco(arm):
    model, chain, rng = model_of(arm), built(arm, {}).chain, np.random.default_rng(1)
    data, n = mujoco.MjData(model), len(arm.links)
    for _ in range(20):
        q, v = rng.uniform(-np.pi, np.pi, n), 3.0 * rng.standard_normal(n)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        M = np.zeros((n, n))
        mujoco.mj_fullM(model, data, M)
        M -= np.diag(model.dof_armature)
        assert np.abs(chain.mass_matrix(q) - M).max() < 1e-12 * np.abs(M).max()
        assert np.abs(chain.bias(q, v) - data.qfrc_bias).max() < 1e-12 * np.abs(data.qfrc_bias).max()


def test_a_payload_is_a_ball_at_the_tip():
    """Against a body of its own, welded to the last one."""
    away, mass, size = np.array([0.02, -0.01, 0.03]), 0.4, 0.05
    ball = (
        f'<body pos="{" ".join(str(x) for x in np.array(BENCHTOP.tip) + away)}">'
        f'<geom type="sphere" size="{size}" mass="{mass}"/></body></body>'
    )
    text = mjcf_of(BENCHTOP, timestep=1e-3, integrator="Euler", is_general=False, has_effort=False)
    model = mujoco.MjModel.from_xml_string(text.replace("</body>", ball, 1))
    data, rng = mujoco.MjData(model), np.random.default_rng(2)
    chain = with_payload(built(BENCHTOP, {}), BENCHTOP, mass, away, size).chain
    q, v = rng.uniform(-2, 2, 6), rng.standard_normal(6)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    assert chain.bias(q, v) == pytest.approx(data.qfrc_bias, rel=1e-12, abs=1e-12)
    M = np.zeros((6, 6))
    mujoco.mj_fullM(model, data, M)
    assert np.abs(chain.mass_matrix(q) + np.diag(model.dof_armature) - M).max() < 1e-12


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_energy_is_conserved_without_drives_at_second_order(arm):
    """Falling from rest without any drive or damper; the midpoint rule errs with the square of its step."""
    chain = built(arm, {}).chain
    free = ideal(chain, gain=np.full(chain.n, 1e-12))
    start = arm.home + 0.3
    drift = []
    for substeps in (10, 20):
        march = free.march(np.tile(start, (40 * substeps, 1)), 1e-2 / substeps, substeps, first=start)
        energy = [chain.energy(q, v) for q, v, _ in march]
        drift.append(np.ptp(energy) / max(np.ptp([0.5 * v @ chain.mass_matrix(q) @ v for q, v, _ in march]), 1e-300))
    assert drift[0] < 1e-3
    assert drift[0] / drift[1] == pytest.approx(4.0, rel=0.3)


# ---- drives ---------------------------------------------------------------------------------------------------------


def lever(**numbers) -> ServoArm:
    """A lever about a vertical axis on one drive: no gravity, one inertia of 0.02 kg m^2 with its armature."""
    one = np.ones((1, 3))
    chain = Chain(
        offset=0.0 * one, turn=np.eye(3)[None], axis=np.array([[0.0, 0.0, 1.0]]), mass=np.array([1.0]),
        centre=0.0 * one, inertia=0.012 * np.eye(3)[None], gravity=np.array([0.0, 0.0, -9.81]),
    )  # fmt: skip
    given = {"gain": 20.0, "velocity_gain": 0.5, "damping": 0.1, "armature": 0.008, **numbers}
    machine = ideal(chain, **{name: np.array([value]) for name, value in given.items()})
    return ServoArm(arm=DESK, machine=machine, ways=direct(1), rate_hz=100.0, substeps=40, logged=("angle",))


STEP = np.concatenate([np.zeros(10), np.full(190, 0.3)])[:, None]


def test_a_step_of_a_command_has_the_closed_form():
    angle = lever().run(STEP[:, :, None])[:, 0, 0]
    omega, zeta = np.sqrt(20.0 / 0.02), 0.6 / (2 * np.sqrt(20.0 * 0.02))
    t, damped = (np.arange(200) - 10) / 100, np.sqrt(20.0 / 0.02) * np.sqrt(1 - zeta**2)
    decay = np.exp(-zeta * omega * t)
    exact = 0.3 * (1 - decay * (np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t))) * (t > 0)
    # (omega h)^2/24 with omega h = 8e-3 is 3e-6 of a cycle.
    assert np.abs(angle - exact).max() < 0.3 * 3e-5


def test_dry_friction_holds_a_joint_beside_its_command():
    """The droop of a stuck joint is at most F/k_p, and it stays there to rounding."""
    angle = lever(dry=0.4).run(STEP[:, :, None])[:, 0, 0]
    assert 0.0 < abs(angle[-1] - 0.3) <= 0.4 / 20.0
    assert np.ptp(angle[-50:]) < 1e-13
    small = lever(dry=0.4).run(0.05 * STEP[:, :, None])[:, 0, 0]  # k_p e = 0.3 < F
    assert np.abs(small).max() < 1e-13


def test_play_lets_a_joint_stand_within_it():
    """Two inertias: the motor reaches the command, the joint stands within the play beside it."""
    arm = lever(has_train=1.0, gap=0.02, train=200.0, train_damper=0.2, motor_share=0.5)
    angle = arm.run(STEP[:, :, None])[:, 0, 0]
    assert abs(angle[-1] - 0.3) <= 0.02 * (1 + 1e-6)
    assert angle[:40].max() > 0.3  # it runs on within the play


def test_an_elastic_train_has_the_modes_of_two_inertias():
    """A stiff loop holds the motor; the joint swings on the train at sqrt(k/I)."""
    arm = lever(gain=4e4, velocity_gain=80.0, damping=0.0, has_train=1.0, train=30.0, train_damper=0.0)
    angle = arm.run(STEP[:, :, None])[:, 0, 0] - 0.3
    up = np.flatnonzero((angle[20:-1] < 0) & (angle[21:] >= 0)) + 20
    crossing = up - angle[up] / (angle[up + 1] - angle[up])
    period = np.mean(np.diff(crossing)) / 100
    assert 2 * np.pi / period == pytest.approx(np.sqrt(30.0 / 0.012), rel=2e-3)


@pytest.mark.parametrize(
    ("numbers", "moment"),
    [
        ({"dead_zone": 0.05}, lambda u, x, v: 20.0 * np.sign(u - x) * max(abs(u - x) - 0.05, 0.0) - 0.5 * v),
        ({"low": -2.0, "high": 2.0}, lambda u, x, v: np.clip(20.0 * (u - x) - 0.5 * v, -2.0, 2.0)),
        ({"torque": 0.7}, lambda u, x, v: 0.7 * (20.0 * (u - x) - 0.5 * v)),
        ({"drag": 0.05}, lambda u, x, v: 20.0 * (u - x) - 0.5 * v - 0.05 * v * abs(v)),
        ({"smooth": 0.3, "smooth_speed": 0.1}, lambda u, x, v: 20.0 * (u - x) - 0.5 * v - 0.3 * np.tanh(v / 0.1)),
        ({"cog": 0.2, "cogs": 24.0, "cog_phase": 0.3}, lambda u, x, v: 20.0 * (u - x) - 0.5 * v + 0.2 * np.sin(24.0 * x + 0.3)),
    ],
)  # fmt: skip
def test_a_changed_drive_moves_as_a_general_integrator_says(numbers, moment):
    """The whole march against DOP853; the cogging moment shifts the rest at the beginning, so the end is compared."""
    arm = replace(lever(**numbers), substeps=80)
    angle = arm.run(STEP[:, :, None])[:, 0, 0]

    def rate(t, x):
        return [x[1], (moment(0.3, x[0], x[1]) - 0.1 * x[1]) / 0.02]

    t = np.arange(190) / 100
    exact = solve_ivp(rate, (0, t[-1]), [angle[10], 0.0], "DOP853", t, rtol=1e-10, atol=1e-12, max_step=1e-3).y[0]
    assert np.abs(angle[10:] - exact).max() < 1e-4 * 0.3


def test_the_way_of_a_command_is_late_and_slow():
    u = np.concatenate([np.full(5, 0.2), np.full(15, 0.5)])[:, None]

    def came(**numbers):
        ways = {name: np.full(1, numbers.get(name, values[0])) for name, values in direct(1).items()}
        return received(u, ways, step=1e-3, substeps=10, before=3)[30:, 0]

    assert came()[49:51] == pytest.approx([0.2, 0.5])
    late = came(delay=0.0125)
    assert late[61:64] == pytest.approx([0.2, 0.35, 0.5])
    slow = came(slope=2.0)
    assert np.diff(slow).max() == pytest.approx(2.0 * 1e-3)
    assert slow[50 + 150 :] == pytest.approx(np.full(0, 0.5))
    lag = came(lag=0.02)
    t = (np.arange(150) + 0.5) * 1e-3
    assert lag[50:] == pytest.approx(0.5 - 0.3 * np.exp(-t / 0.02), abs=1e-4)
    assert came(scale=1.1, offset=0.01)[-1] == pytest.approx(0.56)
    assert set(np.round(came(quantum=0.15), 12)) == {0.15, 0.45}
    soft = came(slope=3.0, bend=60.0)
    assert np.abs(np.diff(soft, 2)).max() <= 60.0 * 1e-6 * (1 + 1e-9)
    assert soft[-1] <= 0.5 + 1e-4


# ---- arms and cases -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_an_arm_moves_as_mujoco_does_with_a_small_step(arm):
    """MuJoCo errs with its step of 50 us; readings come before the new command of their row."""
    model = model_of(arm, timestep=5e-5)
    data, count, substeps = mujoco.MjData(model), 60, 200
    commands = motion("steps", np.random.default_rng(3), np.arange(count) / 100, arm.home, arm.reach)
    ours = setup_of(arm).march(commands)
    data.qpos[:] = ours[0, 0]
    data.ctrl[:] = commands[0]
    theirs = np.zeros((count, 3, len(arm.links)))
    for k in range(count):
        mujoco.mj_forward(model, data)
        theirs[k] = data.qpos, data.qvel, data.sensordata
        data.ctrl[:] = commands[k]
        mujoco.mj_step(model, data, nstep=substeps)
    assert np.abs(ours[:, 0] - theirs[:, 0]).max() < 2e-4
    spread = np.ptp(theirs, axis=0)
    assert (np.abs(ours - theirs).max(axis=0) < 0.01 * spread + 1e-3).all()


@pytest.mark.parametrize("integrator", ["implicitfast", "Euler"])
def test_the_error_of_a_models_step_is_that_of_mujoco(integrator):
    """Both take the same first-order steps."""
    model = model_of(BENCHTOP, timestep=2e-3, integrator=integrator)
    data, count = mujoco.MjData(model), 60
    commands = motion("steps", np.random.default_rng(3), np.arange(count) / 100, BENCHTOP.home, BENCHTOP.reach)
    arm = setup_of(BENCHTOP, logged=("angle", "rate"))
    implicit = integrator != "Euler"
    ours = arm.nominal_readings(commands[:, :, None], 2e-3, is_servo_implicit=implicit)[:, :, 0]
    data.qpos[:] = ours[0, :6]
    theirs = np.zeros((count, 12))
    for k in range(count):
        theirs[k] = np.concatenate([data.qpos, data.qvel])
        data.ctrl[:] = commands[k]
        mujoco.mj_step(model, data, nstep=5)
    assert np.abs(ours - theirs).max() < 1e-8


@pytest.mark.parametrize("kind", MOTIONS)
def test_commands_start_at_rest_within_their_range(kind):
    for seed in range(4):
        u = motion(kind, np.random.default_rng(seed), np.arange(500) / 100, BENCHTOP.home, BENCHTOP.reach)
        assert np.ptp(u[:40], axis=0).max() == 0.0
        assert (np.abs(u - BENCHTOP.home) <= 1.3 * BENCHTOP.reach).all()
        assert (np.ptp(u, axis=0) > 0.05).all()


def test_a_factor_on_a_parameter_changes_that_parameter():
    for b in benign_of({**STATED, "armature": 0.1, "velocity-gain": 0.1, "length": 0.01, "centre-of-mass": 0.02}, DESK):
        one, two = built(DESK, {}), built(DESK, {b.name: 0.1})
        if b.name in ("length:turret", "length:upper", "centre-of-mass:turret"):
            continue  # along the vertical axis: the same motion
        q, v = np.array([0.3, 0.4, 0.5]), np.array([0.2, 0.1, -0.3])
        same = [
            np.allclose(one.drives, two.drives, rtol=1e-12, equal_nan=True),
            np.allclose(one.chain.mass_matrix(q), two.chain.mass_matrix(q), rtol=1e-9),
            np.allclose(one.chain.bias(q, v), two.chain.bias(q, v), rtol=1e-9),
        ]
        assert not all(same), b.name


@pytest.fixture(scope="module")
def null_case(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arm") / "case"
    made = conceal_arm(Wanted(suite="null"), np.random.default_rng(4))
    write_case(made, folder)
    return made, folder


def test_a_case_of_an_arm_is_checked_and_compared(null_case):
    made, folder = null_case
    compared = compare_case(folder)
    assert compared
    text = (folder / "case.toml").read_text() + (folder / "arm.xml").read_text()
    assert not [w for w in ("null", "hidden", "sigma", "effect", "twice") if w in text]
    json.dumps(made.truth, allow_nan=False)


# ---- hidden effects -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shoulder():
    """Two seconds of steps of the desk arm, with the signal sizes at its shoulder."""
    arm = setup_of(DESK, substeps=20, logged=("angle",))
    commands = motion("steps", np.random.default_rng(7), np.arange(200) / 100, DESK.home, DESK.reach)[:, :, None]
    scales = scales_of(arm, commands)
    return arm, commands, replace(scales[1], each=scales)


def place_of(kind) -> str:
    places = {"servo": "actuator:shoulder_servo", "all servos": "chain", "tip": "site:tip"}
    return places.get(kind.on, "joint:shoulder")


@pytest.mark.parametrize("kind", arm_kinds(), ids=lambda k: f"{k.name} {k.on} {k.form}".strip())
def test_everything_that_can_be_hidden_in_an_arm_changes_something_and_grows(shoulder, kind):
    arm, commands, scale = shoulder
    null, shapes, change = arm.run(commands), kind.draw(np.random.default_rng(2)), []
    for share in (0.2, 1.0):
        size = share * min(max(0.3, kind.start), kind.most)
        one = Hidden(kind=kind, place=place_of(kind), shapes=shapes, scale=scale, size=size)
        change.append(np.sqrt(np.mean((arm.run(commands, [one]) - null) ** 2)))
    assert change[1] > 1e-6
    assert change[1] >= change[0]


def test_names_and_parameters_are_those_of_the_catalogue(shoulder):
    from vlab.physics.catalogue import EFFECTS

    for kind in arm_kinds():
        assert set(kind.accepted) <= set(EFFECTS)
        if kind in ARM_STRANGE:
            assert kind.name not in EFFECTS or kind.name in ADDED_SINCE
            continue
        assert kind.name in EFFECTS
        parameters, _ = kind.make(0.5, kind.draw(np.random.default_rng(0)), shoulder[2])
        if kind.same:
            assert set(parameters) == {p.name for p in EFFECTS[kind.name].parameters}, kind.name


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_places_are_named_as_a_diagnosis_names_them(arm):
    text = mjcf_of(arm, timestep=1e-3, integrator="Euler", is_general=True, has_effort=True)
    plant = build_mjcf(text)
    assert {f"joint:{link.joint}" for link in arm.links} <= set(plant.ports)
    assert {"site:tip.x", "site:tip.y", "site:tip.z"} <= set(plant.ports)
    assert tuple(tap.name for tap in plant.actuators) == arm.servos
    for i, link in enumerate(arm.links):
        servo = servo_of(plant, i)
        assert (servo.gain, servo.damping, servo.limits[1]) == (link.gain, link.velocity_gain, link.limit)
        assert (servo.inertia, servo.drag) == (link.armature, link.damping)


def test_calibration_takes_up_what_a_benign_parameter_does(shoulder):
    """A gain 2 % high is within its statement of 5 %; a command 20 ms late is not."""
    arm, commands, _ = shoulder
    benign, sigma = benign_of(STATED, DESK), np.full(3, 2e-4)
    refit = MotionRefit(
        lambda f: replace(arm, machine=built(DESK, f)).run(commands), {b.name: 0.0 for b in benign}, benign, sigma
    )
    stiffer = refit.size(replace(arm, machine=built(DESK, {"gain:shoulder_servo": 0.02})).run(commands))
    assert stiffer.change > 1.0
    assert stiffer.left < 0.1 * stiffer.change
    late = refit.size(arm.with_way("chain", delay=0.02).run(commands))
    assert late.left > 0.2 * late.change > 1.0


@pytest.mark.parametrize("suite", ["in-library", "two-effects"])
def test_hidden_effects_have_the_wanted_size(suite, monkeypatch):
    monkeypatch.setattr(generator, "ARMS", (DESK,))
    monkeypatch.setattr(generator, "SECONDS", (5.0,))
    made = make_case(suite, ("arm",), 6, 0)
    truth = made.truth
    assert len(truth["hidden"]) == (2 if suite == "two-effects" else 1)
    unit = np.hypot(1.0, truth["model_error"]["over_noise"])
    assert 1.5 / 1.25 <= truth["size"]["left"] / unit <= 30 * 1.25
    assert truth["size"]["of_signal"] <= 0.9
    assert truth["step_halved"]["over_noise"] <= 0.1
    for x in truth["hidden"]:
        finding = {"effect": x["accepted"][0], "place": x["place"], "parameters": {}}
        judged = judge(
            {"case": "case-001", **truth}, {"verdict": "missing-physics", "findings": [finding], "seconds": 1.0}
        )
        assert judged.right_effect
        assert judged.place_exact


def test_short_delays_of_an_arm_are_in_class_with_lags():
    truth = {"bench": "arm", "one_level": False, "sigma": [1.0, 1.0]}
    x = {"accepted": ["actuator-delay"], "at_actuator": True, "place": "actuator:yaw_servo"}
    short, long = ({**x, "parameters": {"delay": 0.1 / (2 * np.pi * ARM_HZ) * by}} for by in (0.9, 1.1))
    assert right_class(truth, short) == {"actuator-delay", "actuator-lag"}
    assert right_class(truth, long) == {"actuator-delay"}


@pytest.mark.slow
def test_sealed_arms_are_made_again_bit_for_bit(tmp_path, capsys):
    conceal_cases(tmp_path / "cases", suites=["null"], count=1, seed=3, benches=["arm"], jobs=1)
    status, _, _ = run(
        capsys, "conceal", "--again", str(tmp_path / "cases"), "--out", str(tmp_path / "again"), "--jobs", "1"
    )
    assert status == 0
    assert set(read_commitments(tmp_path / "again")["cases"]) == {"case-001"}
    status, out, _ = run(capsys, "check", str(tmp_path / "again" / "case-001"))
    assert status == 0
    assert "would refuse" in out


def test_the_mixture_of_servo_cases_has_its_shares():
    order = drawn_suites(["servo"], 60, 1)
    share = {suite: order.count(suite) / 60 for suite in order}
    assert share["null"] >= 0.2
    assert share["out-of-library"] >= 0.15
    assert share["two-effects"] >= 0.15
