"""Sealing: what was committed to cannot change unnoticed, and truth is not touched before the answers are frozen."""

import json
import shutil
from typing import get_args

import pytest
from command import run
from sealed_cases import ANSWER, edit

import vlab.proof.prove as proving
from vlab.diagnose.diagnosis import Verdict
from vlab.errors import BadExperiment, BadProof, OutputRefused
from vlab.files.locks import LOCK, sole_use
from vlab.proof import conceal as concealing
from vlab.proof.conceal import conceal_cases, regenerate_cases, unfinished_folder
from vlab.proof.prove import freeze, frozen_answers, prove, read_commitments
from vlab.proof.seal import ANSWERS, FROZEN, answers_folder, canonical, digest, opened, sealed, truth_folder
from vlab.proof.truth import REMADE, open_truth
from vlab.views.reports.proof import write_proof


def test_a_seal_opens_for_its_truth_only():
    kept, commitment = sealed({"effect": "stop", "size": 0.1})
    assert opened(kept, commitment, where="here") == {"effect": "stop", "size": 0.1}
    with pytest.raises(BadProof, match="does not match its commitment"):
        opened({**kept, "truth": {"effect": "stop", "size": 0.2}}, commitment, where="here")
    with pytest.raises(BadProof, match="does not match its commitment"):
        opened({**kept, "salt": "0" * 32}, commitment, where="here")
    assert (
        sealed({"effect": "stop"})[1] != sealed({"effect": "stop"})[1]
    )  # the same truth cannot be guessed from its hash
    assert canonical({"b": 1, "a": 2}) == canonical({"a": 2, "b": 1})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('{"verdict": "nothing-missing", "seconds": NaN}', "the number NaN is not finite"),
        ('{"verdict": "nothing-missing", "seconds": 1e999}', "the number 1e999 is not finite"),
        ('{"verdict": "nothing-missing", "seconds": ' + 400 * "9" + "}", "is not finite"),
        (100_000 * "[", "not readable as JSON"),
        ('{"findings": []}', "not an answer as vlab writes it"),
        ('{"verdict": "missing-physics", "findings": {"effect": "stop"}}', "not an answer as vlab writes it"),
        ('{"verdict": "missing-physics", "findings": [{"effect": 1, "place": ""}]}', "not an answer as vlab writes it"),
        ('["nothing-missing"]', "not an answer as vlab writes it"),
    ],
)
def test_an_answer_that_is_none_is_refused_in_one_line(capsys, cases, answered, text, said):
    path = answers_folder(cases) / ANSWERS / "case-001.json"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    status, out, err = run(capsys, "prove", str(cases), "--jobs", "1")
    assert (status, out) == (2, "")
    assert said in err
    assert str(path) in err
    assert err.count("\n") == 1
    assert answered == ["case-002"]
    assert not (answers_folder(cases) / FROZEN).exists()


def test_the_recordings_say_nothing_of_the_truth(cases):
    names = {p.name for p in (cases / "case-001").iterdir()}
    assert names == {"case.toml", "rig.xml", *(f"run{i + 1}.parquet" for i in range(len(names) - 2))}
    text = "".join(p.read_text() for p in cases.rglob("*") if p.suffix in (".toml", ".json", ".xml"))
    assert not [w for w in ("suite", "null", "seed", "effect", "benign", "hidden", "sigma") if w in text]
    assert len({p.stat().st_mtime for p in (cases / "case-001").iterdir()}) == 1


