"""The 2 kHz loop in MuJoCo's control callback."""

import dataclasses
import threading

import mujoco
import numpy as np
import pytest

from vlab.benchmark.comparisons import integrate_with_scipy
from vlab.controllers import DirectRateFeedback
from vlab.errors import BadController, BadExperiment, Diverged
from vlab.hardware.sensing import coil_gain
from vlab.lab import Experiment, run_experiment
from vlab.lab.callback import control_callback
from vlab.lab.excitation import Multisine, Release
from vlab.lab.laws import published_law
from vlab.lab.prediction import predict_rate_feedback
from vlab.modal.frf import estimate_frf
from vlab.modal.poles import estimate_poles

PLACES = ("40in", "20in", "base")


def experiment(plant, **settings) -> Experiment:
    return Experiment(
        **{
            "plant": plant,
            "seconds": 1.0,
            "excitation": Multisine(level=0.2, period_s=1.0, low_hz=1.0),
            "excite": "base",
        }
        | settings
    )


class Counting:
    """A law that counts its samples and notes what it saw."""

    sensors, actuators = PLACES, PLACES

    def __init__(self) -> None:
        self.seen: list[np.ndarray] = []

    def reset(self) -> None:
        self.seen = []

    def step(self, y):
        self.seen.append(y.copy())
        return np.zeros(3)


@pytest.mark.parametrize("rate", [2000.0, 1000.0, 200.0])
def test_the_law_runs_once_a_sample_and_sees_what_is_recorded(modal, laboratory, rate):
    law = Counting()
    recording = run_experiment(experiment(modal, controller=law, hardware=laboratory.at_rate(rate))).recording
    assert len(law.seen) == len(recording) == rate
    assert np.array_equal(law.seen, np.column_stack([recording[f"sensor:{p}"] for p in PLACES]))


def test_repeated_calls_within_a_step_change_nothing(modal, laboratory):
    # Runge-Kutta calls the callback four times a step: the clock gates it
    law = Counting()
    model = mujoco.MjModel.__copy__(modal.model)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    run_experiment(experiment(dataclasses.replace(modal, model=model), controller=law))
    assert len(law.seen) == 2000


def test_same_seed_same_bits(composite, beam, laboratory):
    hardware = dataclasses.replace(
        laboratory, velocity_sensor=dataclasses.replace(laboratory.velocity_sensor, noise=1e-4)
    )
    runs = [
        run_experiment(
            experiment(composite, controller=published_law(beam, "mfdrf"), hardware=hardware, seed=5)
        ).recording
        for _ in range(2)
    ]
    assert np.array_equal(runs[0].data, runs[1].data)
    other = run_experiment(
        experiment(composite, controller=published_law(beam, "mfdrf"), hardware=hardware, seed=6)
    ).recording
    assert not np.array_equal(runs[0].data, other.data)


def test_threads_side_by_side_share_nothing(composite, modal, beam):
    tasks = [
        experiment(
            plant,
            controller=published_law(beam, law) if law else None,
            excitation=Multisine(level=0.2, period_s=1.0, low_hz=1.0, seed=seed),
        )
        for plant, law, seed in (
            (composite, "mfdrf", 1),
            (composite, "lqdrf", 2),
            (modal, "mfdrf", 3),
            (composite, None, 4),
        )
    ]
    alone = [run_experiment(task).recording.data for task in tasks]
    together: list[np.ndarray | None] = [None] * len(tasks)

    def work(i: int) -> None:
        together[i] = run_experiment(tasks[i]).recording.data

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(tasks))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one, other)
    assert mujoco.get_mjcb_control() is None


def test_a_foreign_callback_is_not_overwritten(modal):
    def foreign(model, data):
        pass

    mujoco.set_mjcb_control(foreign)
    try:
        with pytest.raises(BadExperiment, match="another mjcb_control"):
            run_experiment(experiment(modal))
        assert mujoco.get_mjcb_control() is foreign
    finally:
        mujoco.set_mjcb_control(None)


