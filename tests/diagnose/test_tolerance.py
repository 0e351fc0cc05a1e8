"""Linear effects beside the stated uncertainty of a model."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlab.diagnose.inference.hypothesis_fits import beyond_tolerance
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.mjcf import Uncertain
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.parameters.tolerance import is_within_tolerance
from vlab.physics.catalogue import EFFECTS

# two modes of unit mass at 10 and 20 rad/s; the port moves by half a metre per coordinate of the first one
MODEL = SimpleNamespace(M=np.eye(2), C=np.diag([0.2, 0.4]), K=np.diag([100.0, 400.0]))
PLACE = Place(name="tip", kind="port", rows=np.array([[0.5, 0.1]]), stiffness=40.0)
STATED = [
    Uncertain(name=kind, kind=kind, sd=sd) for kind, sd in (("mass", 0.02), ("stiffness", 0.03), ("damping", 0.3))
]


def term(name, **values):
    return Term(effect=EFFECTS[name], place=PLACE, values=values)


@pytest.mark.parametrize(
    ("name", "key", "limit"),
    [
        ("added-mass", "mass", 2 * 0.02 / 0.25),  # two standard deviations of the first modal mass
        ("lost-stiffness", "share", 2 * 0.03 * 100.0 / (0.25 * 40.0)),
        ("stiffness-to-ground", "stiffness", 2 * 0.03 * 100.0 / 0.25),
        ("viscous-damping", "damping", 2 * 0.3 * 0.2 / 0.25),
    ],
)
def test_the_limit_is_two_standard_deviations_of_a_mode(name, key, limit):
    assert is_within_tolerance(term(name, **{key: 0.99 * limit}), MODEL, STATED)
    assert not is_within_tolerance(term(name, **{key: 1.01 * limit}), MODEL, STATED)
    assert not is_within_tolerance(term(name, **{key: 0.5 * limit}), MODEL, [])  # nothing is stated as uncertain


def test_a_nonlinear_law_has_no_tolerance():
    assert not is_within_tolerance(term("cubic-stiffness", k3=1e-6), MODEL, STATED)


def test_a_small_linear_effect_stands_only_as_an_explanation():
    whole = SimpleNamespace(problem=SimpleNamespace(reduced_model=MODEL, parameters=STATED))
    small, large, law = term("added-mass", mass=0.01), term("added-mass", mass=1.0), term("coulomb-friction", force=1.0)

    def hypothesis(residual, *terms):
        return SimpleNamespace(normalised_residual=residual, long_fit=SimpleNamespace(terms=terms))

    partial = [hypothesis(5.0, small), hypothesis(5.0, law, small), hypothesis(5.0, large), hypothesis(5.0, law)]
    explaining = [hypothesis(1.0, small), hypothesis(1.0, law, small)]
    assert beyond_tolerance(whole, [*partial, *explaining], 1.2) == [*partial[2:], *explaining]
