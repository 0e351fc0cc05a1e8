"""The benches of pendulums and carts: motion, effects and cases against MuJoCo, closed forms and conservation laws."""

import json
from dataclasses import replace
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vlab.cases import compare_case, load_case, simulate
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf
from vlab.proof.case_folder import write_case
from vlab.proof.equivalence import right_class
from vlab.proof.generator.concealed import Wanted
from vlab.proof.generator.hidden import Hidden
from vlab.proof.generator.motion_sizing import MotionRefit
from vlab.proof.generator.pendulum import conceal_pendulum
from vlab.proof.generator.pendulum_effects import SWING_LIBRARY, SWING_STRANGE
from vlab.proof.generator.pendulum_models import BOB, CARTS, LIGHT, SWINGS, TWIN, benign_of, built, mjcf_of, starts_of
from vlab.proof.generator.pendulum_setup import ideal
from vlab.proof.judge import judge
from vlab.proof.servo_scoring import SWING_HZ
from vlab.proof.suites import drawn_suites, make_case, swing_kinds

ALL = (*SWINGS, *CARTS)
STATED = {"mass": 0.02, "inertia": 0.05, "centre-of-mass": 0.02, "length": 0.002, "damping": 0.3, "gain": 0.05}


def log_of(pendulum, factors=None, rate_hz=100.0, substeps=40, lead=0):
    return ideal(pendulum, factors or {}, rate_hz=rate_hz, substeps=substeps, lead=lead)


def model_of(pendulum, timestep=1e-3, integrator="implicitfast"):
    return mujoco.MjModel.from_xml_string(mjcf_of(pendulum, timestep=timestep, integrator=integrator))


def still(machine, **numbers):
    """Return a machine without dampers, with other numbers of all joints."""
    for j in range(machine.n):
        machine = machine.with_numbers(j, damping=0.0, **numbers)
    return machine


def swing(machine, angles, seconds=6.0, step=1e-3, substeps=1):
    """Return coordinates and rates after a release at rest."""
    first = np.array([angles, np.zeros(machine.n)])
    return machine.march(np.zeros(round(seconds / step)), step, substeps, first)


# ---- equations of motion --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("pendulum", ALL, ids=lambda p: p.name)
def test_mass_matrix_and_bias_are_those_of_mujoco(pendulum):
    model, machine, rng = model_of(pendulum), built(pendulum, {}), np.random.default_rng(1)
    data, n = mujoco.MjData(model), machine.n
    for _ in range(20):
        q, v = rng.uniform(-np.pi, np.pi, n), 3.0 * rng.standard_normal(n)
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        M = np.zeros((n, n))
        mujoco.mj_fullM(model, data, M)
        ours, bias, _ = machine.equations(q, v)
        assert np.abs(ours - M).max() < 1e-12 * np.abs(M).max()
        assert np.abs(bias - data.qfrc_bias).max() < 1e-12 * max(np.abs(data.qfrc_bias).max(), 1.0)


def test_a_factor_on_a_parameter_is_that_of_the_model():
    """A calibrated model takes up the deviations: masses carry inertia along, a shift counts in radii of gyration."""
    model = model_of(TWIN)
    factors = {"mass:lower": 0.1, "inertia:upper": -0.2, "centre-of-mass:lower": 0.3, "length:lower": 0.05}
    lower = model.body("lower").id
    model.body_mass[lower] *= np.exp(0.1)
    model.body_inertia[lower] *= np.exp(0.1)
    model.body_inertia[model.body("upper").id] *= np.exp(-0.2)
    gyration = np.sqrt(model.body_inertia[lower].sum() / (2 * model.body_mass[lower]))
    model.body_ipos[lower, 2] -= 0.3 * gyration
    model.body_pos[lower] *= np.exp(0.05)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.4, -0.7), (1.0, 2.0)
    mujoco.mj_setConst(model, data)
    data.qpos[:], data.qvel[:] = (0.4, -0.7), (1.0, 2.0)
    mujoco.mj_forward(model, data)
    M = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, M)
    ours, bias, _ = built(TWIN, factors).equations(data.qpos, data.qvel)
    assert ours == pytest.approx(M, rel=1e-12)
    assert bias == pytest.approx(data.qfrc_bias, rel=1e-12)


