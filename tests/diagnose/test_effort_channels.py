"""Readings of force sensors in the reduced model beside those of MuJoCo."""

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case

from vlab.cases.case import load_case
from vlab.cases.initial_state import InitialState
from vlab.cases.simulate import simulate
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.parameters.locations import at_place
from vlab.diagnose.parameters.mjcf import adjusted
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import effect_named

RIG = """<mujoco><option timestep="0.0001" gravity="0 0 0"/><worldbody>
<body><joint name="shaft" type="hinge" axis="0 0 1" armature="0.03" damping="0.2"/><geom size="0.01" mass="0.1"/></body>
</worldbody><actuator><position name="servo" joint="shaft" gear="1.5" kp="50" kv="4"/></actuator>
<sensor><jointpos name="angle" joint="shaft"/><{sensor}/></sensor></mujoco>"""
MOTOR = RIG.replace(
    '<position name="servo" joint="shaft" gear="1.5" kp="50" kv="4"/>', '<motor name="servo" joint="shaft"/>'
).replace('damping="0.2"', 'damping="0.2" stiffness="3"')
OF_ACTUATOR = 'actuatorfrc name="torque" actuator="servo"'
OF_JOINT = 'jointactuatorfrc name="torque" joint="shaft"'
RATE, SECONDS = 200.0, 3.0
SERVO, KP = "actuator:servo", 50.0
GLIDING = ("actuator-lag", "servo-load-friction")
EFFECTS = {
    "servo-position-gain": {"gain": 0.2},
    "servo-velocity-gain": {"gain": 0.3},
    "servo-integral-gain": {"rate": 2.0},
    "servo-error-dead-zone": {"threshold": 0.02},
    "servo-load-friction": {"share": 0.2, "rise": 0.05},
    "actuator-gain": {"gain": 0.2},
    "actuator-offset": {"offset": 0.02},
    "actuator-delay": {"delay": 0.03},
    "actuator-lag": {"time_constant": 0.03},
    "actuator-dead-zone": {"threshold": 0.1},
}


class Rig:
    """A servo with a force sensor as a case, with its reduced model."""

    def __init__(self, folder, sensor, hold, mjcf=RIG, unit="rad"):
        rng, self.hold = np.random.default_rng(5), hold
        command = multisine(rng, 0.4, 4.0, SECONDS, 0.4)
        t = np.arange(round(RATE * SECONDS)) / RATE
        u = command(t) * np.minimum(t / 0.5, 1.0)  # from rest
        channels = [
            Channel(
                column="u",
                at="servo",
                kind="command" if unit == "rad" else "moment",
                unit=unit,
                is_input=True,
                hold=hold,
            ),
            Channel(column="angle", at="angle", kind="angle", unit="rad"),
            Channel(column="torque", at="torque", kind="torque", unit="N m"),
        ]
        columns = {"u": u, "angle": u, "torque": u}
        records = [Record(name="a", role="fit", columns=columns, rate_hz=RATE)]
        uncertain = {"gain": 0.2, "velocity-gain": 0.2}
        write_case(
            folder, title="", mjcf=mjcf.format(sensor=sensor), uncertain=uncertain, channels=channels, records=records
        )
        self.case = load_case(folder)
        self.problem = prepare(self.case)
        self.run, self.places = self.problem.runs[0], {p.name: p for p in self.problem.places}

    def in_mujoco(self, plant):
        """Return the channels of a plant."""
        rest = InitialState(qpos=plant.rest, qvel=np.zeros(plant.model.nv), how="rest")
        return simulate(plant, self.run, initial=rest).recording.select(list(self.problem.names)).data

    def in_reduced_model(self, effects, theta, place=SERVO):
        """Return the channels of the reduced model."""
        refiner = object.__new__(LeastSquares)  # the simulation alone, without what a fit needs
        refiner.problem, refiner.reduced_model = self.problem, self.problem.reduced_model
        refiner.highest = float(np.abs(refiner.reduced_model.omega).max()) / (2 * np.pi)
        terms = [
            Term(effect=at_place(effect_named(name), self.places[place]), place=self.places[place], values=values)
            for name, values in effects
        ]
        values = [{k: np.array([v]) for k, v in own.items()} for _, own in effects]
        starts = np.zeros((1, 1, 2 * self.problem.reduced_model.m))
        return refiner.simulate([self.problem.signals[0]], terms, theta[None], values, starts)[:, 0, 0]

    def changes(self, plant, effects=(), theta=None, place=SERVO):
        """Return what effects or parameters change in the channels, in the reduced model and in MuJoCo."""
        none = np.zeros(len(self.problem.parameters))
        changed = self.in_reduced_model(list(effects), none if theta is None else theta, place)
        here = changed - self.in_reduced_model([], none)
        there = (self.in_mujoco(plant) - self.in_mujoco(self.case.plant))[: len(here)]
        return here[:-1], there[:-1]  # no command follows the last reading


