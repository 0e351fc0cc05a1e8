"""Every measure of the score on answers and truths made by hand."""

import json

import numpy as np
import pytest

from vlab.proof.equivalence import TABLE, right_class
from vlab.proof.judge import judge, same_place
from vlab.proof.levels import depth, level_rows, level_table
from vlab.proof.manifest import is_set_down, manifest, scoring_digest
from vlab.proof.score import baseline_rows, confusion, measures, score
from vlab.proof.servo_scoring import ON_ARMS, arm_rows, is_part_right, partial_rows
from vlab.proof.stated import EDGE, THRESHOLDS, decision_rows, decision_table, log_score, stated_rows
from vlab.proof.statistics import Rate, clustered_interval
from vlab.proof.targets import TARGETS, Target, targets_to_json, with_targets


def hidden(effect="coulomb-friction", place="joint:carriage", **more):
    return {
        "effect": effect,
        "family": "",
        "form": "",
        "accepted": [effect],
        "place": place,
        "places_alike": ["body:carriage"],
        "places_near": ["tendon:belt", "joint:payload"],
        "at_actuator": False,
        "parameters": {"force": 2.0},
        "same_parameters": True,
        "size": 0.1,
        **more,
    }


def truth(case="c", suite="in-library", things=None, left=5.0, **more):
    things = [hidden()] if things is None else things
    return {
        "case": case,
        "suite": suite,
        "bench": "slider",
        "noise": "low",
        "one_level": False,
        "sigma": [1e-5, 1e-5, 1e-5],
        "hidden": things,
        "size": {"left": left} if things else None,
        **more,
    }


def finding(
    effect="coulomb-friction", place="joint:carriage", probability=0.9, alike=(), value=2.2, ci=(1.9, 2.5), places=None
):
    return {
        "effect": effect,
        "place": place,
        "places_90": list(places or [place]),
        "probability": probability,
        "class": [effect, *alike],
        "parameters": {"force": {"value": value, "unit": "N", "ci90": list(ci)}},
    }


def answer(*findings, verdict=None, gap=0.9, **more):
    verdict = verdict or ("missing-physics" if findings else "nothing-missing")
    return {"verdict": verdict, "findings": list(findings), "heldout": {"gap_closed": gap}, "seconds": 2.0, **more}


def measure(judged, name):
    return next(m for m in measures(judged) if m["measure"].startswith(name))


def test_partial_verdicts_count_apart_and_never_as_right():
    two = truth(suite="two-effects", things=[hidden(), hidden("added-mass", "joint:drive")])
    odd = truth(suite="out-of-library", things=[{**hidden("flow-damping"), "accepted": []}])
    part, unknown = (
        answer(finding(), verdict="partly-explained"),
        answer(finding("unknown-law"), verdict="unknown-law"),
    )
    assert is_part_right(two, part)
    assert not is_part_right(two, answer(finding("stop"), verdict="partly-explained"))
    assert is_part_right(odd, unknown)
    assert judge(two, part).is_wrong
    assert judge(odd, unknown).is_wrong
    rows = {m["measure"]: m["value"] for m in partial_rows({"a": two, "b": odd}, {"a": part, "b": unknown})}
    assert rows["two effects: partly explained"] == 1.0
    assert rows["out of library: place found, law unknown"] == 1.0
    assert rows["partly explained, something hidden: right class"] == 1.0
    assert rows["place found, law unknown, something hidden: right place"] == 1.0
    assert partial_rows({"a": two}, {"a": answer(finding())}) == []


# ---- one case -------------------------------------------------------------------------------------------------------


def test_a_right_answer_is_right_in_everything():
    j = judge(truth(), answer(finding()))
    assert (j.right_effect, j.right_class, j.all_right, j.is_wrong) == (True, True, True, False)
    assert (j.place_exact, j.place_near, j.place_covered, j.places) == (True, True, True, 1)
    assert j.errors == {"force": pytest.approx(0.1)}
    assert j.covered == {"force": True}
    assert (j.gap, j.size, j.probability) == (0.9, 5.0, 0.9)