@pytest.mark.parametrize("pendulum", ALL, ids=lambda p: p.name)
def test_energy_is_conserved_without_friction_at_second_order(pendulum):
    machine = still(built(pendulum, {}))
    angles = np.full(machine.n, 0.7) * (np.array(pendulum.joints) != "slide")
    drift = []
    for step in (4e-3, 2e-3):
        marched = swing(machine, angles, step=step)
        energy = [machine.energy(q, v) for q, v in marched]
        drift.append(np.ptp(energy) / max(0.5 * v @ machine.equations(q, v)[0] @ v for q, v in marched))
    assert drift[1] < 1e-4
    assert drift[0] / drift[1] == pytest.approx(4.0, rel=0.1)


def test_the_period_from_a_large_angle_is_the_elliptic_integral():
    from scipy.special import ellipk

    machine, start = still(built(BOB, {})), np.deg2rad(110.0)
    q = swing(machine, [start], seconds=9.0, step=5e-4)[:, 0, 0]
    down = np.flatnonzero((q[:-1] > 0) & (q[1:] <= 0))
    crossing = (down + q[down] / (q[down] - q[down + 1])) * 5e-4
    rod = BOB.rods[0]
    omega = np.sqrt(rod.mass * 9.81 * rod.centre / (rod.inertia + rod.mass * rod.centre**2))
    assert np.mean(np.diff(crossing)) == pytest.approx(4 * ellipk(np.sin(start / 2) ** 2) / omega, rel=2e-6)


def test_a_cart_keeps_its_momentum_along_the_rail():
    machine = still(built(LIGHT, {}))
    marched = swing(machine, np.array([0.0, 1.0]))
    momentum = [(machine.equations(q, v)[0] @ v)[0] for q, v in marched]
    assert np.ptp(momentum) < 1e-5 * max(abs(v[1]) for _, v in marched)


# ---- friction and other laws ----------------------------------------------------------------------------------------


def test_dry_friction_takes_a_fixed_angle_each_half_swing_and_then_holds():
    """Small angles: 2 F/(m g c) a half swing; m g c is the stiffness."""
    rod = BOB.rods[0]
    stiffness = rod.mass * 9.81 * rod.centre
    force = 0.01 * stiffness * 0.05
    q, v = (swing(still(built(BOB, {}), dry=force), [0.05], seconds=60.0, step=1e-3)[:, k, 0] for k in (0, 1))
    turns = np.flatnonzero((v[1:-1] * v[2:] < 0) & (np.abs(q[1:-1]) > 0.01)) + 1
    drop = -np.diff(np.abs(q[turns]))
    assert len(drop) > 20
    assert drop == pytest.approx(2 * force / stiffness, rel=0.01)
    assert abs(q[-1]) <= force / stiffness
    assert v[-1] == 0.0


LAWS = [
    ({"drag": 0.02, "drag_power": 1.7}, lambda q, v, t: -0.02 * np.sign(v) * abs(v) ** 1.7),
    ({"cubic": 0.3, "spring": 0.2}, lambda q, v, t: -0.2 * q - 0.3 * q**3),
    ({"quintic": 0.1, "drift": 0.02, "push": 0.1}, lambda q, v, t: 0.1 - 0.02 * t * q - 0.1 * q**5),
    ({"smooth": 0.05, "smooth_speed": 0.3}, lambda q, v, t: -0.05 * np.tanh(v / 0.3)),
    ({"stop": 20.0, "gap": 0.8, "stop_power": 1.5}, lambda q, v, t: -np.sign(q) * 20.0 * max(abs(q) - 0.8, 0.0) ** 1.5),
    ({"stop": 9.0, "gap": 0.3, "side": -1.0}, lambda q, v, t: 9.0 * max(-q - 0.3, 0.0)),
    ({"sine": 0.1, "cosine": 0.05, "omega": 3.0}, lambda q, v, t: 0.1 * np.sin(3 * t) + 0.05 * np.cos(3 * t)),
    ({"magnet": 0.3, "magnet_at": 0.4, "magnet_width": 0.1},
     lambda q, v, t: -0.3 * (q - 0.4) / 0.1 * np.exp(0.5 - 0.5 * ((q - 0.4) / 0.1) ** 2)),
    ({"slope": 0.2, "slope_rate": 4.0, "slope_phase": 0.5}, lambda q, v, t: 0.2 * np.sin(4.0 * q + 0.5)),
]  # fmt: skip


