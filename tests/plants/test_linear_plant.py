"""The linear plant: exact steps, the modal plant's motion, and what the plant refuses."""

import dataclasses

import numpy as np
import pytest
from scipy import linalg

from vlab.benchmark.comparisons import integrate_with_scipy
from vlab.controllers import DirectRateFeedback
from vlab.errors import BadExperiment, Diverged
from vlab.fe import FeModel, build_fe_model
from vlab.lab import Experiment, run_experiment
from vlab.lab.excitation import Multisine, Release
from vlab.lab.laws import published_law
from vlab.physics.attach import attach
from vlab.physics.spec import parse_effect
from vlab.plants import build_plant
from vlab.plants.linear import LinearPlant
from vlab.plants.modal import build_modal
from vlab.structure import load_structure

PLACES = ("40in", "20in", "base")


@pytest.fixture(scope="module")
def linear(beam) -> LinearPlant:
    return build_plant(beam, "linear")


def stepped(fe: FeModel, signal: np.ndarray, at: str, outputs: np.ndarray, quantity: str, step: float) -> np.ndarray:
    """Step the FE model by the matrix exponential of its state space under a held force."""
    A, B, C, _ = fe.linear.state_matrices(fe.deflection(at)[:, None], outputs, quantity)
    n = len(A)
    whole = linalg.expm(np.block([[A, B], [np.zeros((1, n + 1))]]) * step)
    x, y = np.zeros(n), np.zeros((len(signal), len(outputs)))
    for k, force in enumerate(signal):
        y[k] = C @ x
        x = whole[:n, :n] @ x + whole[:n, n] * force
    return y


def test_steps_are_those_of_the_matrix_exponential(linear, fe):
    # velocities and displacements share their time stamps; differences linearise to 1e-9, after 3600 radians 4e-6
    excitation, h = Multisine(level=0.2, period_s=1.0, low_hz=1.0), linear.timestep
    run = run_experiment(Experiment(plant=linear, seconds=1.0, excitation=excitation, excite="base")).recording
    signal = excitation.sample((np.arange(2000) + 0.5) * h)
    v = stepped(fe, signal, "base", fe.deflections(PLACES), "velocity", h)
    x = stepped(fe, signal, "base", fe.deflections(["30in"]), "displacement", h)
    assert np.column_stack([run[f"sensor:{p}"] for p in PLACES]) == pytest.approx(v, abs=1e-5 * np.abs(v).max())
    assert run["probe:30in"] == pytest.approx(x[:, 0], abs=1e-5 * np.abs(x).max())


def test_law_and_chain_are_those_of_an_independent_loop(linear, beam, fe, laboratory):
    law, excitation = published_law(beam, "mfdrf"), Multisine(level=0.2, period_s=1.0, low_hz=1.0, high_hz=30.0)
    theirs = integrate_with_scipy(fe, laboratory, law, excitation, seconds=0.25)
    run = run_experiment(
        Experiment(plant=linear, seconds=0.25, controller=law, excitation=excitation, excite=fe.structure.exciter)
    )
    ours = np.column_stack([run.recording[f"sensor:{p}"] for p in PLACES])
    assert run.is_compiled
    assert ours == pytest.approx(theirs, abs=1e-4 * np.abs(theirs).max())  # RK45 at a relative tolerance of 1e-6


@pytest.mark.parametrize("structure", ["beam", "grid"])
def test_the_modal_plant_moves_alike(structure):
    # the modal plant's step shortens a period by (omega h)^2/24: at 20 Hz 0.016 %, after two seconds 4 % of a radian
    built = load_structure(structure)
    linear = build_plant(built, "linear")
    modal = build_modal(build_fe_model(built), modes=linear.model.nv)
    excitation = Multisine(level=0.2, period_s=2.0, low_hz=1.0, high_hz=20.0)
    ours, theirs = (run_experiment(Experiment(plant=p, seconds=2.0, excitation=excitation)) for p in (linear, modal))
    for sensor in linear.sensors:
        a, b = ours.recording[sensor.name], theirs.recording[sensor.name]
        assert np.sqrt(np.mean((a - b) ** 2)) < 0.02 * np.sqrt(np.mean(b**2)), sensor.name
    assert ours.frames == pytest.approx(theirs.frames, abs=0.02 * np.abs(theirs.frames).max())


def test_a_release_starts_at_the_static_deflection_and_rings_as_the_fe_model(linear, fe):
    run = run_experiment(Experiment(plant=linear, seconds=0.5, excitation=Release(level=0.5), excite="base")).recording
    load = fe.deflection("base") * 0.5
    static = np.linalg.solve(fe.linear.K, load)
    A, _, C, _ = fe.linear.state_matrices(load[:, None], fe.deflections(["30in"]), "displacement")
    at = linalg.expm(A * 0.4) @ np.concatenate([np.zeros(fe.linear.n), static])
    assert run["probe:30in"][0] == pytest.approx((C[0, fe.linear.n :] @ static), rel=1e-6)
    assert run["probe:30in"][800] == pytest.approx(float(C[0] @ at), abs=1e-5 * abs(static).max())


def test_loaded_coils_brake_the_exact_motion(linear, beam, laboratory):
    # without buffers the sensors' currents couple the modes; the modal plant in short steps is the second method
    sensor = dataclasses.replace(laboratory.velocity_sensor, buffered=False, unbuffered_load=1.0)
    hardware = dataclasses.replace(laboratory, velocity_sensor=sensor)
    modal = build_modal(build_fe_model(beam), modes=linear.model.nv, timestep=5e-5)
    ours, theirs, free = (
        run_experiment(Experiment(plant=p, seconds=1.0, excitation=Release(level=0.1), hardware=h)).recording[
            "probe:30in"
        ]
        for p, h in ((linear, hardware), (modal, hardware), (linear, laboratory))
    )
    assert np.abs(ours - free).max() > 0.1 * np.abs(free).max()
    assert ours == pytest.approx(theirs, abs=1e-3 * np.abs(theirs).max())


def test_an_unstable_loop_is_an_error(linear, laboratory):
    sensor = dataclasses.replace(laboratory.velocity_sensor, linear_range=1e12)
    law = DirectRateFeedback(-500.0 * np.eye(3), sensors=PLACES, actuators=PLACES)
    hardware = dataclasses.replace(laboratory, velocity_sensor=sensor)
    excitation = Multisine(level=0.2)
    with pytest.raises(Diverged, match="unstable"):
        run_experiment(Experiment(plant=linear, seconds=20.0, controller=law, hardware=hardware, excitation=excitation))


def test_effects_and_laws_in_python_are_refused(linear):
    class Silent:
        sensors, actuators = PLACES, PLACES

        def reset(self):
            pass

        def step(self, y):
            return np.zeros(3)

    rubbing = attach(linear, [parse_effect("coulomb-friction@20in:force=0.05lbf")])
    for plant, law in ((rubbing, None), (linear, Silent())):
        with pytest.raises(BadExperiment, match="use the plant 'modal'"):
            run_experiment(Experiment(plant=plant, seconds=0.1, controller=law))