def test_a_class_counts_when_the_table_says_so():
    lag = truth(things=[hidden("actuator-lag", "actuator:motor", parameters={"time_constant": 0.0005})])
    j = judge(lag, answer(finding("actuator-delay", "actuator:motor")))
    assert (j.right_effect, j.right_class) == (False, True)  # the table
    assert not j.hit  # the probability was that of the name
    late = truth(things=[hidden("actuator-lag", "actuator:motor", parameters={"time_constant": 0.01})])
    assert not judge(late, answer(finding("actuator-delay", "actuator:motor"))).right_class  # 1.5 rad at 24 Hz
    j = judge(truth(), answer(finding("jenkins-slip", alike=["coulomb-friction"])))
    assert (j.right_effect, j.right_class, j.in_claimed) == (False, False, True)  # the tool's own class counts apart
    assert (j.place_exact, j.errors) == (True, {})
    j = judge(truth(), answer(finding("jenkins-slip")))
    assert (j.right_effect, j.right_class, j.in_claimed) == (False, False, False)


def test_the_table_holds_under_its_conditions_only():
    drag = hidden("viscous-damping")
    assert right_class(truth(things=[drag]), drag) == {"viscous-damping"}
    assert right_class(truth(things=[drag], one_level=True), drag) == {"viscous-damping", "quadratic-drag"}
    gain = hidden("actuator-gain")
    assert "sensor-gain" not in right_class(truth(things=[gain]), gain)
    assert "sensor-gain" in right_class(truth(things=[gain], sigma=[1e-5]), gain)
    offset = hidden("force-offset", at_actuator=True)
    assert "actuator-offset" in right_class(truth(things=[offset]), offset)
    assert all(row.why for row in TABLE)


def test_any_accepted_name_of_another_form_is_right_in_class():
    form = hidden(form="tanh", accepted=["coulomb-friction", "lugre-friction"], same_parameters=False)
    j = judge(truth(suite="other-form", things=[form]), answer(finding("lugre-friction")))
    assert (j.right_effect, j.right_class, j.hit, j.errors) == (False, True, True, {})


def test_places_have_several_names_and_neighbours():
    assert same_place("body:carriage", hidden())
    assert same_place("sensor:probe:30in", hidden(place="sensor:30in"))
    assert same_place("coil:base", hidden(place="actuator:base"))
    assert not same_place("sensor:base", hidden(place="actuator:base"))
    j = judge(truth(), answer(finding(place="tendon:belt", places=["tendon:belt", "joint:carriage"])))
    assert (j.place_exact, j.place_near, j.place_covered, j.places) == (False, True, True, 2)
    j = judge(truth(), answer(finding(place="joint:drive")))
    assert (j.place_exact, j.place_near, j.place_covered) == (False, False, False)


def test_parameters_outside_their_interval_are_not_covered():
    j = judge(truth(), answer(finding(value=1.0, ci=(0.9, 1.1))))
    assert j.errors == {"force": pytest.approx(0.5)}
    assert j.covered == {"force": False}
    silent = truth(things=[hidden(parameters={"force": 2.0, "speed": 0.1})])
    j = judge(silent, answer(finding()))
    assert (j.errors["speed"], j.covered["speed"]) == (10.0, False)  # an answer that leaves a parameter out


def test_hum_of_no_steady_phase_is_compared_by_its_amplitude():
    hum = hidden("mains-hum", "sensor:probe", parameters={"sine": 3.0, "cosine": -4.0, "frequency": 50.0})
    said = finding("mains-hum", "sensor:probe")
    said["parameters"] = {
        "amplitude": {"value": 5.5, "unit": "m", "ci90": [5.0, 6.0]},
        "frequency": {"value": 50.0, "unit": "Hz", "ci90": [49.9, 50.1]},
    }
    j = judge(truth(things=[hum]), answer(said))
    assert j.errors == {"amplitude": pytest.approx(0.1), "frequency": 0.0}
    assert j.covered == {"amplitude": True, "frequency": True}


def test_of_two_hidden_things_either_may_come_first():
    second = hidden("cubic-stiffness", "tendon:belt", parameters={"k3": 1.0})
    both = truth(suite="two-effects", things=[hidden(), second])
    one = judge(both, answer(finding("cubic-stiffness", "tendon:belt")))
    assert (one.right_effect, one.place_exact, one.all_right, one.is_wrong) == (True, True, False, True)
    assert one.hit
    two = judge(both, answer(finding("cubic-stiffness", "tendon:belt"), finding()))
    assert two.all_right
    assert two.hit
    assert not two.is_wrong
    three = judge(both, answer(finding("cubic-stiffness", "tendon:belt"), finding(), finding("added-mass")))
    assert not three.all_right
    assert three.hit  # a probability speaks of its own finding
    more = judge(truth(), answer(finding(), finding("added-mass")))
    assert (more.right_class, more.all_right, more.hit) == (True, False, True)


