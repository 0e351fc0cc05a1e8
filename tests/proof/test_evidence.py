"""The shipped campaigns: as large as promised, sealed, and they count to the score that is shown."""

import functools
import json
from pathlib import Path

import pytest

import vlab.proof.prove as proving
from vlab.errors import BadProof
from vlab.files.assets import asset
from vlab.proof.judge import judge
from vlab.proof.levels import LEVELS, level_rows
from vlab.proof.manifest import scoring_digest
from vlab.proof.pack import read_pack, unpack
from vlab.proof.prove import prove_packed
from vlab.proof.seal import SCORE, truth_folder
from vlab.proof.stated import THRESHOLDS, decision_rows, stated_rows
from vlab.proof.targets import TARGETS
from vlab.proof.truth import check_remade, open_truth
from vlab.views.reports.proof import write_proof

CASES, FRESH, LATER = (asset("evidence") / f"{name}.jsonl.xz" for name in ("campaign-340", "fresh-79", "later-81"))
"""The campaign; of cases sealed after it the first ones; and the next ones, answered later."""
campaign = functools.cache(read_pack)
PAGE = Path(__file__).parents[2] / "docs" / "evidence.md"
LEAST = {
    "in-library": 120,
    "null": 60,
    "other-form": 40,
    "out-of-library": 40,
}
LEAST_HARD = 40
"""Two effects and masked together."""


NEW = {"levels", "decisions", "stated"}
"""Parts of a score that came after the stored ones were counted."""


def assert_same(now, then):
    """Counts and words must be equal; of intervals and fits other versions of scipy may differ in the last digits."""
    if isinstance(then, dict):
        assert set(now) == set(then)
        for key in then:
            assert_same(now[key], then[key])
    elif isinstance(then, list):
        for one, other in zip(now, then, strict=True):
            assert_same(one, other)
    elif isinstance(then, float):
        assert now == pytest.approx(then, rel=1e-6, abs=1e-9)
    else:
        assert now == then


@pytest.mark.slow
@pytest.mark.parametrize(("cases", "least"), [(CASES, 300), (FRESH, 75), (LATER, 81)])
def test_the_evidence_counts_to_the_score_that_is_shown(cases, least, tmp_path, monkeypatch):
    if cases == LATER:  # its recordings take a quarter of an hour: some are made again below
        monkeypatch.setattr(proving, "check_remade", lambda *arguments: None)
    found, changed = prove_packed(cases, tmp_path / "out")
    assert found["cases"] >= least
    assert not changed
    counted = json.loads((tmp_path / "out" / "cases-answers" / SCORE).read_text())
    kept = dict(campaign(cases).score)
    assert {name for name in counted if name not in kept} == NEW
    counted = {name: part for name, part in counted.items() if name not in NEW}
    # the sources of the rules have changed since, in words and by equivalences of new effects: the counts have not
    assert counted.pop("counted_with") == scoring_digest()
    kept.pop("counted_with")
    assert kept.pop("is_counted_as_set_down")
    assert not counted.pop("is_counted_as_set_down")
    # the catalogue has grown since: its new effects were never hidden either
    assert set(counted.pop("never_hidden")) >= set(kept.pop("never_hidden"))
    # more methods are counted than then, by more measures; those of then have what they had
    methods = {row["method"]: row for row in counted.pop("baselines")}
    for row in kept.pop("baselines"):
        assert_same({key: methods[row["method"]][key] for key in row}, row)
    assert_same(counted, kept)
    write_proof(found, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().count("<svg") == 4


VARIED = [
    ("rigs-30", 14, 19, 0),
    ("arms-20", 7, 13, 0),
    ("pendulums-16", 7, 11, 0),
    ("rigs-24", 13, 17, 0),
    ("arms-16", 6, 11, 1),
    ("arms-14", 6, 9, 0),
    ("arms-16b", 7, 11, 1),
    ("pendulums-16b", 5, 11, 0),
    ("beams-4b", 1, 2, 0),
]
"""Right classes, of how many, and false alarms."""


@pytest.mark.parametrize(("name", "right", "of", "alarms"), VARIED)
def test_the_varied_cases_count_to_what_the_page_says(name, right, of, alarms, tmp_path):
    found, changed = prove_packed(asset("evidence") / f"{name}.jsonl.xz", tmp_path / "out")
    assert not changed
    assert found["is_answered_first"]
    row = next(row for row in found["measures"] if row["measure"] == "right equivalence class, first answer")
    assert (row["count"], row["of"]) == (right, of)
    assert f"{right} of {of}" in PAGE.read_text(encoding="utf-8")
    row = next(row for row in found["measures"] if row["measure"].startswith("null: anything but"))
    assert row["count"] == alarms


def test_the_later_cases_are_those_that_were_sealed_with_the_fresh_ones():
    sealed, later = (campaign(cases).commitments for cases in (FRESH, LATER))
    assert later["plan"] == sealed["plan"]
    assert all(sealed["cases"][name] == kept for name, kept in later["cases"].items())
    assert not set(campaign(FRESH).answers) & set(later["cases"])


@pytest.mark.slow
def test_truths_of_the_later_cases_come_out_of_their_seed_with_the_recordings_that_were_committed_to(tmp_path):
    # case-142 is a beam from the FE code of the plants, the source of plans that name none
    commitments, names = campaign(LATER).commitments, ["case-082", "case-084", "case-142"]
    truths, remade = open_truth(truth_folder(unpack(campaign(LATER), tmp_path)), commitments, names)
    assert remade == names
    check_remade(truths, commitments, remade, tmp_path, "joblib", 0, "", lambda done, total: None)
    truths["case-084"]["noise"] = "another"
    with pytest.raises(BadProof, match="is not what comes out"):
        check_remade(truths, commitments, remade, tmp_path, "joblib", 0, "", lambda done, total: None)


def test_the_evidence_is_as_large_as_promised():
    suites = campaign(CASES).score["suites"]
    for name, least in LEAST.items():
        assert suites[name]["cases"] >= least, name
    assert suites["two-effects"]["cases"] + suites["masked"]["cases"] >= LEAST_HARD


ROWS = {
    "right effect by name": "right effect, first answer",
    "right class": "right equivalence class, first answer",
    "right class, beam and grid only": "right class on the beam and the grid",
    "right class at the right place": "right class and exact place",
    "exact place, of named effects": "right place, exact, of what was named",
    "90 % credible set contains the place": "coverage of the 90 % place set",
    "90 % intervals contain the parameters": "coverage of 90 % parameter intervals, of effects named right",
    "right effect, all parameters within 10 %": "right effect, all its parameters within 10 %",
    "nothing hidden: verdict other than nothing-missing": "null: anything but nothing-missing (false alarms)",
    "nothing hidden, beam and grid only: other verdict": "null, beam and grid: anything but nothing-missing",
    "nothing hidden: physics named": "null: physics named",
    "outside the catalogue: abstains": "out of library: abstains",
    "near the threshold (0.1 to 1.5 times the noise): right class": "near threshold: right class",
}
"""Rows of the page on evidence by the measures that they show."""


@pytest.mark.parametrize("row", ROWS)
def test_the_page_says_what_was_counted(row):
    (line,) = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith(f"| {row} |")]
    _, _, *counted, target, met, _ = (cell.strip() for cell in line.split("|"))
    both = [{m["measure"]: m for m in campaign(cases).score["measures"]}[ROWS[row]] for cases in (CASES, FRESH, LATER)]
    assert counted == [as_shown(measure) for measure in both]
    measure = both[0]
    assert target == " to ".join(short(float(x)) for x in measure["target"].strip("<>= ").split(" to ") if x)
    said = "shown" if measure["shown"] else {True: "met", False: "missed", None: ""}[measure["met"]]
    assert met.partition(",")[0] == said


