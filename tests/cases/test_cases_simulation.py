"""Simulated recordings against independent integrations: irregular times, a law in the loop, initial states."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from vlab.cases import compare_case, load_case, simulate
from vlab.cases.clock import plan_clock
from vlab.cases.initial_state import InitialState, begins_at_rest
from vlab.cases.linear_start import exponentials
from vlab.cases.misfit import misfit
from vlab.cases.replay_inputs import held_means
from vlab.controllers import DirectRateFeedback
from vlab.diagnose.pipeline import diagnose
from vlab.errors import BadCase, BadRecording, Diverged
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine
from vlab.plants import build_plant
from vlab.plants.mjcf import build_mjcf
from vlab.recordings import write_recording
from vlab.structure.reader import load_structure

PENDULUM = """
<mujoco><option timestep="0.001" gravity="0 0 -9.81"/><worldbody><body name="bob">
  <joint name="hinge" axis="0 1 0" damping="0.05"/>
  <inertial mass="1.2" pos="0 0 -0.5" diaginertia="0.02 0.02 0.001"/><site name="imu" pos="0 0 -0.7"/>
</body></worldbody>
<actuator><motor name="motor" joint="hinge"/></actuator>
<sensor><jointpos name="encoder" joint="hinge"/><gyro name="gyro" site="imu"/><accelerometer name="acc" site="imu"/></sensor>
</mujoco>
"""

CART = """
<mujoco><option timestep="0.0002" gravity="0 0 0"/><worldbody><body name="cart">
  <joint name="x1" type="slide" axis="1 0 0" stiffness="400"/><geom size="0.05" mass="1"/><site name="one"/>
</body><body name="second" pos="0.5 0 0">
  <joint name="x2" type="slide" axis="1 0 0" stiffness="100"/><geom size="0.05" mass="0.5"/><site name="two"/>
</body></worldbody>
<tendon><fixed name="spring" stiffness="300"><joint joint="x1" coef="-1"/><joint joint="x2" coef="1"/></fixed></tendon>
<actuator><motor name="coil" joint="x1"/></actuator>
<sensor><jointpos name="laser" joint="x2"/><jointvel name="pickup" joint="x1"/>
  <framepos name="two" objtype="site" objname="two"/></sensor>
