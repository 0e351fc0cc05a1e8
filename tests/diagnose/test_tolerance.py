"""Linear effects beside the stated uncertainty of a model."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlab.diagnose.inference.hypothesis_fits import beyond_tolerance
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.parameters.tolerance import is_within_tolerance, modal_tolerances
from vlab.physics.catalogue import EFFECTS

# two modes of unit mass at 10 and 20 rad/s; the port moves by half a metre per coordinate of the first one
OWN = (np.eye(2), np.diag([0.2, 0.4]), np.diag([100.0, 400.0]))
PLACE = Place(name="tip", kind="port", rows=np.array([[0.5, 0.1]]), stiffness=40.0)


def model_of(*stated):
    """Return a model with parameters that scale one of its matrices, mass, damping or stiffness."""
    slopes = [tuple(OWN[j] if j == kind else None for j in range(3)) for kind, _ in stated]
    return SimpleNamespace(m=2, prior=np.array([sd for _, sd in stated]), slopes=lambda theta: slopes)


STATED = modal_tolerances(model_of((0, 0.02), (1, 0.3), (2, 0.03)))


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
    assert is_within_tolerance(term(name, **{key: 0.99 * limit}), STATED)
    assert not is_within_tolerance(term(name, **{key: 1.01 * limit}), STATED)
    nothing = modal_tolerances(model_of())
    assert not is_within_tolerance(term(name, **{key: 0.5 * limit}), nothing)


def test_several_parameters_combine_in_quadrature():
    mass, _, stiffness = modal_tolerances(model_of((0, 0.03), (0, 0.04), (2, 0.1)))
    assert mass == pytest.approx([0.1, 0.1])
    assert stiffness == pytest.approx([20.0, 80.0])


def test_a_nonlinear_law_has_no_tolerance():
    assert not is_within_tolerance(term("cubic-stiffness", k3=1e-6), STATED)


def test_a_small_linear_effect_stands_only_as_an_explanation():
    model = model_of((0, 0.02), (1, 0.3), (2, 0.03))
    whole = SimpleNamespace(problem=SimpleNamespace(reduced_model=model))
    small, large, law = term("added-mass", mass=0.01), term("added-mass", mass=1.0), term("coulomb-friction", force=1.0)

    def hypothesis(residual, *terms):
        return SimpleNamespace(normalised_residual=residual, long_fit=SimpleNamespace(terms=terms))

    partial = [hypothesis(5.0, small), hypothesis(5.0, law, small), hypothesis(5.0, large), hypothesis(5.0, law)]
    explaining = [hypothesis(1.0, small), hypothesis(1.0, law, small)]
    assert beyond_tolerance(whole, [*partial, *explaining], 1.2) == [*partial[2:], *explaining]