def judged(*files):
    """The judged cases of some campaigns, with truths and answers by name; names differ between the fresh ones."""
    answers = {name: answer for file in files for name, answer in campaign(file).answers.items()}
    truths = {name: kept["truth"] for file in files for name, kept in campaign(file).truths.items()}
    return [judge(truths[name], answer) for name, answer in answers.items()], truths, answers


def line_of(row):
    """The cells of the one line of the page that begins so."""
    (line,) = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith(f"| {row} |")]
    return [cell.strip() for cell in line.split("|")[2:-1]]


@pytest.mark.parametrize("level", LEVELS)
def test_the_page_says_how_far_answers_are_right(level):
    names = {"place": "exact place", "family": "and family", "effect": "and effect in class", "form": "and law"}
    rates = [level_rows(*judged(file))[0][level] for file in (CASES, FRESH, LATER)]
    assert line_of(names[level]) == [f"{rate['count']} of {rate['of']}" for rate in rates]


def test_the_levels_agree_with_the_measures():
    """Counted on another way: the first rates of the score."""
    for file in (CASES, FRESH, LATER):
        measures = {m["measure"]: m for m in campaign(file).score["measures"]}
        row = level_rows(*judged(file))[0]
        assert row["effect"]["count"] == measures["right class and exact place"]["count"]
        assert row["cases"] == measures["right equivalence class, first answer"]["of"]


@pytest.mark.parametrize("measure", TARGETS)
def test_the_page_says_the_targets_of_new_campaigns(measure):
    assert line_of(f"`{measure}`") == [TARGETS[measure].words]


@pytest.mark.parametrize("threshold", THRESHOLDS)
def test_the_page_says_which_decisions_are_right(threshold):
    cells = line_of(f"{threshold:g}" if threshold else "any")
    for cell, files in zip(cells, [(CASES,), (FRESH, LATER)], strict=True):
        (row,) = [row for row in decision_rows(judged(*files)[0]) if row["threshold"] == threshold]
        assert cell == f"{row['right']}, {row['wrong']}, {row['abstained']}"


def test_the_page_says_how_probabilities_score():
    rows = [stated_rows(*judged(file))[0] for file in (CASES, FRESH, LATER)]
    shown = [f"{short(row['log_score'])} ({short(row['constant'])})" for row in rows]
    assert line_of("of the stated probabilities") == shown
    for row, file in zip(rows, (CASES, FRESH, LATER), strict=True):
        (kept,) = [m for m in campaign(file).score["measures"] if m["measure"] == "Brier score"]
        assert (row["brier"], row["of"]) == (pytest.approx(kept["value"]), kept["of"])


def as_shown(measure):
    """Return a count with its share and exact interval as the page writes it."""
    if not measure["of"]:
        return "0 of 0"
    interval = " to ".join(short(end) for end in measure["ci95"])
    return f"{measure['count']} of {measure['of']}, {short(measure['value'])} ({interval})"


def short(x):
    """Return a share as the page writes it."""
    return f"{x:.2f}"
