"""The search along the motion: when it is taken, its linear system, and what it finds of what is hidden in swinging rigs."""

import copy
import dataclasses
import re

import mujoco
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rig_swinging
from rig_swinging import CASES, PIVOT, WRITE, driven_arm, pushed_cart, swinging_pendulum
from scipy.linalg import expm
from test_reduced_model_inputs import ENCODER, VELOCITY, recorded

from vlab.cases import load_case
from vlab.cases.initial_state import find_initial_state
from vlab.diagnose.data.noise import uneven_noise
from vlab.diagnose.inference.model_choice import choose_model
from vlab.diagnose.inference.trajectory_least_squares import TrajectoryLeastSquares
from vlab.diagnose.inference.trajectory_score_test import TrajectoryScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.actuator_states import actuator_states
from vlab.diagnose.predictors.recorded_motion import refuse_recorded_contacts
from vlab.diagnose.predictors.scope import linear_problem
from vlab.diagnose.predictors.step_jacobian import Stepper, Substeps
from vlab.diagnose.predictors.trajectory_problem import prepare_trajectory
from vlab.diagnose.search.model_class import choose_model_class
from vlab.errors import BadCase
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf

SHIPPED = (
    "emps/case.toml", "silverbox/case.toml", "avc_cantilever/free_decay.toml", "avc_cantilever/closed_loop.toml"
)  # fmt: skip


def shorter(case, samples):
    """Return a case whose recordings end after some samples."""
    step = case.runs()[0].measured.time[1] - case.runs()[0].measured.time[0]
    tables = [dataclasses.replace(r, stop_s=samples * step) for r in case.table.recording]
    return dataclasses.replace(case, table=dataclasses.replace(case.table, recording=tuple(tables)))


# ---- the road ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", SHIPPED)
def test_small_motion_keeps_the_linear_search(file):
    assert linear_problem(load_case(f"assets/cases/{file}")) is not None


def test_a_structure_keeps_the_linear_search(tmp_path):
    case = load_case("assets/cases/dissertation/beam_table1.toml")
    with pytest.raises(BadCase, match="cannot be diagnosed|no \\[\\[recording"):  # it has a modal table alone
        linear_problem(case)


def test_a_pendulum_takes_the_other_road_from_twenty_degrees_on(tmp_path, monkeypatch):
    swinging_pendulum(tmp_path / "far", noise=0.001)
    assert linear_problem(load_case(tmp_path / "far")) is None
    monkeypatch.setattr(rig_swinging, "ANGLES", ((8, "fit"), (6, "holdout")))
    swinging_pendulum(tmp_path / "near", noise=0.001)
    # sin x departs from x by x^2/6: 0.3 % at 8 degrees
    assert linear_problem(load_case(tmp_path / "near")) is not None


@pytest.mark.slow
def test_what_cannot_be_handled_is_said_at_once(tmp_path):
    swinging_pendulum(tmp_path, noise=0.001)
    path = tmp_path / "rig.xml"
    whole = path.read_text()
    path.write_text(
        whole.replace(
            "</worldbody>", '<body pos="1 0 1"><freejoint name="bird"/><geom size=".1" mass="1"/></body></worldbody>'
        )
    )
    with pytest.raises(BadCase, match="bird.*free flight"):
        choose_model_class(load_case(tmp_path))
    path.write_text(
        whole.replace('<flag contact="disable"/>', "").replace(
            "</worldbody>", '<geom name="wall" type="box" size=".02 1 1" pos=".3 0 .5"/></worldbody>'
        )
    )
    with pytest.raises(BadCase, match="wall.*touch.*contact-rich"):
        choose_model_class(load_case(tmp_path))


def test_the_refusal_of_contacts_gives_the_line_that_excludes_them(tmp_path):
    swinging_pendulum(tmp_path)
    path = tmp_path / "rig.xml"
    wall = '<geom name="wall" type="box" size=".02 1 1" pos=".3 0 .5"/>'
    text = path.read_text().replace('<flag contact="disable"/>', "").replace("</worldbody>", f"{wall}</worldbody>")
    path.write_text(text)
    with pytest.raises(BadCase, match="'wall' of body 'world'.*body 'arm' touch.*contact-rich") as caught:
        refuse_recorded_contacts(load_case(tmp_path))
    line = re.search("<contact>.*</contact>", str(caught.value))[0]
    path.write_text(text.replace("</worldbody>", f"</worldbody>{line}"))
    refuse_recorded_contacts(load_case(tmp_path))
    pair = '<contact><pair geom1="wall" geom2="bob"/></contact>'  # MuJoCo does not exclude what a pair asks for
    path.write_text(text.replace("</worldbody>", f"</worldbody>{pair}"))
    with pytest.raises(BadCase, match="remove their <pair>"):
        refuse_recorded_contacts(load_case(tmp_path))