def test_nothing_and_the_unknown_have_their_own_right_answers():
    null = truth(suite="null", things=[])
    assert not judge(null, answer()).is_wrong
    assert judge(null, answer(finding())).is_wrong
    assert judge(null, answer(verdict="none-of-these")).is_wrong
    strange = truth(suite="out-of-library", things=[hidden("parametric-stiffness", accepted=[])])
    assert not judge(strange, answer(verdict="none-of-these")).is_wrong
    assert judge(strange, answer(finding("drifting-stiffness"))).is_wrong
    assert judge(strange, answer()).is_wrong
    assert judge(truth(), answer(verdict="none-of-these")).is_wrong  # it was in the library


def test_findings_count_only_where_physics_is_said_to_be_missing():
    j = judge(truth(), answer(finding(), verdict="none-of-these", gap=0.9))
    assert (j.right_effect, j.answered, j.gap) == (False, "none-of-these", 0.0)


def test_a_refusal_is_a_wrong_answer():
    j = judge(truth(), {"verdict": "crashed", "findings": [], "error": "ValueError: x", "seconds": 0.1})
    assert j.is_wrong
    assert j.answered == "crashed"
    assert score([j])["failed"][0]["error"] == "ValueError: x"


# ---- the table ------------------------------------------------------------------------------------------------------


def campaign():
    """Ten cases whose measures can be counted by hand."""
    rows = [(truth(f"r{i}"), answer(finding(probability=1.0), gap=0.8)) for i in range(4)]  # right
    rows.append(
        (truth("w1"), answer(finding("stop", "joint:drive", probability=0.6), gap=0.5))
    )  # wrong effect and place
    rows.append((truth("w2"), answer(gap=None)))  # missed
    rows.append((truth("n1", "null", []), answer()))
    rows.append((truth("n2", "null", []), answer(finding(probability=0.5))))  # false alarm
    strange = [hidden("flow-damping", accepted=[])]
    rows.append((truth("s1", "out-of-library", strange), answer(verdict="none-of-these")))
    rows.append((truth("t1", "near-threshold", left=0.3), answer()))
    return rows


def by_case(rows):
    """Judged cases, truths and answers by name."""
    return [judge(t, a) for t, a in rows], {t["case"]: t for t, _ in rows}, {t["case"]: a for t, a in rows}


def test_the_table_counts_what_a_hand_counts():
    judged = [judge(t, a) for t, a in campaign()]
    right = measure(judged, "right effect")
    assert (right["count"], right["of"], right["target"], right["met"]) == (4, 6, ">= 0.85", False)
    assert right["ci95"] == list(Rate(4, 6).interval)
    assert (measure(judged, "right place, exact")["count"], measure(judged, "right place, exact")["of"]) == (4, 5)
    alarms = measure(judged, "null: anything but nothing-missing")
    assert (alarms["count"], alarms["of"], alarms["met"]) == (1, 2, False)
    assert measure(judged, "null: physics named")["count"] == 1
    assert measure(judged, "out of library: abstains")["value"] == 1.0
    assert measure(judged, "held-out gap closed, median")["value"] == pytest.approx(0.8)  # .8 x 4, .5, 0
    assert measure(judged, "held-out gap closed, worst tenth")["value"] == pytest.approx(0.25)
    assert measure(judged, "parameter error")["value"] == pytest.approx(0.1)
    # named: four at 1.0 right, one at .6 and one at .5 wrong
    assert measure(judged, "Brier")["value"] == pytest.approx((0.36 + 0.25) / 6)
    assert (measure(judged, "near threshold")["count"], measure(judged, "near threshold")["of"]) == (0, 1)


def test_a_target_is_shown_where_the_whole_interval_meets_it():
    few = [judge(truth(f"n{i}", "null", []), answer()) for i in range(10)]
    alarms = measure(few, "null: anything but nothing-missing")
    assert (alarms["value"], alarms["met"], alarms["shown"]) == (0.0, True, False)  # none of ten says little
    many = [judge(truth(f"n{i}", "null", []), answer()) for i in range(100)]
    assert measure(many, "null: anything but nothing-missing")["shown"]