</mujoco>
"""
MASS = np.diag([1.0, 0.5])
STIFFNESS = np.array([[700.0, -300.0], [-300.0, 400.0]])
PERIODIC = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(MASS, STIFFNESS), np.zeros((2, 2))]])


def write_case(folder, model, header, columns, body):
    (folder / "rig.xml").write_text(model)
    np.savetxt(folder / "run.csv", np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.17g")
    (folder / "case.toml").write_text(
        f'[model]\nmjcf = "rig.xml"\n[[recording]]\nfile = "run.csv"\nrole = "fit"\n{body}'
    )
    return folder


def channel(column, at, kind, unit, more=""):
    return f'[[recording.channel]]\ncolumn = "{column}"\nat = "{at}"\nkind = "{kind}"\nunit = "{unit}"\n{more}\n'


def swing(time, torque, start):
    """Integrate the pendulum by DOP853, its torque held between the time stamps; angle, rate and angular acceleration."""
    inertia, states = 0.02 + 1.2 * 0.5**2, [np.array(start)]

    def slope(t, x, u):
        return [x[1], (-1.2 * 9.81 * 0.5 * np.sin(x[0]) - 0.05 * x[1] + u) / inertia]

    for a, b, u in zip(time[:-1], time[1:], torque[:-1], strict=True):
        solution = solve_ivp(slope, (a, b), states[-1], args=(u,), method="DOP853", rtol=1e-10, atol=1e-12)
        states.append(solution.y[:, -1])
    angle, rate = np.array(states).T
    return angle, rate, np.array([slope(0, x, u)[1] for x, u in zip(states, torque, strict=True)])


def test_a_pendulum_recorded_at_irregular_times_is_reproduced(tmp_path):
    rng = np.random.default_rng(1)
    time = np.sort(np.concatenate([[0.0, 4.0], rng.uniform(0.0, 4.0, 450)]))
    time = time[np.concatenate([[True], np.diff(time) > 1e-4])]
    torque = np.repeat(rng.uniform(-1.0, 1.0, 46), 10)[: time.size]
    angle, rate, _ = swing(time, torque, [0.9, -1.5])
    body = 'time = "t"\n' + channel("u", "motor", "command", "N m", "input = true")
    body += channel("angle", "encoder", "angle", "rad") + channel("rate", "gyro.y", "angular-velocity", "rad/s")
    folder = write_case(tmp_path, PENDULUM, "t,u,angle,rate", [time, torque, angle, rate], body)
    (run,) = compare_case(folder).runs
    state = run.simulation.initial
    # Steps of 1 ms: the torque, which changes between steps, is smeared over one step, and the damping is taken half a
    # step late: 1e-3 s x 0.2 /s; both fall with the step (measured 3.4e-4, and 0.9e-4 at a quarter of it).
    assert state.qpos[0] == pytest.approx(0.9, abs=5e-4)
    assert state.qvel[0] == pytest.approx(-1.5, abs=2e-3)
    assert max(m.nrmse for m in run.misfits) < 1e-3
    np.testing.assert_array_equal(run.simulated.time, run.measured.time)


def test_an_accelerometer_reads_the_specific_force_at_its_time(tmp_path):
    time = np.arange(200) / 100
    angle, rate, acceleration = swing(time, np.zeros(200), [0.9, -1.5])
    # at 0.7 m below the hinge: x is tangential against the sense of the angle, z radial; gravity is felt as -g
    along = -0.7 * acceleration - 9.81 * np.sin(angle)
    radial = 0.7 * rate**2 + 9.81 * np.cos(angle)
    body = "rate_hz = 100.0\n" + channel("angle", "encoder", "angle", "rad")
    body += channel("x", "acc.x", "acceleration", "m/s^2") + channel("z", "acc.z", "acceleration", "m/s^2")
    (run,) = compare_case(write_case(tmp_path, PENDULUM, "angle,x,z", [angle, along, radial], body)).runs
    # As above; a reading half a step early or late would miss by omega h/2 = 2.2e-3.
    assert max(m.nrmse for m in run.misfits) < 1e-3


def free(start, samples):
    """Return the two masses' free motion at 200 Hz, exactly."""
    step, states = expm(PERIODIC / 200), [start]
    while len(states) < samples:
        states.append(step @ states[-1])
    return np.array(states)


@pytest.mark.parametrize("law_hz", [100.0, 50.0, 200.0])
def test_a_static_gain_law_in_the_loop_is_exact_for_a_linear_model(tmp_path, law_hz):
    gain, start, sample = 6.0, np.array([0.01, -0.004, 0.1, 0.0]), 0.01
    state, step = start, 1.0 / max(law_hz, 100.0)
    block = expm(np.block([[PERIODIC, np.array([[0.0], [0.0], [1.0], [0.0]])], [np.zeros((1, 5))]]) * step)
    rows, command = [], 0.0
    for k in range(round(3.0 / step)):
        if k % round(1 / law_hz / step) == 0:
            command = -gain * state[2]
        if k % round(sample / step) == 0:
            rows.append([state[1], state[2], command])
        state = block[:4, :4] @ state + block[:4, 4] * command
    laser, pickup, force = np.array(rows).T
    body = "rate_hz = 100.0\n" + channel("x", "laser", "displacement", "mm") + channel("v", "pickup", "velocity", "m/s")
    body += channel("u", "coil", "force", "N")
    body += (
        f'[recording.controller]\nsensors = ["pickup"]\nactuators = ["coil"]\ngains = [[{gain}]]\nrate_hz = {law_hz}\n'
    )
    folder = write_case(tmp_path, CART, "x,v,u", [1e3 * laser, pickup, force], body)
    case = load_case(folder)
    (run,) = case.runs()
    known = InitialState(qpos=start[:2], qvel=start[2:], how="known")
    # Semi-implicit steps: phase error omega T (omega h)^2/24 = 30 rad/s x 3 s x (0.006)^2/24 = 1.4e-4. A law one sample
    # early or late misses by 10 % and more.
    for initial in (known, None) if law_hz <= 100.0 else (known,):  # what a faster law did between samples is not known
        simulated = simulate(case.plant, run, initial=initial).recording
        assert max(misfit(run.measured, simulated, name).nrmse for name in run.measured.names) < 1e-3