@pytest.mark.parametrize(("numbers", "law"), LAWS, ids=[next(iter(numbers)) for numbers, _ in LAWS])
def test_a_law_moves_the_pendulum_as_a_general_integrator_says(numbers, law):
    rod, step = BOB.rods[0], 2.5e-4
    q = swing(built(BOB, {}).with_numbers(0, **numbers), [1.2], seconds=4.0, step=step)[:, 0, 0]
    inertia = rod.inertia + rod.mass * rod.centre**2

    def rate(t, x):
        gravity = -rod.mass * 9.81 * rod.centre * np.sin(x[0])
        return [x[1], (gravity - rod.damping * x[1] + law(x[0], x[1], t)) / inertia]

    t = np.arange(len(q)) * step
    exact = solve_ivp(rate, (0, t[-1]), [1.2, 0.0], "DOP853", t, rtol=1e-10, atol=1e-12, max_step=2e-3).y[0]
    assert np.abs(q - exact).max() < 5e-5


def test_half_the_step_changes_a_quarter_as_much():
    """With friction in both joints, a stop on the rail and a motor."""
    log = log_of(LIGHT, substeps=10)
    log = replace(log, machine=log.machine.with_numbers(0, dry=0.3, stop=200.0, gap=0.1).with_numbers(1, dry=2e-3))
    commands = 4.0 * np.sin(2 * np.pi * 0.7 * np.arange(400) / 100)[:, None, None]
    runs = [log.stepped(n).run(commands) for n in (10, 20, 40, 80)]
    change = [np.sqrt(np.mean((a - b) ** 2, axis=(0, 2))) for a, b in pairwise(runs)]
    assert (change[-1] < 1e-5).all()
    assert (change[0] / change[-1] > 4.0).all()


@pytest.mark.parametrize(("integrator", "is_fourth"), [("implicitfast", False), ("RK4", True)])
@pytest.mark.parametrize("pendulum", ALL, ids=lambda p: p.name)
def test_the_error_of_a_models_step_is_that_of_mujoco(pendulum, integrator, is_fourth):
    model, log = model_of(pendulum, timestep=2e-3, integrator=integrator), log_of(pendulum)
    data, count = mujoco.MjData(model), 150
    commands = np.zeros((count, len(pendulum.joints), 1))
    commands[:] = 0.8
    if pendulum.cart is not None:
        commands = 3.0 * np.sin(2 * np.pi * 0.7 * np.arange(count) / 100)[:, None, None]
    else:
        data.qpos[:] = 0.8
    ours = log.nominal_readings(commands, 2e-3, is_fourth_order=is_fourth)[:, :, 0]
    theirs = np.zeros_like(ours)
    for k in range(count):
        theirs[k] = data.qpos
        if pendulum.cart is not None:
            data.ctrl[:] = commands[k, :, 0]
        mujoco.mj_step(model, data, nstep=5)
    assert np.abs(ours - theirs).max() < 1e-9
    exact = log.run(commands)[:, :, 0]
    assert np.abs(exact - theirs).max() < (1e-4 if is_fourth else 1e-2)


def test_a_payload_is_a_point_mass_at_the_tip():
    text = mjcf_of(TWIN, timestep=1e-3, integrator="RK4").replace(
        '<site name="tip"', '<body pos="0 0 -0.19"><inertial pos="0 0 0" mass="0.1" diaginertia="1e-12 1e-12 1e-12"/></body><site name="tip"'
    )  # fmt: skip
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = (0.5, -1.0), (1.0, 2.0)
    mujoco.mj_forward(model, data)
    M = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, M)
    ours, bias, _ = built(TWIN, {}).with_payload(0.1).equations(data.qpos, data.qvel)
    assert ours == pytest.approx(M, rel=1e-9)
    assert bias == pytest.approx(data.qfrc_bias, rel=1e-9)


# ---- hidden effects -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def logs():
    """Six seconds of a cart and of a double pendulum to either side, with commands and signal sizes."""
    cart, twin = log_of(LIGHT, substeps=10), log_of(TWIN, substeps=10, lead=10)
    time = np.arange(600) / 100
    both = np.array([1.0, -1.0])
    pushed = (5.0 * np.sin(2 * np.pi * 0.6 * time) * (time > 0.3))[:, None, None] * both
    released = np.tile(np.array([0.8, -0.3]), (600, 1))[:, :, None] * both
    return [(log, u, log.scales(u)) for log, u in ((cart, pushed), (twin, released))]


@pytest.mark.parametrize("kind", swing_kinds(), ids=lambda k: f"{k.name} {k.on} {k.form}".strip())
def test_everything_that_can_be_hidden_changes_something_and_grows(logs, kind):
    met = 0
    for log, commands, scales in logs:
        null = log.run(commands)
        for place in log.places(kind):
            shapes, change = kind.draw(np.random.default_rng(2)), []
            for share in (0.2, 1.0):
                size = share * min(max(0.3, kind.start), kind.most)
                one = Hidden(kind=kind, place=place, shapes=shapes, scale=log.scale_at(place, scales), size=size)
                change.append(np.sqrt(np.mean((log.run(commands, [one]) - null) ** 2)))
            assert change[1] > 1e-6
            assert change[1] >= change[0]
            met += 1
    assert met


