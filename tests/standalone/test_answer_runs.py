"""Every effect of the catalogue, written for plain MuJoCo, beside vlab's own simulation of the same model."""

import json
import subprocess
import sys
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "physics"))
import physics_rig
from physics_rig import CHANNEL_VALUES, FILTER_OF_SERVO, OF_SERVOS, PORT_VALUES, SERVO

from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS
from vlab.physics.native import SPRINGS
from vlab.standalone.answer import StandaloneAnswer, write_answer

pytestmark = pytest.mark.slow
"""The module's recordings are made, or diagnosed, once for all its tests, which takes most of a minute."""

ALL = {**PORT_VALUES, **CHANNEL_VALUES}
SENSORS = ("pos_a", "pos_c", "vel_b")
SAMPLE, STEPS = 1e-3, 2
ROUNDING = 1e-6
"""Share of an effect's own signal. The same law acts in the same step; numbers of the text have ten digits, and the
motion of 1.5 s magnifies them."""
AS_SPRINGS = 0.01
"""The same for a spring beside a joint, which MuJoCo evaluates at the step's beginning and vlab's force at its middle;
the limit of the test of vlab's own written model."""
FILTER = 0.05
"""The same for MuJoCo's filter, which takes a step's command at the step's end. vlab's filter takes the commands as
straight between the steps, half a step later: h/(2 tau) = 5 % of the lag."""


@dataclass(frozen=True, eq=False)
class Rig:
    """The chain of `physics_rig` with a shorter record and without a search problem."""

    plant: object
    run: object
    files: TemporaryDirectory
    known: dict = field(default_factory=dict)

    def in_vlab(self, effects):
        key = repr(effects)
        if key not in self.known:
            plant = attach(self.plant, [Attached(EFFECTS[n], at, v) for n, at, v in effects], channels=SENSORS)
            rest = InitialState(qpos=plant.rest, qvel=np.zeros(plant.model.nv), how="rest")
            self.known[key] = simulate(plant, self.run, initial=rest).recording.select(list(SENSORS)).data
        return self.known[key]


@lru_cache(maxsize=8)
def rig_of(kind="slide", integrator="Euler", servo=""):
    files = TemporaryDirectory(prefix="vlab-answer-")
    folder = Path(files.name)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(physics_rig, "SECONDS", 1.0)
        case = physics_rig._chain_case(folder, kind, SAMPLE / STEPS, integrator)
    if servo:
        case = physics_rig.servoed(folder, servo)
    return Rig(case.plant, case.runs(("fit",))[0], files)


def rig_for(name):
    return rig_of("hinge" if name == "rotary-inertia" else "slide")


@dataclass(frozen=True)
class Job:
    name: str
    rig: Rig
    effects: list
    answer: StandaloneAnswer
    folder: Path


def job(folder, name, rig, effects):
    attached = [Attached(EFFECTS[n], at, values) for n, at, values in effects]
    source = Path(rig.files.name) / "rig.xml"
    answer = write_answer(source, rig.plant, attached, folder / name, channels=SENSORS, sample=SAMPLE)
    return Job(name, rig, effects, answer, folder / name)


SEVERAL = [
    ("added-mass", "tendon:whole", {"mass": 0.6}),
    ("attached-oscillator", "joint:b", {"mass": 0.3, "frequency": 4.0, "damping_ratio": 0.1}),
    ("stribeck-friction", "joint:a", {"force": 1.0, "excess": 0.5, "speed": 0.1}),
    ("actuator-dead-zone", "actuator:push", {"threshold": 1.0}),
    ("actuator-clipping", "actuator:push", {"limit": 10.0}),
    ("actuator-gain", "actuator:push", {"gain": 0.1}),
    ("actuator-gain", "actuator:pull", {"gain": -0.2}),
    ("actuator-quantisation", "actuator:pull", {"step": 0.5}),
    ("sensor-lag", "sensor:pos_a", {"time_constant": 5e-3}),
    ("sensor-offset", "sensor:pos_a", {"offset": 2e-3}),
]
"""Effects that act on each other, with an actuator whose gain comes before its quantisation."""
FORCED = {name: PORT_VALUES[name] for name in ("lugre-friction", "stribeck-friction", "structural-damping")}

