"""Real recordings beside what is known of them: keys, judgement, printed errors, kept answers, the command."""

import json
import shutil

import numpy as np
import pytest
from command import run as command

from vlab.cases import load_case
from vlab.errors import BadProof, OutputRefused
from vlab.files.assets import asset
from vlab.proof.real import prove as proving
from vlab.proof.real.folders import find_cases
from vlab.proof.real.judge import judge_real
from vlab.proof.real.known import Benchmark, KnownCase, KnownEffect, known_of, read_known
from vlab.proof.real.prove import prove_real
from vlab.proof.real.table import errors_by_model, markdown, metrics_of, percent
from vlab.views.figures.real import LEAST, MOST, real_figure

FRICTION = KnownEffect(effects=("coulomb-friction",), families=("friction",), places=("joint:a",))
DRAG = KnownEffect(effects=("quadratic-drag",), families=("damping",))
ABOUT = {"origin": "a rig", "licence": "MIT", "known": "friction", "source": "a paper"}


def key(*effects, abstention=False, benchmark=()):
    return KnownCase(name="one", effect=effects, abstention=abstention, benchmark=benchmark, **ABOUT)


def answer(*findings, verdict="missing-physics"):
    named = [
        {"effect": effect, "family": family, "place": place, "places": [{"place": place}], "probability": 0.9}
        for effect, family, place in findings
    ]
    return {"verdict": verdict, "findings": named}


COULOMB = ("coulomb-friction", "friction", "joint:a")
STRIBECK = ("stribeck-friction", "friction", "joint:a")
ELSEWHERE = ("coulomb-friction", "friction", "joint:b")
DRAGGED = ("quadratic-drag", "damping", "joint:a")
SPRING = ("cubic-stiffness", "nonlinear-stiffness", "joint:a")


@pytest.mark.parametrize(
    ("known", "given", "met", "further"),
    [
        (key(FRICTION), answer(COULOMB), "met", []),
        (key(FRICTION), answer(COULOMB, SPRING), "met", ["cubic-stiffness"]),
        (key(FRICTION), answer(STRIBECK), "family", []),
        (key(FRICTION), answer(ELSEWHERE), "family", []),
        (key(FRICTION), answer(SPRING), "missed", ["cubic-stiffness"]),
        (key(FRICTION), answer(verdict="none-of-these"), "abstained", []),
        (key(FRICTION, DRAG), answer(DRAGGED, COULOMB), "met", []),
        (key(FRICTION, DRAG), answer(COULOMB), "in part", []),
        (key(FRICTION, DRAG), answer(STRIBECK), "in part", []),
        (key(KnownEffect(families=("friction",))), answer(STRIBECK), "met", []),
        (key(abstention=True), answer(verdict="none-of-these"), "met", []),
        (key(abstention=True), answer(SPRING), "missed", ["cubic-stiffness"]),
        (key(FRICTION, abstention=True), answer(COULOMB), "met", []),
        (key(), answer(SPRING), "undocumented", ["cubic-stiffness"]),
        (None, answer(SPRING), "no key", ["cubic-stiffness"]),
        (key(FRICTION), {"verdict": "refused", "findings": [], "error": "no"}, "failed", []),
    ],
)
def test_an_answer_is_compared_with_its_key(known, given, met, further):
    found = judge_real(known, given)
    assert found["met"] == met
    assert found["further"] == further


def test_one_finding_meets_one_effect_and_the_best_fit_goes_first():
    either = KnownEffect(effects=("coulomb-friction", "quadratic-drag"), families=("friction",))
    found = judge_real(key(either, FRICTION), answer(COULOMB, DRAGGED))
    assert found["met"] == "met"
    assert [found[part] for part in ("effect", "family", "place")] == [True, True, True]
    assert found["probability"] == 0.9
    wrong_place = judge_real(key(FRICTION), answer(ELSEWHERE))
    assert [wrong_place[part] for part in ("effect", "family", "place")] == [True, True, False]


# ---- keys -----------------------------------------------------------------------------------------------------------

