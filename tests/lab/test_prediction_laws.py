"""Theory of the sampled loop under any linear law, against simulation and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from vlab.controllers.block_diagonal import block_diagonal
from vlab.controllers.catalogue import published_way

from vlab.controllers import DirectRateFeedback, LinearLaw
from vlab.errors import BadController
from vlab.fe.reduced import build_reduced_model
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Release
from vlab.lab.laws import named_law, published_law
from vlab.lab.prediction import closed_loop_response, law_response, loop_on, predict_rate_feedback, sampled_loop
from vlab.plants.modal import build_modal

PLACES = ("40in", "20in", "base")


@pytest.fixture(scope="module")
def lqg_law(beam):
    return named_law(beam, "lqg", rate=1000.0)


def stepped(loop, commands):
    """Run a loop's own discrete plant and law sample by sample, in plain loops."""
    A, B, C = loop.plant
    a, b, c, d = loop.law
    z, x, y = np.zeros(len(A)), np.zeros(len(a)), []
    for extra in commands:
        sample = C @ z
        u = loop.gain * (c @ x + d @ sample) + extra
        x = a @ x + b @ sample
        z = A @ z + B @ u
        y.append(sample)
    return np.array(y)


def test_static_and_dynamic_predictions_are_one(fe, beam, laboratory):
    # the same gain as a law without states, and as one with a state that does nothing
    law = published_law(beam, "mfdrf")
    idle = LinearLaw(
        [[0.3]], np.zeros((1, 3)), np.zeros((3, 1)), -law.gains, sensors=law.sensors, actuators=law.actuators
    )
    plain = predict_rate_feedback(fe.linear, fe.deflections(law.sensors).T, law.gains, laboratory.converter)
    loop = loop_on(fe, idle, laboratory.converter).closed()
    distance = np.abs(loop.z[:, None] - np.append(plain.z, 0.3)[None, :])
    assert distance.min(axis=1).max() < 1e-9  # rounding of eigenvalues of a matrix of norm 1e3


@pytest.mark.parametrize("delay", [0.0, 1.0, 1.35, 2.6])
@pytest.mark.parametrize("corner", [0.0, 677.0])
def test_predicted_plant_is_hardware_and_structure_in_mujoco(fe, laboratory, lqg_law, delay, corner):
    # impulse of commands through the output chain into MuJoCo's modal plant, against the predicted discrete plant
    parts = replace(laboratory.at_rate(1000.0).converter, delay_samples=delay, filter_corner=corner)
    hardware = replace(laboratory, converter=parts)
    plant = build_modal(fe, modes=8, timestep=1.25e-4)
    loop = loop_on(fe, lqg_law, parts, modes=8)

    class Script:
        sensors = actuators = PLACES

        def reset(self):
            self.k = 0

        def step(self, y):
            self.k += 1
            return np.array([1.0, -2.0, 0.5]) if self.k == 3 else np.zeros(3)

    record = run_experiment(Experiment(plant=plant, seconds=0.3, controller=Script(), hardware=hardware)).recording
    simulated = np.column_stack([record[f"sensor:{p}"] for p in PLACES])
    commands = np.zeros((300, 3))
    commands[2] = [1.0, -2.0, 0.5]
    A, B, C = loop.plant
    z, predicted = np.zeros(len(A)), []
    for u in commands:
        predicted.append(C @ z)
        z = A @ z + B @ u
    # semi-implicit Euler at 1/8 ms: frequency off by (omega h)^2/24 = 7e-5 at 50 Hz, phase after 0.3 s by 7e-3
    assert simulated == pytest.approx(np.array(predicted), abs=1.5e-2 * np.abs(predicted).max())


@pytest.mark.slow
def test_lqg_loop_decays_in_mujoco_as_predicted(fe, laboratory, lqg_law):
    # the lightest pole, 91.7 Hz at a ratio of 8e-4, rings longest after a release; brute force against eigenvalues
    hardware = laboratory.at_rate(1000.0)
    plant = build_modal(fe, modes=12, timestep=6.25e-5)
    least = loop_on(fe, lqg_law, hardware.converter, modes=12).critical()
    run = Experiment(
        plant=plant, seconds=8.0, controller=lqg_law, hardware=hardware, excitation=Release(level=1.0), excite="base"
    )
    x = run_experiment(run).recording["sensor:40in"]
    t = np.arange(len(x)) / 1000.0

    def at(window):  # complex amplitude near the pole's frequency
        lines = np.linspace(least.hz - 0.5, least.hz + 0.5, 401)
        sums = np.abs(np.exp(-2j * np.pi * lines[:, None] * t[window]) @ (x[window] * np.hanning(len(t[window]))))
        return lines[sums.argmax()], sums.max()

    (hz, early), (_, late) = at(slice(3000, 5000)), at(slice(6000, 8000))
    assert hz == pytest.approx(least.hz, rel=1.5e-3)  # (omega h)^2/24 of the step and the grid of lines
    assert np.log(early / late) / 3.0 == pytest.approx(-least.growth, rel=0.05)  # other modes are left at 1 % by then