def test_the_callback_is_gone_after_an_error(modal):
    data = modal.new_data()
    with pytest.raises(ZeroDivisionError), control_callback(data, lambda m, d: None):
        raise ZeroDivisionError
    assert mujoco.get_mjcb_control() is None


def test_mujoco_and_scipy_run_the_same_loop(modal, beam, fe, laboratory):
    # an independent integrator on the FE state space, the same law object and hardware: below 30 Hz, where twelve modes hold
    law, excitation = published_law(beam, "mfdrf"), Multisine(level=0.2, period_s=1.0, low_hz=1.0, high_hz=30.0)
    theirs = integrate_with_scipy(fe, laboratory, law, excitation, seconds=0.5)
    ours = run_experiment(experiment(modal, seconds=0.5, controller=law, excitation=excitation)).recording
    ours = np.column_stack([ours[f"sensor:{p}"] for p in PLACES])
    assert (
        np.abs(ours - theirs).max() < 0.03 * np.abs(theirs).max()
    )  # the start of the signal excites the modes above the twelfth


@pytest.mark.slow
@pytest.mark.parametrize(("plant_name", "tolerance"), [("modal", 2e-3), ("composite", 0.03)])
def test_closed_loop_damping_is_that_of_the_discrete_prediction(request, beam, fe, laboratory, plant_name, tolerance):
    # asked for: 3 % (relative, six modes); the modal plant carries the FE model's own modes and must do far better
    plant, law = request.getfixturevalue(plant_name), published_law(beam, "mfdrf")
    # ten seconds to settle: of the slowest mode, 0.9 1/s, exp(-9) of the transient is left in the periods that are averaged
    excitation = Multisine(level=0.2, period_s=10.0, low_hz=0.3, high_hz=30.0, seed=1)
    recording = run_experiment(experiment(plant, seconds=30.0, excitation=excitation, controller=law)).recording
    frf = estimate_frf(recording, outputs=[f"sensor:{p}" for p in PLACES], period_s=10.0, skip_s=10.0)
    poles = estimate_poles(frf, sample_rate=2000.0, band_hz=(0.3, 30.0), n_modes=6, orders=range(10, 31, 4))
    predicted = predict_rate_feedback(fe.linear, fe.deflections(law.sensors).T, law.gains, laboratory.converter)
    freq, zeta = predicted.modes(fe.linear.freq[:6])
    assert poles.freq == pytest.approx(freq, rel=2.5e-3)  # 0.2 % of the plant and the step
    assert poles.zeta == pytest.approx(zeta, rel=tolerance)


def test_prediction_without_delay_and_filter_is_the_continuous_loop(beam, fe, laboratory):
    # in the limit of fast sampling without delay the sampled loop is (A - B D C)
    law = published_law(beam, "mfdrf")
    fast = dataclasses.replace(laboratory.converter, rate=2e5, highest_rate=1e6, delay_samples=0.0, filter_corner=0.0)
    coils = fe.deflections(law.sensors).T
    freq, zeta = predict_rate_feedback(fe.linear, coils, law.gains, fast).modes(fe.linear.freq[:6])
    exact_freq, exact_zeta = fe.linear.with_rate_feedback(coils, law.gains).complex_modes()
    assert freq == pytest.approx(exact_freq[:6], rel=1e-3)  # half a sample of hold at 200 kHz
    assert zeta == pytest.approx(exact_zeta[:6], rel=3e-3)


def test_release_rings_down_with_the_inherent_damping(composite, beam):
    recording = run_experiment(
        experiment(composite, seconds=8.0, excitation=Release(level=0.5), excite="base")
    ).recording
    assert recording.inputs == ()
    x = recording["probe:30in"]
    assert abs(x[0]) > 1e-4
    early, late = (np.abs(x[a : a + 4000]).max() for a in (0, 12000))
    assert late < early  # it decays ...
    assert late > 0.5 * early  # ... slowly: the lightest modes have 0.1 to 0.4 %


def test_release_starts_at_the_static_deflection(modal, fe):
    recording = run_experiment(experiment(modal, seconds=0.1, excitation=Release(level=0.5), excite="base")).recording
    static = fe.deflection("30in") @ np.linalg.solve(fe.linear.K, fe.deflection("base") * 0.5)
    assert recording["probe:30in"][0] == pytest.approx(static, rel=5e-3)  # compliance of the modes above the twelfth


