"""The search and the choice on short recordings: nothing where nothing is missing, the effect where one is."""

import pytest
import rig_oscillator
from rigs import oscillator_case

import vlab
from vlab.cases import load_case
from vlab.diagnose.advice import scope_note
from vlab.diagnose.inference.model_choice import choose_model
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.selection import search
from vlab.errors import BadCase
from vlab.physics.catalogue import CANDIDATES, EFFECTS

SOME = ("coulomb-friction", "cubic-stiffness", "quadratic-drag", "added-mass", "actuator-clipping", "sensor-gain")


def found(folder, **given):
    rig = oscillator_case(folder, **given)
    return rig, search(ScoreTest(prepare(load_case(folder))), [EFFECTS[name] for name in SOME])


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 2.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_nothing_is_said_where_nothing_is_missing(tmp_path, seed):
    _, result = found(tmp_path, effect="none", seed=seed)
    choice = choose_model(result)
    assert choice.best is result.before
    assert choice.places == {}
    assert result.before.normalised_residual < 1.3  # the refitted model leaves the noise
    # The likeliest of some 100 columns of noise gains about ln(100) = 5, wrong priors some more; hidden effects hundreds.
    assert result.candidates[0].log_likelihood_gain < 20


@pytest.mark.slow
def test_the_hidden_effect_is_chosen_at_its_place_with_its_value(tmp_path):
    rig, result = found(tmp_path, effect="coulomb-friction")
    choice = choose_model(result)
    assert [t.label for t in choice.best.terms] == [f"coulomb-friction@{rig.place}"]
    # the motor's gain alone is 2 % uncertain, and friction is in proportion to it
    assert choice.best.terms[0].values["force"] == pytest.approx(rig.parameters["force"], rel=0.05)
    assert result.before.normalised_residual > 1.3
    assert (
        choice.best.normalised_residual < 1.7
    )  # 0.9 % of the motion, where the noise is half a per cent; the rig sticks between samples, too
    assert next(iter(choice.places)) == rig.place
    assert sum(choice.places.values()) == pytest.approx(1.0)
    assert choice.probability > 0.9


def test_a_search_of_nothing_is_refused(tmp_path):
    case = load_case(oscillator_case(tmp_path, effect="cubic-stiffness").folder)
    with pytest.raises(BadCase, match="stop cannot act at sensor:.*nothing would be searched"):
        vlab.diagnose(case, only=["stop"], at=[next(p.name for p in prepare(case).places if p.kind == "sensor")])


def test_a_restricted_search_says_what_was_left_out():
    assert scope_note(CANDIDATES, ()) == ()
    (note,) = scope_note([EFFECTS["stop"]], ["joint:elbow"])
    left_out = f"{len(CANDIDATES) - 1} of {len(CANDIDATES)} effects of the catalogue"
    assert note == f"not searched, as asked: {left_out} and all places but joint:elbow"
