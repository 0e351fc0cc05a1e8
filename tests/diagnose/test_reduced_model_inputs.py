"""The linear twin's inputs against MuJoCo's runs: limits of actuators, servos, coarse models, readings that show inputs at once."""

from dataclasses import replace

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from test_reduced_model import integrated

from vlab.cases import load_case, simulate
from vlab.cases.initial_state import find_initial_state
from vlab.diagnose.data.runs import windows
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.mjcf import Uncertain, adjusted
from vlab.diagnose.parameters.observation import command_feedthrough
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal import _inputs
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.predictors.scope import linear_problem
from vlab.errors import BadStructure
from vlab.physics.catalogue import EFFECTS
from vlab.plants.mjcf import build_mjcf

RIG = """<mujoco><option timestep="{step}" integrator="{integrator}" gravity="0 0 0"/><worldbody>
<body name="a"><joint name="a" type="slide" axis="1 0 0" stiffness="900" damping="3"/><geom size="0.1" mass="1"/><site name="a"/></body>
<body name="b" pos="1 0 0"><joint name="b" type="slide" axis="1 0 0" stiffness="400" damping="2"/><geom size="0.1" mass="0.5"/></body>
</worldbody>
<tendon><fixed name="spring" stiffness="300"><joint joint="a" coef="-1"/><joint joint="b" coef="1"/></fixed></tendon>
<actuator>{actuator}</actuator>
<sensor><jointpos name="x" joint="b"/><jointvel name="v" joint="a"/><accelerometer name="acc" site="a"/>
<jointactuatorfrc name="torque" joint="a"/></sensor>
</mujoco>"""
MOTOR = '<motor name="drive" joint="a"/>'
ENCODER, VELOCITY = ("x", "displacement", "m"), ("v", "velocity", "m/s")
RATE, SECONDS = 500.0, 3.0


def recorded(
    folder,
    *,
    actuator=MOTOR,
    at="drive",
    kind="force",
    reads=(ENCODER,),
    hold="zero",
    rms=4.0,
    step=0.0005,
    euler=False,
):
    """Return a case whose only recording is MuJoCo's own simulation of the model."""
    t = np.arange(round(RATE * SECONDS)) / RATE
    columns = {"u": multisine(np.random.default_rng(1), 0.5, 20.0, SECONDS, rms)(t)}
    channels = [Channel(column="u", at=at, kind=kind, unit="N" if kind == "force" else "1", is_input=True, hold=hold)]
    channels += [Channel(column=name, at=name, kind=kind, unit=unit) for name, kind, unit in reads]
    columns |= {name: np.sin(t) for name, _, _ in reads}
    mjcf = RIG.format(actuator=actuator, step=step, integrator="Euler" if euler else "RK4")

    def write():
        record = Record(name="run", role="fit", columns=columns, rate_hz=RATE)
        write_case(folder, title="", mjcf=mjcf, uncertain={"stiffness": 0.02}, channels=channels, records=[record])
        return load_case(folder)

    case = write()
    exact = simulate(case.plant, case.runs()[0]).recording
    columns |= {name: exact[name] for name, _, _ in reads}
    return write()


def reduced_model_error(case):
    """Return the largest error of the twin over channels, relative to the recording's rms."""
    problem = prepare(case)
    (signals,) = problem.signals
    assert signals.h == pytest.approx(1 / RATE)
    return float(np.max(np.sqrt(np.mean((integrated(problem, signals) - signals.y) ** 2, axis=0)) / signals.scale))


# The twin is exact for held inputs. Between samples of a smooth one it holds the mean: (2 pi 20 Hz 2 ms)^2/24 = .3 % of its
# fastest part; its acceleration shows that as much as the force itself.
@pytest.mark.parametrize(("hold", "tolerance"), [("zero", 1e-6), ("linear", 4e-3)])
@pytest.mark.parametrize("at", ["drive", "joint:a", "site:a.x"])
def test_an_acceleration_shows_the_input_of_its_own_moment(tmp_path, at, hold, tolerance):
    reads = (ENCODER, ("acc.x", "acceleration", "m/s^2"))
    if at == "joint:a":
        reads = (*reads, ("joint:b", "acceleration", "m/s^2"))
    assert reduced_model_error(recorded(tmp_path, at=at, hold=hold, reads=reads)) < tolerance


