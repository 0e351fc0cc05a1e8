"""A shaft that turns on and on has no springs or stops about a position."""

import numpy as np
import pytest
from rig_folder import Channel, Record, multisine, write_case
from scipy.integrate import solve_ivp

from vlab.cases.case import load_case
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.model_class import choose_model_class
from vlab.physics.catalogue import CANDIDATES
from vlab.physics.rest_position import has_rest_position

SHAFT = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 0"/><worldbody>
<body name="rotor"><joint name="shaft" type="hinge" axis="0 0 1" damping="0.002"/>
<inertial pos="0 0 0" mass="0.2" diaginertia="0.001 0.001 0.001"/></body>
</worldbody><actuator><motor name="motor" joint="shaft"/></actuator>
<sensor><jointvel name="tacho" joint="shaft"/></sensor></mujoco>"""
RATE, SECONDS, FRICTION = 100.0, 8.0, 0.006


def case_of(folder, level, spring=0.0):
    rng, t, records = np.random.default_rng(2), np.arange(round(RATE * SECONDS)) / RATE, []
    for name, role, size in (("a", "fit", 1.0), ("b", "fit", 1.6), ("c", "holdout", 1.3)):
        push = multisine(rng, 0.3, 4.0, SECONDS, 0.02 * level * size)
        v = solve_ivp(
            lambda time, x, push=push: [(push(time) - 0.002 * x[0] - FRICTION * np.tanh(x[0] / 1e-2)) / 1e-3],
            (0, SECONDS), [0.0], "DOP853", t, rtol=1e-8, atol=1e-10, max_step=0.005,
        ).y[0]  # fmt: skip
        v = v + 2e-3 * np.std(v) * rng.standard_normal(len(v))
        records.append(Record(name=name, role=role, columns={"u": push(t), "v": v}, rate_hz=RATE))
    channels = [
        Channel(column="u", at="motor", kind="torque", unit="N m", is_input=True, hold="linear"),
        Channel(column="v", at="tacho", kind="angular velocity", unit="rad/s"),
    ]
    mjcf = SHAFT.replace('damping="0.002"', f'damping="0.002" stiffness="{spring}"')
    write_case(folder, title="", mjcf=mjcf, uncertain={"damping": 0.3}, channels=channels, records=records)
    return load_case(folder)


@pytest.mark.parametrize(("level", "turns"), [(8.0, True), (1.0, False)])
def test_laws_about_a_position_need_a_shaft_that_turns_back(tmp_path, level, turns):
    screen = choose_model_class(case_of(tmp_path, level)).screen
    place = next(p for p in screen.problem.places if p.name == "joint:shaft")
    largest = max(np.ptp(screen.motion(group, place)[0], axis=0).max() for group in screen.groups)
    assert (largest > 2 * np.pi) == turns
    about = [c.label for c in screen.candidates(CANDIDATES) if has_rest_position(c.effect)]
    assert bool(about) != turns


def test_a_shaft_on_a_spring_may_have_laws_about_its_rest(tmp_path):
    screen = choose_model_class(case_of(tmp_path, 8.0, spring=1e-4)).screen
    assert any(has_rest_position(c.effect) for c in screen.candidates(CANDIDATES))


@pytest.mark.slow
def test_friction_of_a_turning_shaft_is_found(tmp_path):
    found = diagnose(case_of(tmp_path, 8.0)).diagnosis
    assert [f.effect for f in found.findings] == ["coulomb-friction"]
    assert found.findings[0].parameters["force"]["value"] == pytest.approx(FRICTION, rel=0.1)
