"""What a smaller difference is worth, and when more physics is believed in."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vlab.diagnose.advice import next_measurement
from vlab.diagnose.inference.evidence import Found, Hypothesis, effective_sample_size, scored, weighed
from vlab.diagnose.inference.model_choice import choose_model, is_plausible_alone, is_prior_driven
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.search.limits import Limits
from vlab.diagnose.search.second_effect import violate_priors
from vlab.diagnose.settings import EVIDENCE, MODEL_CHOICE, SECOND_EFFECT
from vlab.physics.catalogue import EFFECTS


def hypothesis(level, *names, negative_log_prior=0.0, effective_samples=EVIDENCE.model_error_samples, **values):
    place = SimpleNamespace(name="joint:a")
    terms = tuple(Term(effect=EFFECTS[name], place=place, values=values) for name in names)
    none = np.zeros(0)
    fit = Fit(terms=terms, theta=none, offsets=none, starts={}, error=none, chi2=1.0, cost=1.0, sd={})
    return Hypothesis(
        fit=fit,
        normalised_residual=level,
        log_rms_residual=float(np.log(level)),
        negative_log_prior=negative_log_prior,
        effective_samples=effective_samples,
    )


def chosen(before, *others):
    return [t.effect.name for t in choose_model(Found(before=before, hypotheses=others)).best.terms]


def test_noise_averages_out_and_a_models_own_error_does_not():
    noisy = [hypothesis(1.0), hypothesis(1.05)]
    assert weighed(noisy, 1.0, 0.0, 30_000)[0].effective_samples == pytest.approx(30_000)  # nothing is left but noise
    assert weighed(noisy, 1.0, 0.025, 30_000)[0].effective_samples == pytest.approx(
        1.025 / (1 / 30_000 + 0.025 / EVIDENCE.model_error_samples)
    )
    far = weighed([hypothesis(20.0), hypothesis(30.0)], 1.0, 0.0, 30_000)[0].effective_samples
    assert far == pytest.approx(EVIDENCE.model_error_samples, rel=0.01)  # what the best one leaves is the model's error
    assert (
        weighed(noisy, 1.0, 0.0, EVIDENCE.model_error_samples)[0].effective_samples == EVIDENCE.model_error_samples
    )  # few values: frequency responses


def test_recordings_count_all_samples_of_noise_and_few_of_an_error():
    assert effective_sample_size(1.0, 0.0, 30_000) == pytest.approx(30_000)
    assert effective_sample_size(0.0, 1.0, 30_000) == pytest.approx(EVIDENCE.model_error_samples)
    assert (
        effective_sample_size(1.0, 0.01, 30_000) < 0.5 * 30_000
    )  # an error of a tenth of the noise is soon all that matters


def test_a_second_effect_is_sought_where_the_first_takes_a_parameter_that_nobody_believes():
    prior = np.array([0.02, 0.05])

    def single(off, level=1.0):
        found = hypothesis(level, "coulomb-friction", force=1.0)
        return replace(found, fit=replace(found.fit, theta=off * prior))

    def wants(*fitted):
        return violate_priors(fitted, usual=2, prior=prior)

    assert not wants(single(np.array([1.0, 2.0])))
    assert wants(single(np.array([0.0, -SECOND_EFFECT.outlying - 0.1])))
    assert wants(
        single(np.zeros(2)), single(np.array([SECOND_EFFECT.outlying + 0.1, 0.0]), level=0.97)
    )  # the closest as well as the best
    assert not wants(single(np.zeros(2)), single(np.array([SECOND_EFFECT.outlying + 0.1, 0.0]), level=1.5))
    assert not wants(
        single(np.zeros(2)), single(np.array([SECOND_EFFECT.outlying + 0.1, 0.0]), level=0.995)
    )  # hardly closer


def test_most_of_a_gain_may_be_what_priors_ask_for():
    plain = hypothesis(1.01, negative_log_prior=30.0)
    assert is_prior_driven(hypothesis(1.0, "added-mass", mass=0.1, negative_log_prior=2.0), plain)
    assert not is_prior_driven(hypothesis(0.5, "added-mass", mass=0.1, negative_log_prior=2.0), plain)


def test_the_largest_of_many_deviations_asks_for_no_effect():
    """Of 31 standard normals the largest exceeds 3.3, or 5.5 nat of prior density, once in 35; of one, once in 1100."""
    more = hypothesis(1.0, "rotary-inertia", inertia=0.06)
    one = hypothesis(1.0, negative_log_prior=5.5)
    many = replace(one, fit=replace(one.fit, information=np.full(62, 0.5)))
    assert is_prior_driven(more, one)
    assert not is_prior_driven(more, many)
    assert is_prior_driven(more, replace(many, negative_log_prior=7.0))


def test_an_effect_that_frees_a_parameter_of_six_deviations_is_needed_however_well_it_fits():
    calibrated = hypothesis(1.0, negative_log_prior=0.5 * 6.0**2)
    for level in (1.0, 0.1):
        assert is_plausible_alone(
            hypothesis(level, "servo-position-gain", gain=-0.3, negative_log_prior=2.0), calibrated
        )
    usual = hypothesis(1.0, negative_log_prior=0.5 * 3.0**2)
    assert not is_plausible_alone(hypothesis(0.1, "servo-position-gain", gain=-0.3), usual)


def test_to_leave_less_than_integration_does_is_no_merit():
    alike = weighed([hypothesis(0.1), hypothesis(0.2), hypothesis(0.4)], 0.01, 0.05, 30_000, 0.06)
    np.testing.assert_allclose([h.log_rms_residual for h in alike], np.log([0.07**0.5, 0.07**0.5, 0.4]))


def test_a_law_whose_size_may_as_well_be_none_is_nil():
    place, none = SimpleNamespace(name="joint:a"), np.zeros(0)
    slip = Term(effect=EFFECTS["jenkins-slip"], place=place, values={"force": 3e-11, "slip": 5e5})
    offset = Term(effect=EFFECTS["force-offset"], place=place, values={"force": -0.2})
    sd = {"jenkins-slip@joint:a:force": 30.0, "jenkins-slip@joint:a:slip": 0.1, "force-offset@joint:a:force": 0.05}
    fit = Fit(terms=(slip, offset), theta=none, offsets=none, starts={}, error=none, chi2=1.0, cost=1.0, sd=sd)
    assert fit.unidentified == ("jenkins-slip@joint:a",)


def test_a_law_of_which_a_part_is_nothing_is_the_plainer_one():
    place, none = SimpleNamespace(name="joint:a"), np.zeros(0)

    def fit(values, sd, name="stribeck-friction"):
        term = Term(effect=EFFECTS[name], place=place, values=values)
        spread = {f"{term.label}:{p}": s for p, s in sd.items()}
        return Fit(terms=(term,), theta=none, offsets=none, starts={}, error=none, chi2=1.0, cost=1.0, sd=spread)

    (plain,) = fit({"force": 0.6, "excess": 1e-20, "speed": 0.02}, {}).nested_model(list(EFFECTS.values()))
    assert plain.label == "coulomb-friction@joint:a"
    assert plain.values == {"force": 0.6}
    both = fit({"force": 0.6, "excess": 0.1, "speed": 0.02}, {"force": 0.1, "excess": 0.3})
    assert both.nested_model(list(EFFECTS.values())) == both.terms
    (cubic,) = fit({"k2": 3.0, "k3": 50.0}, {"k2": 5.0, "k3": 2.0}, "quadratic-cubic-stiffness").nested_model(
        list(EFFECTS.values())
    )
    assert cubic.label == "cubic-stiffness@joint:a"


def test_one_drive_at_its_limit_comes_before_all_of_them():
    """Where the others never reach it, both leave the same."""
    none = np.zeros(0)

    def at(*also):
        place = SimpleNamespace(name="somewhere", also=also, is_held=True)
        term = Term(effect=EFFECTS["actuator-clipping"], place=place, values={"limit": 2.0})
        fit = Fit(terms=(term,), theta=none, offsets=none, starts={}, error=none, chi2=1.0, cost=1.0)
        return scored(fit, 100, 100).score

    assert at() > at(1) + MODEL_CHOICE.alike


def test_hypotheses_keep_their_order_where_they_have_as_many_parameters():
    three = [hypothesis(x, "added-mass") for x in (1.02, 1.0, 1.3)]
    assert (
        np.argsort([h.score for h in three]).tolist()
        == np.argsort([h.score for h in weighed(three, 1, 0, 1e4)]).tolist()
    )


def test_a_single_finding_comes_with_a_test_that_could_refute_it():
    """Every family of effects has one of its own."""
    said = {}
    for name, effect in EFFECTS.items():
        found = Found(before=hypothesis(900.0), hypotheses=(hypothesis(1.0, name, frequency=3.0),))
        assert chosen(found.before, *found.hypotheses) == [name]
        said.setdefault(effect.family, set()).add(next_measurement(choose_model(found), "missing-physics"))
    assert all(len(words) == 1 for words in said.values())
    assert len(set.union(*said.values())) == len(said)


@pytest.mark.parametrize(("saved", "is_found"), [(5.5, False), (6.5, True)])
@pytest.mark.parametrize("effect", ["added-mass", "coulomb-friction"])
def test_parameters_that_nobody_believes_are_as_good_as_a_misfit(effect, saved, is_found):
    """A nonlinear law may absorb errors of the model, but no such error moves a parameter far from its prior."""
    before = hypothesis(1.0, negative_log_prior=20.0)
    assert chosen(before, hypothesis(1.0, effect, negative_log_prior=20.0 - saved)) == ([effect] if is_found else [])


def test_a_nonlinear_law_needs_more_likelihood_than_a_linear_one():
    before = hypothesis(1.0)
    level = float(np.exp(-8.0 / before.effective_samples))  # 8 nat
    assert chosen(before, hypothesis(level, "added-mass")) == ["added-mass"]
    assert chosen(before, hypothesis(level, "coulomb-friction")) == []


def test_a_force_at_the_mains_frequency_is_not_believed_for_its_likelihood_alone():
    before = hypothesis(1.02, effective_samples=5000.0)
    for hz, is_found in ((50.2, False), (100.0, False), (60.0, False), (47.0, True)):
        force = hypothesis(1.01, "sinusoidal-force", effective_samples=5000.0, frequency=hz)
        assert chosen(before, force) == (["sinusoidal-force"] if is_found else [])
    loud = hypothesis(9.0, effective_samples=5000.0)
    assert chosen(loud, hypothesis(1.0, "sinusoidal-force", effective_samples=5000.0, frequency=50.0)) == [
        "sinusoidal-force"
    ]


def test_a_spring_that_bends_about_no_rest_position_is_believed_last():
    none = np.zeros(0)

    def negative_log_prior(name, is_held):
        place = SimpleNamespace(name="joint:a", is_held=is_held, also=())
        term = Term(effect=EFFECTS[name], place=place, values={})
        fit = Fit(terms=(term,), theta=none, offsets=none, starts={}, error=none, chi2=1.0, cost=1.0, sd={})
        return scored(fit, 1.0, 1e4).negative_log_prior

    for name, is_odd in (
        ("cubic-stiffness", True),
        ("magnetic-negative-stiffness", True),
        ("stiffness-to-ground", False),
    ):
        assert negative_log_prior(name, True) == 0.0
        assert (negative_log_prior(name, False) > 30.0) == is_odd


def test_two_effects_are_believed_that_only_explain_together():
    before, alone = hypothesis(60.0), hypothesis(52.0, "coulomb-friction")  # one takes off a quarter of the excess
    assert chosen(before, alone) == []
    assert chosen(before, alone, hypothesis(5.0, "coulomb-friction", "force-offset")) == [
        "coulomb-friction",
        "force-offset",
    ]
    assert chosen(before, alone, hypothesis(40.0, "coulomb-friction", "force-offset")) == []  # half of it is not enough


def test_every_effect_has_the_probability_of_all_pairs_that_it_is_in():
    before = hypothesis(9.0)
    one, two = hypothesis(3.0, "added-mass"), hypothesis(1.0, "added-mass", "cubic-stiffness")
    other = hypothesis(1.01, "added-mass", "stop")
    choice = choose_model(Found(before=before, hypotheses=(one, two, other)))
    assert choice.shares["added-mass"] == pytest.approx(1.0 - MODEL_CHOICE.lapse)  # the rest is for what was not tried
    assert choice.shares["cubic-stiffness"] == pytest.approx(choice.probability)
    assert 0.4 < choice.probability < 0.95


def test_two_forms_of_the_same_physics_do_not_compete():
    """Which one it is may be open: that it is dry friction is not."""
    forms = hypothesis(1.0, "smooth-friction"), hypothesis(1.0001, "coulomb-friction")
    choice = choose_model(Found(before=hypothesis(9.0), hypotheses=(*forms, hypothesis(3.0, "jenkins-slip"))))
    assert choice.probability == pytest.approx(1.0 - MODEL_CHOICE.lapse)
    assert choice.shares == {"coulomb-friction": pytest.approx(1.0 - MODEL_CHOICE.lapse)}
    assert [h.terms[0].effect.name for h, _ in choice.ranking if h.terms] == ["jenkins-slip"]


def test_a_parameter_of_few_values_costs_no_more_than_their_number():
    """A delay is told to a part of what it might be; of whole samples that are held 400 are tried.

    Up to 160 000 independent samples a hold is as dear as a delay, so that it cannot stand for one at equal residuals.
    """
    hold, delay = (hypothesis(1.0, name, effective_samples=1e8) for name in ("actuator-hold", "actuator-delay"))
    assert delay.score == pytest.approx(-0.5 * np.log(1e8))
    assert hold.score == pytest.approx(-np.log(400))
    hold, delay = (hypothesis(1.0, name, effective_samples=1e4) for name in ("actuator-hold", "actuator-delay"))
    assert hold.score == pytest.approx(delay.score)
    few = hypothesis(1.0, "actuator-hold", effective_samples=9.0)
    assert few.score == pytest.approx(-np.log(3))


def test_a_law_in_all_joints_is_chosen_though_no_smaller_set_leads_to_it():
    """Friction in six joints: one joint alone explains little, and sets of three to five effects were not fitted."""
    everywhere = hypothesis(1.2, *["coulomb-friction"] * 6, force=1.0)
    one = hypothesis(44.0, "coulomb-friction", force=1.0)
    pair = hypothesis(33.0, "coulomb-friction", "servo-error-dead-zone", force=1.0)
    before = hypothesis(57.0)
    for others in ((everywhere, pair, one), (everywhere, one), (everywhere,)):
        assert chosen(before, *others) == ["coulomb-friction"] * 6
    mixed = hypothesis(1.2, *["coulomb-friction"] * 5, "smooth-friction", force=1.0)  # one of the forms made plainer
    assert len(chosen(before, mixed, pair, one)) == 6
    useless = hypothesis(32.9, *["coulomb-friction"] * 6, force=1.0)  # further joints must pay
    assert len(chosen(before, pair, useless, one)) < 6


def test_a_law_in_all_drives_stands_beside_two_other_effects():
    """Weak servos look like a mass and a lag. The law has more parameters, and its prior density is larger by 14 nat."""
    drives = hypothesis(1.1, *["servo-position-gain"] * 6, gain=-0.3, negative_log_prior=8.0)
    pair = hypothesis(1.2, "added-mass", "actuator-lag", negative_log_prior=22.0)
    one = hypothesis(2.0, "added-mass", negative_log_prior=24.0)
    before = hypothesis(2.7, negative_log_prior=35.0)
    assert chosen(before, drives, pair, one) == ["servo-position-gain"] * 6
    unlikely = hypothesis(1.1, *["servo-position-gain"] * 6, gain=-0.3, negative_log_prior=24.0)
    assert chosen(before, unlikely, pair, one) == ["added-mass", "actuator-lag"]


def test_noise_ends_a_search_only_where_no_effect_explains_it():
    before, limits = hypothesis(5.5), Limits(is_noise=lambda fit: True)
    useless, found = hypothesis(5.4, "servo-error-dead-zone"), hypothesis(3.9, "servo-error-dead-zone")
    assert limits.forbid_more(before, [useless], 1.3)
    assert not limits.forbid_more(before, [found, useless], 1.3)
    assert not Limits().forbid_more(before, [useless], 1.3)
    assert Limits(is_single=True).forbid_more(before, [found], 1.3)
