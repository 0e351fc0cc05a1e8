"""Uncertain centres of mass: their size, their effect on the dynamics, and their priors."""

import mujoco
import numpy as np
import pytest

from vlab.diagnose.parameters.mass_distribution import centres_of_mass
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
    shifts = centres_of_mass(plant.model, {"body:arm": 1}, 0.1, {})
    # uniform box: second moment of mass along an axis = m (half length)^2 / 3
    assert {s.name[-1]: s.shifted[0][1] for s in shifts} == pytest.approx(
        {"x": HALF[0] / np.sqrt(3), "z": HALF[2] / np.sqrt(3)}
    )
    assert {s.sd for s in shifts} == {0.1}


def test_axes_that_dynamics_do_not_see_are_left_out(plant):
    names = [s.name for s in centres_of_mass(plant.model, {"body:arm": 1}, 0.1, {})]
    assert "body:arm:centre-of-mass:y" not in names  # along the hinge


def test_a_shifted_pendulum_swings_at_the_closed_form(plant):
    (shift,) = (s for s in centres_of_mass(plant.model, {"body:arm": 1}, 0.1, {}) if s.name.endswith("z"))
    moved = adjusted(plant, [shift], np.array([-0.3]))
    c = DISTANCE + 0.3 * HALF[2] / np.sqrt(3)
    inertia = MASS * (HALF[0] ** 2 + HALF[2] ** 2) / 3 + MASS * c**2
    omega, _ = moved.linearise().eigen
    assert omega[0] == pytest.approx(np.sqrt(MASS * 9.81 * c / inertia), rel=1e-6)


def test_the_distribution_is_as_uncertain_as_the_mass(plant):
    def sd(given):
        return {p.name: p.sd for p in trajectory_parameters(plant, given, ["angle"], [])}

    assert sd({"mass": 0.1})["body:arm:centre-of-mass:z"] == 0.1
    assert sd({"mass": 0.1})["inertia"] == 0.1
    assert sd({"mass": 0.001})["body:arm:centre-of-mass:z"] == sd({})["inertia"] == 0.03  # a weighed body of any shape
    assert sd({"mass": 0.1, "centre-of-mass": 0.02})["body:arm:centre-of-mass:z"] == 0.02
    assert sd({"body:arm:centre-of-mass": 0.2})["body:arm:centre-of-mass:x"] == 0.2


def test_shifts_are_independent_directions_and_change_linearly(plant):
    parameters = trajectory_parameters(plant, {"mass": 0.1}, ["angle"], [])
    moved = [i for i, p in enumerate(parameters) if p.shifted]
    assert not np.any(redundant(parameters)[:, moved])
    change = relative_changes(parameters, np.full(len(parameters), 0.5))
    assert change[moved] == pytest.approx(0.5)
    assert change[[p.name for p in parameters].index("mass")] == pytest.approx(np.expm1(0.5))
    assert change[[p.name for p in parameters].index("sensor:angle")] == 0.0


def test_long_chains_have_no_shifts():
    links = "".join(
        '<body pos="0 0 -0.1"><joint type="hinge" axis="0 1 0"/><geom size="0.01" pos="0 0 -0.1"/>' for _ in range(13)
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{links}{'</body>' * 13}</worldbody></mujoco>")
    assert centres_of_mass(model, {f"body:{i}": i for i in range(1, 14)}, 0.1, {}) == []