def test_what_holds_an_unstable_model_must_be_recorded(tmp_path):
    swinging_pendulum(tmp_path)
    path, time = tmp_path / "rig.xml", np.arange(1500) / rig_swinging.RATE
    path.write_text(path.read_text().replace("-0.5", "0.5"))  # the bob above the pivot
    balanced = 0.01 * np.sin(2 * np.pi * 0.7 * time) + 1e-4 * np.random.default_rng(0).standard_normal(time.size)
    for file in tmp_path.glob("*.parquet"):
        pq.write_table(pa.table({"angle": balanced}), file)
    with pytest.raises(BadCase, match="unstable in the model.*record the commands"):
        choose_model_class(load_case(tmp_path))


def test_a_muscle_is_refused(tmp_path):
    swinging_pendulum(tmp_path)
    path = tmp_path / "rig.xml"
    muscle = '<actuator><muscle name="biceps" joint="pivot"/></actuator><sensor>'
    path.write_text(path.read_text().replace("<sensor>", muscle).replace('type="hinge"', 'type="hinge" range="-3 3"'))
    with pytest.raises(BadCase, match="biceps.*muscle"):
        choose_model_class(load_case(tmp_path))


# ---- the linear system along the motion -------------------------------------------------------------------------------


@pytest.mark.slow
def test_slopes_are_those_of_the_equation_of_motion(tmp_path):
    pushed_cart(tmp_path)
    case = load_case(tmp_path)
    channels = tuple(c for c in case.runs()[0].compared)
    stepper = Stepper(case.plant, channels)
    q, v, u = np.array([0.2, 1.1]), np.array([-0.5, 3.0]), np.array([1.5])
    L, M, by_control, _ = stepper.slopes(q, v, u, np.zeros(0))
    arm, pole, cart, inertia = 0.3, 0.3, 1.0, 0.004

    def acceleration(q, v):
        m12 = -pole * arm * np.cos(q[1])
        mass = np.array([[cart + pole, m12], [m12, inertia + pole * arm**2]])
        force = np.array(
            [
                u[0] - 0.8 * v[0] - 2.0 * q[0] - pole * arm * v[1] ** 2 * np.sin(q[1]),
                -pole * 9.80665 * arm * np.sin(q[1]) - 0.002 * v[1],
            ]
        )
        return np.linalg.solve(mass, force), mass

    exact, step = np.zeros((2, 4)), 1e-6
    for i in range(4):
        d = step * np.eye(4)[i]
        high, low = (acceleration(q + s * d[:2], v + s * d[2:])[0] for s in (1, -1))
        exact[:, i] = (high - low) / (2 * step)
    # forward differences of step 1e-6, read off a step of 1e-4: rounding of 1e-16/1e-6/1e-4
    np.testing.assert_allclose(L[2:], exact, atol=2e-4 * np.abs(exact).max())
    np.testing.assert_allclose(M, acceleration(q, v)[1], rtol=1e-5)  # of the last state tried, 1e-6 away
    np.testing.assert_allclose(by_control[:, 0], np.linalg.inv(M)[:, 0], rtol=1e-5)


@pytest.mark.slow
def test_a_step_and_its_derivative_agree(tmp_path):
    driven_arm(tmp_path)
    case = load_case(tmp_path)
    stepper = Stepper(case.plant, tuple(case.runs()[0].compared))
    q, v, u, h = np.array([0.6, -0.9]), np.array([1.0, -2.0]), np.array([0.5, 0.2]), 1 / 150
    stepper.take(Substeps(count=4))
    first = stepper.advance(q, v, u, np.zeros(0), h)
    middle = stepper.advance(q, v, u, np.zeros(0), h / 2)
    L = stepper.slopes(*middle, u, np.zeros(0))[0]
    move = 1e-4 * np.array([1.0, -0.5, 3.0, 2.0])
    moved = stepper.advance(q + move[:2], v + move[2:], u, np.zeros(0), h)
    change = np.concatenate([moved[0] - first[0], moved[1] - first[1]])
    np.testing.assert_allclose(change, expm(L * h) @ move, atol=2e-3 * np.abs(move).max())  # of second order in h


