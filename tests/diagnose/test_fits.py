"""What becomes of fits: laws whose values their words do not fit."""

from dataclasses import replace

import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.inference.hypothesis_fits import as_meant, scored_by
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.inference.window_least_squares import WindowLeastSquares
from vlab.diagnose.parameters.terms import Candidate, Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.permanent_change import find_permanent_changes
from vlab.physics.catalogue import EFFECTS


@pytest.mark.slow
def test_a_gap_with_a_part_of_the_spring_is_fitted_on_from_the_whole_spring(tmp_path, monkeypatch):
    """Where the gap is a small part of the motion, a recording knows the force that is missing beyond it, stiffness times gap."""
    monkeypatch.setattr(rig_oscillator, "SECONDS", 2.0)
    rig = oscillator_case(tmp_path, effect="dead-band")
    problem = prepare(load_case(tmp_path))
    screen = ScoreTest(problem)
    whole = LeastSquares(screen, problem.in_role("fit"))
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
    assert found.normalised_residual < 0.5 * scored_by(whole, plain).normalised_residual


@pytest.mark.slow
def test_an_event_that_windows_do_not_show_is_sought_in_whole_runs(tmp_path, monkeypatch):
    """Whichever values the screening has for it: a set is there in all that follows, and windows begin after it."""
    monkeypatch.setattr(rig_oscillator, "SECONDS", 2.0)
    rig = oscillator_case(tmp_path, effect="plastic-set", sensors="velocity", benign=0.2)
    problem = prepare(load_case(tmp_path))
    screen = ScoreTest(problem)
    whole = LeastSquares(screen, problem.in_role("fit"))
    windows = WindowLeastSquares(screen)
    plain = windows.fit(())
    places = [p for p in problem.places if p.stiffness > 0]
    nothing = {"stiffness": 1e-9, "yield": 1e9}
    candidates = [
        Candidate(effect=EFFECTS[n], place=p, values=nothing, log_likelihood_gain=0.0) for n in SOME for p in places
    ]
    found = find_permanent_changes(whole, windows, plain, candidates)
    assert found[0].label == f"plastic-set@{rig.place}"
    values = found[0].terms[0].values
    assert values["yield"] == pytest.approx(rig.parameters["yield"], rel=0.12)  # between two that are tried
    assert values["stiffness"] == next(p for p in places if p.name == rig.place).stiffness
    assert {h.terms[0].effect.name for h in found} == {"plastic-set"}
    assert (
        scored_by(whole, whole.fit(found[0].terms, found[0].fit)).normalised_residual
        < 0.5 * scored_by(whole, whole.fit(())).normalised_residual
    )


SOME = ("plastic-set", "jenkins-slip")