def test_the_initial_state_of_a_free_decay_is_found_exactly(tmp_path):
    start = np.array([0.02, -0.01, 0.3, 0.5])
    states = free(start, 400)
    body = "rate_hz = 200.0\n" + channel("x", "laser", "displacement", "m")
    run = load_case(write_case(tmp_path, CART, "x", [states[:, 1]], body)).runs()[0]
    plant = load_case(tmp_path).plant
    initial = simulate(plant, run).initial
    # One sensor on one of two masses: both modes are found. Exact but for the steps, (omega h)^2/24 = 2e-6 of the phase
    # of 25 rad in the window.
    np.testing.assert_allclose(initial.qpos, start[:2], atol=2e-5)
    np.testing.assert_allclose(initial.qvel, start[2:], atol=5e-4)
    assert len(initial.modes_hz) == 2
    assert initial.nrmse < 1e-4


def test_a_recording_that_counts_from_rest_is_compared_from_rest(tmp_path):
    states = free(np.array([0.02, -0.01, 0.3, 0.5]), 200)
    misfits = []
    for more in ("from_rest = true", ""):
        body = "rate_hz = 200.0\n" + channel("x", "two.x", "displacement", "m", more)
        folder = write_case(tmp_path, CART, "x", [states[:, 1]], body)
        misfits.append(compare_case(folder).runs[0].misfits[0])
    assert misfits[0].nrmse < 1e-3  # steps as above
    assert misfits[1].nrmse > 1.0  # the site stands 0.5 m from the origin, and no state of the springs explains that


def test_a_driven_recording_starts_at_rest_unless_it_moves(tmp_path):
    t = np.arange(300) / 100
    force = np.sin(2 * np.pi * 1.5 * t)
    block = expm(np.block([[PERIODIC, np.array([[0.0], [0.0], [1.0], [0.0]])], [np.zeros((1, 5))]]) * 0.01)
    for start, how in ((np.zeros(4), "rest"), (np.array([0.0, 0.02, 0.0, 0.0]), "estimated")):
        state, rows = start, []
        for u in force:
            rows.append(state[1])
            state = block[:4, :4] @ state + block[:4, 4] * u
        body = "rate_hz = 100.0\n" + channel("u", "coil", "command", "N", "input = true")
        folder = write_case(tmp_path, CART, "u,x", [force, rows], body + channel("x", "laser", "displacement", "m"))
        (run,) = compare_case(folder).runs
        assert run.simulation.initial.how == how
        assert run.misfits[0].nrmse < 2e-3  # held inputs are exact, the steps as in the law's test


def test_a_force_on_a_port_acts_as_an_actuator_there_would(tmp_path):
    t = np.arange(300) / 100
    force = np.sin(2 * np.pi * 1.5 * t)
    given = []
    for at in ("coil", "joint:x1", "site:one.x"):
        body = 'rate_hz = 100.0\ninitial = "rest"\n' + channel("u", at, "force", "N", "input = true")
        folder = write_case(tmp_path, CART, "u,x", [force, t], body + channel("x", "joint:x2", "displacement", "m"))
        given.append(simulate(load_case(folder).plant, load_case(folder).runs()[0]).recording["joint:x2"])
    for other in given[1:]:
        np.testing.assert_allclose(other, given[0], atol=1e-12)  # the same force by another way: rounding