def test_parameters_of_a_fit_are_right_or_wrong_together():
    one_by_one = clustered_interval([[True], [False]] * 50)
    low, high = Rate(50, 100).interval
    assert one_by_one == pytest.approx((low, high), abs=0.03)
    together = clustered_interval([[True] * 4, [False] * 4] * 50)
    assert together == pytest.approx(one_by_one, abs=1e-12)  # four parameters say no more than one
    assert clustered_interval([]) == (0.0, 1.0)


def test_the_beam_and_the_grid_are_counted_apart_too():
    rows = [(truth("b1", bench="beam"), answer()), (truth("r1"), answer(finding()))]
    judged = [judge(t, a) for t, a in rows]
    assert (measure(judged, "right class on the beam")["count"], measure(judged, "right class on the beam")["of"]) == (
        0,
        1,
    )
    assert score(judged)["detection"]["all"]["cases"] == 1  # the rig's


def test_the_confusion_matrix_has_every_case_once():
    judged = [judge(t, a) for t, a in campaign()]
    table = confusion(judged)
    assert table["coulomb-friction"] == {"coulomb-friction": 4, "stop": 1, "nothing-missing": 2}
    assert table["nothing"] == {"nothing-missing": 1, "coulomb-friction": 1}
    assert table["(flow-damping)"] == {"none-of-these": 1}
    assert sum(sum(row.values()) for row in table.values()) == len(judged)


def test_the_score_is_a_json_document_with_the_worst_first():
    found = score([judge(t, a) for t, a in campaign()])
    json.dumps(found, allow_nan=False)
    assert [w["case"] for w in found["worst"]][:2] == ["w1", "n2"]
    assert found["suites"]["null"]["right"]["count"] == 1
    assert found["detection"]["all"]["cases"] == 7


def test_simple_methods_stand_beside():
    rows = campaign()
    rows[0][1]["heldout"] |= {"nrmse_before": 0.2, "nrmse_noise": 0.1}
    rows[0][1]["baselines"] = {"mujoco.sysid": {"nrmse": 0.15, "note": ""}}
    rows[1][1]["baselines"] = {"mujoco.sysid": {"note": "not run: no MJCF"}}
    judged = [judge(t, a) for t, a in rows]
    table = baseline_rows(judged, {t["case"]: a for t, a in rows}, {t["case"]: t for t, _ in rows})
    assert [r["method"] for r in table] == ["linear refit only", "mujoco.sysid"]
    assert table[1]["gap_closed"] == pytest.approx(0.5)
    assert (table[1]["cases"], table[1]["vlab"]) == (1, {"right_class": 1.0, "gap_closed": 0.8})  # of the same case
    assert "no MJCF" in table[1]["note"]
    assert "0 of 1" in table[0]["note"]


def test_a_peer_is_counted_apart_where_it_has_the_law():
    rows = campaign()
    named = [{"effect": "coulomb-friction", "place": "joint:drive", "share": 0.5}]
    rows[0][1]["baselines"] = {"sparse regression": {"named": named, "names": ["coulomb-friction"], "note": ""}}
    rows[1][0]["hidden"] = [hidden("stop", "joint:drive")]  # no law of it there
    rows[1][1]["baselines"] = {"sparse regression": {"named": [], "names": ["coulomb-friction"], "note": ""}}
    judged = [judge(t, a) for t, a in rows]
    table = baseline_rows(judged, {t["case"]: a for t, a in rows}, {t["case"]: t for t, _ in rows})
    assert [(r["method"], r["cases"], r["right_class"]) for r in table[1:]] == [
        ("sparse regression", 2, 0.5),
        ("sparse regression, where it has the law", 1, 1.0),
    ]


