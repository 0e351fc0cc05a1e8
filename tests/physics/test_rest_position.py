"""Which laws have a position of rest, told from the laws themselves."""

import pytest

from vlab.physics.catalogue import EFFECTS
from vlab.physics.rest_position import has_rest_position


@pytest.mark.parametrize(
    "name",
    ["stiffness-to-ground", "lost-stiffness", "cubic-stiffness", "string-stiffness", "stop", "dead-band",
     "one-sided-stiffness", "drifting-stiffness", "quadratic-stiffness"],
)  # fmt: skip
def test_springs_and_stops_have_a_position_of_rest(name):
    assert has_rest_position(EFFECTS[name])


@pytest.mark.parametrize(
    "name",
    ["added-mass", "rotary-inertia", "viscous-damping", "quadratic-drag", "coulomb-friction", "stribeck-friction",
     "jenkins-slip", "bouc-wen", "lugre-friction", "force-offset", "sinusoidal-force", "sensor-gain", "actuator-delay"],
)  # fmt: skip
def test_friction_and_loads_have_none(name):
    assert not has_rest_position(EFFECTS[name])
