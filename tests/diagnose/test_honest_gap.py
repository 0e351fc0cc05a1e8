"""The gap counts from the better of two models, a finding is verified where it does something, and attempts are kept."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from rig_folder import Rig
from rig_stop import GAP, STOP, stop_case

from vlab.cases import load_case
from vlab.cli.diagnose import _text
from vlab.diagnose.advice import diverged_note, fit_note, format_probability, notes_on_models, refuted_note, spoilt_note
from vlab.diagnose.diagnosis import Attempt, Diagnosis, Finding, errors_to_json
from vlab.diagnose.findings import alternatives, by_what_they_explain
from vlab.diagnose.inference.evidence import Found, Hypothesis
from vlab.diagnose.inference.model_choice import choose_model
from vlab.diagnose.model_kinds.mjcf_model import MjcfModel
from vlab.diagnose.parameters.terms import Fit, Term
from vlab.diagnose.pipeline import diagnose
from vlab.diagnose.search.attempt import best_attempt, further_attempts
from vlab.diagnose.search.confirmation import Confirmation
from vlab.diagnose.settings import ATTEMPT, EVIDENCE, MODEL_CHOICE
from vlab.diagnose.validation.checked import Checked
from vlab.diagnose.validation.gap import Distance, Part, part_of, whole_gap
from vlab.diagnose.validation.simulation import Ablations, ExtendedModel, check, spread_over
from vlab.diagnose.verdict import closes_gap, decide_verdict, unproven_note
from vlab.physics.attach import Attached, attach
from vlab.physics.catalogue import EFFECTS
from vlab.signals import Channel, Recording


def distance(*, nominal=0.5, calibrated=0.4, after=0.02, noise=0.01, name="run", role="holdout", **others):
    """How far three models are from one recording, as `check` has it."""
    before = min(nominal, calibrated)
    return Distance(
        name=name, role=role, nominal=nominal, before=before, after=after, noise=noise, calibrated=calibrated,
        channels={"y": (nominal, before, after, noise)}, **others,
    )  # fmt: skip


def part(information, left=0.4, name="stop at joint:a"):
    return Part(name=name, left=left, information=information)


NONE = np.zeros(0)


def fit_of(*terms, cost=1.0, **sd):
    return Fit(terms=terms, theta=NONE, offsets=NONE, starts={}, error=NONE, chi2=cost, cost=cost, sd=sd)


def finding(effect="stop", place="joint:a", **values):
    return Finding(
        effect=effect, form=effect, family="contact", place=place, places_90=(place,), probability=0.96, alike=(effect,),
        parameters={k: {"value": v, "unit": "N", "ci90": [v, v]} for k, v in values.items()}, law="F", words="w",
    )  # fmt: skip


def test_a_short_holdout_is_said_beside_an_attempt():
    ratios = np.array([2.0, 3.0, -0.5, 1.0])  # four blocks cannot exclude chance, forty can
    assert "hold out more" in unproven_note("none-of-these", [distance(log_ratios=ratios)])[0]
    assert unproven_note("none-of-these", [distance(log_ratios=np.tile(ratios, 10))]) == ()
    assert unproven_note("none-of-these", [distance(log_ratios=ratios, after=0.35)]) == ()
    assert unproven_note("partly-explained", [distance(log_ratios=ratios)]) == ()
    assert unproven_note("none-of-these", [distance(log_ratios=ratios, role="fit")]) == ()


# ---- the better of the model as given and the refitted one ----------------------------------------------------------


@pytest.fixture(scope="module")
def quiet(tmp_path_factory) -> tuple[Rig, ExtendedModel, list]:
    """The case whose hold-out does not reach the stop, its model as given, and its runs by role."""
    rig = stop_case(tmp_path_factory.mktemp("stop") / "quiet")
    case = load_case(rig.folder)
    return rig, ExtendedModel(plant=case.plant), list(case.runs(("fit", "holdout")))


def with_stop(model, rig):
    one = Attached(effect=EFFECTS[rig.effect], place=rig.place, values=rig.parameters)
    return ExtendedModel(plant=attach(model.plant, [one], channels=[]))


@pytest.mark.slow
def test_where_a_refit_spoils_a_recording_the_model_as_given_stands_there(quiet):
    rig, nominal, runs = quiet
    worse = with_stop(nominal, replace(rig, parameters={"stiffness": STOP, "gap": 0.002}))  # a refit that went wrong
    (second,) = check(runs[1:], worse, with_stop(nominal, rig), nominal=nominal)
    assert second.calibrated > 2 * second.nominal == 2 * second.before
    assert second.is_spoilt
    assert second.standing is second.simulated[0]
    assert {name: errors[1] for name, errors in second.channels.items()} == {
        name: errors[0] for name, errors in second.channels.items()
    }
    without_findings = second.without_findings()
    assert without_findings.after == second.nominal
    assert without_findings.extended is None
    (good,) = check(runs[1:], nominal, None, nominal=worse)
    assert not good.is_spoilt
    assert good.before == good.calibrated == good.after


@pytest.mark.parametrize(("nominal", "calibrated"), [(0.1, 0.9), (0.9, 0.1), (np.inf, 0.1), (0.1, np.inf), (0.1, 0.1)])
def test_before_is_never_worse_than_nominal(nominal, calibrated):
    document = errors_to_json([distance(nominal=nominal, calibrated=calibrated), distance(nominal=0.3, calibrated=0.2)])
    for errors in (document, *document["per_recording"]):
        assert errors["nrmse_nominal"] is None or errors["nrmse_before"] <= errors["nrmse_nominal"]
    assert document["per_recording"][0]["nrmse_before"] == min(nominal, calibrated)
    json.dumps(document, allow_nan=False)


def test_that_a_refit_spoils_recordings_is_said_once():
    runs = [
        distance(nominal=0.0072, calibrated=0.953, name="r1"),
        distance(nominal=0.1, calibrated=np.inf, name="r2"),
        distance(name="r3"),
        distance(nominal=0.1, calibrated=0.1005, name="r4"),  # no more than fits converge to
    ]
    (line,) = spoilt_note(runs)
    assert "r1 (error 0.953, nominal 0.0072)" in line
    assert "r2" in line
    assert "r3" not in line
    assert "r4" not in line
    assert spoilt_note(runs[2:]) == ()


def test_that_the_model_as_given_diverges_is_said_with_a_remedy():
    runs = [distance(nominal=np.inf, calibrated=np.inf, name="r1"), distance(name="r2")]
    (line,) = diverged_note(runs)
    assert "diverges on r1: give the model a shorter timestep" in line
    assert line in notes_on_models(runs)
    assert diverged_note(runs[1:]) == ()


# ---- what a finding does in a recording -----------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stop_that_is_not_reached_does_nothing_and_one_that_is_does(quiet):
    rig, nominal, runs = quiet
    ablations = Ablations(names=("stop",), models=(nominal,))
    loud, aside = check(runs, nominal, with_stop(nominal, rig), nominal=nominal, ablations=ablations)
    assert (aside.parts[0].information, aside.is_idle, aside.gap_closed) == (0.0, True, None)
    assert loud.parts[0].information > 10 * MODEL_CHOICE.alike
    assert not loud.is_idle
    assert whole_gap([aside]) is None
    assert whole_gap([loud, aside]) == loud.gap_closed
    assert loud.bare == loud.parts[0].left == loud.nominal


def test_a_finding_is_told_from_nothing_by_the_energy_of_what_it_does_over_that_of_the_noise():
    own = part_of("stop", 0.9, np.array([0.1, 0.0]), np.array([1.0, 2.0]), 10_000)
    assert own.information == pytest.approx(0.5 * 10_000 * 0.1**2)
    assert part_of("stop", 0.9, np.array([0.01, 0.01]), np.array([1.0, 1.0]), 10_000).is_idle  # one standard deviation
    assert not part_of("stop", np.inf, np.array([np.inf]), np.array([1.0]), 10_000).is_idle  # follows with it alone


def test_a_gap_that_a_refit_closes_is_none_that_a_finding_closes():
    """The stop is grazed: of what is better with it its removal takes away a tenth."""
    grazed = distance(nominal=0.072, calibrated=0.9, after=0.05, noise=0.046, bare=0.052, parts=(part(50.0, 0.052),))
    assert grazed.gap_closed > 0.8
    assert not closes_gap([grazed], model_kind=MjcfModel())
    assert closes_gap([replace(grazed, bare=0.3, parts=(part(50.0, 0.3),))], model_kind=MjcfModel())


def verdict(checked, fitted, *, is_prior_driven=False, left=1.0, effect="coulomb-friction"):
    best = SimpleNamespace(terms=(SimpleNamespace(effect=EFFECTS[effect]),), normalised_residual=left)
    choice = SimpleNamespace(best=best, gained=1.0, is_prior_driven=is_prior_driven)
    seen = SimpleNamespace(damage=SimpleNamespace(fatal=(), warnings=()), is_missing=False, steps=(), stops=())
    return decide_verdict(choice, checked, seen, model_kind=MjcfModel(), fitted=lambda: fitted)


def test_what_no_recording_kept_aside_can_verify_is_not_reported_as_found():
    fitted = [distance(role="fit", after=0.011)]
    idle_note = distance(
        nominal=0.0072, calibrated=0.95, after=0.005, noise=0.0046, bare=0.005, parts=(part(0.0, 0.005),)
    )
    near = replace(
        idle_note, nominal=0.006, before=0.006
    )  # within one and a half times the noise: nothing else would be said
    assert verdict([idle_note], fitted) == verdict([near], fitted) == "none-of-these"
    assert verdict([near], [replace(near, role="fit")]) == "nothing-missing"  # the fit does not ask for it, either
    assert (
        verdict([near], [distance(role="fit", after=0.39)]) == "none-of-these"
    )  # what the fit lacks, nothing explains
    assert fit_note("none-of-these", [near], model_kind=MjcfModel())
    assert not fit_note("nothing-missing", [near], model_kind=MjcfModel())
    assert not fit_note("none-of-these", [distance()], model_kind=MjcfModel())
    information = distance(bare=0.5, parts=(part(500.0, 0.5),))
    assert verdict([information, idle_note], fitted) == "missing-physics"  # the other one can
    assert verdict([information], fitted) == "missing-physics"


def test_what_closes_the_gap_and_leaves_more_than_noise_explains_a_part():
    fitted = [distance(role="fit", after=0.011)]
    assert verdict([distance(after=0.04)], fitted) == "missing-physics"  # 92 % of the gap, four times the noise
    assert verdict([distance(after=0.08)], fitted) == "partly-explained"  # 82 %
    assert verdict([distance(nominal=0.04, calibrated=0.04, after=0.0149)], fitted) == "missing-physics"  # within noise
    assert verdict([distance(after=0.2)], fitted) == "none-of-these"  # 51 %


def test_within_the_model_error_a_linear_effect_is_no_finding():
    """A linear effect absorbs a slightly wrong frequency of a mode; no wrong linear model has friction."""
    better = distance(nominal=0.38, calibrated=0.0021, after=0.0014, noise=0.00096, log_ratios=np.full(8, 0.8))
    assert verdict([better], [replace(better, role="fit")], effect="cross-axis") == "nothing-missing"
    assert verdict([better], [replace(better, role="fit")]) == "partly-explained"


def test_a_calibration_that_follows_only_with_implausible_values_is_a_finding():
    # the refit comes within half a per cent, above the noise, by a value many standard deviations away
    near = distance(nominal=0.075, calibrated=0.0024, after=0.0023, noise=0.0012, bare=0.075, parts=(part(9e3, 0.075),))
    assert verdict([near], [near]) == "nothing-missing"
    assert verdict([near], [near], is_prior_driven=True) == "missing-physics"
    assert (
        verdict([near], [near], is_prior_driven=True, left=6.5) == "nothing-missing"
    )  # the effect leaves much as well
    worse = replace(near, after=0.01)
    assert verdict([worse], [worse], is_prior_driven=True) == "nothing-missing"


def test_a_finding_names_the_recordings_that_verify_it_and_the_largest_comes_first():
    small, large = finding("coulomb-friction"), finding("stop")
    loud = distance(parts=(part(90.0, 0.021), part(900.0, 0.4)), name="loud")
    quiet = distance(parts=(part(90.0, 0.021), part(0.0, 0.02)), name="quiet")
    first, second = by_what_they_explain([small, large], [loud, quiet])
    assert (first.effect, first.verified_by) == ("stop", ("loud",))
    assert (second.effect, second.verified_by) == ("coulomb-friction", ("loud", "quiet"))


# ---- attempts -------------------------------------------------------------------------------------------------------


def attempt(*runs, found=None):
    return Attempt(findings=(found or finding(stiffness=4.0),), checked=runs, fit=fit_of())


def test_a_fit_that_ran_away_is_no_attempt():
    assert attempt(distance(after=0.2)).holds
    assert not attempt(distance(after=0.41)).holds  # worse than before
    assert not attempt(distance(after=np.inf)).holds
    assert not attempt(distance(nominal=68.0, calibrated=68.0, after=66.0)).holds
    idle_note = distance(nominal=0.02, after=0.03, parts=(part(0.0),))
    assert attempt(idle_note).holds  # it is the refit that is worse there
    assert attempt(idle_note).is_of_the_fit_alone
    assert not replace(attempt(idle_note), explains_fitted=False).is_of_the_fit_alone
    assert not attempt(idle_note, distance(after=0.41)).holds


def test_the_best_attempt_is_the_chosen_one_or_the_next_that_did_not_run_away():
    ran, good, better = (attempt(distance(after=after)) for after in (np.inf, 0.3, 0.1))
    assert best_attempt(good, iter([better])) is good
    assert best_attempt(ran, iter([ran, good, better])) is good
    assert best_attempt(replace(good, findings=()), iter([ran, better])) is better
    assert best_attempt(ran, iter([ran] * ATTEMPT.most_attempts + [good])) is None


def test_attempts_are_weighed_on_the_recordings_that_all_are_tried_on():
    """An attempt with errors of left-out recordings is compared on the hold-outs, and one that acts nowhere not at all."""
    idle = (part(0.0),)
    names = [frozenset({name}) for name in ("a", "b", "c", "d")]
    one = replace(attempt(distance(after=0.2), distance(name="left out", after=0.39)), hypothesis=names[0])
    other = replace(attempt(distance(after=0.3), distance(name="quiet", after=0.01, parts=idle)), hypothesis=names[1])
    nowhere = replace(attempt(distance(after=0.1, parts=idle)), hypothesis=names[2])
    worse = replace(attempt(distance(after=np.inf)), hypothesis=names[3])
    errors: dict[frozenset[str], float] = {}
    best_attempt(one, iter([other, nowhere, worse]), lambda attempt: False, errors)
    assert errors == {names[0]: 0.2, names[1]: 0.3, names[3]: np.inf}


def test_an_attempt_that_explains_most_goes_before_one_that_explains_a_part():
    surely = np.array([0.9, 1.1, 1.0, 0.8])
    poor, part_of_it, most = (
        attempt(distance(after=after, log_ratios=sure * surely))
        for after, sure in ((0.39, 0.0), (0.35, 0.3), (0.2, 1.0))
    )
    assert best_attempt(part_of_it, iter([most])) is most
    assert best_attempt(poor, iter([part_of_it, poor])) is part_of_it
    assert best_attempt(part_of_it, iter([most]), lambda a: a is part_of_it) is part_of_it  # the other is improbable


def test_a_recording_that_hardly_moves_is_not_lost_at_its_own_deviation():
    """The mean over this recording alone is a better prediction than any model; that over all recordings is not."""
    still = {"nominal": 60.0, "calibrated": 60.0, "after": 3.9}
    assert not attempt(distance(**still)).holds
    assert attempt(distance(**still, spread={"y": 90.0})).holds
    assert not attempt(
        distance(**{**still, "nominal": 400.0, "calibrated": 400.0, "after": 91.0}, spread={"y": 90.0})
    ).holds
    assert distance(spread={"y": 0.2}).lost == distance().lost  # quieter recordings do not count


def test_the_spread_is_that_of_all_recordings():
    def run_of(values):
        measured = Recording(
            time=0.1 * np.arange(3), channels=(Channel(name="y", unit="m", kind="displacement"),), data=values[:, None]
        )
        return SimpleNamespace(measured=measured, compared=[SimpleNamespace(channel="y")])

    one, other = np.array([1.0, 3.0, 5.0]), np.array([10.0, 10.5, 11.0])
    runs = [run_of(one), run_of(other)]
    assert spread_over(runs, runs[1]) == {"y": pytest.approx(np.std([*one, *other]) / np.std(other))}


def test_parts_of_a_refuted_set_are_attempted_first():
    def terms(labels):
        return tuple(SimpleNamespace(label=label) for label in labels)

    def of(labels, after):
        return replace(attempt(distance(after=after)), fit=replace(fit_of(), terms=terms(labels)))

    def hypothesis(labels):
        return SimpleNamespace(terms=terms(labels))

    def order(first):
        others = map(hypothesis, ("abc", "ad", "", "b", "a"))
        tried = further_attempts(first, others, lambda h: of(names(h.terms), 0.3))
        return ["".join(names(t.fit.terms)) for t in tried]

    def names(terms):
        return [term.label for term in terms]

    assert order(of("ab", 0.5)) == ["b", "a", "abc", "ad"]
    assert order(of("ab", 0.3)) == ["abc", "ad", "b", "a"]
    assert order(of("a", 0.5)) == ["b", "abc", "ad", "a"]  # an effect refuted alone imitates the cause


def keys(document):
    """All keys of a document, wherever they stand."""
    if isinstance(document, dict):
        return {*document, *(key for value in document.values() for key in keys(value))}
    return {key for value in document for key in keys(value)} if isinstance(document, list) else set()


def diagnosis(verdict, **others):
    return Diagnosis(
        title="t", verdict=verdict, mismatch={}, not_excluded=("x",), next_measurement="y",
        **{"findings": (), "alternatives": (), "checked": (distance(after=0.4),), **others},
    )  # fmt: skip


def test_an_abstention_says_what_calibration_removed():
    shown = diagnosis("none-of-these", checked=(distance(nominal=3.0, calibrated=0.3, after=0.3),))
    shown = replace(shown, calibration={"mass": np.log(1.5), "gain": 0.01})
    assert shown.calibrated == pytest.approx(0.99)
    line = "Calibration (mass x 1.5, gain x 1.01) removes 99 % of the nominal model's mean-square error"
    assert line in _text(shown)
    worse = diagnosis("none-of-these", checked=(distance(nominal=0.3, calibrated=0.4, after=0.4),))
    assert worse.calibrated is None
    assert "Calibration" not in _text(worse)


def test_an_attempt_stands_in_the_document_and_the_text_without_a_probability():
    two = Attempt(
        findings=(finding(stiffness=4.0), finding("coulomb-friction", "joint:b", force=0.2)),
        checked=(distance(after=0.21),),
        fit=fit_of(),
    )
    choice = choose_model(Found(before=hypothesis(9.0), hypotheses=(hypothesis(3.0, "added-mass"),)))
    tried = alternatives(choice, SimpleNamespace(model_kind=MjcfModel(), places=()), "none-of-these", 9.0)
    shown = diagnosis("none-of-these", attempt=two, alternatives=tried)
    document = json.loads(json.dumps(shown.to_json(), allow_nan=False))["attempt"]
    assert "probability" not in keys(document)
    assert (document["effect"], document["family"], document["place"]) == ("stop", "contact", "joint:a")
    assert document["parameters"]["stiffness"]["value"] == 4.0
    assert [f["effect"] for f in document["also"]] == ["coulomb-friction"]
    assert document["nrmse_after"] == 0.21
    assert document["gap_closed"] == document["per_recording"][0]["gap_closed"] == pytest.approx(0.19 / 0.39)
    assert [a["probability"] for a in shown.to_json()["alternatives"]] == [None] * len(tried)
    assert tried[0]["remaining_share"] == pytest.approx(1 / 3)
    text = _text(shown)
    for words in (
        "Best attempt, not a finding: stop at joint:a + coulomb-friction at joint:b",
        "49 %",
        "0.21",
        "force = 0.2",
    ):
        assert words in text
    assert "probability" not in text
    assert diagnosis("nothing-missing").to_json()["attempt"] is None


# ---- probabilities --------------------------------------------------------------------------------------------------


def hypothesis(level, *names, effective_samples=EVIDENCE.model_error_samples):
    terms = tuple(Term(effect=EFFECTS[n], place=SimpleNamespace(name="joint:a", index=0), values={}) for n in names)
    return Hypothesis(
        fit=fit_of(*terms),
        normalised_residual=level,
        log_rms_residual=float(np.log(level)),
        negative_log_prior=0.0,
        effective_samples=effective_samples,
    )


def test_probabilities_of_what_was_tried_leave_room_for_what_was_not():
    found = Found(before=hypothesis(9.0), hypotheses=(hypothesis(1.0, "added-mass"), hypothesis(1.02, "stop")))
    choice = choose_model(found)
    assert choice.probability + sum(p for _, p in choice.ranking) == pytest.approx(1.0 - MODEL_CHOICE.lapse)


def test_probabilities_are_printed_as_far_as_they_are_told():
    assert [format_probability(p) for p in (0.96, 0.0123, 6.6e-46)] == ["0.960", "0.012", "< 0.001"]
    choice = choose_model(
        Found(before=hypothesis(9.0), hypotheses=(hypothesis(1.0, "added-mass"), hypothesis(8.0, "stop")))
    )
    problem = SimpleNamespace(model_kind=MjcfModel(), places=())
    tried = alternatives(choice, problem, "missing-physics", 9.0)
    assert 0 < tried[0]["probability"] < 1e-6
    text = _text(diagnosis("missing-physics", findings=(finding(stiffness=4.0),), alternatives=tried))
    assert "< 0.001" in text
    assert text.count("4 % of every probability is reserved for physics outside the catalogue") == 1


# ---- a law at values where it is a plainer one ----------------------------------------------------------------------


class Whole:
    """Fits whose costs are looked up by their effects' names."""

    effective_samples, noise_share, n_values = 1000.0, 0.0, 100

    def __init__(self, **costs):
        self.costs = costs

    def fit(self, terms, start, iterations):
        (term,) = terms
        return fit_of(term, cost=self.costs[term.effect.name.replace("-", "_")])