@pytest.mark.slow
def test_concealing_that_was_stopped_goes_on_with_its_seed_and_makes_no_case_twice(tmp_path):
    plan = {"suites": ["null"], "count": 3, "benches": ["slider"], "jobs": 1}
    out = tmp_path / "cases"

    def until_the_second(done, total):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        conceal_cases(out, **plan, progress=until_the_second)
    assert not out.exists()
    assert not truth_folder(out).exists()
    begun = unfinished_folder(out)
    whole = sorted(path.stem for path in (begun / "truth").iterdir())
    assert {"case-001", "case-002"} <= set(whole)
    before = {name: (begun / "cases" / name / "run1.parquet").stat().st_ino for name in whole}
    (begun / "cases" / "case-003").mkdir(exist_ok=True)  # as one that was being written
    for other in ({"count": 4}, {"suites": ["in-library"]}, {"seed": 2**40}):
        with pytest.raises(BadExperiment, match="begun with another"):
            conceal_cases(out, **{**plan, **other})
    _, seed = conceal_cases(out, **plan)
    assert {name: (out / name / "run1.parquet").stat().st_ino for name in whole} == before
    assert not begun.exists()
    conceal_cases(tmp_path / "at once", **plan, seed=seed)
    first, again = (json.loads((folder / "commitments.json").read_text()) for folder in (out, tmp_path / "at once"))
    assert [c["recordings"] for c in first["cases"].values()] == [c["recordings"] for c in again["cases"].values()]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_recordings_and_another_commitment(made, tmp_path):
    conceal_cases(tmp_path / "again", suites=["null"], count=2, seed=3, benches=["slider"], jobs=1)
    first, again = (json.loads((folder / "commitments.json").read_text()) for folder in (made, tmp_path / "again"))
    for name, kept in first["cases"].items():
        assert kept["recordings"] == again["cases"][name]["recordings"]
        assert kept["truth"] != again["cases"][name]["truth"]  # salted afresh


@pytest.mark.slow
def test_recordings_are_made_again_bit_for_bit(cases, tmp_path, capsys):
    shutil.rmtree(cases / "case-002")  # as evidence is kept: commitments and truth, no recordings
    status, _, _ = run(capsys, "conceal", "--again", str(cases), "--out", str(tmp_path / "again"), "--jobs", "1")
    assert status == 0
    assert set(read_commitments(tmp_path / "again")["cases"]) == {"case-001", "case-002"}
    one = ["--only", "case-002", "--out", str(tmp_path / "one"), "--jobs", "1"]
    assert run(capsys, "conceal", "--again", str(cases), *one)[0] == 0
    assert set(read_commitments(tmp_path / "one")["cases"]) == {"case-002"}
    status, _, err = run(capsys, "conceal", "--again", str(cases), "--only", "case-9", "--out", str(tmp_path / "none"))
    assert (status, (tmp_path / "none").exists()) == (2, False)
    assert "no case 'case-9'; accepted: case-001 to case-002" in err
    edit(cases / "commitments.json", lambda d: d["cases"]["case-001"].update(recordings="0" * 64))
    status, _, err = run(capsys, "conceal", "--again", str(cases), "--out", str(tmp_path / "other"), "--jobs", "1")
    assert (status, (tmp_path / "other").exists()) == (2, False)
    assert "other bits than those that were sealed" in err


@pytest.mark.slow
def test_a_truth_whose_salt_was_lost_is_made_again_with_its_recordings(cases, answered, tmp_path, capsys):
    again, lost = tmp_path / "again", truth_folder(cases) / "case-002.json"
    known = json.loads(lost.read_text())
    lost.unlink()
    words = ["--only", "case-002", "--with-truth", "--out", str(again), "--jobs", "1"]
    assert run(capsys, "conceal", "--again", str(cases), *words)[0] == 0
    remade = json.loads((truth_folder(again) / "case-002.json").read_text())
    assert remade["truth"] == known["truth"]
    shutil.copy(truth_folder(again) / "case-002.json", lost)
    found = prove(cases, answers_folder(cases), jobs=1)
    assert found["truths_made_again"] == ["case-002"]
    said = run(capsys, "prove", str(cases), "--jobs", "1")[1]
    assert "truths opened: 1 by the salt of their commitment, 1 by making their recordings again from the seed" in said
    assert "(case-002)" in said
    assert not (answers_folder(cases) / REMADE).exists()
    write_proof(found, tmp_path / "report.html")
    assert "its salts were lost" in (tmp_path / "report.html").read_text()
    edit(lost, lambda d: d.update(recordings="0" * 64))
    with pytest.raises(BadProof, match="with other recordings than those"):
        prove(cases, answers_folder(cases), jobs=1)


@pytest.mark.slow
def test_a_truth_without_its_salt_is_not_believed_for_its_word(cases, answered, capsys):
    """Whoever writes down the digest that was committed to has made nothing again."""
    path = truth_folder(cases) / "case-002.json"
    known = json.loads(path.read_text())["truth"]
    committed = read_commitments(cases)["cases"]["case-002"]["recordings"]
    forged = {**known, "noise": "low" if known["noise"] != "low" else "high"}
    path.write_text(json.dumps({"recordings": committed, "truth": forged}))
    status, out, err = run(capsys, "prove", str(cases), "--jobs", "1")
    assert (status, out) == (2, "")
    assert "case-002: the truth has no salt and is not what comes out when its recordings are made again" in err
    path.write_text(json.dumps({"recordings": committed, "truth": known}))
    assert prove(cases, answers_folder(cases), jobs=1)["truths_made_again"] == ["case-002"]