AS_LAWS = (
    "servo-integral-gain",
    "servo-error-dead-zone",
    "servo-soft-force-limit",
    "servo-torque-speed-line",
    "servo-load-friction",
    "servo-backlash",
    "servo-compliance",
)
"""Effects within a servo that no number of the servo can hold."""


@pytest.fixture(scope="module")
def jobs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("answers")
    out = [job(folder, name, rig_for(name), [(name, *ALL[name])]) for name in ALL]
    out += [job(folder, "several", rig_of(), SEVERAL)]
    out += [
        job(folder, f"{name}-{integrator}", rig_of(integrator=integrator), [(name, *at)])
        for name, at in FORCED.items()
        for integrator in ("RK4", "implicitfast")
    ]
    out += [
        job(folder, f"{name}{lag}", rig_of(servo=SERVO.format(text)), [(name, "actuator:push", values)])
        for name, values in OF_SERVOS.items()
        for lag, text in (("", ""), ("-filtered", FILTER_OF_SERVO))
    ]
    return {one.name: one for one in out}


@pytest.fixture(scope="module")
def plain(jobs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plain")
    inputs = {one.name: np.column_stack([one.rig.run.measured[n] for n in ("push", "pull")]) for one in jobs.values()}
    np.savez(folder / "inputs.npz", **inputs)
    listed = [
        {"name": n, "folder": str(one.folder), "inputs": n, "steps": STEPS, "sensors": SENSORS}
        for n, one in jobs.items()
    ]
    (folder / "jobs.json").write_text(json.dumps({"inputs": str(folder / "inputs.npz"), "jobs": listed}))
    runner = Path(__file__).with_name("plain_mujoco.py")
    subprocess.run([sys.executable, str(runner), str(folder / "jobs.json"), str(folder / "out.npz")], check=True)
    return np.load(folder / "out.npz")


def share(rig, effects, here):
    there, before = rig.in_vlab(effects), rig.in_vlab([])
    return float(np.sqrt(np.mean((here - there) ** 2) / np.mean((there - before) ** 2)))


def test_the_runs_know_nothing_of_vlab(plain):
    assert bool(plain["without_vlab"])


@pytest.mark.parametrize("name", ALL)
def test_an_effect_runs_in_plain_mujoco_as_in_vlab(name, jobs, plain):
    one = jobs[name]
    assert not one.answer.not_written
    allowed = AS_SPRINGS if name in SPRINGS else {"actuator-lag": FILTER}.get(name, ROUNDING)
    assert share(one.rig, one.effects, plain[name]) < allowed


@pytest.mark.parametrize("name", [f"{n}{lag}" for n in OF_SERVOS for lag in ("", "-filtered")])
def test_an_effect_within_a_servo_runs_in_plain_mujoco_as_in_vlab(name, jobs, plain):
    one = jobs[name]
    assert not one.answer.not_written
    assert share(one.rig, one.effects, plain[name]) < ROUNDING
    is_law = name.removesuffix("-filtered") in AS_LAWS
    assert bool(one.answer.laws) == is_law  # all others are numbers of the servo, in the text
    assert bool(one.answer.uses) == is_law


def test_the_catalogue_is_covered():
    assert {*ALL, *OF_SERVOS, "tension-error"} == set(EFFECTS)  # a stretched bar is no part of an MJCF model


def test_effects_on_each_other_run_in_plain_mujoco_as_in_vlab(jobs, plain):
    one = jobs["several"]
    assert share(one.rig, one.effects, plain["several"]) < ROUNDING
    # the order of the list holds: what MuJoCo does last is an element, what must come before is in the law
    assert [n for n in one.answer.native if "actuator" in n] == [
        "actuator-clipping@actuator:push",
        "actuator-gain@actuator:push",
    ]
    assert one.answer.uses == ("install", "command", "read")


@pytest.mark.parametrize("name", [f"{n}-{i}" for n in FORCED for i in ("RK4", "implicitfast")])
def test_a_law_runs_under_other_integrators(name, jobs, plain):
    one = jobs[name]
    assert share(one.rig, one.effects, plain[name]) < ROUNDING