GOOD = 'name = "one"\norigin = "a"\nlicence = "b"\nknown = "c"\nsource = "d"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[case]]\n" + GOOD.replace('source = "d"\n', ""), "the key 'source' is missing"),
        ("[[case]]\n" + GOOD.replace('"d"', '" "'), "source is empty"),
        ("[[case]]\n" + GOOD + 'familes = ["friction"]\n', "unknown key 'familes'"),
        ("[[case]]\n" + GOOD + '[[case.effect]]\neffects = ["coulomb-frict"]\n', "did you mean 'coulomb-friction'"),
        ("[[case]]\n" + GOOD + '[[case.effect]]\nfamilies = ["fricton"]\n', "did you mean 'friction'"),
        ("[[case]]\n" + GOOD + '[[case.effect]]\nplaces = ["joint:a"]\n', "an effect needs effects, families or both"),
        (2 * ("[[case]]\n" + GOOD), "the name 'one' stands twice"),
        ("[[case]\n", "malformed TOML"),
    ],
)
def test_a_malformed_key_is_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "keys.toml"
    path.write_text(text)
    with pytest.raises(BadProof, match="keys.toml") as refused:
        read_known(path)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def test_every_shipped_case_has_a_key_whose_places_exist():
    cases = find_cases([asset("cases")])
    known = known_of(cases)
    assert len(cases) >= 11
    assert set(known) == {case.name for case in cases}
    for case in cases:
        plant = load_case(case.path)
        names = {tap.name for tap in plant.plant.sensors} | set(plant.plant.ports)
        names |= {f"actuator:{tap.name}" for tap in plant.plant.actuators}
        names |= {name for _, table in plant.recordings() for name in table.channel_names}
        for effect in known[case.name].effect:
            assert set(effect.places) <= names, case.name
        for mark in known[case.name].benchmark:
            assert all(mark.channel in table.channel_names for _, table in plant.recordings())


def test_a_key_beside_a_case_counts_first(tmp_path):
    folder = tmp_path / "emps"
    shutil.copytree(asset("cases/emps"), folder)
    cases = find_cases([folder])
    assert known_of(cases)["emps"].licence == "Apache-2.0"
    before = cases[0].data_digest()
    (folder / "known.toml").write_text("[[case]]\n" + GOOD.replace("one", "emps"))
    assert known_of(cases)["emps"].licence == "b"
    assert cases[0].data_digest() == before  # a key is no recording
    assert [case.name for case in find_cases([folder])] == ["emps"]


def test_cases_are_named_by_folder_and_file():
    names = [case.name for case in find_cases([asset("cases/three_storey"), asset("cases/emps/case.toml")])]
    assert names == ["three_storey-modal", "three_storey-southampton", "three_storey-swansea", "emps"]
    assert [case.name for case in find_cases([asset("cases/emps"), asset("cases/emps")])] == ["emps"]


# ---- printed errors -------------------------------------------------------------------------------------------------


def test_benchmark_errors_are_printed_in_their_unit():
    mark = Benchmark(name="B", channel="q", unit="mm", factor=1000.0, skip=20, remark="", source="")
    given = {
        **answer(COULOMB),
        "absolute": {
            "test": {"size": {"q": 0.05}, "nominal": {"q": 0.01}, "calibrated": {"q": 0.005}, "extended": {"q": 0.001}}
        },
    }
    boxes = {"linear": {"per_recording": [{"name": "test", "absolute": {"q": None}}]}, "nonlinear": {"note": "n"}}
    found = {one["model"]: one for one in metrics_of(key(FRICTION, benchmark=(mark,)), given, boxes)}
    assert found["nominal"]["rmse"] == pytest.approx(10.0)
    assert found["nominal"]["relative"] == pytest.approx(20.0)
    assert found["extended"]["rmse"] == pytest.approx(1.0)
    assert found["linear"]["rmse"] is None
    assert "nonlinear" not in found
    assert metrics_of(key(FRICTION), given, boxes) == []


def test_no_error_of_an_extended_model_without_findings():
    heldout = {"nrmse_nominal": 0.5, "nrmse_refitted": 0.2, "nrmse_after": 0.2}
    assert errors_by_model({"findings": [], "heldout": heldout}, {})["extended"] is None
    assert errors_by_model({**answer(COULOMB), "heldout": heldout}, {})["extended"] == 0.2


@pytest.mark.parametrize(
    ("error", "printed"), [(None, "-"), (0.00123, "0.12"), (0.0489, "4.9"), (0.377, "38"), (29.3, "> 1000")]
)
def test_relative_errors_are_printed_in_percent(error, printed):
    assert percent(error) == printed