@pytest.mark.slow
@pytest.mark.parametrize("held", [False, True])
def test_an_acceleration_holds_the_force_on_a_port_that_acts_at_its_sample(tmp_path, held):
    t = np.arange(300) / 100
    force = np.sin(2 * np.pi * 8.0 * t) + 0.3
    given = []
    for at in ("coil", "joint:x1", "site:one.x"):
        more = 'input = true\nhold = "zero"' if held else 'input = true\nhold = "linear"'
        body = 'rate_hz = 100.0\ninitial = "rest"\n' + channel("u", at, "force", "N", more)
        body += channel("a", "joint:x1", "acceleration", "m/s^2", 'name = "acc"')
        case = load_case(write_case(tmp_path, CART, "u,a", [force, t], body))
        given.append(simulate(case.plant, case.runs()[0]).recording["acc"])
    for other in given[1:]:
        np.testing.assert_allclose(other, given[0], atol=1e-10)  # the same force by another way: rounding
    assert given[1][0] == pytest.approx(0.0 if held else 0.3)  # F/m at rest; a held command stands from its sample on


def test_a_dead_channel_is_named_and_the_others_are_compared(tmp_path):
    states = free(np.array([0.02, -0.01, 0.3, 0.5]), 200)
    body = (
        "rate_hz = 200.0\n" + channel("x", "laser", "displacement", "m") + channel("dead", "pickup", "velocity", "m/s")
    )
    folder = write_case(tmp_path, CART, "x,dead", [states[:, 1], np.zeros(200)], body)
    (run,) = compare_case(folder).runs
    assert run.constant == ("pickup",)
    assert [m.channel for m in run.misfits] == ["laser"]


def test_an_unstable_loop_is_an_error_and_no_result(tmp_path):
    body = 'rate_hz = 100.0\ninitial = "estimated"\n' + channel("x", "laser", "displacement", "m")
    body += '[recording.controller]\nsensors = ["pickup"]\nactuators = ["coil"]\ngains = [[-1e5]]\nrate_hz = 100.0\n'
    folder = write_case(tmp_path, CART, "x", [np.cos(20 * np.arange(300) / 100)], body)
    with pytest.raises(Diverged):
        compare_case(folder)


FALLING = PENDULUM.replace('<joint name="hinge" axis="0 1 0" damping="0.05"/>', '<joint name="hinge" type="slide"/>')


def test_without_a_linearisation_the_initial_state_must_be_said(tmp_path):
    body = "rate_hz = 100.0\n" + channel("a", "acc.z", "acceleration", "m/s^2")
    folder = write_case(tmp_path, FALLING, "a", [1 + np.arange(300) / 100], body)
    with pytest.raises(BadCase, match='say initial = "rest"'):
        compare_case(folder)


@pytest.mark.slow
def test_a_measured_joint_says_the_start_without_a_linearisation(tmp_path):
    time = np.arange(100) / 100
    body = "rate_hz = 100.0\n" + channel("x", "encoder", "displacement", "m")
    folder = write_case(tmp_path, FALLING, "x", [1 + 2 * time - 0.5 * 9.81 * time**2], body)
    (run,) = compare_case(folder).runs
    # started from the first samples, and a parabola is what both integrate exactly
    np.testing.assert_allclose(run.simulation.initial.qpos, [1.0], atol=1e-6)
    np.testing.assert_allclose(run.simulation.initial.qvel, [2.0], atol=1e-5)


def test_a_run_of_too_many_steps_is_refused_before_it_starts(tmp_path):
    body = 'rate_hz = 0.001\ninitial = "rest"\n' + channel("x", "laser", "displacement", "m")
    folder = write_case(tmp_path, CART, "x", [np.arange(300.0)], body)
    with pytest.raises(BadCase, match="steps; at most"):
        compare_case(folder)