# ---- levels, decisions, log score, targets --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("things", "said", "levels"),
    [
        ([hidden()], [finding()], 4),
        ([hidden()], [{**finding(), "form": "smooth-friction"}], 3),
        ([hidden(form="tanh", same_parameters=False)], [finding()], 3),
        ([hidden(family="friction")], [{**finding("lugre-friction"), "family": "friction"}], 2),
        ([hidden(family="friction")], [{**finding("stop"), "family": "contact"}], 1),
        ([hidden()], [finding(place="joint:drive")], 0),  # the effect is right, and stands elsewhere
        ([hidden()], [], 0),
        ([], [finding()], 0),
        ([hidden("stop", "joint:drive"), hidden()], [finding()], 4),
        ([hidden("flow-damping", accepted=[], family="friction")], [{**finding(), "family": "friction"}], 2),
    ],
)
def test_a_level_counts_with_all_levels_before_it(things, said, levels):
    assert depth(truth(things=things), answer(*said)) == levels


def test_levels_are_counted_by_bench_and_verdict():
    rows = campaign()
    rows.append((truth("b1", bench="beam"), answer(finding(place="joint:drive"), verdict="partly-explained")))
    rows.append((truth("b2", bench="beam"), answer(finding(), verdict="partly-explained")))
    rows.append(
        (truth("b3", bench="beam"), answer({**finding("unknown-law"), "family": "unknown-law"}, verdict="unknown-law"))
    )
    found = {(r["bench"], r["verdict"]): r for r in level_rows(*by_case(rows))}
    assert list(found) == [
        *(("all", verdict) for verdict in ("missing-physics", "partly-explained", "unknown-law")),
        *(("beam", verdict) for verdict in ("missing-physics", "partly-explained", "unknown-law")),
        ("slider", "missing-physics"),
    ]
    counts = {
        key: [row[level]["count"] for level in ("place", "family", "effect", "form")] for key, row in found.items()
    }
    # of nine with an effect of the library, four of the slider are right in everything
    assert found["all", "missing-physics"]["cases"] == found["all", "missing-physics"]["place"]["of"] == 9
    assert counts["all", "missing-physics"] == counts["slider", "missing-physics"] == [4, 4, 4, 4]
    assert counts["beam", "missing-physics"] == [0, 0, 0, 0]
    assert counts["beam", "partly-explained"] == [1, 1, 1, 1]
    assert counts["beam", "unknown-law"] == [1, 0, 0, 0]
    assert found["all", "missing-physics"]["place"]["ci95"] == list(Rate(4, 9).interval)
    heads, shown = level_table(list(found.values()))
    assert {len(row) for row in shown} == {len(heads)}
    other = truth("f1", "other-form", [hidden(form="tanh", same_parameters=False)])
    only = level_rows(*by_case([(other, answer(finding()))]))[0]
    assert (only["effect"]["count"], only["form"]["of"]) == (1, 0)  # no law of the catalogue is the hidden one


def test_decisions_are_counted_from_a_stated_probability_on():
    judged, _, _ = by_case(campaign())  # right names at 1; wrong ones at .6, and at .5 with nothing hidden
    found = {row["threshold"]: row for row in decision_rows(judged)}
    assert list(found) == list(THRESHOLDS)
    keys = ("named", "right", "wrong", "wrong_null", "wrong_outside", "abstained")
    assert [found[0.0][key] for key in keys] == [6, 4, 2, 1, 0, 4]
    assert [found[0.5][key] for key in keys] == [6, 4, 2, 1, 0, 4]
    assert [found[0.7][key] for key in keys] == [4, 4, 0, 0, 0, 6]
    assert found[0.5]["wrong_share"]["ci95"] == list(Rate(2, 6).interval)
    strange = truth("s", "out-of-library", [hidden("flow-damping", accepted=[])])
    assert decision_rows([judge(strange, answer(finding()))])[0]["wrong_outside"] == 1
    part = [judge(truth(), answer(finding(), verdict="partly-explained"))]
    assert [decision_rows(part)[0][key] for key in ("named", "abstained")] == [0, 1]
    heads, shown = decision_table(decision_rows([]))
    assert shown[0][0] == "any"
    assert {len(row) for row in shown} == {len(heads)}


