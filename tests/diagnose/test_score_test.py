"""The screening on short recordings of three masses: which effect, where, how large."""

from itertools import pairwise

import pytest
import rig_oscillator
from rigs import oscillator_case

from vlab.cases import load_case
from vlab.diagnose.inference.score_test import ScoreTest
from vlab.diagnose.predictors.modal_problem import prepare
from vlab.diagnose.search.shortlist import shortlisted
from vlab.physics.catalogue import EFFECTS

SOME = (
    "coulomb-friction",
    "quadratic-drag",
    "cubic-stiffness",
    "quadratic-cubic-stiffness",
    "dead-band",
    "one-sided-stiffness",
    "added-mass",
    "actuator-clipping",
    "actuator-gain",
    "sensor-gain",
)
"""What the tests choose from: a sample of all families, so that they stay short."""


def screened(folder, **given):
    """Return the rig, its screening and the candidates, best first."""
    rig = oscillator_case(folder, **given)
    screen = ScoreTest(prepare(load_case(folder)))
    return rig, screen, screen.candidates([EFFECTS[name] for name in SOME])


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    monkeypatch.setattr(rig_oscillator, "SECONDS", 2.0)


def test_the_names_are_the_catalogues():
    assert set(SOME) <= set(EFFECTS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "tolerance"),
    [
        ("coulomb-friction", 0.1),
        ("cubic-stiffness", 0.1),
        ("actuator-clipping", None),  # its limit is a shape, tried on a coarse grid
    ],
)
def test_the_hidden_effect_comes_first_at_its_place(tmp_path, effect, tolerance):
    rig, _, candidates = screened(tmp_path, effect=effect)
    assert all(a.log_likelihood_gain >= b.log_likelihood_gain for a, b in pairwise(candidates))
    first = shortlisted(candidates)[0]  # laws that contain another one gain as much as it and are left out
    assert first.label == f"{effect}@{rig.place}"
    elsewhere = [c for c in candidates if c.effect.name == effect and c.place.name != rig.place]
    assert all(c.log_likelihood_gain < first.log_likelihood_gain - 20 for c in elsewhere)  # odds of e^20 for the place
    if tolerance is not None:
        for name, true in rig.parameters.items():
            assert first.values[name] == pytest.approx(true, rel=tolerance)


@pytest.mark.slow
def test_a_shape_is_found_between_the_values_of_its_grid(tmp_path):
    rig, screen, candidates = screened(tmp_path, effect="actuator-clipping")
    first = next(c for c in candidates if c.effect.name == "actuator-clipping")
    sharp = screen.zoomed(first)
    assert sharp.log_likelihood_gain >= first.log_likelihood_gain
    true = rig.parameters["limit"]
    # two seconds with half a per cent of noise; the motor's gain alone, in proportion to which it is, is 2 % uncertain
    assert sharp.values["limit"] == pytest.approx(true, rel=0.02)
    assert abs(sharp.values["limit"] - true) < 0.5 * abs(first.values["limit"] - true)


@pytest.mark.slow
def test_the_effect_taken_as_present_leaves_nothing_to_the_others(tmp_path):
    _, screen, candidates = screened(tmp_path, effect="cubic-stiffness")
    first = next(c for c in candidates if c.effect.name == "cubic-stiffness")
    rest = screen.given([first])
    others = [c for c in rest.candidates([EFFECTS[name] for name in SOME]) if c.label != first.label]
    assert others[0].log_likelihood_gain < 0.05 * first.log_likelihood_gain
    _, (values,) = rest.estimate
    assert values["k3"] == pytest.approx(4e6, rel=0.1)


@pytest.mark.slow
def test_no_effect_of_the_whole_catalogue_comes_before_the_hidden_one(tmp_path):
    oscillator_case(tmp_path, effect="coulomb-friction")
    candidates = ScoreTest(prepare(load_case(tmp_path))).candidates(list(EFFECTS.values()))
    assert shortlisted(candidates)[0].label == "coulomb-friction@joint:mass2"
