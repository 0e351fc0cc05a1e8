"""Which candidates are tried first."""

from types import SimpleNamespace

from vlab.diagnose.second import best_of_families
from vlab.diagnose.shortlist import shortlisted
from vlab.diagnose.terms import Candidate
from vlab.physics.catalogue import EFFECTS


def candidate(name, gain, place="joint:a"):
    return Candidate(effect=EFFECTS[name], place=SimpleNamespace(name=place), values={}, gain=gain)


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
    assert names(best_of_families(table, EFFECTS["slew-limit"])) == ["coulomb-friction", "soft-saturation"]
    assert names(best_of_families(table, EFFECTS["smooth-friction"])) == ["rate-limit"]