STRIBECK = {"force": 0.6, "excess": 0.2, "speed": 1e-5}


@pytest.mark.parametrize(
    ("values", "coulomb", "left"),
    [
        ({**STRIBECK, "excess": 1e-35}, 100.0, "coulomb-friction"),  # a part is nothing
        (STRIBECK, 100.2, "coulomb-friction"),  # over before a sample has passed
        ({**STRIBECK, "speed": 0.1}, 150.0, "stribeck-friction"),
    ],
)
def test_a_law_at_values_where_it_is_a_plainer_one_gives_way_to_it(values, coulomb, left):
    place = SimpleNamespace(name="joint:a", is_held=True, also=())
    own = fit_of(Term(effect=EFFECTS["stribeck-friction"], place=place, values=values), cost=100.0)
    best = Hypothesis(fit=own, normalised_residual=1.0, log_rms_residual=0.0, negative_log_prior=0.0)
    known = fit_of(Term(effect=EFFECTS["coulomb-friction"], place=place, values={"force": 0.1}), cost=300.0)
    fitted_worse = Hypothesis(fit=known, normalised_residual=2.0, log_rms_residual=0.7, negative_log_prior=0.0)
    confirmation = Confirmation(
        problem=None, whole=Whole(coulomb_friction=coulomb), start=own, seen=None, effects=list(EFFECTS.values()),
        is_linear=True,
    )  # fmt: skip
    found = SearchFound(before=hypothesis(9.0), hypotheses=(best, fitted_worse))
    after = confirmation._simpler(found, best, own)
    assert after.hypotheses[0].terms[0].effect.name == left
    assert [h.label for h in after.hypotheses].count("coulomb-friction@joint:a") == 1
    assert after.hypotheses[0].normalised_residual == pytest.approx(1.0, rel=0.01)