def test_samples_that_are_too_far_apart_for_their_model_are_refused_before_they_are_simulated(tmp_path):
    time = np.append(np.arange(20) / 100.0, 1e5)  # one stamp in another unit
    body = 'time = "t"\n' + channel("y", "encoder", "angle", "rad")
    write_case(tmp_path, PENDULUM, "t,y", [time, np.sin(np.arange(21))], body)
    with pytest.raises(BadCase, match="5e\\+03 s apart on average.*is the time in seconds"):
        compare_case(tmp_path)


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1e30, "reaches 1e\\+30 rad.*at most 1e\\+10"), (1e-200, "moves by .*e-200 rad; at least 1e-77")],
)
def test_samples_that_no_simulation_can_have_are_refused(tmp_path, factor, said):
    time = np.arange(50) / 100.0
    body = "rate_hz = 100\n" + channel("y", "encoder", "angle", "rad")
    write_case(tmp_path, PENDULUM, "y,z", [factor * np.cos(9 * time), time], body)
    with pytest.raises(BadRecording, match=f"run.csv: 'encoder' {said}"):
        compare_case(tmp_path)
    with pytest.raises(BadRecording, match=f"run.csv: 'encoder' {said}"):
        diagnose(load_case(tmp_path))


def test_a_comparison_tells_how_far_it_is(tmp_path):
    body = "rate_hz = 100\n" + channel("y", "encoder", "angle", "rad")
    write_case(tmp_path, PENDULUM, "y,z", [np.cos(np.arange(900) / 9.0)] * 2, body)
    shares = []
    compare_case(tmp_path, progress=lambda share, what: shares.append(share))
    assert shares == sorted(shares)
    assert len(shares) > 10  # every 500 of 9000 steps
    assert shares[-1] == pytest.approx(1.0)


def test_the_exponentials_are_those_of_scipy():
    matrices = np.random.default_rng(4).normal(size=(5, 6, 6)) * np.array([1e-6, 0.1, 1, 5, 20])[:, None, None]
    for ours, matrix in zip(exponentials(matrices), matrices, strict=True):
        exact = expm(matrix)
        np.testing.assert_allclose(
            ours, exact, atol=1e-12 * np.abs(exact).max()
        )  # squaring nine times loses 2^9 roundings


def test_the_means_of_a_staircase_keep_its_integral():
    rng = np.random.default_rng(2)
    time, values, edges = np.cumsum(rng.uniform(0.1, 1, 50)), rng.normal(size=50), np.linspace(0, 30, 400)
    time -= time[0]
    means = held_means(time, values, edges)
    fine = np.linspace(0, 30, 400_001)
    staircase = values[np.searchsorted(time, fine, side="right") - 1]
    # the right-hand sum on the fine grid is off by one cell a jump
    assert means.sum() * (edges[1] - edges[0]) == pytest.approx(
        np.sum(staircase[:-1]) * (fine[1] - fine[0]), abs=50 * 8e-5 * 3
    )


@pytest.mark.parametrize(("rate", "steps", "step"), [(100.0, 50, 2e-4), (3000.0, 2, 1 / 6000), (20000.0, 1, 5e-5)])
def test_the_integration_step_is_shortened_to_fit_the_samples(tmp_path, rate, steps, step):
    body = f"rate_hz = {rate}\n" + channel("x", "laser", "displacement", "m")
    case = load_case(write_case(tmp_path, CART, "x", [np.arange(50.0)], body))
    clock = plan_clock(case.plant.timestep, case.runs()[0])
    assert (clock.steps, clock.on_time) == (steps, True)
    assert clock.timestep == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize("controlled", [False, True])
