"""What becomes of fits: laws whose values their words do not fit."""

from dataclasses import replace

import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.fits import as_meant, scored_by
from vlab.diagnose.prepare import prepare
from vlab.diagnose.refine import Refiner
from vlab.diagnose.screen import Screen
from vlab.diagnose.terms import Term
from vlab.physics.catalogue import EFFECTS


def test_a_gap_with_a_part_of_the_spring_is_fitted_on_from_the_whole_spring(tmp_path, monkeypatch):
    """Where the gap is a small part of the motion, a recording knows the force that is missing beyond it, stiffness times gap."""
    monkeypatch.setattr(rig_oscillator, "SECONDS", 2.0)
    rig = oscillator_case(tmp_path, effect="dead-band")
    problem = prepare(load_case(tmp_path))
    screen = Screen(problem)
    whole = Refiner(screen, problem.in_role("fit"))
    plain = whole.fit(())
    place = next(p for p in problem.places if p.name == rig.place)
    stiffness, gap = place.stiffness, rig.parameters["gap"]
    part = Term(effect=EFFECTS["dead-band"], place=place, values={"stiffness": 0.05 * stiffness, "gap": 20 * gap})
    set_ = Term(effect=EFFECTS["plastic-set"], place=place, values={"stiffness": 0.05 * stiffness, "yield": gap})
    hypotheses = [scored_by(whole, replace(plain, terms=(term,))) for term in (part, set_)]
    (found,) = as_meant(whole, hypotheses)  # nothing is known of the other law
    assert found.label == part.label
    values = found.long_fit.terms[0].values
    assert values["stiffness"] >= 0.5 * stiffness
    assert values["stiffness"] * values["gap"] == pytest.approx(stiffness * gap, rel=0.05)
    assert found.level < 0.5 * scored_by(whole, plain).level