def test_the_log_score_is_the_mean_negative_log_likelihood():
    # ln .9 = -.105361, ln .2 = -1.609438
    assert log_score([0.9, 0.8], [True, False]) == pytest.approx((0.105361 + 1.609438) / 2, abs=1e-6)
    assert log_score([0.5] * 7, [True] * 3 + [False] * 4) == pytest.approx(np.log(2))
    assert log_score([1.0], [False]) == pytest.approx(np.log(1000.0))  # a certainty ends at EDGE
    assert log_score([0.0], [False]) == pytest.approx(-np.log(1 - EDGE))
    assert log_score([], []) is None
    # proper: of seven in ten nothing scores better than .7
    outcome = [True] * 7 + [False] * 3
    scores = [log_score([p] * 10, outcome) for p in np.arange(0.05, 1.0, 0.05)]
    assert np.argmin(scores) == 13


def test_stated_probabilities_count_for_the_event_of_which_they_speak():
    rows = [
        (truth("a"), answer(finding(probability=0.9))),
        (truth("b"), answer(finding("stop", probability=0.8))),
        (truth("c"), answer(finding(probability=0.4), verdict="partly-explained")),
        (truth("d"), answer(finding("unknown-law", probability=0.7), verdict="unknown-law")),
        (truth("e"), answer(verdict="none-of-these")),
        (truth("f", "null", []), answer()),
    ]
    found = {row["verdict"]: row for row in stated_rows(*by_case(rows))}
    assert {verdict: (row["of"], row["holds"]) for verdict, row in found.items()} == {
        "all": (4, 0.75),
        "missing-physics": (2, 0.5),
        "partly-explained": (1, 1.0),
        "unknown-law": (1, 1.0),
    }
    assert found["all"]["log_score"] == pytest.approx(-np.log([0.9, 0.2, 0.4, 0.7]).mean())
    assert found["all"]["brier"] == pytest.approx((0.01 + 0.64 + 0.36 + 0.09) / 4)
    assert found["all"]["constant"] == pytest.approx(-(0.75 * np.log(0.75) + 0.25 * np.log(0.25)))
    assert (found["missing-physics"]["low"], found["missing-physics"]["high"]) == pytest.approx((0.81, 0.89))
    (none,) = stated_rows([], {}, {})
    assert (none["of"], none["log_score"], none["constant"]) == (0, None, None)


def test_targets_stand_beside_the_measures_where_a_manifest_sets_them_down():
    judged, _, _ = by_case(campaign())
    before = measures(judged)
    assert with_targets(before, {}) == before
    after = {row["measure"]: row for row in with_targets(before, targets_to_json())}
    assert {m for m in TARGETS if m not in after} == {ON_ARMS}
    for row in before:
        kept = {key: value for key, value in row.items() if key not in ("target", "met", "shown")}
        assert {key: after[row["measure"]][key] for key in kept} == kept
        assert row["measure"] in TARGETS or after[row["measure"]] == row
    assert after["right equivalence class, first answer"]["target"] == ">= 0.95, lower end >= 0.9"
    assert after["null: anything but nothing-missing (false alarms)"]["target"] == "<= 0.03"
    assert after["Brier score"]["met"] is False  # .10 of six


def test_a_lower_end_belongs_to_the_target():
    name = "right equivalence class, first answer"
    for of, met in ((20, False), (200, True)):  # the lower end is .83 and .98
        rows = [(truth(f"c{i}"), answer(finding())) for i in range(of)]
        (row,) = with_targets([measure(by_case(rows)[0], name)], targets_to_json())
        assert (row["value"], row["met"], row["shown"]) == (1.0, met, met)
    assert (Target().words, Target(lower_end=0.9).words) == ("", "lower end >= 0.9")
    assert Target(at_least=0.85, at_most=0.95).words == "0.85 to 0.95"
    assert not Target(at_least=0.85, at_most=0.95).holds(0.96)


def test_arms_have_a_row_of_their_own():
    arm = truth("a", bench="arm")
    assert arm_rows([judge(truth(), answer(finding()))]) == []
    (row,) = with_targets(arm_rows([judge(arm, answer(finding())), judge(truth(), answer())]), targets_to_json())
    assert (row["measure"], row["count"], row["of"], row["target"], row["met"]) == (ON_ARMS, 1, 1, ">= 0.85", True)


def test_the_rules_that_a_manifest_binds_are_those_of_the_count():
    now = manifest({})
    assert now["targets"] == targets_to_json()
    assert is_set_down(now)
    assert is_set_down({"scoring": scoring_digest()})  # a stored campaign is older than the other rules
    assert not is_set_down({**now, "scoring": "0"})
    assert not is_set_down({**now, "more_scoring": "0"})