def test_a_truth_without_its_salt_is_refused_where_the_recordings_come_out_otherwise(cases, answered, monkeypatch):
    path = truth_folder(cases) / "case-002.json"
    kept = json.loads(path.read_text())
    committed = read_commitments(cases)["cases"]["case-002"]["recordings"]
    path.write_text(json.dumps({"recordings": committed, "truth": kept["truth"]}))
    made = concealing.write_case

    def another(case, folder):
        made(case, folder)
        (folder / "case.toml").write_text("")

    monkeypatch.setattr(concealing, "run_all", lambda work, items, **how: (work(item) for item in items))  # here
    monkeypatch.setattr(concealing, "write_case", another)
    with pytest.raises(BadProof, match="other bits than those that were sealed"):
        prove(cases, answers_folder(cases), jobs=1)
    assert not (answers_folder(cases) / REMADE).exists()


@pytest.mark.slow
def test_some_of_the_cases_of_a_plan_are_made_again(cases, tmp_path):
    """A folder may hold a part of what a plan conceals: names, not their number, say which cases they are."""
    edit(cases / "commitments.json", lambda d: d["cases"].pop("case-001"))
    regenerate_cases(cases, tmp_path / "part", jobs=1)
    assert set(read_commitments(tmp_path / "part")["cases"]) == {"case-002"}


@pytest.mark.parametrize("name", ["../cases-truth/case-001", "case-001/..", "/etc/passwd", "case-1", ""])
def test_a_name_among_the_commitments_leads_nowhere_else(cases, answered, name):
    prove(cases, answers_folder(cases), jobs=1)
    edit(cases / "commitments.json", lambda d: d["cases"].update({name: d["cases"]["case-001"]}))
    with pytest.raises(BadProof, match="is no commitment to a case"):
        prove(cases, answers_folder(cases), jobs=1)
    with pytest.raises(BadProof, match="is no commitment to a case"):
        regenerate_cases(cases, cases.with_name("again"), jobs=1)


def test_one_prove_at_a_time_works_in_a_folder(cases, answered, capsys):
    out = answers_folder(cases)
    with sole_use(out, of="vlab prove"):
        status, text, err = run(capsys, "prove", str(cases), "--jobs", "1")
        assert (status, text, err.count("\n")) == (2, "", 1)
        assert "another vlab prove is at work in" in err
        assert [p.name for p in out.iterdir()] == [LOCK]
    assert run(capsys, "prove", str(cases), "--jobs", "1")[0] == 0
    assert len(answered) == 2


def test_one_conceal_at_a_time_works_in_a_folder(tmp_path, capsys):
    out = tmp_path / "cases"
    with sole_use(unfinished_folder(out), of="vlab conceal"):
        status, _, err = run(capsys, "conceal", "--suite", "null", "--n", "1", "--out", str(out))
        assert status == 2
        assert "another vlab conceal is at work in" in err
    assert not out.exists()


def test_answers_are_never_written_over(cases, monkeypatch):
    """Where the lock fails its purpose, as on a disk that two machines share without locks, the first answer stays."""
    out = answers_folder(cases)
    theirs = {"case": "case-001", **ANSWER, "seconds": 7.0}

    def answer(item, **settings):
        if item[0] == "case-001":
            (out / ANSWERS / "case-001.json").write_text(json.dumps(theirs))
        return item[0], {"case": item[0], **ANSWER}

    monkeypatch.setattr(proving, "answer_case", answer)
    with pytest.raises(OutputRefused, match="never written over"):
        prove(cases, out, jobs=1)
    assert json.loads((out / ANSWERS / "case-001.json").read_text()) == theirs
    prove(cases, out, jobs=1)
    frozen = (out / FROZEN).read_bytes()
    commitments = read_commitments(cases)
    with pytest.raises(OutputRefused, match="never written over"):
        freeze(out, commitments, sorted(commitments["cases"]))
    assert (out / FROZEN).read_bytes() == frozen
    assert json.loads((out / ANSWERS / "case-001.json").read_text()) == theirs