RIGS = {
    "actuator": (OF_ACTUATOR, "zero"),
    "joint": (OF_JOINT, "zero"),
    "first": (OF_ACTUATOR, "zero-first"),
    "linear": (OF_ACTUATOR, "linear"),
}
"""Force sensor and hold of the commands."""


@pytest.fixture(scope="module", params=RIGS)
def rig(request, tmp_path_factory):
    return Rig(tmp_path_factory.mktemp("effort"), *RIGS[request.param])


def compare(rig, here, there, off):
    size = np.sqrt(np.mean(there**2, axis=0))
    assert np.all(size > 0.0)
    # the search holds the mean of a straight command over each interval
    steps = 0.0 if rig.hold != "linear" else 0.02 * KP * np.sqrt(np.mean(rig.problem.signals[0].u ** 2))
    assert np.all(np.sqrt(np.mean((here - there) ** 2, axis=0)) < off * size + np.array([0.0, steps]))


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_of_an_actuator_changes_what_a_force_sensor_reads(rig, name):
    values = EFFECTS[name]
    plant = attach(rig.case.plant, [Attached(effect_named(name), SERVO, values)])
    # what glides within a sample is known at its middle: the search steps by samples, MuJoCo by a fiftieth of them
    off = 0.4 if name in GLIDING else 0.15 if name.startswith("servo") else 0.03
    compare(rig, *rig.changes(plant, [(name, values)]), off=off)


@pytest.mark.parametrize(
    ("name", "values"),
    [("rate-limit", {"slope": 1e5}), ("slew-limit", {"slope": 1e5}), ("actuator-lag", {"time_constant": 1e-5})],
)
def test_an_effect_that_does_nothing_changes_no_reading(rig, name, values):
    if rig.hold != "zero":
        pytest.skip("a held command moves at once, and within the first step of MuJoCo only where it is seen first")
    here = rig.changes(rig.case.plant, [(name, values)])[0][:, 1]
    there = rig.in_mujoco(rig.case.plant)[:, 1]
    assert np.sqrt(np.mean(here**2)) < 0.01 * np.sqrt(np.mean(there**2))


@pytest.mark.parametrize("name", ["coil-force-over-travel"])
def test_a_force_sensor_reads_a_law_of_a_motor(name, tmp_path):
    values = {"loss": 2.0}
    rig = Rig(tmp_path, OF_ACTUATOR, "zero", mjcf=MOTOR, unit="N m")
    plant = attach(rig.case.plant, [Attached(effect_named(name), "joint:shaft", values)])
    compare(rig, *rig.changes(plant, [(name, values)], place="joint:shaft"), off=0.03)


@pytest.mark.parametrize("name", ["gain:servo", "velocity-gain:servo"])
def test_a_gain_changes_what_a_force_sensor_reads(rig, name):
    theta = np.array([0.3 * (p.name == name) for p in rig.problem.parameters])
    compare(rig, *rig.changes(adjusted(rig.case.plant, rig.problem.parameters, theta), theta=theta), off=0.03)
