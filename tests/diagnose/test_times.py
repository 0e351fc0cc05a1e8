"""Delays, lags, holds and velocity limits are found in seconds and in the unit of the command."""

import mujoco
import numpy as np
import pytest
from rig_times import CASES, RATE, SERVO, commands, matrices, motion, times_case
from scipy.signal import cont2discrete

from vlab.cases.case import load_case
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.trial_scan import Scales, best_values, between_values, scan_values
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.limited_actuator import limited_actuator
from vlab.diagnose.predictors.scope import linear_problem
from vlab.diagnose.settings import TRIAL_SCAN
from vlab.physics.catalogue import EFFECTS
from vlab.physics.filters import delay_line, delayed
from vlab.plants.mjcf import build_mjcf

DELAYS = [name for name in CASES if name.startswith("delay")]


def parameter(name):
    return EFFECTS[name].parameters[0]


# ---- the rig ----------------------------------------------------------------------------------------------------------


def test_the_rig_moves_as_scipy_discretises_it():
    """A delay of whole samples is a shift, and the motion without one is that of scipy's zero-order hold."""
    u = commands(np.random.default_rng(1), "none")[:800]
    A, B = matrices()
    Ad, Bd, *_ = cont2discrete((A, B[:, None], np.eye(4), np.zeros((4, 1))), 1 / RATE)
    x, expected = np.zeros(4), np.zeros((len(u), 4))
    for k in range(len(u)):
        expected[k] = x
        x = Ad @ x + Bd[:, 0] * u[k]
    np.testing.assert_allclose(motion(u), expected, atol=1e-12)
    np.testing.assert_allclose(motion(u, 30 / RATE)[30:], motion(u)[:-30], atol=1e-12)


# ---- trial values -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["actuator-delay", "sensor-delay"])
@pytest.mark.parametrize("step", [1e-4, 2e-3, 1e-2])
def test_trial_delays_reach_a_quarter_of_a_second_at_any_step(name, step):
    """Between 0.1 ms and 0.2 s some trial value lies within a factor of 1.8 or an eighth of a cycle."""
    highest = 12.0
    p = parameter(name)
    values = np.concatenate([p.grid, scan_values(p, Scales(step=step, duration=8.0, highest_hz=highest))])
    for delay in np.geomspace(1e-4, 0.2, 50):
        near = np.min(np.abs(values - delay)) <= 1 / (8 * highest) + 1e-12
        assert near or np.min(np.abs(np.log(values / delay))) < np.log(1.8)
    assert values.size < 30


def test_trial_periods_are_whole_samples_and_limited():
    p = parameter("actuator-hold")
    coarse = scan_values(p, Scales(step=0.01, duration=8.0, highest_hz=5.0))
    np.testing.assert_allclose(coarse, 0.01 * np.arange(2, 21))
    fine = scan_values(p, Scales(step=1e-5, duration=8.0, highest_hz=5.0))
    assert fine.size <= TRIAL_SCAN.most
    assert fine[-1] == pytest.approx(0.2)


def test_trial_slopes_reach_from_slow_targets_to_the_steepest_step():
    """A step of 0.9 rad within 1 ms has 900 rad/s; its profile velocity may be 1 rad/s."""
    p = parameter("slew-limit")
    values = scan_values(p, Scales(step=1e-3, duration=8.0, highest_hz=5.0, span=1.8, steepest=900.0))
    assert values[0] == pytest.approx(1.8 / 8.0)
    assert np.all(values[1:] / values[:-1] <= TRIAL_SCAN.ratio + 1e-12)
    assert values[-1] * TRIAL_SCAN.ratio >= 900.0
    assert scan_values(p, Scales(step=1e-3, duration=8.0, highest_hz=5.0)).size == 0  # no command


def test_trial_resonances_reach_over_the_recorded_band():
    """From one period in a recording to the highest frequency, no resonance is further off than half a bandwidth."""
    p = next(p for p in EFFECTS["attached-oscillator"].parameters if p.scan == "resonance")
    values = scan_values(p, Scales(step=1e-3, duration=8.0, highest_hz=25.0))
    assert (values[0], values[-1]) == pytest.approx((1.0 / 8.0, 25.0))
    assert np.all(values[1:] / values[:-1] <= 1.0 + 2.0 * TRIAL_SCAN.damping_ratio + 1e-12)
    assert len(scan_values(p, Scales(step=1e-3, duration=0.01, highest_hz=25.0))) == 1  # no period fits


@pytest.mark.parametrize("command", [np.linspace(-1, 1, 4001), np.sin(np.linspace(0, 60, 4001))], ids=["ramp", "sine"])
def test_some_trial_step_rounds_like_any_true_step(command):
    """Trials are close to any step from a hundredth to half of the command. The grid has a step of half the command."""
    effect = EFFECTS["actuator-quantisation"]
    (parameter,), scales = effect.parameters, Scales(step=1e-3, duration=8.0, highest_hz=5.0, largest=1.0)
    trials = scan_values(parameter, scales)

    def error(step):
        return command - effect.actuate(command, {"step": step}, 1e-3)

    errors = [error(step) for step in trials]
    for step in np.geomspace(0.011, 0.5, 40):
        true = error(step)
        alike = [np.corrcoef(true, e)[0, 1] for e in errors]
        assert max(alike) > 0.4  # an eighth of a cycle off at the largest command, where a sine dwells
        finer = between_values(parameter, trials[np.argsort(alike)[-TRIAL_SCAN.kept :]].tolist(), scales)
        assert max(np.corrcoef(true, error(s))[0, 1] for s in finer) > 0.7