def test_a_measured_force_shows_the_command(tmp_path):
    case = recorded(tmp_path, reads=(ENCODER, ("torque", "force", "N")))
    assert command_feedthrough(case.plant, case.runs()[0].compared) == pytest.approx(np.array([[0.0], [1.0]]))
    assert reduced_model_error(case) < 1e-6


def test_what_is_stiffer_than_the_search_follows_still_yields(tmp_path, monkeypatch):
    """The driven mass sits on a spring that takes it to 225 Hz, above the band: it moves as the force says, at once."""
    stiff = RIG.replace('stiffness="900" damping="3"', 'stiffness="2e6" damping="200"')
    monkeypatch.setattr(
        "test_reduced_model_inputs.RIG", stiff.replace("<sensor>", '<sensor><jointpos name="base" joint="a"/>')
    )
    case = recorded(tmp_path, hold="linear", reads=(("base", "displacement", "m"), ENCODER))
    assert prepare(case).reduced_model.m == 1
    # at 20 Hz its damper holds it back by c w/k = 1.3 %, its inertia lifts it by (w/w0)^2 = .8 %, and it rings a little where the
    # slope of the force changes; without what yields all of it would be missing
    assert reduced_model_error(case) < 0.03


@pytest.mark.parametrize(
    "limits",
    [
        'ctrllimited="true" ctrlrange="-3 2"',
        'ctrllimited="true" ctrlrange="0 255"',
        'forcelimited="true" forcerange="-2 5"',
    ],
)
def test_the_model_s_own_limits_are_no_missing_physics(tmp_path, limits):
    case = recorded(tmp_path, actuator=f'<motor name="drive" joint="a" {limits}/>', reads=(ENCODER, VELOCITY))
    assert case.plant.actuator_forces()[:, 0] == pytest.approx([1.0, 0.0])
    assert reduced_model_error(case) < 1e-6


SERVO = '<position name="drive" joint="a" kp="500" kv="2" forcelimited="true" forcerange="-50 50"/>'


def test_a_servo_s_gain_is_what_its_command_is_worth(tmp_path):
    case = recorded(tmp_path, actuator=SERVO, kind="command", rms=0.01, reads=(ENCODER, VELOCITY))
    assert case.plant.actuator_forces()[:, 0] == pytest.approx([500.0, 0.0])
    assert reduced_model_error(case) < 1e-6
    before, after = (
        case.plant,
        adjusted(case.plant, [Uncertain(name="", kind="gain", sd=1.0, actuator=0)], np.array([0.1])),
    )
    np.testing.assert_array_equal(before.linearise().K, after.linearise().K)
    assert after.actuator_forces()[0, 0] == pytest.approx(500.0 * np.exp(0.1))


def test_a_coarse_model_is_seen_at_the_step_that_it_is_simulated_with(tmp_path):
    """10 ms would raise the second frequency by 1.7 %; recordings at 500 Hz are simulated at 2 ms."""
    # what is left is the phase of forces that change every step, as in `test_reduced_model`
    assert reduced_model_error(recorded(tmp_path, step=0.01, euler=True, reads=(ENCODER, VELOCITY))) < 4e-3


def test_an_actuator_with_a_state_of_its_own_goes_along_the_motion(tmp_path):
    filtered = '<general name="drive" joint="a" dyntype="filter" dynprm="0.02" gainprm="1"/>'
    assert linear_problem(recorded(tmp_path, actuator=filtered, kind="command")) is None


def test_an_actuator_of_several_inputs_is_refused_in_one_line(tmp_path):
    (tmp_path / "rig.xml").write_text(
        RIG.format(actuator='<pid name="drive" joint="a" kp="3"/>', step=0.001, integrator="Euler")
    )
    with pytest.raises(BadStructure, match="'drive' takes 2 inputs"):
        build_mjcf("rig.xml", folder=tmp_path)


@pytest.mark.parametrize("hold", ["zero", "linear"])
def test_a_start_is_estimated_from_accelerations_under_way(tmp_path, hold):
    """Recorded from the middle of a run: the state at the first sample follows from accelerations and the command alone."""
    reads = (("acc.x", "acceleration", "m/s^2"), ("joint:b", "acceleration", "m/s^2"))
    case = recorded(tmp_path, hold=hold, reads=reads)
    (whole,) = case.runs()
    cut = replace(
        whole.measured, time=whole.measured.time[400:] - whole.measured.time[400], data=whole.measured.data[400:]
    )
    found = find_initial_state(case.plant, replace(whole, measured=cut, initial="auto"))
    assert found.how == "estimated"
    # the command before the first sample is not known: one reading of some hundreds is off
    assert found.nrmse < 0.1