class SearchFound(Found):
    """What a search found, without what it was found with."""


def test_a_plainer_law_has_some_of_the_parameters_in_the_same_units():
    place = SimpleNamespace(name="joint:a")
    lugre = {"force": 0.6, "bristle": 1e-4, "excess": 0.5, "speed": 0.1}
    terms = fit_of(Term(effect=EFFECTS["lugre-friction"], place=place, values=lugre)).nested(list(EFFECTS.values()))
    assert [t.effect.name for (t,) in terms] == ["coulomb-friction"]  # not Stribeck's, whose excess is a force
    assert terms[0][0].values == {"force": 0.6}


# ---- the whole way --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_stop_that_the_hold_out_does_not_reach_is_verified_by_halves_of_the_fit(quiet):
    rig, _, _ = quiet
    found = diagnose(load_case(rig.folder), effects=[EFFECTS[n] for n in ("one-sided-stiffness", "added-mass")])
    document = found.diagnosis.to_json()
    assert document["verdict"] == "missing-physics"
    (stop,) = document["findings"]
    assert (stop["effect"], stop["place"]) == (rig.effect, rig.place)
    assert stop["parameters"]["stiffness"]["value"] == pytest.approx(STOP, rel=0.1)
    assert stop["parameters"]["gap"]["value"] == pytest.approx(GAP, rel=0.05)
    runs = document["heldout"]["per_recording"]
    assert [run["can_verify"] for run in runs] == [False, True, True]  # the hold-out recording does not reach the stop
    halves = [run["name"] for run in runs[1:]]
    assert [name.endswith("s, left out of the fit") for name in halves] == [True, True]
    assert stop["verified_by"] == halves
    assert len(set(halves)) == 2
    for run in runs[1:]:
        assert run["nrmse_after"] < 0.2 * run["nrmse_before"]
    assert "does not act" in _text(found.diagnosis) or "not verify" in _text(found.diagnosis)


def test_a_calibrated_model_of_implausible_parameters_leaves_the_nominal_one():
    simulated = tuple(SimpleNamespace(name=name) for name in ("nominal", "calibrated", "extended"))
    run = Checked(
        name="run", role="holdout", nominal=0.2, before=0.011, after=0.012, noise=0.01, calibrated=0.011,
        channels={"x": (0.2, 0.011, 0.012, 0.01)}, run=SimpleNamespace(), simulated=simulated,
    )  # fmt: skip
    refuted = run.against_nominal()
    assert refuted.gap_closed == pytest.approx(0.188 / 0.19)
    assert refuted.standing is simulated[0]
    assert refuted.channels["x"] == (0.2, 0.2, 0.012, 0.01)
    assert "implausible parameters" in refuted_note([refuted])[0]
    assert refuted_note([run]) == ()