def test_a_scan_keeps_the_largest_peaks_and_few_columns():
    sizes = []

    def gains(values):
        sizes.append(len(values))
        return [np.cos(12.0 * v) * np.exp(-v) for v in values]

    values = np.linspace(0.01, 6.0, 500)
    found = best_values(values, gains)
    expected = [2 * np.pi * k / 12.0 for k in (1, 2)]
    assert found[0] == pytest.approx(values[0])
    np.testing.assert_allclose(found[1:], expected, atol=0.02)
    assert max(sizes) <= TRIAL_SCAN.columns
    assert best_values(np.zeros(0), gains) == []


# ---- commands before a recording ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("actuator-delay", {"delay": 0.0233}),
        ("actuator-lag", {"time_constant": 0.03}),
        ("actuator-hold", {"period": 0.012}),
        ("slew-limit", {"slope": 3.0}),
        ("rate-limit", {"slope": 3.0}),
        ("actuator-jitter", {"jitter": 0.004}),
    ],
)
def test_a_command_that_stood_before_is_no_step(name, values):
    """What follows a standing command is that command and what follows its changes, all at once or step by step."""
    effect, h, stood = EFFECTS[name], 1e-3, 0.7
    u = stood + np.concatenate([np.zeros(50), 0.3 * np.random.default_rng(2).standard_normal(200)])
    acting = effect.follow(u, values, h, stood)
    np.testing.assert_allclose(acting[:50], stood, atol=1e-12)
    np.testing.assert_allclose(acting - stood, effect.actuate(u - stood, values, h), atol=1e-12)
    step = effect.follower(values, h, stood)
    np.testing.assert_allclose([step(x) for x in u.tolist()], acting, atol=1e-9)


def test_a_long_delay_at_small_steps_takes_one_number_a_step():
    h, delay = 1e-5, 0.2
    step = delay_line(delay, h)
    impulse = [step(1.0)] + [step(0.0) for _ in range(20_010)]
    assert int(np.argmax(impulse)) == 20_000
    assert sum(impulse) == pytest.approx(1.0)
    x = np.random.default_rng(3).standard_normal(25_000)
    np.testing.assert_allclose(delayed(x, delay, h)[20_000:], x[:5000], atol=1e-6)


# ---- limited actuators ----------------------------------------------------------------------------------------------------


def test_the_force_of_a_limited_servo_is_that_of_mujoco(tmp_path):
    """Commands inside, at and beyond the limits, against MuJoCo's own actuator forces."""
    (tmp_path / "arm.xml").write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1"/>'
        '<body pos="0 0 0.3"><joint name="b" axis="0 1 0"/><geom size="0.1"/></body></body></worldbody>'
        '<actuator><position name="servo" joint="b" kp="12" kv="0.4" gear="2" forcerange="-3 3" ctrlrange="-1 1" ctrllimited="true"/>'
        '<motor name="free" joint="a"/></actuator></mujoco>'
    )
    plant, rng = build_mjcf(tmp_path / "arm.xml"), np.random.default_rng(4)
    q, v = 0.3 * rng.standard_normal((40, 2)), rng.standard_normal((40, 2))
    u, change = rng.standard_normal(40), rng.standard_normal((40, 3))
    found = limited_actuator(plant, 0, q, v)
    assert found is not None
    data = mujoco.MjData(plant.model)

    def force(k, command):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q[k], v[k], [command, 0.0]
        mujoco.mj_forward(plant.model, data)
        return data.qfrc_actuator.copy()

    expected = [[force(k, u[k] + c) - force(k, u[k]) for c in change[k]] for k in range(40)]
    forces = found.moment[:, :, None] * found.change(u, change)[:, None, :]
    np.testing.assert_allclose(forces, np.swapaxes(expected, 1, 2), atol=1e-9)
    assert limited_actuator(plant, 1, q, v) is None  # without limits the derivative is exact


# ---- screening and diagnosis ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [*DELAYS, "late reading"])
def test_the_screening_starts_near_a_delay(tmp_path, name):
    """The linear prediction alone puts a delay within an eighth of a cycle of 10 Hz, without a fit."""
    times_case(tmp_path, name)
    problem, hidden = linear_problem(load_case(tmp_path)), CASES[name]
    assert problem is not None
    screen = ScoreTest(problem)
    found = screen.zoomed(screen.candidates([EFFECTS[hidden.effect]])[0])
    assert found.place.name == hidden.place
    assert found.values["delay"] == pytest.approx(
        hidden.values["delay"], rel=0.2, abs=1 / 80 if name != "delay 0.3 ms" else 1e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CASES if name != "none"])
def test_what_is_late_held_or_slow_is_named(tmp_path, name):
    times_case(tmp_path, name)
    diagnosis, hidden = diagnose(load_case(tmp_path)).diagnosis, CASES[name]
    assert diagnosis.verdict == "missing-physics"
    finding = diagnosis.findings[0]
    assert {finding.effect, finding.form} & set(hidden.right)
    assert finding.place == hidden.place
    (value,) = finding.parameters.values()
    assert value["value"] == pytest.approx(next(iter(hidden.values.values())), rel=hidden.tolerance)
    if hidden.effect == "actuator-delay":
        assert SERVO in finding.places_90
        assert "actuator-hold" not in finding.alike


@pytest.mark.slow
def test_nothing_late_is_nothing_missing(tmp_path):
    times_case(tmp_path, "none")
    assert diagnose(load_case(tmp_path)).diagnosis.verdict == "nothing-missing"