def test_composite_release_starts_at_its_own_static_deflection(composite):
    # force and reading both go through the smooth curve: the compliance between two ports, symmetric by Maxwell
    recording = run_experiment(
        experiment(composite, seconds=0.1, excitation=Release(level=0.1), excite="40in")
    ).recording
    rows = composite.port_rows(["40in", "30in"])
    static = rows[1] @ np.linalg.lstsq(composite.linearise().K, 0.1 * rows[0], rcond=1e-12)[0]
    assert recording["probe:30in"][0] == pytest.approx(static, rel=1e-5)  # rotations of 1e-3 rad, squared


def test_coil_sensor_loses_gain_outside_its_travel(modal, laboratory):
    travel = laboratory.velocity_sensor.linear_range
    assert coil_gain(np.array([0.0, travel / 2, travel]), travel) == pytest.approx([1.0, 1.0, 0.5])
    small, large = (
        run_experiment(experiment(modal, excitation=Release(level=level), seconds=2.0)).recording["sensor:base"]
        for level in (0.1, 10.0)
    )
    assert np.abs(large).max() < 99 * np.abs(small).max()  # a linear sensor would give 100 times as much


def test_amplifier_limit_clips_the_force(modal, beam, laboratory):
    hardware = dataclasses.replace(laboratory, coil=dataclasses.replace(laboratory.coil, limit=0.05))
    recording = run_experiment(experiment(modal, controller=published_law(beam, "mfdrf"), hardware=hardware)).recording
    assert np.abs(recording["force:base"]).max() == pytest.approx(0.05)


def test_back_emf_adds_damping_only_without_current_control(modal, laboratory):
    hardware = dataclasses.replace(laboratory, coil=dataclasses.replace(laboratory.coil, current_controlled=False))
    assert hardware.coil.back_emf_damping == pytest.approx(25.0 / 8.0)  # Bl^2/R
    controlled, braked = (
        run_experiment(experiment(modal, excitation=Release(level=0.5), seconds=5.0, hardware=h)).recording[
            "probe:30in"
        ][-2000:]
        for h in (laboratory, hardware)
    )
    assert np.abs(braked).max() < 0.7 * np.abs(controlled).max()


def test_an_unstable_loop_is_an_error_not_a_result(modal, laboratory):
    endless = dataclasses.replace(
        laboratory, velocity_sensor=dataclasses.replace(laboratory.velocity_sensor, linear_range=1e12)
    )
    anti_damper = DirectRateFeedback(-500.0 * np.eye(3), sensors=PLACES, actuators=PLACES)
    with pytest.raises(Diverged, match="unstable"):
        run_experiment(experiment(modal, controller=anti_damper, hardware=endless, seconds=20.0))


@pytest.mark.slow
def test_sensors_that_lose_gain_turn_an_unstable_loop_into_a_limit_cycle(modal):
    anti_damper = DirectRateFeedback(-500.0 * np.eye(3), sensors=PLACES, actuators=PLACES)
    x = run_experiment(experiment(modal, controller=anti_damper, seconds=20.0)).recording["probe:30in"]
    assert np.abs(x[-4000:]).max() == pytest.approx(np.abs(x[-8000:-4000]).max(), rel=0.2)  # neither grown nor gone


def test_wrong_wiring_is_refused_before_anything_runs(modal, beam):
    class TooMany(Counting):
        def step(self, y):
            return np.zeros(4)

    with pytest.raises(BadController, match="gives \\(4,\\) commands"):
        run_experiment(experiment(modal, controller=TooMany()))
    with pytest.raises(LookupError, match="unknown actuator 'bse'; did you mean"):
        run_experiment(experiment(modal, excite="bse"))


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf"), 1e9])
def test_durations_that_cannot_be_run_are_refused(modal, seconds):
    with pytest.raises(BadExperiment, match="cannot be run"):
        experiment(modal, seconds=seconds)
