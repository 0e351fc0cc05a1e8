"""The first minutes of a newcomer: init, check, diagnose, and what is typed wrongly on the way."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from arm_logs import ARM, write_arm, write_log
from command import run

from vlab.cli.diagnose import _next_command
from vlab.diagnose.advice import share

FRICTION = 0.15  # N m, in the elbow of the machine and not of the model


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Path:
    """Return the folder of a model and two logs with dry friction in the elbow, and a drafted case."""
    folder = tmp_path_factory.mktemp("arm")
    write_arm(folder, logs=2, seconds=6.0, friction=FRICTION)
    return folder


@pytest.fixture(scope="module")
def case(arm) -> Path:
    from vlab.cli import main

    assert main(["init", str(arm / "arm.xml"), *map(str, sorted(arm.glob("*.csv"))), "--out", str(arm / "case")]) == 0
    return arm / "case"


# ---- init -----------------------------------------------------------------------------------------------------------


def test_init_writes_a_case_and_says_the_next_command(capsys, arm, case, tmp_path):
    logs = [str(path) for path in sorted(arm.glob("*.csv"))]
    status, out, err = run(capsys, "init", str(arm / "arm.xml"), *logs, "--out", str(tmp_path / "new"), "--json")
    document = json.loads(out)
    assert (status, err) == (0, "")
    assert set(document) >= {"case", "channels", "unsure"}
    assert document["case"] == str(tmp_path / "new" / "case.toml")
    assert [c["at"] for c in document["channels"] if c["input"]] == ["shoulder_pan", "elbow_flex"]
    assert document["next"].startswith("vlab check ")
    assert document["next"].endswith("--allow-outside")
    status, out, _ = run(capsys, "init", str(arm / "arm.xml"), *logs, "--out", str(tmp_path / "new"), "--overwrite")
    assert status == 0
    assert "action.elbow_flex.pos" in out
    assert "held out, to verify what is found: run2.csv" in out
    assert f"next: vlab check {tmp_path / 'new' / 'case.toml'}" in out


def test_init_writes_beside_the_logs_and_never_over_a_case(capsys, tmp_path):
    model, logs = write_arm(tmp_path / "my logs", logs=1, seconds=2.0)
    line = ["init", str(model), str(logs[0])]
    assert run(capsys, *line)[0] == 0
    before = (tmp_path / "my logs" / "case.toml").read_text()
    (tmp_path / "my logs" / "case.toml").write_text("mine")
    status, out, err = run(capsys, *line)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "case.toml is there already; name another folder with --out, or add --overwrite" in err
    assert (tmp_path / "my logs" / "case.toml").read_text() == "mine"
    assert run(capsys, *line, "--overwrite")[0] == 0
    assert (tmp_path / "my logs" / "case.toml").read_text() == before
    status, out, err = run(capsys, *line, "--out", str(tmp_path / "mine.toml"))
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "looks like a file; case.toml is written inside the folder" in err
    assert not (tmp_path / "mine.toml").exists()


# ---- check ----------------------------------------------------------------------------------------------------------


def test_check_tells_each_channel_beside_its_simulation(capsys, case, tmp_path):
    line = ["check", str(case), "--allow-outside", "--json", "--out", str(tmp_path / "out")]
    status, out, err = run(capsys, *line)
    document = json.loads(out)
    assert (status, err) == (0, "")
    assert set(document) >= {"findings", "refused", "seconds_expected"}
    assert document["refused"] == []
    assert document["seconds_expected"] > 0.0
    (elbow,) = (c for c in document["channels"] if c["channel"] == "joint:elbow_flex" and c["role"] == "fit")
    assert elbow["correlation"] > 0.99
    assert elbow["simulated_rms"] == pytest.approx(elbow["recorded_rms"], rel=0.1)
    assert elbow["period_s"] == pytest.approx(0.02)
    assert 0.0 < elbow["low_hz"] < elbow["high_hz"] < 2.6  # lines from 0.2 to 2.2 Hz
    assert elbow["noise"] == pytest.approx(2e-4, rel=0.5)
    assert abs(elbow["delay_s"]) < 0.02
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"check.png", "check.json", "manifest.json"}
    assert (tmp_path / "out" / "check.png").read_bytes().startswith(b"\x89PNG")


def edited(case: Path, folder: Path, old: str, new: str) -> Path:
    """Return a copy of a case with another text, with its files named from there."""
    text = (case / "case.toml").read_text().replace("../", f"{case.parent.resolve()}/")
    assert old in text
    folder.mkdir()
    (folder / "case.toml").write_text(text.replace(old, new))
    return folder


def test_check_names_a_turned_sign_and_its_line(capsys, case, tmp_path):
    wrong = edited(
        case, tmp_path / "case", 'column = "elbow_flex.pos"', 'column = "elbow_flex.pos"\nscale = -0.017453292519943295'
    )
    status, out, _ = run(capsys, "check", str(wrong), "--allow-outside", "--json")
    document = json.loads(out)
    assert status == 0
    rows = [c for c in document["channels"] if c["channel"] == "joint:elbow_flex"]
    assert all(row["correlation"] < -0.9 for row in rows)
    (found,) = (f for f in document["findings"] if f["channel"] == "joint:elbow_flex" and f["mend"])
    assert "sign turned" in found["what"]
    assert found["mend"].startswith("scale = 0.01745")
    _, out, _ = run(capsys, "check", str(wrong), "--allow-outside")
    assert out.index("First correct the case as the warnings say") < out.index("next: vlab diagnose")


def test_check_says_what_diagnose_would_refuse(capsys, case, tmp_path):
    wrong = edited(case, tmp_path / "case", 'role = "fit"', 'role = "holdout"')
    status, out, _ = run(capsys, "check", str(wrong), "--allow-outside")
    assert status == 0
    assert "vlab diagnose would refuse the case: " in out
    assert "no [[recording]] has the role fit" in out
    assert "next:" not in out


def test_contacts_along_the_recorded_motion_are_refused_before_any_search(capsys, case, tmp_path, monkeypatch):
    touching = ARM.replace('contype="0" conaffinity="0"', "").replace(
        "<worldbody>", '<worldbody><geom name="floor" type="plane" size="2 2 0.1" pos="0 0 0.1"/>'
    )
    wrong = edited(case, tmp_path / "case", "arm.xml", "touching.xml")
    (case.parent / "touching.xml").write_text(touching)
    status, out, _ = run(capsys, "check", str(wrong), "--allow-outside", "--json")
    assert status == 0
    assert any("touch in" in why and "floor" in why for why in json.loads(out)["refused"])

    def searched(*args):
        raise AssertionError("a linearisation about touching bodies may be singular")

    monkeypatch.setattr("vlab.diagnose.pipeline.choose_model_class", searched)
    status, out, err = run(capsys, "diagnose", str(wrong), "--allow-outside")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "touch in" in err


@pytest.mark.parametrize(
    ("part", "text"), [(0.5, "50 %"), (0.994, "99 %"), (0.99504, "99.5 %"), (0.99996, "99.99 %"), (1.0, "100 %")]
)
def test_all_is_explained_only_where_nothing_is_left(part, text):
    assert share(part) == text


def test_the_next_command_names_the_written_model():
    assert _next_command(Path("out/emps"), is_complete=True) == "vlab compare out/emps/amended.toml"
    on = "vlab diagnose 'out/my arm/amended.toml' --out 'out/my arm-2'"
    assert _next_command(Path("out/my arm"), is_complete=False) == on


def test_diagnose_alone_asks_for_a_case_and_for_no_log(capsys):
    status, _, err = run(capsys, "diagnose")
    assert status == 2
    assert "required: case (" in err


# ---- diagnose -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_model_and_its_logs_are_diagnosed_in_one_command(capsys, tmp_path, monkeypatch):
    model, logs = write_arm(tmp_path / "arm", logs=3, friction=FRICTION)
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "diagnose", str(model), *map(str, logs), "--json")
    document = json.loads(out)
    assert status == 0
    assert document["out"] == "out/diagnosis-001"
    assert document["case"] == "out/diagnosis-001/case.toml"
    (finding,) = document["findings"]
    assert (finding["effect"], finding["place"]) == ("coulomb-friction", "joint:elbow_flex")
    assert finding["parameters"]["force"]["value"] == pytest.approx(FRICTION, rel=0.1)
    written = {p.name for p in (tmp_path / "out" / "diagnosis-001").iterdir()}
    assert written >= {"case.toml", "check.png", "check.json", "report.html", "diagnosis.json", "amended.toml"}
    status, out, _ = run(capsys, "compare", "out/diagnosis-001/case.toml", "--allow-outside")
    assert status == 0


def test_an_error_of_the_search_leaves_the_drafted_case(capsys, monkeypatch, arm, tmp_path):
    from vlab.cli import diagnose as verb
    from vlab.errors import BadCase

    def refuse(*given, **options):
        raise BadCase("too far from linear")

    monkeypatch.setattr(verb, "diagnose", refuse)
    logs = [str(path) for path in sorted(arm.glob("*.csv"))]
    status, _, err = run(capsys, "diagnose", str(arm / "arm.xml"), *logs, "--out", str(tmp_path / "out"))
    assert (status, "too far from linear" in err) == (2, True)
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"case.toml", "check.png", "check.json", "manifest.json"}


def test_an_interrupted_search_does_not_block_the_next_one(capsys, monkeypatch, arm, tmp_path):
    from vlab.cli import diagnose as verb
    from vlab.errors import BadCase

    stop: list[BaseException] = [KeyboardInterrupt(), BadCase("too far from linear")]

    def end(*given, **options):
        raise stop[0]

    monkeypatch.setattr(verb, "diagnose", end)
    out = tmp_path / "out"
    line = ["diagnose", str(arm / "arm.xml"), *map(str, sorted(arm.glob("*.csv"))), "--out", str(out)]
    status, _, err = run(capsys, *line)
    assert (status, err.count("\n")) == (130, 1)
    assert f"{out} holds the drafted case without a diagnosis; next: vlab diagnose {out / 'case.toml'}" in err
    stop.pop(0)
    status, _, err = run(capsys, *line)  # as if nothing had been there
    assert (status, "too far from linear" in err) == (2, True)
    (out / "case.toml").write_text((out / "case.toml").read_text() + "# my own remark\n")
    status, _, err = run(capsys, *line)
    assert (status, "is there already" in err) == (2, True)
    assert "# my own remark" in (out / "case.toml").read_text()


# ---- typed wrongly --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["diagnose", "arm.xml"], "draft a case: vlab init arm.xml LOG..."),
        (["compare", "arm.xml"], "draft a case: vlab init arm.xml LOG..."),
        (["check", "arm.xml"], "draft a case: vlab init arm.xml LOG..."),
        (["modes", "arm.xml"], "this is XML, such as a MuJoCo model"),
        (["compare", "run1.csv"], "this is a recording, and a case is a TOML file"),
        (["diagnose", "."], "there is no case.toml in this folder; draft one: vlab init MODEL.xml LOG... --out ."),
        (["diagnose", "case.toml", "run1.csv"], "case.toml is a case, which names its recordings itself"),
        (["diagnose", "case.toml", "--time", "t"], "--time is for logs after a model"),
        (["init", "arm.xml"], "required: LOG"),
        (["init", "run1.csv", "arm.xml"], "give the model first, then its logs"),
        (["init", "arm.xml", "nowhere.csv"], "nowhere.csv"),
        (["init", "arm.xml", "run1.csv", "--time", "timestmp"], "did you mean 'timestamp'?"),
        (["init", "arm.xml", "run1.csv", "--rate", "50"], "did you mean '--rate-hz'?"),
        (["chek", "case.toml"], "did you mean 'check'?"),
    ],
)
def test_a_wrong_line_names_the_right_one(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(ARM)
    write_log(Path("run1.csv"), 1, 0.5)
    if "case.toml" in words:
        Path("case.toml").write_text("title = 'mine'")
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    status, out, err = run(capsys, *words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert message in err
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_noise_of_a_constant_reading_is_no_fault(capsys, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    time = 0.02 * np.arange(200)
    still = np.full(200, 0.1)
    table = np.column_stack([time, np.sin(time), still, np.sin(time) * np.minimum(1, time), still])
    names = "t,shoulder_pan_cmd,elbow_flex_cmd,shoulder_pan_pos,elbow_flex_pos"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=names, comments="")
    status, out, _ = run(capsys, "init", str(tmp_path / "arm.xml"), str(tmp_path / "log.csv"))
    assert status == 0
    assert "elbow_flex_pos: it is 0.1 throughout" in out
    status, out, _ = run(capsys, "check", str(tmp_path))
    assert status == 0
    assert "no channel shows the joint 'elbow_flex'" in out


def test_modules_of_a_command_are_left_out_of_collections():
    code = (
        "import gc; from vlab.cli import main; main(['effects']); print(gc.isenabled(), gc.get_freeze_count() > 10_000)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-2:] == ["True", "True"]
