"""The fewest effects that predict hold-out recordings as well, and no effects of improbable families."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_graded import choice
from test_honest_gap import distance, fit_of, hypothesis, part

from vlab.diagnose.diagnosis import Attempt
from vlab.diagnose.search.attempt import Trials

SAMPLES = 400
"""Of the one hold-out recording."""
FRICTION, MASS = "coulomb-friction", "added-mass"


class Held(Trials):
    """Trials on one hold-out recording whose error follows from the number of effects."""

    left: dict

    def of(self, fit, terms):
        return attempt_of(fit, self.left[len(fit.terms)])


def attempt_of(fit, after, information=1e4):
    parts = tuple(part(information, name=t.label) for t in fit.terms)
    checked = distance(after=after, parts=parts)
    object.__setattr__(checked, "measured", np.zeros(SAMPLES))
    return Attempt(findings=(), checked=(checked,), fit=fit)


def trials(left) -> Held:
    made = Held(problem=None, seen=None, runs=[SimpleNamespace(name="run")], before=None, nominal=None)
    object.__setattr__(made, "left", left)
    return made


def refit(terms, start):
    return fit_of(*terms)


BOTH, ONE = hypothesis(1.0, FRICTION, MASS), hypothesis(1.2, FRICTION)


@pytest.mark.parametrize(
    ("both", "alone", "count"),
    [
        # residuals of an error of the model, beyond the noise of .01: 40 samples count, and 3 nat are 7.8 %
        (0.1, 0.107, 1),
        (0.1, 0.109, 2),
        # residuals of noise: all samples count, and 3 nat of 400 are .75 %
        (0.01, 0.01005, 1),
        (0.01, 0.0102, 2),
    ],
)
def test_effects_that_predict_nothing_are_not_reported(both, alone, count):
    held = trials({2: both, 1: alone})
    best = attempt_of(BOTH.fit, both)
    assert len(held.plainest(best, [BOTH, ONE], refit, lambda fit: [], lambda a: True).fit.terms) == count
    assert held.plainest(best, [BOTH, ONE], refit, lambda fit: [], lambda a: False) is best


def test_an_effect_that_implausible_parameters_can_replace_stays():
    def moved(terms, start):
        return replace(
            fit_of(*terms), chi2=101.0, information=np.ones(4)
        )  # 100 of chi-squared with 4 degrees of freedom

    best = attempt_of(BOTH.fit, 0.1)
    assert trials({2: 0.1, 1: 0.1}).plainest(best, [BOTH, ONE], moved, lambda fit: [], lambda a: True) is best


def test_an_effect_without_hold_out_data_stays():
    best = attempt_of(BOTH.fit, 0.1, information=0.0)
    assert trials({2: 0.1, 1: 0.1}).plainest(best, [BOTH, ONE], refit, lambda fit: [], lambda a: True) is best


def test_improbable_families_are_left_out_where_the_rest_stands():
    best, held = attempt_of(BOTH.fit, 0.1), trials({2: 0.1, 1: 0.12})
    of = choice(coulomb_friction=0.9, added_mass=0.05)
    (left,) = held.probable(best, of, refit, lambda fit: [], lambda a: True).fit.terms
    assert left.effect.name == FRICTION
    assert held.probable(best, of, refit, lambda fit: [], lambda a: False) is best
    assert held.probable(best, choice(iwan_slip=0.9), refit, lambda fit: [], lambda a: True) is best
    weak = choice(coulomb_friction=0.4, iwan_slip=0.6)  # another family, but of the attempt's effects this one leads
    (left,) = held.probable(best, weak, refit, lambda fit: [], lambda a: True).fit.terms
    assert left.effect.name == FRICTION
