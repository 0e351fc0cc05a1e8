"""The compiled loop: the numbers of the loop in Python, and what it leaves to that loop."""

import dataclasses
import threading

import mujoco
import numpy as np
import pytest

from vlab.controllers import DirectRateFeedback, LinearLaw, ObserverFeedback
from vlab.errors import BadExperiment
from vlab.hardware.output_chain import OutputChain
from vlab.hardware.sensing import Sampling
from vlab.lab import Experiment, loop, run_experiment
from vlab.lab.callback import callback_kept, control_callback
from vlab.lab.compiled_loop import system_of
from vlab.lab.excitation import Multisine, Release
from vlab.lab.laws import named_law, published_law
from vlab.lab.loop import ControlLoop, can_compile, plain_matrices
from vlab.physics.attach import attach
from vlab.physics.spec import parse_effect
from vlab.plants import build_plant
from vlab.structure import load_structure

PLACES = ("40in", "20in", "base")


class Plain:
    """A user's law around another one: Python code, whatever it does."""

    def __init__(self, law) -> None:
        self.sensors, self.actuators, self._law = law.sensors, law.actuators, law

    def reset(self) -> None:
        self._law.reset()

    def step(self, y):
        return self._law.step(y)


def on_both_paths(monkeypatch, experiment):
    compiled = run_experiment(experiment)
    with monkeypatch.context() as patch:
        patch.setattr(loop, "can_compile", lambda *given: False)
        python = run_experiment(experiment)
    assert (compiled.is_compiled, python.is_compiled) == (True, False)
    return compiled, python


def assert_equal_runs(compiled, python):
    """Compare to 1e-12 of the largest value of a channel: sums in another order, over some hundred steps."""
    for name in compiled.recording.names:
        ours, theirs = compiled.recording[name], python.recording[name]
        assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max(), name
    assert compiled.frames == pytest.approx(python.frames, abs=1e-12 * np.abs(python.frames).max())
    for ours, theirs in zip(compiled.effort, python.effort, strict=True):
        assert ours.saturated_share == theirs.saturated_share


@pytest.fixture(scope="module")
def plants():
    grid = load_structure("grid")
    beam = load_structure("beam")
    return {
        ("beam", "composite"): build_plant(beam, "composite"),
        ("beam", "modal"): build_plant(beam, "modal"),
        ("beam", "fe"): build_plant(beam, "fe"),
        ("grid", "modal"): build_plant(grid, "modal"),
    }


KINDS = [("beam", "composite"), ("beam", "modal"), ("beam", "fe"), ("grid", "modal")]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("law", [None, "mfdrf", "lqg"])
def test_both_paths_give_the_same_numbers(monkeypatch, plants, laboratory, kind, law):
    structure = load_structure(kind[0])
    controller = named_law(structure, law) if law else None
    hardware = laboratory.at_rate(getattr(controller, "rate", None) or 2000.0)
    plant, excitation = plants[kind], Multisine(level=0.2, period_s=0.3, low_hz=4.0)
    compiled, python = on_both_paths(
        monkeypatch,
        Experiment(plant=plant, seconds=0.3, excitation=excitation, controller=controller, hardware=hardware),
    )
    assert np.abs(compiled.recording[plant.sensors[0].name]).max() > 0
    assert_equal_runs(compiled, python)


def test_both_paths_have_the_same_hardware(monkeypatch, plants, beam, laboratory):
    # noise, quantisation, loaded coils beyond their travel, an amplifier at its limit that does not control the current
    sensor = dataclasses.replace(laboratory.velocity_sensor, noise=1e-4, buffered=False, linear_range=1e-3)
    hardware = dataclasses.replace(
        laboratory.at_rate(500.0),
        velocity_sensor=sensor,
        converter=dataclasses.replace(laboratory.at_rate(500.0).converter, resolution=1e-3),
        coil=dataclasses.replace(laboratory.coil, limit=0.3, current_controlled=False),
    )
    law = DirectRateFeedback(30.0 * np.eye(2), sensors=("base", "20in"), actuators=("20in", "40in"))
    compiled, python = on_both_paths(
        monkeypatch,
        Experiment(
            plant=plants["beam", "modal"], seconds=0.4, controller=law, hardware=hardware, excitation=Release(level=3.0)
        ),
    )
    assert 0 < compiled.effort[1].saturated_share < 1
    assert_equal_runs(compiled, python)


def test_a_restoring_force_acts_on_both_paths(monkeypatch, plants):
    plant = plants["beam", "composite"]
    stiff = dataclasses.replace(plant, restoring=0.01 * plant.linearise().K)
    for one in (stiff, dataclasses.replace(stiff, dissipation=None)):
        run = Experiment(plant=one, seconds=0.2, excitation=Multisine(level=0.2, period_s=0.2, low_hz=5.0))
        assert_equal_runs(*on_both_paths(monkeypatch, run))