def test_an_experiment_of_the_laboratory_is_reproduced_by_its_own_structure(tmp_path, controlled):
    plant = build_plant(load_structure("beam"))
    coils, gains = ["base", "20in"], [[3.0, 0.0], [0.0, 5.0]]
    law = DirectRateFeedback(gains, sensors=coils, actuators=coils) if controlled else None
    experiment = Experiment(plant=plant, seconds=1.0, excitation=Multisine(level=0.05), excite="base", controller=law)
    write_recording(run_experiment(experiment).recording, tmp_path / "run.parquet")
    text = '[model]\nstructure = "beam"\n[[recording]]\nfile = "run.parquet"\nrole = "fit"\ntime = "time"\n'
    text += channel("excitation:base", "base", "excitation", "N", "input = true")
    text += channel("sensor:20in", "20in", "velocity", "m/s")
    if controlled:
        text += f"[recording.controller]\nsensors = {coils}\nactuators = {coils}\ngains = {gains}\n"
        text += 'gains_unit = "N s/m"\nrate_hz = 2000.0\n'
    (tmp_path / "case.toml").write_text(text)
    (run,) = compare_case(tmp_path).runs
    # The excitation is known at its samples only: linear interpolation at 60 Hz and 2 kHz is off by (omega T)^2/8 = 0.4 %.
    assert run.misfits[0].nrmse < 4e-3


@pytest.mark.parametrize(("upright", "begins"), [(False, True), (True, False)])
def test_what_is_unstable_begins_at_rest_only_where_it_stands_still(tmp_path, upright, begins):
    """A sixtieth of the largest angle is nothing to a hanging pendulum; an upright one has fallen from there."""
    length = 0.5 if upright else -0.5
    (tmp_path / "rig.xml").write_text(
        '<mujoco><worldbody><body><joint name="pivot" type="hinge" axis="0 1 0"/>'
        f'<geom size="0.05" pos="0 0 {length}" mass="1"/></body></worldbody>'
        '<actuator><motor name="drive" joint="pivot"/></actuator></mujoco>'
    )
    plant = build_mjcf("rig.xml", folder=tmp_path)
    angle = np.array([[0.05], [0.1], [3.0]])
    assert begins_at_rest(angle, np.array([True]), plant) == begins
    assert begins_at_rest(np.array([[0.0], [0.1], [3.0]]), np.array([True]), plant)


def test_the_effort_of_a_servo_that_held_before_the_record_is_right_from_the_first_reading(tmp_path):
    """A held link: the servo's moment balances gravity, and its command stood before the first sample."""
    model = (
        '<mujoco><option timestep="0.001"/><worldbody><body><joint name="arm" axis="0 1 0" damping="0.2"/>'
        '<inertial pos="0.5 0 0" mass="1" diaginertia="0.01 0.01 0.01"/></body></worldbody>'
        '<actuator><position name="servo" joint="arm" kp="80" kv="4" forcerange="-12 12"/></actuator>'
        '<sensor><actuatorfrc name="effort" actuator="servo"/></sensor></mujoco>'
    )
    time, hold = np.arange(200) / 100.0, 0.4
    angle = 0.3  # where the servo's moment is that of gravity
    for _ in range(50):
        angle = hold + 9.81 * 0.5 * np.cos(angle) / 80
    moment = np.full(time.size, 80 * (hold - angle))
    body = (
        "rate_hz = 100\n"
        + channel("u", "servo", "command", "rad", 'input = true\nhold = "zero"')
        + channel("q", "joint:arm", "angle", "rad")
        + channel("m", "effort", "moment", "N m")
    )
    folder = write_case(tmp_path, model, "u,q,m", [np.full(time.size, hold), np.full(time.size, angle), moment], body)
    case = load_case(folder)
    (run,) = case.runs(("fit",))
    found = simulate(case.plant, run)
    assert found.initial.how == "estimated"
    np.testing.assert_allclose(
        found.recording["effort"], moment, rtol=1e-3
    )  # the force limit would show at the first reading
    np.testing.assert_allclose(found.recording["joint:arm"], angle, atol=1e-5)
