"""The choice settled: laws that MuJoCo confirms are kept, those in vain are dropped, and why is said."""

from dataclasses import replace

import numpy as np
import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.data.quality import DataQuality
from vlab.diagnose.data_findings import DataFindings
from vlab.diagnose.inference.hypothesis_fits import by_score, scored_by
from vlab.diagnose.inference.least_squares import LeastSquares
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.parameters.terms import Term
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.confirmation import Confirmation, _dropped, _instead, _without
from vlab.diagnose.search.selection import TimeFound
from vlab.diagnose.validation.simulation import check
from vlab.physics.catalogue import EFFECTS

K3 = rig_oscillator.EFFECTS["cubic-stiffness"].parameters["k3"]


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Return a problem with a cubic spring hidden in it, its fits over whole runs, and that of nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_oscillator, "SECONDS", 2.0)
        rig = oscillator_case(tmp_path_factory.mktemp("rig"), effect="cubic-stiffness")
        problem = prepare(load_case(rig.folder))
    screen = ScoreTest(problem)
    whole = LeastSquares(screen, problem.in_role("fit"))
    return problem, screen, whole, whole.fit(())


@pytest.fixture(scope="module")
def confirmation(rig):
    problem, _, whole, plain = rig
    seen = DataFindings(
        limit=None,
        stops=(),
        steps=(),
        interferences=(),
        benign_interferences=(),
        damage=DataQuality(fatal=(), warnings=(), notes=()),
    )
    return Confirmation(
        problem=problem, whole=whole, start=plain, seen=seen, effects=tuple(EFFECTS.values()), is_linear=True
    )


def term(problem, name, place="tendon:spring2", **values):
    return Term(effect=EFFECTS[name], place=next(p for p in problem.places if p.name == place), values=values)


@pytest.fixture(scope="module")
def fitted(rig):
    """Return fits of hypotheses by their names, each made once."""
    _, _, whole, plain = rig
    known = {}

    def of(*terms):
        key = tuple(t.label for t in terms)
        if key not in known:
            fit = whole.fit(terms, replace(plain, terms=terms))
            known[key] = replace(scored_by(whole, fit), whole=fit)
        return known[key]

    return of


def found_of(rig, *hypotheses) -> TimeFound:
    problem, screen, whole, plain = rig
    return TimeFound(
        problem=problem,
        screen=screen,
        windows=whole,
        whole=whole,
        before=replace(scored_by(whole, plain), whole=plain),
        hypotheses=tuple(by_score(hypotheses)),
    )


def misled(hypothesis, by):
    """Return a hypothesis that a search believes by so much more than its fit deserves."""
    return replace(
        hypothesis,
        log_rms_residual=hypothesis.log_rms_residual - by,
        normalised_residual=hypothesis.normalised_residual * float(np.exp(-by)),
    )


# ---- what is settled ------------------------------------------------------------------------------------------------


def test_a_law_that_mujoco_confirms_is_settled_as_it_was_found(rig, confirmation, fitted):
    problem = rig[0]
    cubic = fitted(term(problem, "cubic-stiffness", k3=K3))
    done = confirmation.confirm(found_of(rig, cubic, fitted(term(problem, "cubic-stiffness", "tendon:spring3", k3=K3))))
    assert done.choice.best.label == cubic.label
    assert done.rejected == ()
    assert done.after.terms[0].values["k3"] == pytest.approx(K3, rel=0.15)
    (run,) = check(problem.runs[-1:], *confirmation._models(done))
    assert run.after < 0.3 * run.before  # MuJoCo's own run of it, beside that of the refitted model


@pytest.mark.slow
def test_a_law_that_only_the_search_believes_gives_way_to_the_next(rig, confirmation, fitted):
    """The same law at the wrong spring leaves most of the gap in MuJoCo."""
    problem = rig[0]
    wrong = misled(fitted(term(problem, "cubic-stiffness", "tendon:spring3", k3=K3)), by=6.0)
    right = fitted(term(problem, "cubic-stiffness", k3=K3))
    done = confirmation.confirm(found_of(rig, wrong, right))
    assert done.choice.best.label == right.label
    assert done.rejected == (f"{wrong.label}: its law fits in the reduced model, but not in MuJoCo; dropped",)


@pytest.mark.parametrize("noise", [False, True])
def test_mujoco_decides_between_rivals_that_leave_more_than_noise(rig, confirmation, fitted, noise):
    """A wrong law with a little more evidence gives way along a motion, unless its fit leaves noise alone."""
    problem, along = rig[0], replace(confirmation, is_linear=False)
    right = replace(fitted(term(problem, "cubic-stiffness", k3=K3)), normalised_residual=3.0)
    wrong = replace(misled(fitted(term(problem, "viscous-damping", damping=1.0)), by=6.0), normalised_residual=2.9)
    if noise:
        wrong = replace(wrong, normalised_residual=1.0)
    assert wrong.score > right.score
    done = along.confirm(found_of(rig, wrong, right))
    assert done.choice.best.label == (wrong if noise else right).label
    assert done.rejected == (
        () if noise else (f"{wrong.label}: the residual in MuJoCo is smaller with {right.label}; dropped",)
    )