@pytest.mark.parametrize(("decay", "is_implicit"), [(2e3, False), (2e5, True)])
def test_steps_of_a_stiff_servo_are_stable(tmp_path, decay, is_implicit):
    """A servo's friction of damping / inertia 1/s follows its command within an interval of 10 ms."""
    inertia, gain = 1e-4, 60.0
    path = tmp_path / "wrist.xml"
    path.write_text(
        f'''<mujoco><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/><worldbody><body>
        <joint name="wrist" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>
        </body></worldbody><actuator><position name="servo" joint="wrist" kp="{gain}" kv="{decay * inertia}"/></actuator>
        </mujoco>'''
    )
    stepper = Stepper(build_mjcf("wrist.xml", folder=tmp_path), ())
    q, v, u, none, h = np.array([0.1]), np.array([0.0]), np.array([0.4]), np.zeros(0), 0.01
    found = stepper.find_substeps([(q, v, u, none, h)])
    assert found.is_implicit == is_implicit
    exact = expm(h * np.array([[0.0, 1.0], [-gain / inertia, -decay]])) @ [q[0] - u[0], v[0]]
    q, v = stepper.advance(q, v, u, none, h)
    # implicit steps of 2 ms err by the square of step times gain / damping
    assert q[0] - u[0] == pytest.approx(exact[0], rel=1e-4 if not is_implicit else 2e-2)


@pytest.mark.slow
def test_the_system_along_the_motion_gives_what_mujoco_gives(tmp_path):
    swinging_pendulum(tmp_path, "none", noise=0.001)
    case = shorter(load_case(tmp_path), 300)
    problem, moving = prepare_trajectory(case)
    screen = TrajectoryScoreTest(problem, moving).at(np.zeros(len(problem.parameters)))
    refiner = TrajectoryLeastSquares(screen, whole=True)
    place = next(p for p in problem.places if p.name == PIVOT)
    term = Term(effect=EFFECTS["cubic-stiffness"], place=place, values={"k3": 0.05})
    starts = np.zeros((1, len(refiner.runs), 2))
    theta = np.zeros((1, len(problem.parameters)))
    y = refiner.simulate(refiner.runs, [term], theta, [{"k3": np.array([0.05])}], starts)
    model = copy.copy(case.plant.model)
    model.jnt_stiffnesspoly[0, 1] = 0.05
    data = mujoco.MjData(model)
    motion = screen.motions[1]
    data.qpos[:], data.qvel[:] = motion.q[0], motion.v[0]
    seen = []
    for _ in range(300):
        seen.append(float(data.qpos[0]))
        mujoco.mj_step(model, data, 10)
    away = np.abs(y[:300, 0, 1, 0] - seen).max()
    nominal = np.abs(np.array(seen) - motion.q[:300, 0]).max()
    assert nominal > 0.05  # the spring matters
    assert away < 0.15 * nominal  # deviations are linear up to their size: that of the motion's share squared


def test_noise_at_uneven_times_is_found():
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.004, 0.016, 2000))
    y = np.sin(4 * time) + 0.003 * rng.standard_normal(2000)
    assert uneven_noise(time, y) == pytest.approx(0.003, rel=0.08)


# ---- starts -----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("is_even", [True, False])
def test_a_start_far_from_rest_is_found(tmp_path, is_even, monkeypatch):
    monkeypatch.setattr(rig_swinging, "BENIGN", 0.0)
    swinging_pendulum(tmp_path, noise=0.001, is_even=is_even)
    case = load_case(tmp_path)
    for run in case.runs():
        found = find_initial_state(case.plant, run)
        assert found.nrmse < 0.0015, run.name  # nothing but the noise of 0.1 %


# ---- what is hidden ---------------------------------------------------------------------------------------------------