def test_the_transition_matrix_is_the_loop_run_sample_by_sample(fe, laboratory, lqg_law):
    loop = loop_on(fe, lqg_law, laboratory.at_rate(1000.0).converter, modes=6)
    rng = np.random.default_rng(0)
    state = rng.standard_normal(len(loop.matrix))
    n = len(loop.plant[0])
    A, B, C = loop.plant
    a, b, c, d = loop.law
    z, x = state[:n], state[n:]
    sample = C @ z
    expected = np.concatenate([A @ z + B @ (c @ x + d @ sample), a @ x + b @ sample])
    assert loop.matrix @ state == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_two_forms_of_one_law_have_one_loop(fe, laboratory, lqg_law):
    parts = laboratory.at_rate(1000.0).converter
    one, other = (loop_on(fe, law, parts).closed().z for law in (lqg_law, block_diagonal(lqg_law)))
    assert np.abs(one[:, None] - other[None, :]).min(axis=1).max() < 1e-6  # condition of the transformation, 1e4


def test_opened_loop_is_the_response_run_sample_by_sample(fe, laboratory, lqg_law):
    # I + L from the closed loop: command disturbance to command is (I + L)^-1; take it from a long simulated sine
    loop = loop_on(fe, lqg_law, laboratory.at_rate(1000.0).converter, modes=4)
    hz, n = 5.0, 8000
    phase = 2j * np.pi * hz * np.arange(n) / 1000.0
    direction = np.array([1.0, 0.3, -0.5])
    y = stepped(loop, np.real(np.exp(phase)[:, None] * direction))
    A, B, C = loop.plant
    zed = np.exp(2j * np.pi * hz / 1000.0)
    K, L = law_response(loop.law, np.array([hz]), 1000.0)[0], loop.opened(np.array([hz]))[0]
    P = C @ np.linalg.solve(zed * np.eye(len(A)) - A, B)
    assert pytest.approx(L, abs=1e-9 * np.abs(L).max()) == -K @ P
    last = slice(n - 4000, n)  # settled: 20 whole periods, the slowest pole has decayed by e^-30
    measured = 2 * np.mean(y[last] * np.exp(-phase[last])[:, None], axis=0)
    expected = P @ np.linalg.solve(np.eye(3) + L, direction)
    assert measured == pytest.approx(expected, abs=1e-3 * np.abs(expected).max())


def test_a_dynamic_laws_analytical_response_is_that_of_its_sampled_loop(fe, laboratory, lqg_law):
    # an impulse of force behind the filter, on the sampled loop; far below the sample rate images of the hold are small
    parts = replace(laboratory.converter, rate=2000.0)
    law = LinearLaw([[0.97]], [[0.5]], [[-2.0]], [[-5.0]], sensors=["base"], actuators=["base"], rate=2000.0)
    row = fe.deflection("base")
    freq = np.array([1.0, 4.8, 8.8, 14.4])
    ours = closed_loop_response(
        fe.linear,
        row[:, None],
        law,
        parts,
        freq,
        sensors=row[None],
        excited=row[:, None],
        outputs=row[None],
        quantity="velocity",
    )[:, 0, 0]
    G = fe.linear.frequency_response(freq, row[:, None], row[None], quantity="velocity").H[:, 0, 0]
    L = sampled_loop(fe.linear, row[:, None], law, parts).opened(freq)[:, 0, 0]
    assert ours == pytest.approx(G / (1 + L), rel=2e-3)  # aliases of 400 Hz modes


def test_which_mode_moves_is_told_by_energy(fe, laboratory, lqg_law):
    loop = loop_on(fe, lqg_law, laboratory.at_rate(1000.0).converter)
    least = loop.critical()
    assert (least.mode, round(least.hz, 1)) == (10, 91.7)
    assert least.share > 0.99
    assert least.zeta == pytest.approx(8e-4, rel=0.05)  # identified beforehand, one digit


@pytest.mark.parametrize("rate", [500.0, 2000.0])
def test_a_law_for_another_rate_is_refused(fe, laboratory, lqg_law, rate):
    with pytest.raises(BadController, match="made for 1000 Hz"):
        loop_on(fe, lqg_law, laboratory.at_rate(rate).converter)


def test_laws_that_theory_cannot_predict_are_refused(fe, laboratory):
    class Mine:
        sensors = actuators = ("base",)

        def reset(self):
            pass

        def step(self, y):
            return -y

    with pytest.raises(BadController, match="linear laws only"):
        loop_on(fe, Mine(), laboratory.converter)
    law = DirectRateFeedback(np.eye(3), sensors=PLACES, actuators=PLACES)
    with pytest.raises(BadController, match="takes 3 samples"):
        sampled_loop(fe.linear, fe.deflections(["base"]).T, law, laboratory.converter)


def test_poles_of_an_observer_are_told_from_the_modes(beam, laboratory):
    # no delay, no filter, and fast sampling: on its own model the loop has the regulator's poles, by separation
    rate = 2e4
    design = published_way(beam, "lqg", rate=rate)
    parts = replace(laboratory.converter, rate=rate, highest_rate=rate, delay_samples=0.0, filter_corner=0.0)
    found = loop_on(build_reduced_model(beam, "exact"), design.controller, parts).mode_poles(range(6))
    # the hold is half a sample of delay: of a heavily damped pole it turns s T / 2, at 20 kHz 0.4 % at the sixth mode
    assert [p.hz for p in found] == pytest.approx(design.poles.freq[:6], rel=5e-3)
    assert [p.zeta for p in found] == pytest.approx(design.poles.zeta[:6], abs=5e-3)
    assert design.filter_poles.zeta[:6].min() > 0.1  # others lie close by in frequency