@pytest.mark.parametrize("name", ["actuator-lag", "actuator-delay"])
def test_what_comes_out_late_in_a_window_was_commanded_before_it(tmp_path, name):
    """Windows of a run, put together again, are the run: a lag of ten samples does not begin anew in each."""
    case = recorded(tmp_path, reads=(ENCODER, VELOCITY))
    problem = prepare(case)
    place = next(p for p in problem.places if p.name == "actuator:drive")
    (parameter,) = EFFECTS[name].parameters
    late = Term(effect=EFFECTS[name], place=place, values={parameter.name: 0.02})
    values = [{parameter.name: np.array([0.02])}]
    (run,) = problem.signals
    parts = windows(run, np.zeros((len(run), 2 * problem.reduced_model.m)), run.y, 5.0)
    assert len(parts) > 2
    whole = _inputs([run], [late], values, 1, with_ends=False)[0][:, 0, 0]
    cut = np.concatenate([_inputs([part], [late], values, 1, with_ends=False)[0][: len(part), 0, 0] for part in parts])
    # what stood more than 120 samples before has decayed by e^-12
    np.testing.assert_allclose(cut, whole, atol=1e-4 * np.abs(whole).max())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sensor-high-pass", {"time_constant": 2.0}),  # longer than a window
        ("sensor-lag", {"time_constant": 0.01}),
        ("sensor-resonance", {"frequency": 40.0, "damping_ratio": 0.1}),
    ],
)
def test_a_sensor_remembers_in_a_window_what_it_has_seen_before(tmp_path, name, values):
    """Windows of a run, put together again, are the run."""
    problem = prepare(recorded(tmp_path, reads=(ENCODER, VELOCITY)))
    refiner = LeastSquares(ScoreTest(problem), problem.signals)
    place = next(p for p in problem.places if p.name.startswith("sensor:"))
    term = Term(effect=EFFECTS[name], place=place, values=values)
    own = [{k: np.array([v]) for k, v in values.items()}]
    theta = np.zeros((1, len(problem.reduced_model.prior)))
    (run,) = problem.signals
    parts = windows(run, np.zeros((len(run), 2 * problem.reduced_model.m)), run.y, 5.0)
    assert len(parts) > 2
    whole, *cut = (
        refiner._read(part.y[:, None, None].copy(), [part], [term], theta, own)[:, 0, 0] for part in (run, *parts)
    )
    np.testing.assert_allclose(np.concatenate(cut), whole, atol=1e-4 * np.abs(whole).max())


STIFF_SERVO = '<position name="drive" joint="a" kp="2e5" kv="2e3"/>'


@pytest.mark.parametrize("euler", [True, False])
def test_a_servo_damped_beyond_its_critical_damping_lags_as_in_mujoco(tmp_path, monkeypatch, euler):
    """It prescribes a motion 10 ms late (kv/kp), whatever its mass; coupled by damping alone to what is measured."""
    monkeypatch.setattr("test_reduced_model_inputs.RIG", RIG.replace('damping="3"', ""))
    case = recorded(tmp_path, actuator=STIFF_SERVO, kind="command", rms=0.01, reads=(ENCODER, VELOCITY), euler=euler)
    assert prepare(case).reduced_model.m == 2
    # steps of half a millisecond beside poles of 100 and 1900 per second: half a step's lag is left of the fast one
    assert reduced_model_error(case) < 0.03


def test_what_turns_freely_in_a_damper_is_no_servo(tmp_path, monkeypatch):
    """Two masses on a spring with dampers to ground: the mode without a spring is overdamped, and has no stiffness to keep."""
    monkeypatch.setattr(
        "test_reduced_model_inputs.RIG", RIG.replace(' stiffness="900"', "").replace(' stiffness="400"', "")
    )
    case = recorded(tmp_path, reads=(ENCODER, VELOCITY), euler=True)
    # the dampers couple the modes, which are stepped alone: 3 + 2 N s/m for half a millisecond beside 1.5 kg
    assert reduced_model_error(case) < 3e-3