def test_the_figure_shows_one_marker_a_model_and_keeps_extremes_on_the_axis():
    errors = {"nominal": 50.0, "calibrated": 0.4, "extended": 0.05, "linear": None, "nonlinear": 1e-7}
    row = {"case": "a", "is_held_out": True, "errors": errors, "noise": 0.01}
    figure = real_figure([row, {**row, "case": "fitted only", "is_held_out": False}])
    (axes,) = figure.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["a"]
    drawn = [float(line.get_xdata()[0]) for line in axes.lines if len(line.get_xdata()) == 1]
    assert sorted(drawn) == pytest.approx(sorted([MOST, 40.0, 5.0, LEAST, 1.0]))
    assert "%" in axes.get_xlabel()
    assert axes.get_xscale() == "log"


# ---- runs -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def frame(tmp_path_factory):
    """The modes of a frame, which take a second."""
    folder = tmp_path_factory.mktemp("real") / "frame"
    folder.mkdir()
    for name, new in (("modal.toml", "case.toml"), ("rig.xml", "rig.xml")):
        shutil.copy(asset(f"cases/three_storey/{name}"), folder / new)
    (folder / "known.toml").write_text("[[case]]\n" + GOOD.replace("one", "frame"))
    return folder


@pytest.fixture(scope="module")
def proved(frame):
    return prove_real([frame], frame.parent / "out", jobs=1)


def test_a_run_writes_its_result(frame, proved):
    out = frame.parent / "out"
    assert json.loads((out / "real.json").read_text()) == json.loads(json.dumps(proved))
    (row,) = proved["cases"]
    assert row["verdict"] == "none-of-these"
    assert row["met"] == "undocumented"
    assert not row["is_held_out"]
    assert "not applicable" in row["black_boxes"]["linear"]["note"]
    text = (out / "real.md").read_text()
    assert text == markdown(proved)
    assert "| frame | c | none-of-these | - | undocumented |" in text


def test_finished_answers_are_kept(frame, proved, monkeypatch):
    def never(item, **settings):
        raise AssertionError("answered again")

    monkeypatch.setattr(proving, "answer_real", never)
    monkeypatch.setattr(proving, "black_box_real", never)
    again = prove_real([frame.parent], frame.parent / "out", jobs=1)  # the folder of the folder, and only it
    assert again == proved


@pytest.mark.parametrize(("part", "value", "said"), [("code", "0", "another code"), ("data", "0", "other recordings")])
def test_answers_of_other_code_or_data_are_refused(frame, proved, tmp_path, part, value, said):
    out = tmp_path / "out"
    shutil.copytree(frame.parent / "out", out)
    path = out / "answers" / "frame.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), part: value}))
    with pytest.raises(BadProof, match=said):
        prove_real([frame], out, jobs=1)


def test_an_unreadable_case_is_a_failed_answer(frame, tmp_path):
    folder = tmp_path / "bad"
    shutil.copytree(frame, folder)
    (folder / "rig.xml").unlink()
    (row,) = prove_real([folder], tmp_path / "out", jobs=1)["cases"]
    assert row["verdict"] == "refused"
    assert row["met"] == "failed"
    assert "rig.xml" in row["error"]


def test_the_output_folder_lies_outside_the_cases(frame):
    with pytest.raises((BadProof, OutputRefused), match="--out"):
        prove_real([frame], frame / "out", jobs=1)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--real", "nowhere", "--out", "o"], "nowhere: there is no such folder"),
        (["--real", "empty", "--out", "o"], "empty: no case is in this folder"),
        (["--real", "empty"], "--out DIR"),
        (["--real", "empty", "--out", "o", "--quick"], "--quick does not go with --real"),
        (["--real", "empty", "--out", "o", "--time-limit", "0"], "time-limit is 0"),
        (["cases", "--keys", "k.toml"], "--keys belongs to --real"),
    ],
)
def test_wrong_words_are_refused_in_one_line(capsys, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    status, _, err = command(capsys, "prove", *words)
    assert status == 2
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_the_command_prints_the_table_and_draws(capsys, frame, proved):
    out = frame.parent / "out"
    status, text, _ = command(capsys, "prove", "--real", str(frame), "--out", str(out), "--jobs", "1")
    assert status == 0
    assert "none-of-these" in text
    assert "0 of 1 cases have a documented key" in text
    assert (out / "real.svg").read_text().startswith("<svg")
    assert np.isfinite(proved["cases"][0]["seconds"])
