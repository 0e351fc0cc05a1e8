"""What a fit may make of an effect's parameters: what the catalogue says of them, and no more."""

import numpy as np
import pytest

from vlab.diagnose.inference.parameter_vector import from_unbounded, limits_of, to_unbounded
from vlab.physics.catalogue import EFFECTS

SIZES = [
    (effect.name, parameter)
    for effect in EFFECTS.values()
    for parameter in effect.parameters
    if parameter.role == "amplitude" and not parameter.reference
]


@pytest.mark.parametrize(("name", "parameter"), SIZES, ids=[f"{name}:{p.name}" for name, p in SIZES])
@pytest.mark.parametrize("times", [1e-2, 1.0, 1e6])
def test_a_size_stays_within_the_catalogues_range_wherever_it_starts(name, parameter, times):
    start = times * parameter.high
    low, high = limits_of(parameter, start, lambda reference: 1.0)
    assert low <= high
    reached = from_unbounded(parameter, np.array([low, np.clip(to_unbounded(parameter, start), low, high), high]))
    assert np.all(np.abs(reached) <= parameter.high * (1 + 1e-9))


def test_a_gain_of_a_thousand_is_no_gain():
    (gain,) = EFFECTS["actuator-gain"].parameters
    assert limits_of(gain, 1007.0, lambda reference: 1.0) == (-3.0, 3.0)