def test_names_and_parameters_are_those_of_the_catalogue(logs):
    for kind in swing_kinds():
        assert set(kind.accepted) <= set(EFFECTS)
        if kind in SWING_STRANGE:
            assert kind.name not in EFFECTS
            continue
        assert kind.name in EFFECTS
        parameters, _ = kind.make(0.5, kind.draw(np.random.default_rng(0)), logs[0][2][0])
        if kind.same:
            assert set(parameters) == {p.name for p in EFFECTS[kind.name].parameters}, kind.name


@pytest.fixture(scope="module")
def null_cart():
    return conceal_pendulum("cart", Wanted(suite="null"), np.random.default_rng(4))


APART = {"coulomb-friction": 0.1, "stribeck-friction": 0.1}
"""Shares of the effect by which the sides may differ: friction of MuJoCo is soft."""


@pytest.mark.parametrize(
    ("kind", "place"),
    [
        pytest.param(k, p, marks=[pytest.mark.slow] if i else [])
        for k in SWING_LIBRARY
        if k.same
        for i, p in enumerate(log_of(LIGHT).places(k))
    ],
    ids=lambda x: x if isinstance(x, str) else x.name,
)
def test_a_name_means_the_same_on_a_cart_of_mujoco(kind, place, null_cart, tmp_path):
    """Both sides answer the same commands with and without an effect of the same parameters at the same place."""
    log, time = log_of(LIGHT), np.arange(400) / 100
    commands = (5.0 * np.cos(2 * np.pi * 0.6 * time) * (time > 0.3))[:, None, None]
    scales, null = log.scales(commands), log.run(commands)
    size = min(max(0.1, kind.start), kind.most)
    shapes = kind.draw(np.random.default_rng(2))
    one = Hidden(kind=kind, place=place, shapes=shapes, scale=log.scale_at(place, scales), size=size)
    made = null_cart
    text = mjcf_of(LIGHT, timestep=1e-3, integrator="RK4")
    nominal = replace(made.blueprint, files={"cart.xml": text}, rate_hz=100.0)
    plan = replace(made.plan, recordings=made.plan.recordings[:1], commands=commands)
    sensors = (("joint:slide", "displacement", "m"), ("joint:pivot", "angle", "rad"))
    write_case(replace(made, blueprint=nominal, plan=plan, sensors=sensors, outputs=null), tmp_path / "case")
    loaded = load_case(tmp_path / "case")
    (run,) = loaded.runs()
    values = {k: float(v) for k, v in one.parameters.items()}
    named = place.replace("sensor:", "sensor:joint:")
    attached = Attached(effect=EFFECTS[kind.name], place=named, values=values)
    channels = [name for name, _, _ in sensors]
    plant = attach(loaded.plant, [attached], channels=channels)
    ours = [simulate(p, run).recording.select(channels).data for p in (loaded.plant, plant)]
    theirs = (log.run(commands, [one]) - null)[:, :, 0]
    rms = null[:, :, 0].std(axis=0)
    apart = np.sqrt(np.mean(((ours[1] - ours[0] - theirs) / rms) ** 2))
    assert apart < APART.get(kind.name, 0.03) * np.sqrt(np.mean((theirs / rms) ** 2))


@pytest.mark.parametrize("pendulum", ALL, ids=lambda p: p.name)
def test_places_are_named_as_a_diagnosis_names_them(pendulum):
    plant = build_mjcf(mjcf_of(pendulum, timestep=1e-3, integrator="RK4"))
    assert {f"joint:{name}" for name in pendulum.joints} <= set(plant.ports)
    assert {"site:tip.x", "site:tip.z"} <= set(plant.ports)
    assert [tap.name for tap in plant.actuators] == (["motor"] if pendulum.cart is not None else [])