def test_law_and_chain_are_one_system(laboratory):
    rng = np.random.default_rng(0)
    A = 0.3 * rng.standard_normal((4, 4))
    law = LinearLaw(
        A,
        rng.standard_normal((4, 2)),
        rng.standard_normal((3, 4)),
        rng.standard_normal((3, 2)),
        sensors=("a", "b"),
        actuators=("c", "d", "e"),
    )
    to, substeps = np.array([3, 0, 2]), 3
    one, chain = (OutputChain(laboratory.converter, channels=n, substeps=substeps) for n in (1, 4))
    F = system_of(law.matrices, to, one, 4)
    z = np.zeros(F.shape[1] - 2)
    for y in rng.standard_normal((20, 2)):
        result = F @ np.concatenate([z, y])
        command = np.zeros(4)
        command[to] = law.step(y)
        assert result[:4] == pytest.approx(command, abs=1e-12)
        assert result[4:16].reshape(substeps, 4) == pytest.approx(chain.push(command), abs=1e-12)
        z = result[16:]


def test_a_law_without_sensors_acts(monkeypatch, plants):
    law = LinearLaw(
        np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((1, 0)), np.zeros((1, 0)), sensors=(), actuators=("base",)
    )
    generator = LinearLaw([[1.0]], np.zeros((1, 0)), [[1.0]], np.zeros((1, 0)), sensors=(), actuators=("base",))
    for one in (law, generator):
        run = Experiment(plant=plants["beam", "modal"], seconds=0.1, controller=one, excitation=Multisine(level=0.1))
        assert_equal_runs(*on_both_paths(monkeypatch, run))


class Louder(LinearLaw):
    """A linear law with a step of its own."""

    def step(self, y):
        return 2 * super().step(y)


def test_only_laws_that_are_their_matrices_are_compiled(beam):
    rate = DirectRateFeedback(np.eye(3), sensors=PLACES, actuators=PLACES)
    A, B, C, D = np.zeros((1, 1)), np.zeros((1, 3)), np.zeros((3, 1)), np.eye(3)
    linear = LinearLaw(A, B, C, D, sensors=PLACES, actuators=PLACES)
    louder = Louder(A, B, C, D, sensors=PLACES, actuators=PLACES)
    free, limited = (
        ObserverFeedback(A, B, C, K=C, M=B, sensors=PLACES, actuators=PLACES, limit=limit) for limit in (None, 1.0)
    )
    patched = LinearLaw(A, B, C, D, sensors=PLACES, actuators=PLACES)
    patched.step = lambda y: np.zeros(3)
    assert [plain_matrices(law) is not None for law in (rate, linear, free)] == [True] * 3
    assert [plain_matrices(law) for law in (louder, limited, patched, Plain(linear))] == [None] * 4


def test_effects_and_other_integrators_run_in_python(modal):
    assert can_compile(modal, None)
    assert not can_compile(attach(modal, [parse_effect("coulomb-friction@20in:force=0.05lbf")]), None)
    options = {
        "integrator": int(mujoco.mjtIntegrator.mjINT_RK4),  # its steps have no halves
        "disableflags": int(mujoco.mjtDisableBit.mjDSBL_ACTUATION),  # MuJoCo then calls no control callback
    }
    for option, value in options.items():
        model = mujoco.MjModel.__copy__(modal.model)
        setattr(model.opt, option, value)
        assert not can_compile(dataclasses.replace(modal, model=model), None)


def test_both_kinds_of_loop_run_side_by_side(modal, composite, beam):
    law = published_law(beam, "mfdrf")
    tasks = [
        Experiment(plant=plant, seconds=0.5, controller=controller, excitation=Multisine(level=0.2, seed=seed))
        for plant, controller, seed in ((modal, law, 1), (modal, Plain(law), 2), (composite, None, 3))
    ]
    alone = [run_experiment(task) for task in tasks]
    assert [run.is_compiled for run in alone] == [True, False, True]
    together = [None] * len(tasks)

    def work(i: int) -> None:
        together[i] = run_experiment(tasks[i])

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(tasks))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(alone, together, strict=True):
        assert np.array_equal(one.recording.data, other.recording.data)


def test_the_dispatcher_stays_while_compiled_steps_run():
    with callback_kept():
        with control_callback(object(), lambda model, data: None):
            assert mujoco.get_mjcb_control() is not None
        assert mujoco.get_mjcb_control() is not None  # a thread may be between MuJoCo's test and its call
    assert mujoco.get_mjcb_control() is None


def test_a_run_ends_with_its_last_step(modal, laboratory):
    is_velocity = np.array([tap.kind == "velocity" for tap in modal.sensors])
    for law in (None, Plain(DirectRateFeedback(np.eye(3), sensors=PLACES, actuators=PLACES))):
        run = ControlLoop(
            modal,
            laboratory,
            law,
            added=np.zeros((10, 3)),
            sampling=Sampling.draw(laboratory, is_velocity, 10, np.random.default_rng(0)),
            samples=10,
            substeps=1,
            frame_every=5,
        )
        run.advance(4)
        run.advance(6)
        with pytest.raises(BadExperiment, match="1 steps were asked of a run with 0 steps left"):
            run.advance(1)


def test_forces_of_another_length_are_refused(modal, laboratory):
    is_velocity = np.array([tap.kind == "velocity" for tap in modal.sensors])
    sampling = Sampling.draw(laboratory, is_velocity, 10, np.random.default_rng(0))
    with pytest.raises(BadExperiment, match="do not fit 10 samples of 2 steps"):
        ControlLoop(
            modal, laboratory, None, added=np.zeros((10, 3)), sampling=sampling, samples=10, substeps=2, frame_every=5
        )
