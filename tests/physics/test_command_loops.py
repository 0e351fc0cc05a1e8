"""Whole signals of commands give the bits of one sample after another."""

import numpy as np
import pytest

from vlab.physics.actuator_dynamics import Jitter, RateLimit, SlewLimit

H = 1e-3
"""Sample period [s]."""


def commands(*shape):
    """Return commands that wander [N]."""
    return np.cumsum(np.random.default_rng(3).standard_normal(shape), axis=0)


def one_by_one(effect, u, values):
    """Return the forces (n,) of the sample-by-sample form."""
    step = effect.stepper(values, H)
    return [step(float(x)) for x in u]


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (SlewLimit(), {"slope": 300.0}),
        (SlewLimit(), {"slope": 1e5}),
        (RateLimit(), {"slope": 300.0}),
        (Jitter(), {"jitter": 2.5e-4}),
        (Jitter(), {"jitter": 7.3e-3}),
    ],
)
@pytest.mark.parametrize("samples", [1, 2, 333])
def test_a_signal_gives_the_forces_of_its_samples(effect, values, samples):
    u = commands(samples)
    np.testing.assert_array_equal(effect.actuate(u, values, H), one_by_one(effect, u, values))


@pytest.mark.parametrize("effect", [SlewLimit(), Jitter()])
def test_columns_are_signals_of_their_own(effect):
    u, values = commands(50, 3, 2), {"slope": 300.0, "jitter": 2.5e-3}
    found = effect.actuate(u, values, H)
    for i, j in np.ndindex(3, 2):
        np.testing.assert_array_equal(found[:, i, j], effect.actuate(u[:, i, j], values, H))
