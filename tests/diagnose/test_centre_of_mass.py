"""Uncertain centres of mass: their size, their effect on the dynamics, and their priors."""

import numpy as np
import pytest

from vlab.diagnose.parameters.centre_of_mass import centres_of_mass
from vlab.diagnose.parameters.mjcf import adjusted, redundant, relative_changes
from vlab.diagnose.predictors.trajectory_problem import trajectory_parameters
from vlab.plants.mjcf import build_mjcf

MASS, HALF, DISTANCE = 0.7, np.array([0.02, 0.03, 0.1]), 0.15
BOX = f"""
<mujoco>
  <option gravity="0 0 -9.81" integrator="RK4" timestep="0.001"/>
  <worldbody>
    <body name="arm">
      <joint name="pivot" type="hinge" axis="0 1 0"/>
      <geom type="box" size="{HALF[0]} {HALF[1]} {HALF[2]}" pos="0 0 {-DISTANCE}" mass="{MASS}"/>
      <site name="tip" pos="0 0 -0.3"/>
    </body>
  </worldbody>
  <sensor><jointpos name="angle" joint="pivot"/></sensor>
</mujoco>
"""


@pytest.fixture
def plant():
    return build_mjcf(BOX)


def test_a_shift_is_a_radius_of_gyration(plant):
    shifts = centres_of_mass(plant.model, {"body:arm": 1}, {"centre-of-mass": 0.1})
    # uniform box: second moment of mass along an axis = m (half length)^2 / 3
    assert {s.name[-1]: s.shifted[0][1] for s in shifts} == pytest.approx(
        {"x": HALF[0] / np.sqrt(3), "z": HALF[2] / np.sqrt(3)}
    )
    assert {s.sd for s in shifts} == {0.1}


def test_axes_that_dynamics_do_not_see_are_left_out(plant):
    names = [s.name for s in centres_of_mass(plant.model, {"body:arm": 1}, {"centre-of-mass": 0.1})]
    assert "body:arm:centre-of-mass:y" not in names  # along the hinge


def test_a_shifted_pendulum_swings_at_the_closed_form(plant):
    (shift,) = (
        s for s in centres_of_mass(plant.model, {"body:arm": 1}, {"centre-of-mass": 0.1}) if s.name.endswith("z")
    )
    moved = adjusted(plant, [shift], np.array([-0.3]))
    c = DISTANCE + 0.3 * HALF[2] / np.sqrt(3)
    inertia = MASS * (HALF[0] ** 2 + HALF[2] ** 2) / 3 + MASS * c**2
    omega, _ = moved.linearise().eigen
    assert omega[0] == pytest.approx(np.sqrt(MASS * 9.81 * c / inertia), rel=1e-6)


def test_a_centre_of_mass_is_exact_unless_a_case_states_another(plant):
    def sd(given):
        parameters = trajectory_parameters(plant, given, ["angle"], [])
        return {p.name.removeprefix("body:arm:centre-of-mass:"): p.sd for p in parameters if p.shifted}

    assert sd({"mass": 0.1}) == {}
    assert sd({"centre-of-mass": 0.02}) == {"x": 0.02, "z": 0.02}
    assert sd({"centre-of-mass": 0.02, "body:arm:centre-of-mass": 0.2}) == {"x": 0.2, "z": 0.2}


def test_shifts_are_independent_directions_and_change_linearly(plant):
    parameters = trajectory_parameters(plant, {"centre-of-mass": 0.1}, ["angle"], [])
    moved = [i for i, p in enumerate(parameters) if p.shifted]
    assert not np.any(redundant(parameters)[:, moved])
    change = relative_changes(parameters, np.full(len(parameters), 0.5))
    assert change[moved] == pytest.approx(0.5)
    assert change[[p.name for p in parameters].index("mass")] == pytest.approx(np.expm1(0.5))
    assert change[[p.name for p in parameters].index("sensor:angle")] == 0.0
