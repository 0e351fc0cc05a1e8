"""Linear effects beside the stated uncertainty of a model."""

from types import SimpleNamespace

import numpy as np
import pytest

from vlab.diagnose.inference.evidence import scored
from vlab.diagnose.inference.hypothesis_fits import with_tolerances
from vlab.diagnose.parameters.locations import Place
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.parameters.tolerance import is_within_tolerance, modal_tolerances
from vlab.physics.catalogue import EFFECTS

# two modes of unit mass at 10 and 20 rad/s; the port moves by half a metre per coordinate of the first one
OWN = (np.eye(2), np.diag([0.2, 0.4]), np.diag([100.0, 400.0]))
PLACE = Place(name="tip", kind="port", rows=np.array([[0.5, 0.1]]), stiffness=40.0)


def model_of(*stated):
    """Return a model with parameters that scale one of its matrices, mass, damping or stiffness."""
    slopes = [tuple(OWN[j] if j == kind else None for j in range(3)) for kind, _ in stated]
    changes = [SimpleNamespace(name="", sd=sd) for _, sd in stated]
    return SimpleNamespace(m=2, prior=np.zeros(len(stated)), changes=changes, slopes=lambda theta: slopes)


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


def hypothesis(residual, *terms):
    none, cost = np.zeros(0), residual**2
    fit = Fit(terms=terms, theta=none, offsets=none, starts={}, error=none, chi2=cost, cost=cost)
    return scored(fit, samples=1.0, effective_samples=20.0)


def settled(*hypotheses):
    """Return hypotheses by label, with small linear effects taken as tolerances."""
    model = model_of((0, 0.02), (1, 0.3), (2, 0.03))
    whole = SimpleNamespace(problem=SimpleNamespace(reduced_model=model))
    out = with_tolerances(whole, hypotheses[0], hypotheses[1:], 1.2, lambda terms, start: hypothesis(7.0, *terms))
    assert out[0].label == "nothing"
    return {h.label: h for h in out}


SMALL, LARGE = term("added-mass", mass=0.01), term("viscous-damping", damping=50.0)
FRICTION, SLIP = term("coulomb-friction", force=1.0), term("jenkins-slip", stiffness=1.0, limit=1.0)


def test_a_small_linear_effect_counts_for_the_model_without_it():
    paired = hypothesis(4.0, FRICTION, SMALL)
    found = settled(hypothesis(9.0), hypothesis(5.0, FRICTION), paired, hypothesis(8.0, SMALL), hypothesis(6.0, LARGE))
    assert set(found) == {"nothing", FRICTION.label, LARGE.label}
    assert found[FRICTION.label].score == pytest.approx(paired.score)
    assert [found[k].normalised_residual for k in ("nothing", FRICTION.label, LARGE.label)] == [8.0, 4.0, 6.0]
    assert found[FRICTION.label].long_fit.cost == 25.0  # the fit stays its own


def test_a_law_that_acts_as_a_small_stiffness_gains_nothing_beside_it():
    found = settled(
        hypothesis(9.0), hypothesis(5.0, FRICTION), hypothesis(3.9, FRICTION, SMALL), hypothesis(4.0, FRICTION, SLIP)
    )
    assert found[FRICTION.label].score > found[f"{FRICTION.label} + {SLIP.label}"].score


def test_a_small_linear_effect_stands_where_it_explains():
    found = settled(
        hypothesis(9.0), hypothesis(1.0, SMALL), hypothesis(1.1, FRICTION, SMALL), hypothesis(5.0, FRICTION)
    )
    assert {SMALL.label, f"{FRICTION.label} + {SMALL.label}", FRICTION.label} < set(found)
    assert found["nothing"].normalised_residual == 9.0
    assert found[FRICTION.label].normalised_residual == 5.0


def test_what_no_other_hypothesis_has_is_fitted_without_the_small_effect():
    found = settled(hypothesis(9.0), hypothesis(5.0, FRICTION), hypothesis(2.0, FRICTION, LARGE, SMALL))
    both = found[f"{FRICTION.label} + {LARGE.label}"]
    assert both.long_fit.cost == 49.0
    assert both.normalised_residual == 2.0