def answers(folder, rig, effect, samples=None, **given):
    WRITE[rig](folder, effect, **given)
    case = load_case(folder)
    along = choose_model_class(case if samples is None else shorter(case, samples))
    assert not along.is_linear
    names = {e for hidden in CASES[rig].values() for e, _ in hidden.right} | {"sensor-gain", "lugre-friction"}
    found = along.search([EFFECTS[name] for name in sorted(names)], lambda share, what: None)
    choice = choose_model(found)
    return [(t.effect.name, t.place.name) for t in choice.best.terms], choice, found


@pytest.mark.slow
def test_the_screening_sees_the_hidden_effect(tmp_path):
    rig = swinging_pendulum(tmp_path, "quadratic-drag")
    problem, moving = prepare_trajectory(shorter(load_case(tmp_path), 500))
    screen = TrajectoryScoreTest(problem, moving)
    some = ("quadratic-drag", "coulomb-friction", "viscous-damping", "stop", "dead-band", "stiffness-to-ground")
    best = screen.candidates([EFFECTS[n] for n in some])[0]
    assert best.label == f"quadratic-drag@{PIVOT}"
    # dampers are uncertain by 30 %, and 5 s of three swings hold little more
    assert best.values["coefficient"] == pytest.approx(rig.parameters["coefficient"], rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["none", "viscous-damping"])
def test_a_short_swing_is_diagnosed(tmp_path, effect):
    found, choice, _ = answers(tmp_path, "pendulum", effect, samples=500)
    assert found == list(CASES["pendulum"][effect].right[:1])
    assert bool(choice.best.terms) == (effect != "none")


@pytest.mark.slow
@pytest.mark.parametrize("rig", sorted(CASES))
@pytest.mark.parametrize("seed", [0, 1])
def test_hidden_effects_are_named_and_placed(tmp_path, rig, seed):
    """Every effect once: half of them on rigs of the first seed, half on those of the second."""
    wrong = []
    for effect, hidden in list(CASES[rig].items())[seed::2]:
        found, _, _ = answers(tmp_path / effect, rig, effect, seed=seed)
        if (found and (len(found) > 1 or found[0] not in hidden.right)) or bool(found) != bool(hidden.right):
            wrong.append((effect, found))
    assert len(wrong) <= 1, (
        wrong
    )  # friction that peaks near rest is all but plain dry friction where a pendulum swings far


@pytest.mark.slow
@pytest.mark.parametrize("dynamics", ["filterexact", "filter", "integrator"])
def test_what_an_actuator_with_a_state_does_is_known(tmp_path, dynamics):
    """Its state follows its command as in MuJoCo, and a unit of it pushes as hard as its gain says."""
    actuator = f'<general name="drive" joint="a" dyntype="{dynamics}" dynprm="0.02" gainprm="3"/>'
    case = recorded(tmp_path, actuator=actuator, kind="command", reads=(ENCODER, VELOCITY))
    problem, moving = prepare_trajectory(case)
    screen = TrajectoryScoreTest(problem, moving)
    assert screen.driven_force(0)[10:-10, 0] == pytest.approx(
        np.tile([3.0, 0.0], (len(moving.trajectories[0]) - 20, 1)), rel=1e-4
    )
    (trajectory,) = moving.trajectories
    np.testing.assert_array_equal(screen.commands(0)[:, 0], trajectory.act[:, 0])
    data, model = case.plant.new_data(), copy.copy(case.plant.model)
    model.opt.timestep, states = trajectory.h[0] / 64, []
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER  # with Runge and Kutta's method its exact filter is not
    for command in trajectory.u[:200, 0]:
        states.append(data.act[0])
        data.ctrl[:] = command
        mujoco.mj_step(model, data, 64)
    # the exact filter and the integral are exact; the other goes on by Euler's method, off by half a step over its time constant
    tolerance = {"filterexact": 1e-9, "integrator": 1e-9, "filter": 1e-3}[dynamics] * np.abs(states).max()
    np.testing.assert_allclose(trajectory.act[:200, 0], states, atol=tolerance)
    lag, change = screen.stepper.lags[0], np.sin(np.arange(200.0))[:, None, None]
    both = actuator_states(case.plant, trajectory.u[:200] + change[:, 0], trajectory.h[:200]) - trajectory.act[:200]
    np.testing.assert_allclose(screen.acted(0, change)[:, 0, 0], both[:, lag.address], atol=1e-12 * np.abs(both).max())
