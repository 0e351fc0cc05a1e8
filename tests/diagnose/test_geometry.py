"""Inertia and geometry of bodies as uncertain parameters of small motion, beside closed forms."""

import numpy as np
import pytest
from rig_folder import Channel, Record, write_case
from scipy.integrate import solve_ivp

from vlab.cases.case import load_case
from vlab.diagnose.parameters.geometry import geometry_about_rest, gravity_shares
from vlab.diagnose.parameters.mjcf import adjusted
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.predictors.modal_problem import prepare

MASS, LENGTH, INERTIA, GRAVITY = 0.4, 0.3, 0.002, 9.81
RIG = """<mujoco><option timestep="0.001" integrator="RK4" gravity="0 0 -9.81"/><worldbody>
<body name="arm"><joint name="pivot" type="hinge" axis="0 1 0" damping="0.002" stiffness="{k}"/>
<inertial pos="0 0 -0.3" mass="0.4" diaginertia="0.002 0.002 0.001"/></body>
</worldbody><sensor><jointpos name="encoder" joint="pivot"/></sensor></mujoco>"""
RATE, SECONDS, NOISE = 100.0, 12.0, 2e-4


def case_of(folder, *, length=LENGTH, spring=0.0, uncertain=None, friction=0.0):
    """Write free swings of a pendulum from 0.12 rad, integrated by a method of order 8."""
    rng, t = np.random.default_rng(1), np.arange(round(RATE * SECONDS)) / RATE
    inertia = INERTIA + MASS * length**2

    def slope(_, x):
        dry = friction * np.tanh(x[1] / 1e-3)
        return [x[1], (-MASS * GRAVITY * length * np.sin(x[0]) - 0.002 * x[1] - spring * x[0] - dry) / inertia]

    records = []
    for name, role, start in (("a", "fit", 0.12), ("b", "fit", 0.06), ("c", "holdout", 0.09)):
        x = solve_ivp(slope, (0, SECONDS), [start, 0.0], "DOP853", t, rtol=1e-9, atol=1e-12, max_step=0.005).y[0]
        x = x + NOISE * rng.standard_normal(len(x))
        records.append(Record(name=name, role=role, columns={"x": x}, rate_hz=RATE, initial="estimated"))
    channels = [Channel(column="x", at="encoder", kind="angle", unit="rad")]
    write_case(
        folder, title="", mjcf=RIG.format(k=spring), uncertain=uncertain or {}, channels=channels, records=records
    )
    return load_case(folder)


@pytest.mark.parametrize("spring", [0.0, 0.5, 5.0])
def test_the_share_of_gravity_is_that_of_a_pendulum_with_a_spring(tmp_path, spring):
    plant = case_of(tmp_path, spring=spring).plant
    hung = MASS * GRAVITY * LENGTH
    basis = np.array([[1.0]])
    assert gravity_shares(plant, basis) == pytest.approx([hung / (hung + spring)], rel=1e-6)
    kinds = {p.kind for p in geometry_about_rest(plant, {}, basis)}
    assert kinds == ({"inertia", "length"} if hung > spring else set())
    assert {p.kind for p in geometry_about_rest(plant, {"inertia": 0.1}, basis)} >= {"inertia"}


INERTIAL = '<inertial pos="0 0 -0.3" mass="0.4" diaginertia="0.002 0.002 0.001"/>'
FORMS = {
    "at the joint": INERTIAL,
    "below the joint": INERTIAL.replace("-0.3", "0.2"),  # with the joint at 0.5
    "welded": '<geom size="0.01" mass="0.001"/><body pos="0.05 0 -0.3">'
    + INERTIAL.replace("0 0 -0.3", "-0.05 0 0")
    + "</body>",
    "two masses": INERTIAL + '<body pos="0 0 -0.1"><geom size="0.02" mass="0.1"/></body>',
}


@pytest.mark.parametrize("form", FORMS)
def test_modal_matrices_follow_masses_inertias_and_lengths_exactly(tmp_path, form):
    case_of(tmp_path)
    rig = tmp_path / "rig.xml"
    text = rig.read_text().replace(INERTIAL, FORMS[form])
    rig.write_text(text.replace('name="pivot"', 'name="pivot" pos="0 0 0.5"') if form == "below the joint" else text)
    problem = prepare(load_case(tmp_path))
    rng = np.random.default_rng(7)
    for _ in range(3):
        theta = 0.2 * rng.standard_normal(len(problem.parameters))
        M, _, K, _, _ = problem.reduced_model.matrices(theta[None])
        linear, shapes = adjusted(problem.plant, problem.parameters, theta).linearise(), problem.reduced_model.shapes
        assert M[0] == pytest.approx(shapes.T @ linear.M @ shapes, rel=1e-6)
        assert K[0] == pytest.approx(shapes.T @ linear.K @ shapes, rel=1e-6)


def test_the_frequency_follows_the_distance_from_the_axis(tmp_path):
    case_of(tmp_path)
    rig = tmp_path / "rig.xml"
    text = rig.read_text().replace(INERTIAL, FORMS["below the joint"])
    rig.write_text(text.replace('name="pivot"', 'name="pivot" pos="0 0 0.5"'))
    problem = prepare(load_case(tmp_path))
    names = [p.name for p in problem.parameters]
    theta = np.zeros(len(names))
    theta[names.index("inertia")], theta[names.index("length")], theta[names.index("mass")] = 0.2, -0.1, 0.1
    M, _, K, _, _ = problem.reduced_model.matrices(theta[None])
    length, mass = LENGTH * np.exp(-0.1), MASS * np.exp(0.1)
    inertia = INERTIA * np.exp(0.2 + 0.1) + mass * length**2
    assert K[0, 0, 0] / M[0, 0, 0] == pytest.approx(mass * GRAVITY * length / inertia, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("length", [0.94 * LENGTH, 1.06 * LENGTH])
def test_a_pendulum_of_another_length_lacks_no_physics(tmp_path, length):
    assert diagnose(case_of(tmp_path, length=length)).diagnosis.verdict == "nothing-missing"


@pytest.mark.slow
def test_friction_of_a_pendulum_of_another_length_is_found(tmp_path):
    found = diagnose(case_of(tmp_path, length=1.05 * LENGTH, friction=0.002)).diagnosis
    assert [f.effect for f in found.findings] == ["coulomb-friction"]
    assert found.findings[0].parameters["force"]["value"] == pytest.approx(0.002, rel=0.15)