def test_calibration_takes_up_benign_parameters_and_releases_but_no_friction():
    log = log_of(BOB, substeps=10, lead=10)
    commands = np.stack([np.full((800, 1), a) for a in (0.6, 1.8)], axis=-1)
    benign = (*benign_of(STATED, BOB), *starts_of(BOB, 2))
    sigma = np.full(1, 1e-3)
    refit = MotionRefit(lambda f: log.rebuilt(f).run(commands), {}, benign, sigma, is_relinearised=True)
    for factors in ({"inertia:rod": 0.03}, {"angle:1:0": 0.01, "rate:0:0": -0.1}):
        moved = refit.size(log.rebuilt(factors).run(commands))
        assert moved.change > 5.0
        assert moved.left < 0.1
    rubbed = refit.size(log.with_numbers("joint:pivot", dry=0.02).run(commands))
    assert rubbed.left > 10.0
    assert rubbed.left > 0.05 * rubbed.change  # the damper takes most of small friction


# ---- cases ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("bench", ["pendulum", "cart"])
def test_the_same_seed_gives_the_same_bits(bench):
    made, again = (conceal_pendulum(bench, Wanted(suite="null"), np.random.default_rng(4)) for _ in range(2))
    assert np.array_equal(made.outputs, again.outputs)
    json.dumps(made.truth, allow_nan=False)
    assert made.truth["step_halved"]["over_noise"] <= 0.1


@pytest.mark.parametrize("bench", [pytest.param("pendulum", marks=pytest.mark.slow), "cart"])
def test_a_case_is_checked_and_compared(bench, tmp_path):
    made = conceal_pendulum(bench, Wanted(suite="null"), np.random.default_rng(4))
    write_case(made, tmp_path / "case")
    compared = compare_case(tmp_path / "case")
    assert compared
    text = (tmp_path / "case" / "case.toml").read_text() + (tmp_path / "case" / f"{bench}.xml").read_text()
    assert not [w for w in ("null", "hidden", "sigma", "effect", "twice", "release") if w in text]


@pytest.mark.parametrize(
    ("suite", "bench"),
    [("in-library", "cart"), pytest.param("in-library", "pendulum", marks=pytest.mark.slow), ("two-effects", "cart")],
)
def test_hidden_effects_have_the_wanted_size_and_their_own_names_are_right(suite, bench):
    truth = make_case(suite, (bench,), 6, 0).truth
    assert len(truth["hidden"]) == (2 if suite == "two-effects" else 1)
    unit = np.hypot(1.0, truth["model_error"]["over_noise"])
    assert 1.5 / 1.25 <= truth["size"]["left"] / unit <= 30 * 1.25
    assert truth["step_halved"]["over_noise"] <= 0.1
    for x in truth["hidden"]:
        finding = {"effect": x["accepted"][0], "place": x["place"], "parameters": {}}
        judged = judge(
            {"case": "case-001", **truth}, {"verdict": "missing-physics", "findings": [finding], "seconds": 1.0}
        )
        assert judged.right_effect
        assert judged.place_exact


def test_short_delays_of_a_cart_are_in_class_with_lags():
    truth = {"bench": "cart", "one_level": False, "sigma": [1.0, 1.0]}
    x = {"accepted": ["actuator-delay"], "at_actuator": True, "place": "actuator:motor"}
    short, long = ({**x, "parameters": {"delay": 0.1 / (2 * np.pi * SWING_HZ) * by}} for by in (0.9, 1.1))
    assert right_class(truth, short) == {"actuator-delay", "actuator-lag"}
    assert right_class(truth, long) == {"actuator-delay"}


def test_a_tilted_rail_is_in_class_with_an_offset_of_the_motor_but_not_at_the_hinge():
    log = log_of(LIGHT)
    kind = next(k for k in swing_kinds() if k.name == "force-offset")
    truth = {"bench": "cart", "one_level": False, "sigma": [1.0, 1.0]}
    scales = log.scales(np.ones((50, 1, 1)))
    for place, names in (("joint:slide", {"force-offset", "actuator-offset"}), ("joint:pivot", {"force-offset"})):
        one = Hidden(kind=kind, place=place, shapes={"sign": 1.0}, scale=log.scale_at(place, scales), size=0.1)
        hidden = {"accepted": ["force-offset"], "parameters": {}, **log.alike(one)}
        assert right_class(truth, hidden) == names


def test_one_rod_hides_no_mass():
    """Masses at one rod change its period alone."""
    masses = [k for k in swing_kinds() if k.family == "mass"]
    assert masses
    assert not [k for k in masses if log_of(BOB).places(k)]
    assert all(log_of(TWIN).places(k) for k in masses if k.angular is not False)


def test_the_mixture_of_pendulums_has_its_shares():
    order = drawn_suites(["pendulums"], 60, 1)
    share = {suite: order.count(suite) / 60 for suite in order}
    assert share == {"in-library": 0.4, "null": 0.2, "out-of-library": 0.15, "two-effects": 0.15, "other-form": 0.1}