@pytest.mark.slow
def test_where_mujoco_confirms_none_the_first_is_reported_and_not_among_the_dropped(rig, confirmation, fitted):
    problem = rig[0]
    first, second = (
        misled(fitted(term(problem, "cubic-stiffness", place, k3=K3)), by)
        for place, by in (("tendon:spring3", 8.0), ("joint:mass1", 5.0))
    )
    done = confirmation.confirm(found_of(rig, first, second))
    assert done.choice.best.label == first.label
    assert done.after.terms[0].label == first.label
    assert done.rejected == (f"{second.label}: its law fits in the reduced model, but not in MuJoCo; dropped",)


def test_a_law_of_which_the_last_fit_leaves_nothing_is_dropped(rig, confirmation, fitted):
    """Of a drag that the rig does not have, however much the search believes in it."""
    drag = misled(fitted(term(rig[0], "quadratic-drag", "joint:mass1", coefficient=0.1)), by=6.0)
    done = confirmation.confirm(found_of(rig, drag))
    assert done.choice.best.terms == ()
    assert done.rejected == (f"{drag.label}: of {drag.label} the last fit leaves nothing; dropped",)


def test_nothing_is_settled_as_nothing(rig, confirmation, fitted):
    """Its model before and after is the same one."""
    weak = fitted(term(rig[0], "quadratic-drag", "joint:mass1", coefficient=0.1))
    found = found_of(rig)
    done = confirmation.confirm(
        replace(found, hypotheses=(replace(weak, log_rms_residual=9.0, normalised_residual=float(np.exp(9.0))),))
    )
    assert done.choice.best is found.before
    assert done.after is done.before
    assert done.after.terms == ()
    assert done.rejected == ()


def test_a_part_of_a_pair_that_is_nothing_is_dropped_and_the_rest_stays(rig, confirmation, fitted):
    """Dry friction that the rig does not have, beside the spring that it has."""
    problem = rig[0]
    both = fitted(
        term(problem, "cubic-stiffness", k3=K3), term(problem, "jenkins-slip", "joint:mass3", force=1e-9, slip=1e3)
    )
    alone = fitted(term(problem, "cubic-stiffness", k3=K3))
    pair = misled(both, by=8.0)
    done = confirmation.confirm(
        found_of(
            rig,
            replace(
                alone,
                log_rms_residual=alone.log_rms_residual + 1.0,
                normalised_residual=alone.normalised_residual * np.e,
            ),
            pair,
        )
    )
    assert done.choice.best.label == alone.label
    assert any(line.startswith(both.label) for line in done.rejected)
    assert done.after.terms[0].values["k3"] == pytest.approx(K3, rel=0.15)


def test_the_plainer_of_two_laws_that_explain_as_much_is_kept(rig, confirmation, fitted):
    """The square of the displacement adds nothing to its cube here."""
    problem = rig[0]
    wider = fitted(term(problem, "quadratic-cubic-stiffness", k2=10.0, k3=K3))
    done = confirmation.confirm(found_of(rig, wider))
    assert done.choice.best.label == "cubic-stiffness@tendon:spring2"
    assert [t.effect.name for t in done.after.terms] == ["cubic-stiffness"]


def test_the_plainer_law_takes_the_place_of_the_wider_one(rig, confirmation, fitted):
    """It is not left to the scores which of two equals is kept."""
    wider = fitted(term(rig[0], "quadratic-cubic-stiffness", k2=10.0, k3=K3))
    out = confirmation._simpler(found_of(rig, wider), wider, confirmation._exactly(wider))
    assert [h.label for h in out.hypotheses] == ["cubic-stiffness@tendon:spring2"]


def test_a_law_that_needs_all_its_parts_is_not_made_plainer(rig, confirmation, fitted):
    """The cube alone stays a cube: of a plainer law the recordings would leave much more."""
    cubic = fitted(term(rig[0], "cubic-stiffness", k3=K3))
    found = found_of(rig, cubic)
    assert confirmation._simpler(found, cubic, cubic.fit) is found


# ---- its parts ------------------------------------------------------------------------------------------------------


def test_a_hypothesis_stands_in_the_place_of_others_in_the_order_of_scores(rig, fitted):
    problem = rig[0]
    first, second = (
        fitted(term(problem, "cubic-stiffness", place, k3=K3)) for place in ("tendon:spring2", "tendon:spring3")
    )
    found = found_of(rig, first, second)
    own = misled(second, by=20.0)
    out = _instead(found, own, [second])
    assert out.hypotheses == (own, first)
    assert found.hypotheses[0] is first  # the given one is the same


def test_what_is_left_out_takes_along_what_adds_to_the_rest_of_it(rig, fitted):
    """Where a part of a pair is nothing, so it is in any larger set that holds the rest."""
    problem = rig[0]
    one = term(problem, "cubic-stiffness", k3=K3)
    slip = term(problem, "jenkins-slip", "joint:mass3", force=1e-9, slip=1e3)
    single, pair = fitted(one), fitted(one, slip)
    other = fitted(term(problem, "cubic-stiffness", "tendon:spring3", k3=K3))
    found = found_of(rig, single, pair, other)
    assert set(_without(found, pair).hypotheses) == {single, other}
    assert set(_without(found, pair, [slip.label]).hypotheses) == {single, other}
    again = replace(pair, log_likelihood_gain=1.0)
    both = replace(found, hypotheses=(single, pair, again, other))
    assert set(_without(both, pair).hypotheses) == {single, again, other}
    assert set(_without(both, pair, [slip.label]).hypotheses) == {single, other}


def test_what_was_dropped_is_said_with_its_reason():
    assert _dropped([("a@b", "it does nothing")]) == ("a@b: it does nothing; dropped",)
    assert _dropped([]) == ()
