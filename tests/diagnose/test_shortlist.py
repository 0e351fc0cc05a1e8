"""Which candidates are tried first."""

from types import SimpleNamespace

from vlab.diagnose.parameters.terms import Candidate
from vlab.diagnose.search.second_effect import best_of_families
from vlab.diagnose.search.shortlist import shortlisted
from vlab.physics.catalogue import EFFECTS


def candidate(name, gain, place="joint:a"):
    return Candidate(effect=EFFECTS[name], place=SimpleNamespace(name=place), values={}, log_likelihood_gain=gain)


def names(candidates):
    return [c.effect.name for c in candidates]


def test_an_effect_goes_before_another_form_of_it_that_gains_little_more():
    near = [candidate("smooth-friction", 1000.0), candidate("coulomb-friction", 950.0)]
    assert names(shortlisted(near)) == ["coulomb-friction"]
    far = [candidate("smooth-friction", 1000.0), candidate("coulomb-friction", 500.0)]
    assert names(shortlisted(far)) == ["smooth-friction", "coulomb-friction"]
    elsewhere = [candidate("smooth-friction", 1000.0), candidate("coulomb-friction", 950.0, place="joint:b")]
    assert names(shortlisted(elsewhere)) == ["smooth-friction", "coulomb-friction"]


def test_beside_an_effect_no_other_form_of_it_is_a_second_one():
    table = [
        candidate("rate-limit", 300.0), candidate("smooth-friction", 200.0), candidate("coulomb-friction", 190.0),
        candidate("soft-saturation", 100.0),
    ]  # fmt: skip
    assert names(best_of_families(table, candidate("slew-limit", 0.0))) == ["coulomb-friction", "soft-saturation"]
    assert names(best_of_families(table, candidate("smooth-friction", 0.0))) == ["rate-limit"]


def test_two_laws_of_what_slips_at_one_place_are_one_friction():
    table = [
        candidate("jenkins-slip", 300.0),
        candidate("cubic-stiffness", 200.0),
        candidate("jenkins-slip", 100.0, "joint:b"),
    ]
    found = best_of_families(table, candidate("coulomb-friction", 0.0))
    assert [(c.effect.name, c.place.name) for c in found] == [
        ("cubic-stiffness", "joint:a"),
        ("jenkins-slip", "joint:b"),
    ]