def test_sealed_cases_are_not_written_over(cases, tmp_path, capsys):
    before = (cases / "commitments.json").read_bytes()
    for words in (["--suite", "null", "--n", "1"], ["--again", str(cases), "--only", "case-001"]):
        status, _, err = run(capsys, "conceal", *words, "--out", str(cases))
        assert status == 2
        assert "holds sealed cases" in err
    assert (cases / "commitments.json").read_bytes() == before


def test_answers_are_not_frozen_where_the_code_was_changed_meanwhile(cases, answered, monkeypatch):
    kept, asked = proving.manifest, []

    def changing(commitments, **settings):
        asked.append(1)
        return {**kept(commitments, **settings), "code": str(len(asked))}

    monkeypatch.setattr(proving, "manifest", changing)
    with pytest.raises(BadProof, match="begun with another code"):
        prove(cases, answers_folder(cases), jobs=1)
    assert not (answers_folder(cases) / FROZEN).exists()


def test_frozen_answers_are_counted_again_without_the_recordings(cases, answered):
    first = prove(cases, answers_folder(cases), jobs=1)
    shutil.rmtree(cases / "case-001")
    assert prove(cases, answers_folder(cases), jobs=1)["measures"] == first["measures"]


def test_answers_that_come_after_the_opening_are_told_from_the_first(cases, answered, capsys):
    first = prove(cases, answers_folder(cases), jobs=1)
    assert first["is_answered_first"]
    assert prove(cases, answers_folder(cases), jobs=1)["is_answered_first"]  # counted again
    other = cases.with_name("other-answers")
    shutil.copytree(answers_folder(cases), other)
    (other / FROZEN).unlink()
    edit(other / ANSWERS / "case-001.json", lambda d: d.update(seconds=1e9))
    status, text, _ = run(capsys, "prove", str(cases), "--out", str(other), "--jobs", "1")
    assert status == 0
    assert "they are no evidence" in text
    assert "no evidence" in (other / "report.html").read_text()


def test_the_page_says_that_the_rules_were_changed(cases, answered, monkeypatch):
    assert prove(cases, answers_folder(cases), jobs=1)["is_counted_as_set_down"]
    monkeypatch.setattr("vlab.proof.manifest.scoring_digest", lambda *sources: "another")
    found = prove(cases, answers_folder(cases), jobs=1)
    assert not found["is_counted_as_set_down"]
    write_proof(found, cases.with_name("report.html"))
    assert "rules of counting were changed" in cases.with_name("report.html").read_text()


def test_a_score_has_a_page_even_where_nothing_was_hidden(cases, answered, capsys):
    status, text, _ = run(capsys, "prove", str(cases), "--jobs", "1")
    assert status == 0
    assert "score and report.html" in text
    page = (answers_folder(cases) / "report.html").read_text()
    assert page.count("<svg") == 2  # counts and the matrix; no sizes and no probabilities to draw
    assert "2 cases, seed 3" in page


def test_truth_is_not_touched_before_the_answers_are_frozen(cases, answered, monkeypatch):
    away = cases.with_name("elsewhere")
    truth_folder(cases).rename(away)
    with pytest.raises(BadProof, match="there is no such folder"):
        prove(cases, answers_folder(cases), jobs=1)
    assert (answers_folder(cases) / FROZEN).exists()  # everything was answered without it
    found = prove(cases, answers_folder(cases), truth=away, jobs=1)
    assert found["cases"] == 2
    assert len(answered) == 2  # and not answered again


def test_a_changed_truth_is_refused(cases, answered):
    edit(
        truth_folder(cases) / "case-002.json",
        lambda d: d["truth"].update(noise="low" if d["truth"]["noise"] != "low" else "high"),
    )
    with pytest.raises(BadProof, match=r"case-002\.json: the truth does not match"):
        prove(cases, answers_folder(cases), jobs=1)


def test_a_changed_answer_is_refused(cases, answered):
    out = answers_folder(cases)
    prove(cases, out, jobs=1)
    edit(out / ANSWERS / "case-001.json", lambda d: d.update(verdict="missing-physics"))
    with pytest.raises(BadProof, match="changed after it was frozen"):
        prove(cases, out, jobs=1)


def test_a_changed_manifest_is_refused(cases, answered):
    out = answers_folder(cases)
    prove(cases, out, jobs=1)
    edit(out / "manifest.json", lambda d: d.update(code="0"))
    with pytest.raises(BadProof, match="manifest was changed"):
        frozen_answers(out, read_commitments(cases))


@pytest.mark.parametrize("targets", ["none", {"Brier score": 0.05}, {"Brier score": {"at_most": "low"}}])
def test_targets_that_are_none_are_refused_in_one_line(cases, answered, capsys, targets):
    out = answers_folder(cases)
    prove(cases, out, jobs=1)
    edit(out / "manifest.json", lambda d: d.update(targets=targets))
    changed = digest(json.loads((out / "manifest.json").read_text()))
    edit(out / FROZEN, lambda d: d.update(manifest=changed))
    status, _, err = run(capsys, "prove", str(cases), "--jobs", "1")
    assert (status, err.count("\n")) == (2, 1)
    assert f"{out / 'manifest.json'}: not a manifest as vlab writes it" in err


def test_the_first_cases_can_be_answered_alone_and_no_others_left_out(cases, answered):
    out = answers_folder(cases)
    (truth_folder(cases) / "case-002.json").rename(truth_folder(cases) / "kept.json")  # it is not asked for
    assert prove(cases, out, first=1, jobs=1)["cases"] == 1
    assert len(answered) == 1
    assert prove(cases, out, jobs=1)["cases"] == 1  # frozen is frozen
    edit(out / FROZEN, lambda d: d["answers"].update({"case-002": d["answers"].pop("case-001")}))
    with pytest.raises(BadProof, match="answers were left out"):
        prove(cases, out, jobs=1)


def test_changed_recordings_are_refused(cases):
    path = cases / "case-001" / "run1.parquet"
    path.write_bytes(path.read_bytes()[:-1] + b"x")
    with pytest.raises(BadProof, match="not those that were committed to"):
        read_commitments(cases)


def test_answers_of_other_cases_are_refused(cases, answered):
    prove(cases, answers_folder(cases), jobs=1)
    edit(cases / "commitments.json", lambda d: d.update(plan="0" * 64))
    with pytest.raises(BadProof, match="given to other cases"):
        prove(cases, answers_folder(cases), jobs=1)
    with pytest.raises(BadProof, match=r"plan\.json"):
        open_truth(truth_folder(cases), read_commitments(cases), ["case-001"])


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["conceal", "--suite", "nul", "--out", "x"], "unknown suite 'nul'; did you mean 'null'?"),
        (["conceal"], "name the folder of the cases with --out"),
        (["conceal", "--n", "0", "--out", "x"], "0 cases cannot be made"),
        (["conceal", "--seed", "-1", "--out", "x"], "'-1' is no seed"),
        (["conceal", "--benches", "boat", "--out", "x"], "unknown bench 'boat'"),
        (["conceal", "--jobs", "-2", "--out", "x"], "jobs is -2"),
        (["prove", "x", "--first", "-1"], "first is -1"),
        (["conceal", "--only", "case-001", "--out", "x"], "--only belongs to --again"),
        (["conceal", "--with-truth", "--out", "x"], "--with-truth belongs to --again"),
        (["prove", "nowhere"], "there is no such file"),
        (["prove"], "name a folder of concealed cases, or say --quick"),
        (["prove", "x", "--quick"], "one of the two"),
        (["prove", "x", "--seed", "1"], "--seed belongs to --quick"),
    ],
)
def test_bad_input_is_one_line(capsys, tmp_path, monkeypatch, words, text):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, *words)
    assert (status, out) == (2, "")
    assert err.startswith("error: ")
    assert text in err
    assert err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_few_cases_are_proved_from_end_to_end(capsys, tmp_path):
    """Concealed, diagnosed and scored; what is asserted is that it holds together, not how good the answers are."""
    out = tmp_path / "proof"
    status, text, _ = run(
        capsys, "prove", "--quick", "--n", "2", "--seed", "4", "--json", "--baselines", "1", "--out", str(out)
    )
    document = json.loads(text)
    assert status == 0
    assert document["cases"] == 2
    assert document["seed"] == 4
    assert not document["failed"]
    assert {m["measure"] for m in document["measures"]} >= {"right effect, first answer", "Brier score"}
    assert all(j["verdict"] in get_args(Verdict) for j in document["judged"])
    assert (out / "cases-answers" / FROZEN).exists()
    assert (out / "cases-answers" / "report.html").exists()
